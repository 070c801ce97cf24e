//! `size`: the paper's figure 12. Messages of 1, 2, 4 and 8 KB, many of each uploaded at once: sealed, stored and
//! anchored as we do it, and as in the prototype, which stores ciphertexts on the chain.

use std::collections::BTreeMap;
use std::sync::Arc;

use serde::Serialize;
use serde_json::json;

use super::Lab;
use super::args::SizeArguments;
use super::consensus::{Paper, milliseconds, ordered, tell_failures};
use super::judgement::Judgement;
use super::network::{Directory, Network};
use super::plot::{Axis, Bar, COLOURS, Mark, PAPER, Plot, RGBColor, Series};
use super::prototype::Prototype;
use super::report::{Measured, Report};
use super::spread::{Spread, decimal, number};
use super::uploads::{Load, MESSAGE, Outcome, Way, run as upload};
use authros_output::table;
use authros_service::Failure;

/// The paper's four.
const SIZES: [usize; 4] = [1024, 2048, 4096, 8192];
/// On the embedded PoW chain, where a block takes seconds and holds three prototype uploads of 8 KB, the prototype has
/// this share of the uploads.
const PROTOTYPE_SHARE: usize = 10;

const NOTES: [&str; 6] = [
    "ours: a message is sealed and signed, its ciphertext is stored on disk, and its digest is anchored: batch = under a \
     Merkle root with others (closed at 256 records or after a second), each = by a dataUpload of its own.",
    "prototype: the ciphertext itself, as long as the message, is stored on the chain, in a contract that follows the \
     paper's description (contracts/bench); nothing is stored elsewhere. On the embedded pow it has a tenth of the uploads.",
    "response: from the common start to an upload's receipt, including waiting for others; total: to the last receipt; \
     per upload: total over uploads. All in milliseconds.",
    "The authors give milliseconds per request of 1 KB; of the larger sizes the paper draws curves (figure 12) and \
     prints no numbers.",
    "Their networks ran geth on their machine, with block periods that the paper does not give; ours differ.",
    "Our pow is real work at the paper's difficulty, but Keccak-256, not ethash; its block times are random, so the \
     times of a single run mean little: compare gas, and many runs on one machine.",
];

/// One size and method on one network.
#[derive(Debug, Serialize)]
struct Row {
    network: &'static str,
    consensus: String,
    /// `batch`, `each` or `prototype`.
    way: &'static str,
    uploads: usize,
    succeeded: usize,
    /// Percent.
    success: f64,
    #[serde(flatten)]
    measured: Measured,
    total: f64,
    per_upload: f64,
    uploads_per_second: f64,
    transactions: u64,
    gas: u64,
    gas_per_upload: f64,
    blocks: usize,
    paper: Option<Paper>,
    failures: BTreeMap<String, u64>,
}

impl Row {
    fn network_name(&self) -> String {
        format!("{} {}", self.network, self.consensus)
    }
}

/// Uploads all sizes with every method on every network.
///
/// # Errors
/// If a network cannot be opened, or its count differs from the receipts.
pub async fn run(lab: &Lab, arguments: &SizeArguments) -> Result<Judgement, Failure> {
    let (mut results, mut presets) = (Vec::new(), Vec::new());
    let uploads = usize::try_from(arguments.runs).unwrap_or(usize::MAX);
    for place in arguments.network.places() {
        let directory = Directory::new()?;
        let network = Arc::new(Network::open(&place, lab.provider, directory.path(), lab.funder.as_ref()).await?);
        presets.push(network.preset());
        let prototype = Arc::new(deploy(&network).await?);
        let slow = network.is_embedded() && network.consensus == "pow";
        let few = if slow { uploads.div_ceil(PROTOTYPE_SHARE) } else { uploads };
        for bytes in SIZES {
            let ways = [(Way::Batch, uploads), (Way::Each, uploads), (Way::Prototype(Arc::clone(&prototype)), few)];
            for (way, uploaders) in ways {
                let load = Load { way, bytes, uploaders };
                let outcome = upload(&network, &load).await?;
                results.push(row(&network, &load, outcome));
            }
        }
    }
    let title = "Uploads by size of message: ours and ciphertexts on the chain (the paper's figure 12)";
    let report = Report::new("figure-12-size", title, &NOTES, json!({ "networks": presets }), results);
    lab.outlet.show(&report, &tables(&report.results, &presets), &report.page(2, plots(&report.results)))?;
    let failures = report.results.iter().map(|row| (row.network_name(), row.way, &row.failures));
    Ok(tell_failures(lab, failures))
}

/// The prototype's contract, with both accounts registered.
async fn deploy(network: &Network) -> Result<Prototype, Failure> {
    let chain = &network.chain;
    let [first, _] = &network.accounts;
    let prototype = Prototype::deploy(chain, &first.eoa, chain.nonce(first.address, true).await?).await?;
    for account in &network.accounts {
        prototype.register(chain, &account.eoa, chain.nonce(account.address, true).await?).await?;
    }
    Ok(prototype)
}

