//! How long after capture a message is durable, confirmed and verified, and what is busy meanwhile.

use super::{NOTES, Row, Summary};
use crate::report::Report;
use crate::svg::{Axis, Bar, COLOURS, Mark, Page, Plot, Series};

pub(super) fn page(report: &Report<Row>, summaries: &[Summary]) -> Page {
    let plots = summaries.iter().flat_map(|summary| {
        let rows: Vec<&Row> = report.results.iter().filter(|row| row.load == summary.load).collect();
        [latencies(summary.load, &rows), stages(summary)]
    });
    Page {
        title: "Publisher to verified at a held rate".to_owned(),
        machine: report.machine.line(),
        columns: 2,
        plots: plots.collect(),
        notes: NOTES.map(str::to_owned).into(),
    }
}

fn latencies(load: &str, rows: &[&Row]) -> Plot {
    let of = |name: &str, colour: &'static str, value: fn(&Row) -> f64| {
        let bars = rows.iter().map(|row| Bar::between(value(row), f64::NAN, f64::NAN));
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

fn stages(summary: &Summary) -> Plot {
    let shares = summary.shares();
    let bars = shares.iter().map(|(_, share)| Some(Bar::plain(*share))).collect();
    let series = vec![Series::new("share of the load's duration", COLOURS[2], Mark::Bars(bars))];
    Plot {
        title: format!("{}: busy stages, waiting included", summary.load),
        across: Axis::places("stage", shares.iter().map(|(stage, _)| (*stage).to_owned())),
        left: Axis::from_zero("%", series.iter().flat_map(Series::values)),
        right: None,
        series,
    }
}
