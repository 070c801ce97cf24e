//! `authros bench record`: one record on one core, step by step: compressed, sealed, digested and signed, then checked,
//! proven and opened. The steps are those of the very code that the program runs.

mod plots;
mod timed;

use serde::Serialize;
use serde_json::{Map, json};

use self::timed::{Kit, Lap};
use super::judgement::Judgement;
use super::machine::Machine;
use super::outlet::Outlet;
use super::progress::Progress;
use super::report::{Measured, Report};
use super::spread::{Spread, decimal, number};
use authros_crypto::Provider;
use authros_output::table;
use authros_service::Failure;
use authros_service::failure::internal;

/// 1 KiB (odometry), 58 KB (a compressed picture, as in `bench pipeline`), 1 MB (a raw one).
const SIZES: [usize; 3] = [1024, 58 * 1024, 1_000_000];
/// The longest bar, characters.
const LONGEST_BAR: usize = 50;
/// The name of all steps together.
const WHOLE: &str = "whole";

const NOTES: [&str; 4] = [
    "One core; messages of random bytes, so compression is attempted but gains nothing and the whole length is sealed. \
     For everything else in the pipeline (vault, ledger, chain) see `bench pipeline`, whose stages seal and verify are \
     these.",
    "fields: head and header encoded or parsed, with all their checks. keys: HKDF-SM3 and the salt. SM4-GCM: head and \
     body, including the copy. SM3: the digest of the stored bytes. SM2: signing or verifying it.",
    "proof: the leaf and the path of a batch of 256 to its root. restore: decompression, not needed here.",
    "share: of the sum of all runs. Times are microseconds per message; per second and core: from the medians.",
];

/// A step, or all of them, at one size.
#[derive(Debug, Serialize)]
struct Row {
    /// `seal` or `open`.
    way: &'static str,
    step: &'static str,
    #[serde(flatten)]
    measured: Measured,
    /// Of the whole, 0 to 1.
    share: f64,
    /// Of the whole: messages a second on one core.
    per_second: Option<f64>,
    /// Of the whole: megabytes (10^6) a second on one core.
    mb_per_second: Option<f64>,
    paper: Option<f64>,
}

/// Measures.
///
/// # Errors
/// If an algorithm fails, or the page of plots cannot be written.
pub async fn run(runs: u32, provider: &'static dyn Provider, outlet: &Outlet) -> Result<Judgement, Failure> {
    let measured = tokio::task::spawn_blocking(move || measure(runs, provider)).await;
    let results = measured.map_err(|_| internal("the measurement"))??;
    let mut about = Map::new();
    about.insert("notes".to_owned(), json!(NOTES));
    let report = Report { name: "record", machine: Machine::read(), about, results };
    outlet.show(&report, || text(&report), || plots::page(&report))?;
    Ok(Judgement::Reached)
}

fn measure(runs: u32, provider: &'static dyn Provider) -> Result<Vec<Row>, Failure> {
    let mut progress = Progress::new("record");
    let mut rows = Vec::new();
    for (at, size) in SIZES.into_iter().enumerate() {
        let kit = Kit::new(provider, size)?;
        let mut laps = [Vec::new(), Vec::new()];
        for run in 0..runs as usize {
            let (sealed, lap) = kit.seal()?;
            laps[0].push(lap);
            laps[1].push(kit.open(&sealed)?);
            progress.at(at * runs as usize + run, SIZES.len() * runs as usize);
        }
        for (way, laps) in ["seal", "open"].into_iter().zip(&laps) {
            rows.extend(rows_of(way, size, laps));
        }
    }
    Ok(rows)
}

