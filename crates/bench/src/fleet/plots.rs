//! Processor time per record and per copy, part by part; and how long fail-overs took.

use super::{NOTES, Row};
use crate::report::Report;
use crate::svg::{Axis, Bar, COLOURS, Mark, Page, Plot, Series};

pub(super) fn page(report: &Report<Row>) -> Page {
    let rows = &report.results;
    let plain = |value: fn(&Row) -> f64| Mark::Bars(rows.iter().map(|row| Some(Bar::plain(value(row)))).collect());
    let processor = vec![
        Series::new("for each record", COLOURS[0], plain(|row| row.processor)),
        Series::new("for each copy of it", COLOURS[1], plain(|row| row.per_copy)),
    ];
    let between = vec![Series::new("for each record", COLOURS[2], plain(|row| row.between))];
    let failover = rows.iter().map(|row| {
        let (middle, most) = (row.failover_p50?, row.failover_max?);
        Bar::between(middle, middle, most)
    });
    let failover = vec![Series::new("median; whisker: the longest", COLOURS[3], Mark::Bars(failover.collect()))];
    Page {
        title: "A fleet: robots at one gateway and at several".to_owned(),
        machine: report.machine.line(),
        columns: 1,
        plots: vec![
            plot("Processor time", "us", rows, processor),
            plot("Bytes between gateways", "bytes", rows, between),
            plot("Fail-over", "s", rows, failover),
        ],
        notes: NOTES.map(str::to_owned).into(),
    }
}

fn plot(title: &str, unit: &str, rows: &[Row], series: Vec<Series>) -> Plot {
    let names = rows.iter().map(|row| format!("{}\n{} gateways", row.part, row.gateways));
    Plot {
        title: title.to_owned(),
        across: Axis::places("part", names),
        left: Axis::from_zero(unit, series.iter().flat_map(Series::values)),
        right: None,
        series,
    }
}
