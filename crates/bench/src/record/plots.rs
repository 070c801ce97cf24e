//! The share of each step in sealing a record, and in opening and verifying it.

use super::{NOTES, Row, SIZES, WHOLE};
use crate::report::Report;
use crate::svg::{Axis, Bar, COLOURS, Mark, Page, Plot, Series};

pub(super) fn page(report: &Report<Row>) -> Page {
    Page {
        title: "One record on one core, step by step".to_owned(),
        machine: report.machine.line(),
        columns: 1,
        plots: vec![plot("Sealed", "seal", report), plot("Opened and verified", "open", report)],
        notes: NOTES.map(str::to_owned).into(),
    }
}

fn plot(title: &str, way: &str, report: &Report<Row>) -> Plot {
    let rows = || report.results.iter().filter(|row| row.way == way && row.step != WHOLE);
    let of_size = |size: usize| rows().filter(move |row| row.measured.bytes == size as u64);
    let series: Vec<Series> = SIZES
        .into_iter()
        .zip(COLOURS)
        .map(|(size, colour)| {
            let bars = of_size(size).map(|row| Some(Bar::plain(row.share * 100.0)));
            Series::new(format!("{size} bytes"), colour, Mark::Bars(bars.collect()))
        })
        .collect();
    Plot {
        title: title.to_owned(),
        across: Axis::places("step", of_size(SIZES[0]).map(|row| row.step.to_owned())),
        left: Axis::from_zero("% of its time", series.iter().flat_map(Series::values)),
        right: None,
        series,
    }
}
