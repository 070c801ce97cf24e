//! `authros bench size`: the paper's figure 12. Messages of 1, 2, 4 and 8 KB, many of each uploaded at once: sealed,
//! stored and anchored as we do it, and as in the prototype, which stores ciphertexts on the chain.

mod plots;

use std::sync::Arc;

use serde::Serialize;
use serde_json::{Map, Value, json};

use super::consensus::{Paper, milliseconds};
use super::funder::Funder;
use super::judgement::Judgement;
use super::machine::Machine;
use super::network::{Directory, Network, Place, reach};
use super::outlet::Outlet;
use super::prototype::Prototype;
use super::report::{Measured, Report};
use super::spread::{Spread, bars, decimal, histogram, number};
use super::uploads::{Load, MESSAGE, Outcome, Way, run as upload};
use crate::args::SizeArguments;
use authros_crypto::Provider;
use authros_output::table;
use authros_service::Failure;

/// The paper's four.
const SIZES: [usize; 4] = [1024, 2048, 4096, 8192];

const NOTES: [&str; 6] = [
    "ours: a message is sealed and signed, its ciphertext is stored on disk, and its digest is anchored: batch = under a \
     Merkle root with others (closed at 256 records or after a second), each = by a dataUpload of its own.",
    "prototype: the ciphertext itself, as long as the message, is stored on the chain, in a contract that follows the \
     paper's description (contracts/bench); nothing is stored elsewhere.",
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
    /// `ours` or `prototype`.
    way: &'static str,
    /// `batch` or `each`.
    mode: &'static str,
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
    #[serde(skip)]
    responses: Vec<f64>,
    failures: std::collections::BTreeMap<String, u64>,
}

impl Row {
    fn network_name(&self) -> String {
        format!("{} {}", self.network, self.consensus)
    }

    /// `batch`, `each` or `prototype`.
    fn column(&self) -> &'static str {
        if self.way == "ours" { self.mode } else { self.way }
    }
}

/// Uploads all sizes with every method on every network; exit code 8 if an upload failed.
///
/// # Errors
/// If a network cannot be opened, or its count differs from the receipts.
pub async fn run(
    arguments: SizeArguments,
    provider: &'static dyn Provider,
    outlet: &Outlet,
    funder: Option<&Funder>,
) -> Result<Judgement, Failure> {
    if let Some(url) = &arguments.node {
        reach(url).await?;
    }
    let mut places: Vec<Place> = arguments.networks.iter().map(|network| Place::Embedded((*network).into())).collect();
    places.extend(arguments.node.map(Place::Node));
    let (mut results, mut presets) = (Vec::new(), Vec::new());
    for place in &places {
        let directory = Directory::new()?;
        let network = Arc::new(Network::open(place, provider, directory.path(), funder).await?);
        presets.push(network.preset());
        let prototype = Arc::new(deploy(&network).await?);
        for bytes in SIZES {
            for way in [Way::Batch, Way::Each, Way::Prototype(Arc::clone(&prototype))] {
                let load = Load { way, bytes, uploaders: arguments.runs as usize };
                let outcome = upload(&network, &load).await?;
                results.push(row(&network, &load, outcome));
            }
        }
    }
    let report = Report { name: "size", machine: Machine::read(), about: about(&presets), results };
    outlet.show(&report, || text(&report, &presets), || plots::page(&report))?;
    Ok(judged(&report.results, outlet))
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
    let (way, mode) = match &load.way {
        Way::Prototype(_) => ("prototype", "each"),
        ours => ("ours", ours.word()),
    };
    Row {
        network: network.kind,
        consensus: network.consensus.clone(),
        way,
        mode,
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
        responses: outcome.responses,
        failures: outcome.failures,
    }
}

fn judged(rows: &[Row], outlet: &Outlet) -> Judgement {
    let mut failed = false;
    for row in rows {
        for (why, times) in &row.failures {
            failed = true;
            let what = (row.network_name(), row.column(), row.measured.bytes);
            outlet.note(&format!("authros: {}, {}, {} bytes: {times} uploads failed: {why}", what.0, what.1, what.2));
        }
    }
    Judgement::complete(!failed)
}

fn about(presets: &[String]) -> Map<String, Value> {
    let mut about = Map::new();
    about.insert("networks".to_owned(), json!(presets));
    about.insert("notes".to_owned(), json!(NOTES));
    about
}

fn text(report: &Report<Row>, presets: &[String]) -> String {
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
    let rows: Vec<Vec<String>> = report.results.iter().map(cells).collect();
    let mut lines = vec![
        "size: uploads of 1 to 8 KB, all of a size at once, on two accounts; response and totals in ms".to_owned(),
        format!("machine: {}", report.machine.line()),
        "\nours and the prototype: total in ms, and the ratio of prototype to ours".to_owned(),
        columns(&report.results),
        "\nall figures".to_owned(),
        table(&head, &rows),
        "\nper upload".to_owned(),
    ];
    let name = |row: &Row| format!("{}, {}, {} bytes", row.network_name(), row.column(), row.measured.bytes);
    lines.extend(bars(&report.results.iter().map(|row| (name(row), row.per_upload)).collect::<Vec<_>>(), "ms"));
    for row in report.results.iter().filter(|row| row.measured.bytes == SIZES[3] as u64) {
        lines.push(format!("\nresponse of {}", name(row)));
        lines.extend(histogram(&row.responses, "ms"));
    }
    lines.push(String::new());
    lines.extend_from_slice(presets);
    lines.extend(NOTES.map(str::to_owned));
    lines.join("\n")
}

/// The two columns of the paper's comparison: ours beside the prototype's.
fn columns(rows: &[Row]) -> String {
    let head = ["network", "bytes", "ours, batch", "ours, each", "prototype", "times batch", "times each"];
    let beside = rows.chunks(3).filter_map(|ways| {
        let [batch, each, prototype] = ways else { return None };
        let totals = [batch.total, each.total, prototype.total];
        let mut cells = vec![batch.network_name(), batch.measured.bytes.to_string()];
        cells.extend(totals.map(decimal));
        cells.extend([totals[0], totals[1]].map(|ours| decimal(totals[2] / ours)));
        Some(cells)
    });
    table(&head, &beside.collect::<Vec<_>>())
}

fn cells(row: &Row) -> Vec<String> {
    let Spread { min, p50, p95, max } = row.measured.spread;
    let mut cells = vec![row.network_name(), row.column().to_owned(), row.measured.bytes.to_string()];
    cells.push(format!("{} %", decimal(row.success)));
    cells.extend([min, p50, p95, max, row.total, row.per_upload].map(decimal));
    let authors =
        row.paper.map(|paper| format!("{}-{}", decimal(paper.per_request_from), decimal(paper.per_request_to)));
    cells.push(authors.unwrap_or("-".to_owned()));
    cells.extend([decimal(row.uploads_per_second), decimal(row.gas_per_upload)]);
    cells.extend([row.transactions.to_string(), row.blocks.to_string()]);
    cells
}
