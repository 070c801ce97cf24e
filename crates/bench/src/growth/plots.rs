//! Time against the number of records, on logarithmic axes: a flat line costs the same however many there are.

use super::{NOTES, Row, works};
use crate::report::Report;
use crate::spread::number;
use crate::svg::{Axis, COLOURS, Mark, Page, Plot, Series};

/// The works of each plot: a title, and the prefixes of their names.
const PLOTS: [(&str, &[&str]); 3] = [
    ("Ledger: one more record, its life line, and counts", &["append", "life", "counts"]),
    ("Pages of a list", &["page", "next", "topic", "held", "none", "time", "tag"]),
    ("Console: frames, keys and rows", &["frame", "key", "rows in", "filter", "encode"]),
];

pub(super) fn page(report: &Report<Row>) -> Page {
    Page {
        title: "Cost while the ledger grows".to_owned(),
        machine: report.machine.line(),
        columns: 2,
        plots: PLOTS.iter().map(|(title, names)| plot(title, names, &report.results)).collect(),
        notes: NOTES.map(str::to_owned).into(),
    }
}

fn plot(title: &str, names: &[&str], rows: &[Row]) -> Plot {
    let is_in = |work: &&str| names.iter().any(|name| work.split(',').next() == Some(*name));
    let series: Vec<Series> = works(rows)
        .into_iter()
        .filter(is_in)
        .zip(COLOURS.iter().cycle())
        .map(|(work, colour)| {
            let points = rows.iter().filter(|row| row.work == work);
            let points = points.map(|row| (number(row.records), row.measured.spread.p50)).collect();
            Series::new(work, colour, Mark::Line(points))
        })
        .collect();
    Plot {
        title: title.to_owned(),
        across: Axis::decades("records in the ledger", rows.iter().map(|row| number(row.records))),
        left: Axis::decades("us, median", series.iter().flat_map(Series::values)),
        right: None,
        series,
    }
}
