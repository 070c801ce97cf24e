//! The shapes of figures 16 and 17: histograms of encryption, decryption and digests, and how long each implementation
//! takes.

use super::{Algorithm, LARGEST, PAPER_SM3, PAPER_SM3_LEAST, Row, find};
use crate::plot::{Axis, Bar, COLOURS, Mark, PAPER, Plot, Series, histogram};

/// The plots, and how many are side by side.
pub(super) fn of(rows: &[Row], algorithm: Algorithm) -> (usize, Vec<Plot>) {
    match algorithm {
        Algorithm::Sm2 => (2, sm2(rows)),
        Algorithm::Sm3 => (2, sm3(rows)),
        Algorithm::Sm4 => (4, sm4(rows)),
    }
}

fn size_of(bytes: u64) -> String {
    if bytes == LARGEST as u64 { "800 KB".to_owned() } else { format!("{} KB", bytes / 1024) }
}

/// In order of appearance, without duplicates.
fn distinct<T: PartialEq>(all: impl Iterator<Item = T>) -> Vec<T> {
    all.fold(Vec::new(), |mut found, one| {
        if !found.contains(&one) {
            found.push(one);
        }
        found
    })
}

/// One work at all sizes, by all implementations of it.
fn by_size(rows: &[Row], work: &str, title: &str) -> Plot {
    let of_work = || rows.iter().filter(|row| row.work == work);
    let sizes = distinct(of_work().map(|row| row.measured.bytes));
    let everybody = distinct(of_work().map(|row| row.by));
    let mut series: Vec<Series> = everybody
        .iter()
        .zip(COLOURS)
        .map(|(by, colour)| {
            let bars =
                sizes.iter().map(|size| bar(of_work().find(|row| row.by == *by && row.measured.bytes == *size)?));
            Series::new(*by, colour, Mark::Bars(bars.collect()))
        })
        .collect();
    if work == "digest" {
        let middle = f64::midpoint(PAPER_SM3_LEAST, PAPER_SM3);
        let paper = sizes
            .iter()
            .map(|size| if *size == LARGEST as u64 { Bar::between(middle, PAPER_SM3_LEAST, PAPER_SM3) } else { None });
        series.push(Series::new("paper", PAPER, Mark::Bars(paper.collect())));
    }
    Plot {
        title: title.to_owned(),
        across: Axis::places("size of a message", sizes.into_iter().map(size_of)),
        left: Axis::decades("us, median; whiskers p5 to p95", series.iter().flat_map(Series::values)),
        right: None,
        series,
    }
}

fn bar(row: &Row) -> Option<Bar> {
    Bar::between(row.measured.spread.p50, row.p5, row.measured.spread.p95)
}

/// How often each time occurred.
fn times(rows: &[Row], work: &str, by: &str, bytes: usize, title: &str) -> Option<Plot> {
    let row = find(rows, work, by, bytes)?;
    let title = format!("{title} of {}, {by}, {} times", size_of(row.measured.bytes), row.measured.runs);
    Some(histogram(title, &row.times, "us"))
}

fn sm3(rows: &[Row]) -> Vec<Plot> {
    let mut plots = Vec::from_iter(times(rows, "digest", "authros", LARGEST, "SM3"));
    plots.push(by_size(rows, "digest", "Digests; the paper gives 6190 to 6340 us for 800 KB"));
    plots.extend(times(rows, "digest", "libsm", LARGEST, "SM3"));
    plots
}

fn sm4(rows: &[Row]) -> Vec<Plot> {
    let sizes = [1024, 2048, 4096, 8192];
    let mut plots = Vec::new();
    for (work, title) in [("seal", "Encryption"), ("open", "Decryption")] {
        plots.extend(sizes.iter().filter_map(|bytes| {
            let row = find(rows, work, "authros", *bytes)?;
            Some(histogram(format!("{title}, {}", size_of(row.measured.bytes)), &row.times, "us"))
        }));
    }
    let works = [("seal", "Encryption"), ("open", "Decryption"), ("record", "Whole record"), ("digest", "SM3 alone")];
    plots.extend(works.map(|(work, title)| by_size(rows, work, title)));
    plots
}

fn sm2(rows: &[Row]) -> Vec<Plot> {
    let works = distinct(rows.iter().map(|row| row.work));
    let everybody = distinct(rows.iter().map(|row| row.by));
    let series: Vec<Series> = everybody
        .iter()
        .zip(COLOURS)
        .map(|(by, colour)| {
            let bars = works.iter().map(|work| bar(rows.iter().find(|row| row.work == *work && row.by == *by)?));
            Series::new(*by, colour, Mark::Bars(bars.collect()))
        })
        .collect();
    let all = Plot {
        title: "SM2 on 32 bytes".to_owned(),
        across: Axis::places("", works.iter().map(|work| (*work).to_owned())),
        left: Axis::decades("us, median; whiskers p5 to p95", series.iter().flat_map(Series::values)),
        right: None,
        series,
    };
    let histograms = works.iter().filter_map(|work| {
        let row = rows.iter().find(|row| row.work == *work && row.by == "authros")?;
        Some(histogram(format!("{work}, authros, {} times", row.measured.runs), &row.times, "us"))
    });
    std::iter::once(all).chain(histograms).collect()
}
