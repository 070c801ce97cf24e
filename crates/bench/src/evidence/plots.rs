//! A bar for each time, and one for each size.

use super::{NOTES, Row};
use crate::report::Report;
use crate::svg::{Axis, Bar, COLOURS, Mark, Page, Plot, Series};

pub(super) fn page(report: &Report<Row>) -> Page {
    let notes = NOTES.map(str::to_owned).into();
    let plots = vec![
        plot(report, "us/record", "Verification, beside SM2 and SM3 alone"),
        plot(report, "bytes/record", "Bytes of a bundle per record"),
        plot(report, "bytes/batch", "Proof bytes per batch"),
    ];
    Page { title: "Evidence".to_owned(), machine: report.machine.line(), columns: 2, plots, notes }
}

/// The rows of one unit.
fn plot(report: &Report<Row>, unit: &str, title: &str) -> Plot {
    let rows = || report.results.iter().filter(|row| row.measured.unit == unit);
    let bars = rows().map(|row| {
        let spread = row.measured.spread;
        Bar::between(spread.p50, spread.min, spread.max)
    });
    let series = vec![Series::new(unit, COLOURS[0], Mark::Bars(bars.collect()))];
    Plot {
        title: title.to_owned(),
        across: Axis::places("", rows().map(|row| format!("{}\n{}", row.what, row.records))),
        left: Axis::decades(unit, series.iter().flat_map(Series::values)),
        right: None,
        series,
    }
}
