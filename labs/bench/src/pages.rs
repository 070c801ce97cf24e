//! `pages`: pages of a list on a ledger of many records beside the same on one of few, in turns. A page must cost the same
//! whatever the number of records.

mod written;

use std::path::Path;
use std::time::Instant;

use serde::Serialize;
use serde_json::{Value, json};

use super::Lab;
use super::args::PagesArguments;
use super::judgement::{Judgement, Target};
use super::network::Directory;
use super::pipeline::before::OWNER;
use super::plot::{Axis, Bar, COLOURS, Mark, Plot, Series};
use super::progress::Progress;
use super::report::{Measured, Report};
use super::spread::{Spread, decimal};
use crate::pipeline::before::captured_at;
use authros_model::{RecordKind, RecordState};
use authros_output::table;
use authros_service::Failure;
use authros_service::reply::internal;
use authros_store::{Ledger, RecordQuery};

/// Rows of a page.
const ROWS: u64 = 100;
/// Records of the span that a page is filtered by.
const SPAN: u64 = 10_000;
/// The most that a page may take with many records over what it takes with few.
const MOST_RATIO: f64 = 2.0;

const NOTES: [&str; 4] = [
    "Pages of 100 rows, newest first, of one owner's messages, read from the store; times in microseconds, of few and many \
     in turns. ratio: the median with many records over the median with few.",
    "first, middle, last: of the whole list. topic: one of 500. quarantined: one record in 997. tampered: no record. time: \
     within ten seconds. text: part of the names of 5 % of the topics. all: text, state and time. counts: records by state.",
    "The rows are written into the file by SQL, with counts and batches, without ciphertext, and nothing was sealed. Topics \
     alternate, the worst case: neighbours in the list are in different places of the index.",
    "The files stay in the system's cache: pages that come from a disk are slower.",
];

/// One kind of page on one ledger.
#[derive(Debug, Serialize)]
struct Row {
    page: &'static str,
    records: u64,
    /// On the page.
    rows: usize,
    #[serde(flatten)]
    measured: Measured,
}

/// Measures; [`Judgement::Missed`] if a page takes more than twice the time.
///
/// # Errors
/// If the ledgers cannot be written, or a page is not what it must be.
pub async fn run(lab: &Lab, arguments: &PagesArguments) -> Result<Judgement, Failure> {
    // Dropped here even if the bench is ended while its thread is still working.
    let directory = Directory::new()?;
    let (path, levels, rounds) = (directory.path().to_owned(), [arguments.few, arguments.many], arguments.rounds);
    let measured = tokio::task::spawn_blocking(move || measure(&path, levels, rounds)).await;
    let results = measured.map_err(|_| internal("the measurement"))??;
    let ratios = ratios(&results);
    let targets: Vec<Target> = ratios
        .iter()
        .map(|(page, ratio)| Target::at_most(format!("{page}, many over few"), MOST_RATIO, *ratio))
        .collect();
    let named: serde_json::Map<String, Value> =
        ratios.iter().map(|(page, ratio)| ((*page).to_owned(), json!(ratio))).collect();
    let about = json!({ "ratios": named, "targets": targets });
    let report = Report::new("pages", "Pages of a list, few and many records", &NOTES, about, results);
    let page = report.page(1, vec![plot(&report.results)]);
    lab.outlet.show(&report, &[text(&report.results, &ratios), Target::lines(&targets)], &page)?;
    Ok(Judgement::of(&targets))
}

/// A ledger, and what is asked of it.
struct Level {
    records: u64,
    ledger: Ledger,
    works: Vec<Work>,
}

struct Work {
    page: &'static str,
    /// The counts by state if there is none.
    query: Option<RecordQuery>,
    rows: usize,
    times: Vec<f64>,
}

fn measure(directory: &Path, levels: [u64; 2], rounds: u32) -> Result<Vec<Row>, Failure> {
    let mut made = Vec::new();
    for records in levels {
        let mut progress = Progress::new(format!("{records} records"));
        let path = directory.join(format!("{records}.db"));
        let done = |there| progress.at(whole(there), whole(records));
        let ledger = written::ledger(&path, records, done)?;
        let works = works(&ledger, records)?;
        made.push(Level { records, ledger, works });
    }
    // The first round warms up.
    for round in 0..=rounds {
        for level in &mut made {
            for work in &mut level.works {
                let begun = Instant::now();
                let rows = ask(&level.ledger, work.query.as_ref())?;
                let took = begun.elapsed().as_secs_f64() * 1e6;
                if rows != work.rows {
                    return Err(internal(format!("{} has {rows} rows, not {}", work.page, work.rows)));
                }
                if round > 0 {
                    work.times.push(took);
                }
            }
        }
    }
    Ok(made.iter().flat_map(Level::rows).collect())
}

fn whole(count: u64) -> usize {
    usize::try_from(count).unwrap_or(usize::MAX)
}

impl Level {
    fn rows(&self) -> impl Iterator<Item = Row> {
        self.works.iter().map(|work| {
            let runs = work.times.len() as u64;
            let measured = Measured { bytes: 1024, runs, unit: "us", spread: Spread::of(&work.times) };
            Row { page: work.page, records: self.records, rows: work.rows, measured }
        })
    }
}

/// How many rows are on it.
fn ask(ledger: &Ledger, query: Option<&RecordQuery>) -> Result<usize, Failure> {
    match query {
        Some(query) => Ok(ledger.records.list(query)?.rows.len()),
        None => Ok(ledger.counts.by_state(Some(OWNER))?.topics.len()),
    }
}

