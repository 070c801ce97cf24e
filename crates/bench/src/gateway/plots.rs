//! Records a second for each way of uploading, beside the most one core could do.

use super::{NOTES, Row, SIZES};
use crate::report::Report;
use crate::svg::{Axis, Bar, COLOURS, Mark, Page, Plot, Series};

pub(super) fn page(report: &Report<Row>) -> Page {
    Page {
        title: "Records accepted by a gateway".to_owned(),
        machine: report.machine.line(),
        columns: 1,
        plots: SIZES.iter().map(|(bytes, _)| plot(&report.results, *bytes)).collect(),
        notes: NOTES.map(str::to_owned).into(),
    }
}

fn plot(results: &[Row], bytes: usize) -> Plot {
    let rows: Vec<&Row> = results.iter().filter(|row| row.measured.bytes == bytes as u64).collect();
    let of_kept = |name: &str, colour: &'static str, kept: Option<&str>| {
        let bars = rows.iter().map(|row| {
            let spread = row.measured.spread;
            if row.kept == kept { Bar::between(spread.p50, spread.min, spread.max) } else { None }
        });
        Series::new(name, colour, Mark::Bars(bars.collect()))
    };
    let series = vec![
        of_kept("at most, on one core", COLOURS[3], None),
        of_kept("kept on disk", COLOURS[0], Some("disk")),
        of_kept("kept in memory", COLOURS[1], Some("memory")),
    ];
    let names = rows.iter().map(|row| match row.kept {
        Some(_) => format!("{}\nby {}", row.way, row.connections),
        None => row.way.replace(' ', "\n"),
    });
    Plot {
        title: format!("records of {bytes} bytes; whiskers: the slowest and the fastest run"),
        across: Axis::places("way of uploading, number of connections", names),
        left: Axis::decades("records a second", series.iter().flat_map(Series::values)),
        right: None,
        series,
    }
}
