//! The median and the 95th percentile of each publisher, load by load.

use super::{LOADS, NOTES, Row};
use crate::report::Report;
use crate::svg::{Axis, Bar, COLOURS, Mark, Page, Plot, Series};

pub(super) fn page(report: &Report<Row>) -> Page {
    Page {
        title: "Messages to subscribers of ROS 1".to_owned(),
        machine: report.machine.line(),
        columns: 1,
        plots: vec![
            plot("Half of all messages were there after", report, |row| row.measured.spread.p50),
            plot("95 of 100 messages were there after", report, |row| row.measured.spread.p95),
        ],
        notes: NOTES.map(str::to_owned).into(),
    }
}

fn plot(title: &str, report: &Report<Row>, value: impl Fn(&Row) -> f64) -> Plot {
    let mut publishers: Vec<&str> = report.results.iter().map(|row| row.publisher).collect();
    publishers.dedup();
    publishers.truncate(2);
    let series: Vec<Series> = publishers
        .into_iter()
        .zip(COLOURS)
        .map(|(publisher, colour)| {
            let of = |load: &str| report.results.iter().find(|row| row.publisher == publisher && row.load == load);
            let bars = LOADS.iter().map(|load| of(load.name).map(|row| Bar::plain(value(row))));
            Series::new(publisher.to_owned(), colour, Mark::Bars(bars.collect()))
        })
        .collect();
    Plot {
        title: title.to_owned(),
        across: Axis::places("load", LOADS.iter().map(|load| load.name.to_owned())),
        left: Axis::from_zero("us", series.iter().flat_map(Series::values)),
        right: None,
        series,
    }
}
