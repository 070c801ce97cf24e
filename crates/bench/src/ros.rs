//! `authros bench ros`: the same messages to the same subscribers, by our own publisher and by rosrust in a process of
//! its own, in turn: losses, time from the order to publish to the last byte read, processor time.

mod lap;
mod plots;

use std::path::Path;

use serde::Serialize;
use serde_json::{Map, json};

use self::lap::{Lap, Load};
use super::judgement::Judgement;
use super::machine::Machine;
use super::outlet::Outlet;
use super::progress::Progress;
use super::report::{Measured, Report};
use super::spread::{Spread, decimal, number};
use crate::args::{PublisherChoice, RosArguments};
use authros_model::ErrorKind;
use authros_output::table;
use authros_service::Failure;

/// What is published.
const LOADS: [Load; 2] = [
    Load { name: "1 kHz x 1 KB", bytes: 1024, per_second: 1000 },
    Load { name: "10 Hz x 1 MB", bytes: 1_000_000, per_second: 10 },
];

const NOTES: [&str; 3] = [
    "From the order to publish to the moment when a subscriber has read the last byte, on loopback; all subscribers of all \
     rounds together. Publishers take turns, so that both meet the same machine.",
    "Subscribers are nodes of this process, the same for both. cpu: processor time of this process and of rosrust's, for each \
     message published. rosrust has one more subscriber, which counts what has left: nothing else tells it.",
    "missing: messages that a subscriber did not get; dropped: of these, what the publisher says of itself.",
];

/// One publisher with one load, all rounds together.
#[derive(Debug, Serialize)]
struct Row {
    publisher: &'static str,
    load: &'static str,
    #[serde(flatten)]
    measured: Measured,
    subscribers: u16,
    /// Messages published.
    published: u64,
    /// Messages that subscribers did not get, all together.
    missing: u64,
    /// What the publisher says was dropped.
    dropped: u64,
    /// Processor time for each message published, microseconds.
    cpu: f64,
    /// This one's figures divided by our own's; of ours `null`.
    p50_ratio: Option<f64>,
    p95_ratio: Option<f64>,
    cpu_ratio: Option<f64>,
    paper: Option<f64>,
}

