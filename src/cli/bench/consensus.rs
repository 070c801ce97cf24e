//! `authros bench consensus`: the paper's figure 11. Many upload at once, on the embedded chain by
//! authority and by work and on a node, one by one and in batches, beside the authors' figures.

use std::sync::Arc;
use std::time::{Duration, Instant};

use serde::Serialize;
use serde_json::{Map, Value, json};

use super::machine::Machine;
use super::network::{Directory, Network, Place, reach};
use super::report::{Measured, Report};
use super::spread::{Spread, decimal, histogram, number};
use super::uploads::{MESSAGE, Outcome, run as upload};
use crate::chain::Consensus;
use crate::cli::args::ConsensusArguments;
use crate::cli::output::{Output, table};
use crate::crypto::Provider;
use crate::model::{AnchorMode, ErrorKind};
use crate::service::Failure;

const NOTES: [&str; 5] = [
    "each: one dataUpload transaction per record; batch: Merkle roots, closed at 256 records or after a second.",
    "response: from the common start to an uploader's receipt, so it includes sealing, storing and waiting for others; \
     total: from the start to the last receipt. Both in milliseconds.",
    "The authors give milliseconds per request; their total here is that times the uploaders.",
    "Their networks ran on their machine, by geth, with block periods that the paper does not give; ours have others \
     (period), so only what a user waits for can be compared, not the consensus itself.",
    "Our pow is real work at the paper's difficulty, but Keccak-256, not ethash: a hash is cheaper, so a block is too.",
];

/// The authors' raw figures: milliseconds per request and success, from and to.
#[derive(Debug, Clone, Copy, Serialize)]
struct Paper {
    per_request_from: f64,
    per_request_to: f64,
    total_from: f64,
    total_to: f64,
    success_from: f64,
    success_to: f64,
}

