//! A bar for each kind of thing.

use super::{NOTES, Row};
use crate::report::Report;
use crate::svg::{Axis, Bar, COLOURS, Mark, Page, Plot, Series};

pub(super) fn page(report: &Report<Row>) -> Page {
    let rows = &report.results;
    // Memory given back has no place on a logarithmic axis.
    let bars = rows.iter().map(|row| Bar::between(row.bytes_each, f64::NAN, f64::NAN).filter(|_| row.bytes_each > 0.0));
    let series = vec![Series::new("bytes of memory each", COLOURS[0], Mark::Bars(bars.collect()))];
    let plot = Plot {
        title: "Memory of each of many".to_owned(),
        across: Axis::places("", rows.iter().map(|row| row.what.replace(", ", "\n"))),
        left: Axis::decades("bytes", series.iter().flat_map(Series::values)),
        right: None,
        series,
    };
    Page {
        title: "Memory".to_owned(),
        machine: report.machine.line(),
        columns: 1,
        plots: vec![plot],
        notes: NOTES.map(str::to_owned).into(),
    }
}