fn works(ledger: &Ledger, records: u64) -> Result<Vec<Work>, Failure> {
    let first = RecordQuery {
        owner: Some(OWNER),
        kind: Some(RecordKind::Data),
        newest_first: true,
        limit: whole(ROWS),
        ..RecordQuery::default()
    };
    let middle = captured_at(records / 2);
    let words = vec!["sensor7/".to_owned()];
    let span = RecordQuery { since: Some(middle), until: Some(captured_at(records / 2 + SPAN)), ..first.clone() };
    // The page behind one that ends in the middle, and behind one that ends a page before the oldest.
    let behind = |number| {
        let before = RecordQuery { until: Some(captured_at(number)), ..first.clone() };
        let after = ledger.records.list(&before)?.next;
        let page = RecordQuery { after, ..first.clone() };
        if page.after.is_some() { Ok(page) } else { Err(internal("a list ends too soon")) }
    };
    let asked = [
        ("middle", behind(records / 2)?),
        ("last", behind(2 * ROWS)?),
        ("topic", RecordQuery { topic: Some("/robot3/sensor0/data".to_owned()), ..first.clone() }),
        ("quarantined", RecordQuery { state: Some(RecordState::Quarantined), ..first.clone() }),
        ("tampered", RecordQuery { state: Some(RecordState::Tampered), ..first.clone() }),
        ("time", span.clone()),
        ("text", RecordQuery { words: words.clone(), ..first.clone() }),
        ("all", RecordQuery { words, state: Some(RecordState::Verified), ..span }),
        ("first", first),
    ];
    let works = asked.into_iter().map(|(page, query)| (page, Some(query))).chain([("counts", None)]);
    let works = works.map(|(page, query)| {
        let rows = ask(ledger, query.as_ref())?;
        Ok(Work { page, query, rows, times: Vec::new() })
    });
    works.collect()
}

/// Each page with the median on many records over the one on few.
fn ratios(rows: &[Row]) -> Vec<(&'static str, f64)> {
    let (few, many) = rows.split_at(rows.len() / 2);
    few.iter().zip(many).map(|(few, many)| (few.page, many.measured.spread.p50 / few.measured.spread.p50)).collect()
}

fn text(rows: &[Row], ratios: &[(&'static str, f64)]) -> String {
    let (few, many) = rows.split_at(rows.len() / 2);
    let cells = few.iter().zip(many).zip(ratios).map(|((few, many), (page, ratio))| {
        let times = [few, many].map(|row| [row.measured.spread.min, row.measured.spread.p50].map(decimal));
        let mut cells = vec![(*page).to_owned(), many.rows.to_string()];
        cells.extend(times.into_iter().flatten());
        cells.push(format!("{ratio:.2}"));
        cells
    });
    let of = |rows: &[Row]| rows.first().map_or(0, |row| row.records);
    let heads = [of(few), of(many)].map(|records| [format!("{records}: least"), "median".to_owned()]);
    let heads: Vec<&str> = heads.iter().flatten().map(String::as_str).collect();
    let head: Vec<&str> = ["page", "rows"].into_iter().chain(heads).chain(["ratio"]).collect();
    format!("a page, us\n{}", table(&head, cells))
}

fn plot(rows: &[Row]) -> Plot {
    let (few, many) = rows.split_at(rows.len() / 2);
    let of = |rows: &[Row], colour| {
        let name = format!("{} records", rows.first().map_or(0, |row| row.records));
        let bars =
            rows.iter().map(|row| row.measured.spread).map(|spread| Bar::between(spread.p50, spread.min, spread.p95));
        Series::new(name, colour, Mark::Bars(bars.collect()))
    };
    let series = vec![of(few, COLOURS[0]), of(many, COLOURS[4])];
    Plot {
        title: "A page of a list: median, least to 95th percentile".to_owned(),
        across: Axis::places("", few.iter().map(|row| row.page.to_owned())),
        left: Axis::from_zero("us", series.iter().flat_map(Series::values)),
        right: None,
        series,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_page_is_timed_on_both_ledgers_and_has_the_rows_that_it_must() {
        let directory = tempfile::tempdir().expect("a directory");
        let rows = measure(directory.path(), [25_000, 120_000], 2).expect("measured");
        let ratios = ratios(&rows);
        assert_eq!((rows.len(), ratios.len()), (20, 10));
        assert!(ratios.iter().all(|(_, ratio)| *ratio > 0.0), "{ratios:?}");
        let (few, many) = rows.split_at(10);
        for (few, many) in few.iter().zip(many) {
            assert_eq!((few.page, few.records, many.records), (many.page, 25_000, 120_000));
            assert_eq!((few.measured.runs, many.measured.runs), (2, 2));
        }
        let on = |page: &str| rows.iter().filter(|row| row.page == page).map(|row| row.rows).collect::<Vec<_>>();
        for page in ["first", "middle", "last", "time", "text", "all"] {
            assert_eq!(on(page), [100, 100], "{page}");
        }
        // 50 records of each topic, and numbers from 997 to 24,925.
        assert_eq!((on("topic"), on("quarantined")), (vec![50, 100], vec![25, 100]));
        assert_eq!((on("tampered"), on("counts")), (vec![0, 0], vec![500, 500]));
    }
}