/// Measures; [`Judgement::Incomplete`] if a message was lost.
///
/// # Errors
/// If a node or its subscribers do not start, or the page of plots cannot be written.
pub fn run(arguments: &RosArguments, outlet: &Outlet) -> Result<Judgement, Failure> {
    let length = authros_model::positive_span(&arguments.length)
        .map_err(|error| Failure::new(ErrorKind::Input, error.to_string()))?;
    let publishers: &[&'static str] = match arguments.publisher {
        PublisherChoice::Own => &[lap::OWN],
        PublisherChoice::Rosrust => &[lap::ROSRUST],
        PublisherChoice::Both => &[lap::OWN, lap::ROSRUST],
    };
    let combinations: Vec<(&'static str, Load)> =
        LOADS.into_iter().flat_map(|load| publishers.iter().map(move |by| (*by, load))).collect();
    let program: Option<&Path> = arguments.program.as_deref().filter(|path| !path.as_os_str().is_empty());
    let mut laps: Vec<Vec<Lap>> = combinations.iter().map(|_| Vec::new()).collect();
    let (mut progress, all) = (Progress::new("ros"), combinations.len() * arguments.rounds as usize);
    for round in 0..arguments.rounds as usize {
        for (at, (by, load)) in combinations.iter().enumerate() {
            laps[at].push(lap::run(by, load, length, arguments.subscribers, program)?);
            progress.at(round * combinations.len() + at + 1, all);
        }
    }
    drop(progress);
    let together = combinations.iter().zip(&laps);
    let mut results: Vec<Row> = together.map(|((by, load), laps)| row(by, load, arguments.subscribers, laps)).collect();
    compare(&mut results);
    let about = Map::from_iter([("notes".to_owned(), json!(NOTES))]);
    let report = Report { name: "ros", machine: Machine::read(), about, results };
    outlet.show(&report, || text(&report), || plots::page(&report))?;
    Ok(Judgement::complete(report.results.iter().all(|row| row.missing == 0)))
}

fn row(publisher: &'static str, load: &Load, subscribers: u16, laps: &[Lap]) -> Row {
    let times: Vec<f64> = laps.iter().flat_map(|lap| lap.times.iter().copied()).collect();
    let published: u64 = laps.iter().map(|lap| lap.published).sum();
    let expected = published * u64::from(subscribers);
    let cpu = laps.iter().map(|lap| lap.processor).sum::<f64>() * 1e6 / number(published).max(1.0);
    let runs = times.len() as u64;
    Row {
        publisher,
        load: load.name,
        measured: Measured { bytes: load.bytes as u64, runs, unit: "us", spread: Spread::of(&times) },
        subscribers,
        published,
        missing: expected.saturating_sub(runs),
        dropped: laps.iter().map(|lap| lap.dropped).sum(),
        cpu,
        p50_ratio: None,
        p95_ratio: None,
        cpu_ratio: None,
        paper: None,
    }
}

/// Sets the others beside our own.
fn compare(rows: &mut [Row]) {
    let own: Vec<(&'static str, Spread, f64)> = rows
        .iter()
        .filter(|row| row.publisher == lap::OWN)
        .map(|row| (row.load, row.measured.spread, row.cpu))
        .collect();
    for row in rows.iter_mut().filter(|row| row.publisher != lap::OWN) {
        if let Some((_, spread, cpu)) = own.iter().find(|(load, ..)| *load == row.load) {
            row.p50_ratio = Some(row.measured.spread.p50 / spread.p50);
            row.p95_ratio = Some(row.measured.spread.p95 / spread.p95);
            row.cpu_ratio = Some(row.cpu / cpu);
        }
    }
}

fn text(report: &Report<Row>) -> String {
    let rows: Vec<Vec<String>> = report.results.iter().map(cells).collect();
    let head = ["publisher", "load", "published", "missing", "dropped", "p50 us", "p95 us", "max us", "cpu us"];
    let mut lines = vec![
        "ros: messages to subscribers of ROS 1".to_owned(),
        format!("machine: {}", report.machine.line()),
        String::new(),
        table(&head, &rows),
        String::new(),
    ];
    for row in &report.results {
        if let (Some(p50), Some(p95), Some(cpu)) = (row.p50_ratio, row.p95_ratio, row.cpu_ratio) {
            let Row { publisher, load, .. } = row;
            lines.push(format!("{publisher} / own, {load}: p50 {p50:.2}, p95 {p95:.2}, cpu {cpu:.2}"));
        }
    }
    lines.extend(NOTES.map(str::to_owned));
    lines.join("\n")
}

fn cells(row: &Row) -> Vec<String> {
    let Spread { p50, p95, max, .. } = row.measured.spread;
    let counts = [row.published, row.missing, row.dropped].map(|count| count.to_string());
    let mut cells = vec![row.publisher.to_owned(), row.load.to_owned()];
    cells.extend(counts);
    cells.extend([p50, p95, max, row.cpu].map(decimal));
    cells
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lap(times: &[f64], processor: f64) -> Lap {
        Lap { times: times.to_vec(), published: 2, dropped: 1, processor }
    }

    #[test]
    fn rounds_are_put_together_and_set_beside_our_own() {
        let own = row(lap::OWN, &LOADS[0], 2, &[lap(&[10.0, 20.0, 30.0, 40.0], 0.000_004)]);
        let laps = [lap(&[20.0, 40.0, 60.0], 0.000_008), lap(&[20.0, 40.0, 60.0, 80.0], 0.000_008)];
        let mut rows = vec![own, row(lap::ROSRUST, &LOADS[0], 2, &laps)];
        compare(&mut rows);
        assert_eq!((rows[0].missing, rows[1].missing, rows[1].dropped), (0, 1, 2));
        assert!((rows[0].cpu - 2.0).abs() < 1e-9 && (rows[1].cpu - 4.0).abs() < 1e-9);
        assert_eq!((rows[0].p50_ratio, rows[1].p50_ratio, rows[1].cpu_ratio), (None, Some(2.0), Some(2.0)));
    }
}
