//! `authros bench growth`: how cost grows with the number of records. Ledgers of 10^3, 10^4 to 10^6 records are filled;
//! for each, another record, its way to verified, a page of a list and a frame of the console are timed. Pages and
//! frames of all ledgers take turns, so that other load on the machine affects all of them.

pub(crate) mod fill;
mod frames;
pub(crate) mod life;
mod pages;
mod plots;

use std::path::Path;
use std::time::Instant;

use serde::Serialize;
use serde_json::{Map, Value, json};

use self::fill::Costs;
use super::judgement::Judgement;
use super::machine::Machine;
use super::network::Directory;
use super::outlet::Outlet;
use super::progress::Progress;
use super::report::{Measured, Report};
use super::spread::{Spread, bars};
use crate::args::GrowthArguments;
use authros_output::table;
use authros_service::Failure;
use authros_service::failure::internal;
use authros_store::Ledger;

/// The number of records at which the first figures are taken.
const FIRST: u64 = 1_000;
/// How often the ledgers take turns, and how often each piece of work is timed in a turn.
const TURNS: usize = 7;
const ROUNDS: usize = 3;

const NOTES: [&str; 4] = [
    "append: a record acknowledged (on disk), in commits of 256 as in the pipeline; life: its steps from stored to \
     verified (batched, submitted, mined, confirmed), in batches of 1,024; both per record, means of 4,096 with their \
     share of checkpoints. page: 18 rows, newest first (next: the following page, topic: of one topic, held: in \
     quarantine, none: in a state that no record has, time: captured until a given time, tag: by a tag that one topic \
     in twenty has); counts: records of all states.",
    "frame: the whole console at 200 x 50, without the terminal; key: the cursor moved; rows in: 2,000 topics taken \
     over; filter: a letter typed and deleted; encode: 2,000 topics as JSON.",
    "Times are microseconds, medians of 21 (append and life: of 5 means or more); ratio: the median with the most \
     records divided by the median with the fewest.",
    "The records, of 500 topics in turn, are fed to the ledger and verified as the pipeline does it, but nothing is \
     sealed and no chain runs. Each record of a commit belonging to a different topic is the worst case: it touches \
     its own pages in two indices.",
];

/// One piece of work at one number of records.
#[derive(Debug, Serialize)]
struct Row {
    /// `append`, `page`, `frame`, and so on.
    work: &'static str,
    records: u64,
    #[serde(flatten)]
    measured: Measured,
    paper: Option<f64>,
}

/// Measures.
///
/// # Errors
/// If the ledger cannot be made, or the disk is full.
pub async fn run(arguments: GrowthArguments, outlet: &Outlet) -> Result<Judgement, Failure> {
    // Dropped here even where the bench is ended while its thread still works.
    let directory = Directory::new()?;
    let path = directory.path().to_owned();
    let measured = tokio::task::spawn_blocking(move || measure(&path, arguments.records)).await;
    let results = measured.map_err(|_| internal("the measurement"))??;
    let ratios = ratios(&results);
    let mut about = Map::new();
    let named = ratios.iter().map(|(work, ratio)| ((*work).to_owned(), json!(ratio)));
    about.insert("ratios".to_owned(), Value::Object(named.collect()));
    about.insert("notes".to_owned(), json!(NOTES));
    let report = Report { name: "growth", machine: Machine::read(), about, results };
    outlet.show(&report, || text(&report, &ratios), || plots::page(&report))?;
    Ok(Judgement::Reached)
}

/// Powers of ten from [`FIRST`] up to the greatest number of records, which is always included.
fn levels(most: u64) -> Vec<u64> {
    let powers = std::iter::successors(Some(FIRST), |level| level.checked_mul(10)).take_while(|level| *level < most);
    powers.chain([most.max(FIRST)]).collect()
}

/// A ledger with this many records, and the times of each work on it, microseconds.
struct Level {
    records: u64,
    ledger: Ledger,
    times: Figures,
}