/// The whole first, then its steps in order.
fn rows_of(way: &'static str, size: usize, laps: &[Lap]) -> Vec<Row> {
    let whole: Vec<f64> = laps.iter().map(|lap| lap.iter().map(|(_, time)| time).sum()).collect();
    let sum: f64 = whole.iter().sum();
    let row = |step, times: &[f64]| {
        let spread = Spread::of(times);
        let measured = Measured { bytes: size as u64, runs: times.len() as u64, unit: "us", spread };
        let per_second = (step == WHOLE).then(|| 1e6 / spread.p50);
        let mb_per_second = per_second.map(|messages| messages * number(size) / 1e6);
        let share = times.iter().sum::<f64>() / sum;
        Row { way, step, measured, share, per_second, mb_per_second, paper: None }
    };
    let names = laps.first().into_iter().flatten().map(|(name, _)| *name);
    let of = |name| {
        let time = |lap: &Lap| lap.iter().find(|(step, _)| *step == name).map_or(0.0, |(_, time)| *time);
        row(name, &laps.iter().map(time).collect::<Vec<_>>())
    };
    std::iter::once(row(WHOLE, &whole)).chain(names.map(of)).collect()
}

fn text(report: &Report<Row>) -> String {
    let wholes: Vec<Vec<String>> = report.results.iter().filter(|row| row.step == WHOLE).map(cells).collect();
    let mut lines = vec![
        "record: one message on one core".to_owned(),
        format!("machine: {}", report.machine.line()),
        String::new(),
        table(&["way", "bytes", "runs", "min us", "p50 us", "p95 us", "messages/s", "MB/s"], &wholes),
    ];
    for row in &report.results {
        if row.step == WHOLE {
            lines.push(format!("\n{} of {} bytes, share of its time", row.way, row.measured.bytes));
        } else {
            lines.push(bar(row));
        }
    }
    lines.push(String::new());
    lines.extend(NOTES.map(str::to_owned));
    lines.join("\n")
}

fn cells(row: &Row) -> Vec<String> {
    let Spread { min, p50, p95, .. } = row.measured.spread;
    let mut cells = vec![row.way.to_owned(), row.measured.bytes.to_string(), row.measured.runs.to_string()];
    let (per_second, mb_per_second) = (row.per_second.unwrap_or(f64::NAN), row.mb_per_second.unwrap_or(f64::NAN));
    cells.extend([min, p50, p95, per_second, mb_per_second].map(decimal));
    cells
}

fn bar(row: &Row) -> String {
    let length = (1..=LONGEST_BAR).filter(|at| (number(*at) - 0.5) / number(LONGEST_BAR) <= row.share).count();
    let (share, time) = (row.share * 100.0, row.measured.spread.p50);
    format!("  {:<9} {share:>5.1} % {time:>9.2} us |{}", row.step, "#".repeat(length))
}

#[cfg(test)]
mod tests {
    use super::*;
    use authros_crypto::{ProviderName, provider};

    #[test]
    fn steps_add_up_to_the_whole() {
        let rows = measure(2, provider(ProviderName::RustCrypto)).expect("measures");
        for size in SIZES {
            for (way, steps) in [("seal", 6), ("open", 7)] {
                let of = |row: &&Row| row.way == way && row.measured.bytes == size as u64;
                let (whole, parts): (Vec<&Row>, Vec<&Row>) = rows.iter().filter(of).partition(|row| row.step == WHOLE);
                assert_eq!((whole.len(), parts.len()), (1, steps), "{way} {size}: {parts:?}");
                let sum: f64 = parts.iter().map(|row| row.share).sum();
                assert!((sum - 1.0).abs() < 1e-9 && (whole[0].share - 1.0).abs() < 1e-9, "{sum}");
                let rate = whole[0].mb_per_second.expect("of the whole") / whole[0].per_second.expect("too") * 1e6;
                assert!((rate - number(size)).abs() < 1e-3, "{rate}");
                assert!(parts.iter().all(|row| row.per_second.is_none() && row.measured.spread.max > 0.0), "{parts:?}");
            }
        }
    }

    #[test]
    fn a_bar_is_as_long_as_its_share() {
        let row = |share: f64| Row { share, ..rows_of("seal", 1, &[vec![("x", 1.0)]]).remove(1) };
        let length = |share: f64| bar(&row(share)).chars().filter(|letter| *letter == '#').count();
        assert_eq!([0.0, 0.02, 0.5, 1.0].map(length), [0, 1, 25, 50]);
    }
}
