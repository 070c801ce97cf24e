//! The shape of figure 12: for each network the time of an upload by the size of its message.

use super::{NOTES, Row, SIZES};
use crate::report::Report;
use crate::svg::{Axis, Bar, COLOURS, Mark, PAPER, Page, Plot, Series};

pub(super) fn page(report: &Report<Row>) -> Page {
    let mut names: Vec<String> = Vec::new();
    for name in report.results.iter().map(Row::network_name) {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    // The paper has PoW on the left.
    names.sort_by_key(|name| !name.contains("pow"));
    let of = |name: &str| report.results.iter().filter(|row| row.network_name() == name).collect::<Vec<_>>();
    let mut plots: Vec<Plot> = names.iter().map(|name| response(name, &of(name))).collect();
    if plots.len() % 2 == 1 && plots.len() > 1 {
        plots.extend(names.last().map(|name| per_upload(name, &of(name))));
        names.pop();
    }
    plots.extend(names.iter().map(|name| per_upload(name, &of(name))));
    Page {
        title: "Uploads by size of message: ours and ciphertexts on the chain (the paper's figure 12)".to_owned(),
        machine: report.machine.line(),
        columns: 2,
        plots,
        notes: NOTES.map(str::to_owned).into(),
    }
}

fn sizes() -> Axis {
    Axis::places("size of a message", SIZES.map(|bytes| format!("{} KB", bytes / 1024)))
}

/// One bar for each size of a method.
fn series(name: &str, colour: &'static str, rows: &[&Row], column: &str, bar: fn(&Row) -> Option<Bar>) -> Series {
    let bars = SIZES.map(|bytes| {
        rows.iter().find(|row| row.column() == column && row.measured.bytes == bytes as u64).and_then(|row| bar(row))
    });
    Series::new(name, colour, Mark::Bars(bars.into()))
}

fn ways(rows: &[&Row], bar: fn(&Row) -> Option<Bar>) -> Vec<Series> {
    vec![
        series("ours, batch", COLOURS[0], rows, "batch", bar),
        series("ours, each", COLOURS[1], rows, "each", bar),
        series("prototype's way", COLOURS[4], rows, "prototype", bar),
    ]
}

fn response(name: &str, rows: &[&Row]) -> Plot {
    let series = ways(rows, |row| {
        let spread = row.measured.spread;
        Bar::between(spread.p50 / 1e3, spread.min / 1e3, spread.p95 / 1e3)
    });
    Plot {
        title: format!("{name}: response, median; whiskers: least, p95"),
        across: sizes(),
        left: Axis::from_zero("response, s", series.iter().flat_map(Series::values)),
        right: None,
        series,
    }
}

fn per_upload(name: &str, rows: &[&Row]) -> Plot {
    let mut series = ways(rows, |row| row.per_upload.is_finite().then(|| Bar::plain(row.per_upload)));
    series.push(self::series("authors, per request", PAPER, rows, "each", |row| {
        let paper = row.paper?;
        let (from, to) = (paper.per_request_from, paper.per_request_to);
        Bar::between(f64::midpoint(from, to), from, to)
    }));
    Plot {
        title: format!("{name}: time per upload"),
        across: sizes(),
        left: Axis::decades("total over uploads, ms", series.iter().flat_map(Series::values)),
        right: None,
        series,
    }
}