fn row(network: &Network, load: &Load, outcome: Outcome) -> Row {
    let (uploads, succeeded) = (number(outcome.uploaders), outcome.responses.len());
    let total = milliseconds(outcome.total);
    let done = number(succeeded);
    Row {
        network: network.kind,
        consensus: network.consensus.clone(),
        way: load.way.word(),
        uploads: outcome.uploaders,
        succeeded,
        success: done * 100.0 / uploads,
        measured: Measured {
            bytes: load.bytes as u64,
            runs: succeeded as u64,
            unit: "ms",
            spread: Spread::of(&outcome.responses),
        },
        total,
        per_upload: total / done,
        uploads_per_second: done * 1000.0 / total,
        transactions: outcome.transactions,
        gas: outcome.gas,
        gas_per_upload: number(outcome.gas / 1000) * 1000.0 / done,
        blocks: outcome.blocks.len(),
        paper: if load.bytes == MESSAGE { Paper::of(&network.consensus, uploads) } else { None },
        failures: outcome.failures,
    }
}

fn tables(rows: &[Row], presets: &[String]) -> Vec<String> {
    let head = [
        "network",
        "way",
        "bytes",
        "success",
        "min",
        "p50",
        "p95",
        "max",
        "total",
        "per upload",
        "authors'",
        "uploads/s",
        "gas per upload",
        "tx",
        "blocks",
    ];
    let all: Vec<Vec<String>> = rows.iter().map(cells).collect();
    vec![beside(rows), table(&head, &all), presets.join("\n")]
}

/// The paper's comparison: ours beside the prototype's.
fn beside(rows: &[Row]) -> String {
    let head = ["network", "bytes", "ours, batch", "ours, each", "prototype", "times batch", "times each"];
    let line = |ways: &[Row]| {
        let [batch, each, prototype] = ways else { return None };
        let times = [batch, each, prototype].map(|row| row.per_upload);
        let mut cells = vec![batch.network_name(), batch.measured.bytes.to_string()];
        cells.extend(times.map(decimal));
        cells.extend([times[0], times[1]].map(|ours| decimal(times[2] / ours)));
        Some(cells)
    };
    format!("milliseconds per upload\n{}", table(&head, rows.chunks(3).filter_map(line)))
}

fn cells(row: &Row) -> Vec<String> {
    let Spread { min, p50, p95, max } = row.measured.spread;
    let mut cells = vec![row.network_name(), row.way.to_owned(), row.measured.bytes.to_string()];
    cells.push(format!("{} %", decimal(row.success)));
    cells.extend([min, p50, p95, max, row.total, row.per_upload].map(decimal));
    let authors =
        row.paper.map(|paper| format!("{}-{}", decimal(paper.per_request_from), decimal(paper.per_request_to)));
    cells.push(authors.unwrap_or("-".to_owned()));
    cells.extend([decimal(row.uploads_per_second), decimal(row.gas_per_upload)]);
    cells.extend([row.transactions.to_string(), row.blocks.to_string()]);
    cells
}

/// The average time of an upload by the size of its message, and the responses below it.
fn plots(rows: &[Row]) -> Vec<Plot> {
    let names = ordered(rows.iter().map(Row::network_name));
    let of = |name: &String| rows.iter().filter(|row| row.network_name() == *name).collect::<Vec<_>>();
    let averages = names.iter().map(|name| per_upload(name, &of(name)));
    averages.chain(names.iter().map(|name| response(name, &of(name)))).collect()
}

fn sizes() -> Axis {
    Axis::places("size of a message", SIZES.map(|bytes| format!("{} KB", bytes / 1024)))
}

/// One bar for each size of a method.
fn series(name: &str, colour: RGBColor, rows: &[&Row], way: &str, bar: fn(&Row) -> Option<Bar>) -> Series {
    let bars = SIZES.map(|bytes| {
        rows.iter().find(|row| row.way == way && row.measured.bytes == bytes as u64).and_then(|row| bar(row))
    });
    Series::new(name, colour, Mark::Bars(bars.into()))
}

fn ways(rows: &[&Row], bar: fn(&Row) -> Option<Bar>) -> Vec<Series> {
    vec![
        series("ours, batch", COLOURS[0], rows, "batch", bar),
        series("ours, each", COLOURS[1], rows, "each", bar),
        series("prototype's way", COLOURS[4], rows, "prototype", bar),
    ]
}

fn per_upload(name: &str, rows: &[&Row]) -> Plot {
    let mut series = ways(rows, |row| Bar::plain(row.per_upload));
    series.push(self::series("authors, per request", PAPER, rows, "each", |row| row.paper?.per_request_bar()));
    Plot {
        title: format!("{name}: average time of an upload"),
        across: sizes(),
        left: Axis::decades("total over uploads, ms", series.iter().flat_map(Series::values)),
        right: None,
        series,
    }
}

fn response(name: &str, rows: &[&Row]) -> Plot {
    let series = ways(rows, |row| {
        let spread = row.measured.spread;
        Bar::between(spread.p50 / 1e3, spread.min / 1e3, spread.p95 / 1e3)
    });
    Plot {
        title: format!("{name}: response, median; whiskers: least, p95"),
        across: sizes(),
        left: Axis::from_zero("response, s", series.iter().flat_map(Series::values)),
        right: None,
        series,
    }
}
