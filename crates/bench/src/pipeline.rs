//! `authros bench pipeline`: the whole line of a throw-away site at a constant rate, publishers included, through real
//! TCPROS. ROS master, chain and vault are embedded, or those given by --ros-master, --chain and --vault.

mod before;
pub(crate) mod host;
mod plots;
mod run;
mod watch;

use std::collections::VecDeque;

use serde::Serialize;
use serde_json::{Map, json};

pub(crate) use self::run::heard;
use self::run::{Load, Summary};
pub(crate) use self::watch::slope;
use super::judgement::Judgement;
use super::machine::Machine;
use super::outlet::Outlet;
use super::report::{Measured, Report};
use super::spread::{Spread, bars, decimal};
use crate::Global;
use crate::args::{LoadChoice, PipelineArguments};
use authros_model::ErrorKind;
use authros_output::table;
use authros_pipeline::stages::{Milestone, Stages};
use authros_service::Failure;

/// Bytes of a picture, as in docs/format.md, section 10.
const PICTURE: usize = 58 * 1024;
/// The limit within which 99 of 100 messages must be verified for a rate to count as held, milliseconds.
const VERIFIED_WITHIN: f64 = 5_000.0;
/// Pictures a second of each publisher.
const PICTURES: u32 = 30;

const NOTES: [&str; 7] = [
    "durable: from the last byte read off the publisher's socket to the fsync that acknowledges it; confirmed: until \
     its anchor is deep enough; verified: until it is read back and checked. A percentile is at most 1/16 too high.",
    "Publishers, site and everything embedded share this process and its cores; cores = processor time over time.",
    "memory: resident bytes of the process, publishers included: at the start of the load, at the peak, and at the \
     end; minute by minute, those not backed by a file.",
    "pre-existing records belong to another owner: 500 topics, 1,360 bytes each in the vault, verified; they were not \
     really sealed, so the scrubber skips them.",
    "--doubling: a rate is sustained if nothing is lost, at least 98 % of it arrives and 99 % of messages are verified \
     within 5 s; the last one printed was not, unless it is the highest possible.",
    "law: captured = verified + pending + right ended + quarantined + dropped + tampered, checked every second.",
    "stages: busy time of each, including waits for disk, vault or node, divided by the duration of the load. With a \
     backlog, seal and verify use several cores; for the cost of one record on one core, step by step, see `bench \
     record`.",
];

/// One milestone of one load.
#[derive(Debug, Serialize)]
struct Row {
    load: &'static str,
    milestone: &'static str,
    #[serde(flatten)]
    measured: Measured,
    p99: f64,
    paper: Option<f64>,
}

/// Runs the loads one after the other, each in a home of its own; [`Judgement::Incomplete`] if a message was lost or
/// the counts did not balance.
///
/// # Errors
/// If the site cannot be opened, or a part that was named does not answer.
pub async fn run(global: Global<'_>, arguments: PipelineArguments, outlet: &Outlet) -> Result<Judgement, Failure> {
    let length = authros_model::positive_span(&arguments.length)
        .map_err(|error| Failure::new(ErrorKind::Input, error.to_string()))?;
    let mut results = Vec::new();
    let mut summaries = Vec::new();
    let mut loads: VecDeque<Load> = loads(&arguments).into();
    while let Some(load) = loads.pop_front() {
        let host = host::Host::open(global, arguments.before, outlet.output()).await?;
        let ran = run::run(&host, &load, length).await;
        let rows = Milestone::ALL.map(|milestone| row(&load, milestone, host.stages()));
        host.close().await;
        let summary = match ran {
            // A doubled rate that the line cannot keep up with is an answer, too.
            Err(failure) if load.doubled > 0 => {
                outlet.note(&format!("authros: {}: {}", load.name, failure.message));
                break;
            }
            ran => ran?,
        };
        let held = summary.is_held() && rows.iter().all(|row| row.p99 <= VERIFIED_WITHIN);
        results.extend(rows);
        summaries.push(summary);
        loads.extend(load.twice().filter(|_| arguments.doubling && held));
    }
    let mut about = Map::new();
    about.insert("loads".to_owned(), json!(summaries));
    about.insert("notes".to_owned(), json!(NOTES));
    let report = Report { name: "pipeline", machine: Machine::read(), about, results };
    outlet.show(&report, || text(&report, &summaries), || plots::page(&report, &summaries))?;
    // Doubled rates end when messages are lost: that is their purpose.
    let whole = summaries.iter().filter(|summary| !summary.is_doubled()).all(Summary::is_whole);
    Ok(Judgement::complete(whole))
}

fn loads(arguments: &PipelineArguments) -> Vec<Load> {
    let publishers = arguments.publishers;
    let (bytes, per_second) = (arguments.bytes as usize, f64::from(arguments.rate));
    let messages = Load { name: run::MESSAGES[0], bytes, per_second, publishers, doubled: 0 };
    let per_second = f64::from(PICTURES) * f64::from(publishers);
    let pictures = Load { name: "pictures", bytes: PICTURE, per_second, publishers, doubled: 0 };
    match arguments.load {
        LoadChoice::Messages => vec![messages],
        LoadChoice::Pictures => vec![pictures],
        LoadChoice::Both => vec![messages, pictures],
    }
}

fn row(load: &Load, milestone: Milestone, stages: &Stages) -> Row {
    let within = |percent| stages.within(milestone, percent).map_or(f64::NAN, |time| time.as_secs_f64() * 1000.0);
    Row {
        load: load.name,
        milestone: milestone.word(),
        measured: Measured {
            bytes: load.bytes as u64,
            runs: stages.count_of(milestone),
            unit: "ms",
            spread: Spread { min: within(0), p50: within(50), p95: within(95), max: within(100) },
        },
        p99: within(99),
        paper: None,
    }
}

fn text(report: &Report<Row>, summaries: &[Summary]) -> String {
    let latencies = report.results.iter().map(latency_cells).collect::<Vec<_>>();
    let mut lines = vec![
        "pipeline: publisher -> captured -> sealed -> stored -> anchored -> confirmed -> verified".to_owned(),
        format!("machine: {}", report.machine.line()),
        String::new(),
        table(&Summary::COLUMNS, &summaries.iter().map(Summary::cells).collect::<Vec<_>>()),
        "\nfrom capture, ms".to_owned(),
        table(&["load", "to", "messages", "min", "p50", "p95", "p99", "max"], &latencies),
    ];
    lines.push("\nmedians".to_owned());
    let name = |row: &Row| format!("{} {}", row.load, row.milestone);
    lines
        .extend(bars(&report.results.iter().map(|row| (name(row), row.measured.spread.p50)).collect::<Vec<_>>(), "ms"));
    for summary in summaries {
        lines.push(format!("\n{}: busy stages, share of the load's duration", summary.load));
        lines.extend(summary.bars());
    }
    lines.push(String::new());
    lines.extend(NOTES.map(str::to_owned));
    lines.join("\n")
}

fn latency_cells(row: &Row) -> Vec<String> {
    let Spread { min, p50, p95, max } = row.measured.spread;
    let mut cells = vec![row.load.to_owned(), row.milestone.to_owned(), row.measured.runs.to_string()];
    cells.extend([min, p50, p95, row.p99, max].map(decimal));
    cells
}
