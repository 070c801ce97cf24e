//! Time and size of each message by codec.

use super::{CODECS, NOTES, Row};
use crate::report::Report;
use crate::spread::number;
use crate::svg::{Axis, Bar, COLOURS, Mark, Page, Plot, Series};

pub(super) fn page(report: &Report<Row>) -> Page {
    let mut messages: Vec<&'static str> = report.results.iter().map(|row| row.message).collect();
    messages.dedup();
    let total = |row: &Row| {
        let spread = row.measured.spread;
        Bar::between(spread.p50, spread.min, spread.max)
    };
    let sealed = |row: &Row| {
        let share = number(row.sealed) / number(row.measured.bytes).max(1.0);
        Some(Bar::plain(share * 100.0))
    };
    let plots = vec![
        plot("Compressed and sealed; whiskers: least and most", Scale::Decades, "ms", &messages, report, total),
        plot("Bytes that are sealed", Scale::FromZero, "% of the message", &messages, report, sealed),
    ];
    Page {
        title: "Raw pictures, clouds and small messages by codec".to_owned(),
        machine: report.machine.line(),
        columns: 1,
        plots,
        notes: NOTES.map(str::to_owned).into(),
    }
}

enum Scale {
    Decades,
    FromZero,
}

fn plot(
    title: &str,
    scale: Scale,
    unit: &str,
    messages: &[&'static str],
    report: &Report<Row>,
    bar: fn(&Row) -> Option<Bar>,
) -> Plot {
    let series: Vec<Series> = CODECS
        .iter()
        .zip(COLOURS)
        .map(|(codec, colour)| {
            let of = |message: &&str| {
                bar(report.results.iter().find(|row| row.message == *message && row.codec == codec.name)?)
            };
            Series::new(codec.name, colour, Mark::Bars(messages.iter().map(of).collect()))
        })
        .collect();
    let values = series.iter().flat_map(Series::values);
    let left = match scale {
        Scale::Decades => Axis::decades(unit, values),
        Scale::FromZero => Axis::from_zero(unit, values),
    };
    let names = messages.iter().map(|name| name.replacen(' ', "\n", 1));
    Plot { title: title.to_owned(), across: Axis::places("message", names), left, right: None, series }
}