/// Works in order, each with its times.
type Figures = Vec<(&'static str, Vec<f64>)>;

impl Level {
    /// Fills a ledger; small ones several times, until there are enough figures.
    fn fill(directory: &Path, records: u64, mut done: impl FnMut(u64)) -> Result<Self, Failure> {
        let mut costs = Costs::default();
        for place in 0..fill::FIGURES {
            let ledger = Ledger::open(&directory.join(format!("{records}-{place}.db")))?;
            fill::fill(&ledger, records, &mut costs, &mut done)?;
            if costs.append.len() as u64 >= fill::FIGURES {
                return Ok(Self { records, ledger, times: vec![("append", costs.append), ("life", costs.life)] });
            }
        }
        Err(internal("a ledger that returned no figure"))
    }

    fn take_turn(&mut self) -> Result<(), Failure> {
        let figures = pages::time(&self.ledger)?.into_iter().chain(frames::time(&self.ledger)?);
        for (work, times) in figures {
            match self.times.iter_mut().find(|(name, _)| *name == work) {
                Some((_, all)) => all.extend(times),
                None => self.times.push((work, times)),
            }
        }
        Ok(())
    }

    fn rows(&self) -> impl Iterator<Item = Row> {
        self.times.iter().map(|(work, times)| {
            let (runs, spread) = (times.len() as u64, Spread::of(times));
            let measured = Measured { bytes: fill::MESSAGE, runs, unit: "us", spread };
            Row { work, records: self.records, measured, paper: None }
        })
    }
}

fn measure(directory: &Path, most: u64) -> Result<Vec<Row>, Failure> {
    let levels = levels(most);
    let all = levels.iter().sum();
    let (mut progress, mut behind) = (Progress::new("growth"), 0);
    let mut filled = Vec::with_capacity(levels.len());
    for records in levels {
        filled.push(Level::fill(directory, records, |done| progress.at(whole(behind + done), whole(all)))?);
        behind += records;
    }
    for _ in 0..TURNS {
        filled.iter_mut().try_for_each(Level::take_turn)?;
    }
    Ok(filled.iter().flat_map(Level::rows).collect())
}

fn whole(count: u64) -> usize {
    usize::try_from(count).unwrap_or(usize::MAX)
}

/// Microseconds of each of several rounds, after a warm-up.
fn timed(mut work: impl FnMut() -> Result<(), Failure>) -> Result<Vec<f64>, Failure> {
    work()?;
    let mut times = Vec::with_capacity(ROUNDS);
    for _ in 0..ROUNDS {
        let begun = Instant::now();
        work()?;
        times.push(begun.elapsed().as_secs_f64() * 1e6);
    }
    Ok(times)
}

/// Each work once, in order.
fn works(rows: &[Row]) -> Vec<&'static str> {
    rows.iter()
        .take_while(|row| Some(row.records) == rows.first().map(|first| first.records))
        .map(|row| row.work)
        .collect()
}

/// How many times as long each work takes with the most records as with the fewest.
fn ratios(rows: &[Row]) -> Vec<(&'static str, f64)> {
    let of =
        |work: &str| rows.iter().filter(|row| row.work == work).map(|row| row.measured.spread.p50).collect::<Vec<_>>();
    let ratio = |work| match of(work)[..] {
        [first, .., last] => last / first,
        _ => f64::NAN,
    };
    works(rows).into_iter().map(|work| (work, ratio(work))).collect()
}

fn text(report: &Report<Row>, ratios: &[(&'static str, f64)]) -> String {
    let mut levels: Vec<u64> = report.results.iter().map(|row| row.records).collect();
    levels.dedup();
    let heads: Vec<String> = levels.iter().map(|level| format!("{level} records")).collect();
    let mut head = vec!["work"];
    head.extend(heads.iter().map(String::as_str));
    head.push("ratio");
    let row = |(work, ratio): &(&'static str, f64)| {
        let times = report.results.iter().filter(|row| row.work == *work).map(|row| time(row.measured.spread.p50));
        let ratio = if ratio.is_finite() { format!("{ratio:.2}") } else { "-".to_owned() };
        std::iter::once((*work).to_owned()).chain(times).chain([ratio]).collect()
    };
    let rows: Vec<Vec<String>> = ratios.iter().map(row).collect();
    let mut lines = vec![
        "growth: cost of an operation as the ledger grows, us".to_owned(),
        format!("machine: {}", report.machine.line()),
        String::new(),
        table(&head, &rows),
        "\nratio between the most records and the fewest; 1 = flat".to_owned(),
    ];
    lines.extend(bars(&ratios.iter().map(|(work, ratio)| ((*work).to_owned(), *ratio)).collect::<Vec<_>>(), "times"));
    lines.push(String::new());
    lines.extend(NOTES.map(str::to_owned));
    lines.join("\n")
}

fn time(value: f64) -> String {
    if value < 100.0 { format!("{value:.2}") } else { format!("{value:.0}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_are_powers_of_ten_and_the_end() {
        assert_eq!(levels(1_000), [1_000]);
        assert_eq!(levels(100_000), [1_000, 10_000, 100_000]);
        assert_eq!(levels(20_000), [1_000, 10_000, 20_000]);
        assert_eq!(levels(5), [1_000]);
    }

    #[test]
    fn every_work_is_timed_at_every_level() {
        let directory = tempfile::tempdir().expect("a directory");
        let rows = measure(directory.path(), 1_500).expect("measures");
        let names = works(&rows);
        assert_eq!(rows.len(), 2 * names.len(), "{names:?}");
        assert!(rows.iter().all(|row| row.measured.spread.min > 0.0 && row.measured.runs > 0), "{rows:?}");
        for work in ["append", "life", "page", "none", "counts", "frame, uploads", "key"] {
            assert!(names.contains(&work), "{names:?}");
        }
        let ratios = ratios(&rows);
        assert!(ratios.len() == names.len() && ratios.iter().all(|(_, ratio)| *ratio > 0.0), "{ratios:?}");
    }
}
