//! `consensus`: the paper's figure 11. Many upload at once, on the embedded chain by authority and by work or on a
//! node, one by one and in batches, beside the authors' figures.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use serde::Serialize;
use serde_json::json;

use super::Lab;
use super::args::ConsensusArguments;
use super::judgement::Judgement;
use super::network::{Directory, Network};
use super::plot::{Axis, Bar, COLOURS, Mark, PAPER, Plot, Series};
use super::report::{Measured, Report};
use super::spread::{Spread, decimal, number};
use super::uploads::{Load, MESSAGE, Outcome, Way, run as upload};
use authros_output::table;
use authros_service::Failure;

const NOTES: [&str; 6] = [
    "each: one dataUpload transaction per record; batch: Merkle roots, closed at 256 records, after a second, or when \
     nothing arrives for 10 ms and no earlier batch is waiting for a block (at most four times in a row).",
    "response: from the common start to an uploader's receipt, including sealing, storing and waiting for others; \
     total: from the start to the last receipt. Both in milliseconds.",
    "The authors give milliseconds per request; their total here is that times the number of uploaders, and times \
     theirs is our uploads per second divided by one per their shortest request.",
    "To see what a chain sustains beyond a burst, use --uploaders 10000.",
    "Their networks ran geth on their machine, with block periods that the paper does not give; ours differ (period), \
     so only a user's waiting time can be compared, not the consensus itself.",
    "Our pow is real work at the paper's difficulty, but Keccak-256, not ethash: a hash is cheaper, so a block is too.",
];

/// The authors' raw figures: milliseconds per request and success, from and to.
#[derive(Debug, Clone, Copy, Serialize)]
#[allow(missing_docs, reason = "the type's line says it")]
pub struct Paper {
    pub per_request_from: f64,
    pub per_request_to: f64,
    pub total_from: f64,
    pub total_to: f64,
    pub success_from: f64,
    pub success_to: f64,
}

impl Paper {
    /// For a consensus they measured, for this many uploads of 1 KB.
    pub fn of(consensus: &str, uploaders: f64) -> Option<Self> {
        let (from, to) = match consensus {
            "poa" => (15.4, 15.8),
            "pow" => (52.0, 55.0),
            _ => return None,
        };
        Some(Self {
            per_request_from: from,
            per_request_to: to,
            total_from: from * uploaders,
            total_to: to * uploaders,
            success_from: 99.7,
            success_to: 99.9,
        })
    }

    /// A bar of their milliseconds per request.
    pub fn per_request_bar(self) -> Option<Bar> {
        let (from, to) = (self.per_request_from, self.per_request_to);
        Bar::between(f64::midpoint(from, to), from, to)
    }
}

/// One run.
#[derive(Debug, Serialize)]
struct Row {
    network: &'static str,
    consensus: String,
    client: String,
    mode: &'static str,
    uploaders: usize,
    succeeded: usize,
    /// Percent.
    success: f64,
    #[serde(flatten)]
    measured: Measured,
    total: f64,
    /// From the first transaction sent to the last receipt.
    on_chain: f64,
    per_request: f64,
    uploads_per_second: f64,
    /// The ratio to the authors' time, taking their fastest request.
    times_authors: Option<f64>,
    transactions: u64,
    gas: u64,
    blocks: usize,
    /// As configured, milliseconds; `None` if the chain has none or does not say.
    period_set: Option<u64>,
    /// Observed between blocks of the run, milliseconds; `None` for a single block.
    period_seen: Option<f64>,
    difficulty: Option<u64>,
    gas_limit: u64,
    paper: Option<Paper>,
    failures: BTreeMap<String, u64>,
}

impl Row {
    fn network_name(&self) -> String {
        format!("{} {}", self.network, self.consensus)
    }
}

/// Runs all combinations.
///
/// # Errors
/// If a network cannot be opened, or its count differs from the receipts.
pub async fn run(lab: &Lab, arguments: &ConsensusArguments) -> Result<Judgement, Failure> {
    let (mut results, mut presets) = (Vec::new(), Vec::new());
    for place in arguments.network.places() {
        let directory = Directory::new()?;
        let network = Arc::new(Network::open(&place, lab.provider, directory.path(), lab.funder.as_ref()).await?);
        presets.push(network.preset());
        for uploaders in &arguments.uploaders {
            for way in [Way::Each, Way::Batch] {
                let load = Load { way, bytes: MESSAGE, uploaders: usize::try_from(*uploaders).unwrap_or(usize::MAX) };
                let outcome = upload(&network, &load).await?;
                results.push(row(&network, load.way.word(), outcome));
            }
        }
    }
    let preset = json!({ "message_bytes": MESSAGE, "accounts": 2 });
    let about = json!({ "preset": preset, "networks": presets });
    let title = "Uploads at once: total time and success (the paper's figure 11)";
    let report = Report::new("figure-11-consensus", title, &NOTES, about, results);
    lab.outlet.show(&report, &tables(&report.results, &presets), &report.page(2, plots(&report.results)))?;
    let failures = report.results.iter().map(|row| (row.network_name(), row.mode, &row.failures));
    Ok(tell_failures(lab, failures))
}

/// Reports failed uploads; complete if there were none.
pub fn tell_failures<'a>(
    lab: &Lab,
    runs: impl Iterator<Item = (String, &'static str, &'a BTreeMap<String, u64>)>,
) -> Judgement {
    let mut failed = false;
    for (network, way, failures) in runs {
        for (why, times) in failures {
            failed = true;
            lab.outlet.note(&format!("authros-bench: {network}, {way}: {times} uploads failed: {why}"));
        }
    }
    Judgement::complete(!failed)
}