impl Paper {
    fn of(consensus: &str, uploaders: f64) -> Option<Self> {
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
}

/// One run.
#[derive(Debug, Serialize)]
struct Row {
    network: &'static str,
    consensus: String,
    client: String,
    mode: String,
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
    transactions: u64,
    gas: u64,
    blocks: usize,
    /// As set, milliseconds; `None` where the chain has none or does not tell.
    period_set: Option<u64>,
    /// Between blocks of the run, as seen, milliseconds; `None` for a single block.
    period_seen: Option<f64>,
    difficulty: Option<u64>,
    gas_limit: u64,
    paper: Option<Paper>,
    #[serde(skip)]
    responses: Vec<f64>,
    failures: std::collections::BTreeMap<String, u64>,
}

/// Runs all combinations; exit code 8 where an upload failed.
///
/// # Errors
/// Where a network cannot be opened, or its count differs from the receipts.
pub async fn run(
    arguments: ConsensusArguments,
    provider: &'static dyn Provider,
    csv: bool,
    output: Output,
) -> Result<u8, Failure> {
    if let Some(url) = &arguments.node {
        reach(url).await?;
    }
    let mut places = vec![Place::Embedded(Consensus::POA), Place::Embedded(Consensus::POW)];
    places.extend(arguments.node.map(Place::Node));
    let mut results = Vec::new();
    for place in &places {
        let directory = Directory::new()?;
        let network = Arc::new(Network::open(place, provider, directory.path()).await?);
        for uploaders in &arguments.uploaders {
            for mode in [AnchorMode::Each, AnchorMode::Batch] {
                let outcome = upload(&network, mode, usize::try_from(*uploaders).unwrap_or(usize::MAX)).await?;
                results.push(row(&network, mode, outcome));
            }
        }
    }
    let about = about();
    let report = Report { name: "consensus", machine: Machine::read(), about, results };
    report.show(csv, output, || text(&report));
    Ok(code(&report.results, output))
}

fn code(rows: &[Row], output: Output) -> u8 {
    let mut failed = false;
    for row in rows {
        for (why, times) in &row.failures {
            failed = true;
            output.note(&format!(
                "authros: {} {}, {}: {times} uploads failed: {why}",
                row.network, row.consensus, row.mode
            ));
        }
    }
    if failed { ErrorKind::Incomplete.exit_code() } else { 0 }
}

fn about() -> Map<String, Value> {
    let preset = json!({ "message_bytes": MESSAGE, "accounts": 2, "vault": "embedded, one commit for all that waits" });
    let mut about = Map::new();
    about.insert("preset".to_owned(), preset);
    about.insert("notes".to_owned(), json!(NOTES));
    about
}

fn milliseconds(time: Duration) -> f64 {
    time.as_secs_f64() * 1000.0
}

fn row(network: &Network, mode: AnchorMode, outcome: Outcome) -> Row {
    let uploaders = number(outcome.uploaders);
    let succeeded = outcome.responses.len();
    let (total, on_chain) = (milliseconds(outcome.total), milliseconds(outcome.on_chain));
    Row {
        network: network.kind,
        consensus: network.consensus.clone(),
        client: network.client.clone(),
        mode: mode.to_string(),
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
        uploads_per_second: number(succeeded) * 1000.0 / total,
        transactions: outcome.transactions,
        gas: outcome.gas,
        blocks: outcome.blocks.len(),
        period_set: network.sealing.period,
        period_seen: period_seen(&outcome.blocks),
        difficulty: network.sealing.difficulty.as_ref().and_then(|text| text.parse().ok()),
        gas_limit: network.gas_limit,
        paper: Paper::of(&network.consensus, uploaders),
        responses: outcome.responses,
        failures: outcome.failures,
    }
}

fn period_seen(blocks: &[Instant]) -> Option<f64> {
    let gaps = blocks.len().checked_sub(1).filter(|gaps| *gaps > 0)?;
    let whole = blocks.last()?.duration_since(*blocks.first()?);
    Some(milliseconds(whole) / number(gaps))
}

fn text(report: &Report<Row>) -> String {
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
        "tx",
        "blocks",
        "period",
    ];
    let rows = |cells: fn(&Row) -> Vec<String>| report.results.iter().map(cells).collect::<Vec<_>>();
    let mut lines = vec![
        format!("consensus: uploads at once, {MESSAGE} bytes each, on two accounts; times in ms"),
        format!("machine: {}", report.machine.line()),
        "\nresponse".to_owned(),
        table(&responses, &rows(response_cells)),
        "\ntotal".to_owned(),
        table(&totals, &rows(total_cells)),
    ];
    for row in &report.results {
        lines.push(format!(
            "\nresponse of {} uploaders, {} {}, {}",
            row.uploaders, row.network, row.consensus, row.mode
        ));
        lines.extend(histogram(&row.responses, "ms"));
    }
    lines.push(String::new());
    lines.extend(presets(&report.results));
    lines.extend(NOTES.map(str::to_owned));
    lines.join("\n")
}

fn names(row: &Row) -> Vec<String> {
    vec![format!("{} {}", row.network, row.consensus), row.mode.clone(), row.uploaders.to_string()]
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
    cells.extend([row.transactions.to_string(), row.blocks.to_string()]);
    cells.push(row.period_seen.map_or("one block".to_owned(), decimal));
    cells
}

/// What each network was set to, once.
fn presets(rows: &[Row]) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for row in rows {
        let sealing = match (row.period_set, row.difficulty) {
            (Some(period), _) => format!("block period at least {period} ms"),
            (None, Some(difficulty)) => format!("difficulty {difficulty:#x}, no fixed period"),
            (None, None) => "period as the node has it".to_owned(),
        };
        let line =
            format!("{} {}: {}, {sealing}, gas limit {:#x}", row.network, row.consensus, row.client, row.gas_limit);
        if !lines.contains(&line) {
            lines.push(line);
        }
    }
    lines
}
