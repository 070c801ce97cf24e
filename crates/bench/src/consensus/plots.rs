//! The shape of figure 11: for each network the total time and the success of 300, 500 and 700 uploads at once.

use super::{NOTES, Row};
use crate::report::Report;
use crate::spread::number;
use crate::svg::{Axis, Bar, COLOURS, Mark, PAPER, Page, Plot, Series, Side};

pub(super) fn page(report: &Report<Row>) -> Page {
    let mut names: Vec<String> = Vec::new();
    for name in report.results.iter().map(network) {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    // The paper has PoW on the left.
    names.sort_by_key(|name| !name.contains("pow"));
    let plots = names.iter().map(|name| {
        let rows: Vec<&Row> = report.results.iter().filter(|row| network(row) == *name).collect();
        plot(name, &rows)
    });
    Page {
        title: "Uploads at once: total time and success (the paper's figure 11)".to_owned(),
        machine: report.machine.line(),
        columns: 2,
        plots: plots.collect(),
        notes: NOTES.map(str::to_owned).into(),
    }
}

fn network(row: &Row) -> String {
    format!("{} {}", row.network, row.consensus)
}

fn plot(name: &str, rows: &[&Row]) -> Plot {
    let of_mode = |mode: &'static str| rows.iter().filter(move |row| row.mode == mode).copied();
    let totals = |mode| Mark::Bars(of_mode(mode).map(|row| Some(Bar::plain(row.total / 1000.0))).collect());
    let authors = of_mode("each").map(|row| {
        let paper = row.paper?;
        let (from, to) = (paper.total_from / 1000.0, paper.total_to / 1000.0);
        Bar::between(f64::midpoint(from, to), from, to)
    });
    let mut series = vec![
        Series::new("ours, batch", COLOURS[0], totals("batch")),
        Series::new("ours, each", COLOURS[1], totals("each")),
        Series::new("authors", PAPER, Mark::Bars(authors.collect())),
    ];
    let left = Axis::from_zero("total, s", series.iter().flat_map(Series::values));
    let success = of_mode("batch").enumerate().map(|(at, row)| (number(at) + 0.5, row.success));
    let success = Mark::Line(success.collect());
    series.push(Series { side: Side::Right, ..Series::new("success, ours in batches", COLOURS[3], success) });
    Plot {
        title: name.to_owned(),
        across: Axis::places("uploaders at once, 1 KB each", of_mode("each").map(|row| row.uploaders.to_string())),
        left,
        right: Some(Axis::from_zero("success, %", [100.0])),
        series,
    }
}