/// A time in milliseconds.
pub fn milliseconds(time: Duration) -> f64 {
    time.as_secs_f64() * 1000.0
}

fn row(network: &Network, mode: &'static str, outcome: Outcome) -> Row {
    let uploaders = number(outcome.uploaders);
    let succeeded = outcome.responses.len();
    let (total, on_chain) = (milliseconds(outcome.total), milliseconds(outcome.on_chain));
    let uploads_per_second = number(succeeded) * 1000.0 / total;
    let paper = Paper::of(&network.consensus, uploaders);
    Row {
        network: network.kind,
        consensus: network.consensus.clone(),
        client: network.client.clone(),
        mode,
        uploaders: outcome.uploaders,
        succeeded,
        success: number(succeeded) * 100.0 / uploaders,
        measured: Measured {
            bytes: MESSAGE as u64,
            runs: succeeded as u64,
            unit: "ms",
            spread: Spread::of(&outcome.responses),
        },
        total,
        on_chain,
        per_request: total / number(succeeded),
        uploads_per_second,
        times_authors: paper.map(|paper| uploads_per_second * paper.per_request_from / 1000.0),
        transactions: outcome.transactions,
        gas: outcome.gas,
        blocks: outcome.blocks.len(),
        period_set: network.sealing.period,
        period_seen: period_seen(&outcome.blocks),
        difficulty: network.sealing.difficulty.as_ref().and_then(|text| text.parse().ok()),
        gas_limit: network.gas_limit,
        paper,
        failures: outcome.failures,
    }
}

fn period_seen(blocks: &[Instant]) -> Option<f64> {
    let gaps = blocks.len().checked_sub(1).filter(|gaps| *gaps > 0)?;
    let whole = blocks.last()?.duration_since(*blocks.first()?);
    Some(milliseconds(whole) / number(gaps))
}

fn tables(rows: &[Row], presets: &[String]) -> Vec<String> {
    let responses = ["network", "mode", "uploaders", "succeeded", "min", "p50", "p95", "max"];
    let totals = [
        "network",
        "mode",
        "uploaders",
        "total",
        "per request",
        "authors' each",
        "authors' total",
        "uploads/s",
        "times theirs",
        "tx",
        "blocks",
        "period",
    ];
    let cells = |cells: fn(&Row) -> Vec<String>| rows.iter().map(cells).collect::<Vec<_>>();
    vec![table(&responses, cells(response_cells)), table(&totals, cells(total_cells)), presets.join("\n")]
}

fn names(row: &Row) -> Vec<String> {
    vec![row.network_name(), row.mode.to_owned(), row.uploaders.to_string()]
}

fn response_cells(row: &Row) -> Vec<String> {
    let Spread { min, p50, p95, max } = row.measured.spread;
    let mut cells = names(row);
    cells.push(format!("{} ({} %)", row.succeeded, decimal(row.success)));
    cells.extend([min, p50, p95, max].map(decimal));
    cells
}

fn total_cells(row: &Row) -> Vec<String> {
    let range = |from: f64, to: f64| format!("{}-{}", decimal(from), decimal(to));
    let mut cells = names(row);
    cells.extend([row.total, row.per_request].map(decimal));
    cells.extend(match row.paper {
        Some(paper) => [range(paper.per_request_from, paper.per_request_to), range(paper.total_from, paper.total_to)],
        None => ["-", "-"].map(str::to_owned),
    });
    cells.push(decimal(row.uploads_per_second));
    cells.push(row.times_authors.map_or("-".to_owned(), decimal));
    cells.extend([row.transactions.to_string(), row.blocks.to_string()]);
    cells.push(row.period_seen.map_or("one block".to_owned(), decimal));
    cells
}

/// Names without duplicates, the paper's order: PoW on the left.
pub fn ordered(names: impl Iterator<Item = String>) -> Vec<String> {
    let mut found: Vec<String> = Vec::new();
    for name in names {
        if !found.contains(&name) {
            found.push(name);
        }
    }
    found.sort_by_key(|name| !name.contains("pow"));
    found
}

/// For each network the total time and the success by the number of uploaders.
fn plots(rows: &[Row]) -> Vec<Plot> {
    let of = |name: &String| rows.iter().filter(|row| row.network_name() == *name).collect::<Vec<_>>();
    let names = ordered(rows.iter().map(Row::network_name));
    names.iter().map(|name| plot(name, &of(name))).collect()
}

fn plot(name: &str, rows: &[&Row]) -> Plot {
    let of_mode = |mode: &'static str| rows.iter().filter(move |row| row.mode == mode).copied();
    let totals = |mode| Mark::Bars(of_mode(mode).map(|row| Bar::plain(row.total / 1000.0)).collect());
    let authors = of_mode("each").map(|row| {
        let paper = row.paper?;
        let (from, to) = (paper.total_from / 1000.0, paper.total_to / 1000.0);
        Bar::between(f64::midpoint(from, to), from, to)
    });
    let mut series = vec![
        Series::new("ours, batch", COLOURS[0], totals("batch")),
        Series::new("ours, each", COLOURS[1], totals("each")),
        Series::new("authors", PAPER, Mark::Bars(authors.collect())),
    ];
    let left = Axis::from_zero("total, s", series.iter().flat_map(Series::values));
    let success = of_mode("batch").enumerate().map(|(at, row)| (number(at) + 0.5, row.success));
    series.push(Series::new("success, ours in batches", COLOURS[3], Mark::Line(success.collect())));
    Plot {
        title: name.to_owned(),
        across: Axis::places("uploaders at once, 1 KB each", of_mode("each").map(|row| row.uploaders.to_string())),
        left,
        right: Some(Axis::from_zero("success, %", [100.0])),
        series,
    }
}
