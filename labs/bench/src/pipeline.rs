//! `pipeline`: the whole line of a throw-away site at a constant rate, publishers included, through real TCPROS. ROS
//! master, and chain are embedded.

pub(crate) mod before;
mod host;
mod publishers;
mod run;
mod watch;

use serde::Serialize;
use serde_json::json;

use self::run::{Load, Summary};
use super::Lab;
use super::args::{LoadChoice, PipelineArguments};
use super::judgement::Judgement;
use super::plot::{Axis, Bar, COLOURS, Mark, Plot, Series};
use super::report::{Measured, Report};
use super::spread::{Spread, decimal};
use authros_model::ErrorKind;
use authros_output::table;
use authros_pipeline::stages::{Milestone, Stages};
use authros_service::Failure;

/// Bytes of a picture, as in the targets of docs/benchmarks.md.
const PICTURE: usize = 58 * 1024;
/// Pictures a second of each publisher.
const PICTURES: u32 = 30;

const NOTES: [&str; 6] = [
    "durable: from the last byte read off the publisher's socket to the fsync that acknowledges it; confirmed: until \
     its anchor is deep enough; verified: until it is read back and checked. A percentile is at most 1/16 too high.",
    "Publishers, site and everything embedded share this process and its cores; cores = processor time over time.",
    "memory: resident bytes of the process, publishers included: at the start of the load, at the peak, and at the \
     end; minute by minute, those not backed by a file.",
    "pre-existing records belong to another owner: 500 topics, 1,360 bytes each in the store, verified; they were not \
     really sealed, so the scrubber skips them.",
    "law: captured = verified + pending + unauthorised + quarantined + dropped + tampered, checked every second.",
    "stages: busy time of each, including waits for disk or node, divided by the duration of the load. With a \
     backlog, seal and verify use several cores; for the cost of one record on one core, step by step, see `record`.",
];

/// One milestone of one load.
#[derive(Debug, Serialize)]
struct Row {
    load: &'static str,
    milestone: &'static str,
    #[serde(flatten)]
    measured: Measured,
    p99: f64,
}

/// Runs the loads one after the other, each in a home of its own; [`Judgement::Incomplete`] if a message was lost or
/// the counts did not balance.
///
/// # Errors
/// If the site cannot be opened, or not everything is verified in time.
pub async fn run(lab: &Lab, arguments: &PipelineArguments) -> Result<Judgement, Failure> {
    let length = authros_model::positive_span(&arguments.length)
        .map_err(|error| Failure::new(ErrorKind::Input, error.to_string()))?;
    let mut results = Vec::new();
    let mut summaries = Vec::new();
    for load in loads(arguments) {
        let host = host::Host::open(lab, arguments.before).await?;
        let ran = run::run(&host, &load, length).await;
        results.extend(Milestone::ALL.map(|milestone| row(&load, milestone, host.stages())));
        host.close().await;
        summaries.push(ran?);
    }
    let about = json!({ "loads": summaries });
    let report = Report::new("pipeline", "Publisher to verified at a held rate", &NOTES, about, results);
    let plots = summaries.iter().flat_map(|summary| {
        let rows: Vec<&Row> = report.results.iter().filter(|row| row.load == summary.load).collect();
        [latencies(summary.load, &rows), stages(summary)]
    });
    let page = report.page(2, plots.collect());
    lab.outlet.show(&report, &tables(&report.results, &summaries), &page)?;
    Ok(Judgement::complete(summaries.iter().all(Summary::is_whole)))
}

fn loads(arguments: &PipelineArguments) -> Vec<Load> {
    let publishers = arguments.publishers;
    let (bytes, per_second) = (arguments.bytes as usize, f64::from(arguments.rate));
    let messages = Load { name: "messages", bytes, per_second, publishers };
    let per_second = f64::from(PICTURES) * f64::from(publishers);
    let pictures = Load { name: "pictures", bytes: PICTURE, per_second, publishers };
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
    }
}

fn tables(rows: &[Row], summaries: &[Summary]) -> Vec<String> {
    let latencies: Vec<Vec<String>> = rows.iter().map(latency_cells).collect();
    let busy: Vec<Vec<String>> = summaries.iter().flat_map(Summary::busy_cells).collect();
    let mut tables = vec![
        table(&Summary::COLUMNS, summaries.iter().map(Summary::cells)),
        format!(
            "from capture, ms\n{}",
            table(&["load", "to", "messages", "min", "p50", "p95", "p99", "max"], &latencies)
        ),
        format!("busy stages\n{}", table(&["load", "stage", "% of the time", "us a message"], &busy)),
    ];
    tables.extend(summaries.iter().map(Summary::lines));
    tables
}

fn latency_cells(row: &Row) -> Vec<String> {
    let Spread { min, p50, p95, max } = row.measured.spread;
    let mut cells = vec![row.load.to_owned(), row.milestone.to_owned(), row.measured.runs.to_string()];
    cells.extend([min, p50, p95, row.p99, max].map(decimal));
    cells
}

/// How long after capture a message is durable, confirmed and verified.
fn latencies(load: &str, rows: &[&Row]) -> Plot {
    let of = |name: &str, colour, value: fn(&Row) -> f64| {
        let bars = rows.iter().map(|row| Bar::plain(value(row)));
        Series::new(name, colour, Mark::Bars(bars.collect()))
    };
    let series = vec![
        of("median", COLOURS[0], |row| row.measured.spread.p50),
        of("p95", COLOURS[1], |row| row.measured.spread.p95),
        of("p99", COLOURS[3], |row| row.p99),
        of("most", COLOURS[4], |row| row.measured.spread.max),
    ];
    Plot {
        title: format!("{load}: time from capture"),
        across: Axis::places("", rows.iter().map(|row| row.milestone.to_owned())),
        left: Axis::decades("ms", series.iter().flat_map(Series::values)),
        right: None,
        series,
    }
}

/// What is busy meanwhile.
fn stages(summary: &Summary) -> Plot {
    let shares = summary.shares();
    let bars = shares.iter().map(|(_, share)| Bar::plain(*share)).collect();
    let series = vec![Series::new("share of the load's duration", COLOURS[2], Mark::Bars(bars))];
    Plot {
        title: format!("{}: busy stages, waiting included", summary.load),
        across: Axis::places("stage", shares.iter().map(|(stage, _)| (*stage).to_owned())),
        left: Axis::from_zero("%", series.iter().flat_map(Series::values)),
        right: None,
        series,
    }
}
