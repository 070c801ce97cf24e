//! `record`: one record on one core: compressed, sealed, digested and signed, then checked, proven and opened. Each step
//! by the chosen provider, and all of it by every provider. The steps are those of the very code that the product runs.

mod timed;

use serde::Serialize;
use serde_json::json;

use self::timed::{Kit, Lap};
use super::Lab;
use super::judgement::Judgement;
use super::plot::{Axis, Bar, COLOURS, Mark, Plot, Series};
use super::progress::Progress;
use super::report::{Measured, Report};
use super::spread::{Spread, decimal, number};
use authros_crypto::{Provider, ProviderName, provider};
use authros_output::table;
use authros_service::Failure;
use authros_service::reply::internal;

/// 1 KiB (odometry), 58 KB (a compressed picture, as in `pipeline`), 1 MB (a raw one).
const SIZES: [usize; 3] = [1024, 58 * 1024, 1_000_000];
/// The name of all steps together.
const WHOLE: &str = "whole";
const PROVIDERS: [ProviderName; 3] = [ProviderName::Authros, ProviderName::RustCrypto, ProviderName::Libsm];

const NOTES: [&str; 5] = [
    "One core; messages of random bytes, so compression is attempted but gains nothing and the whole length is sealed. \
     For everything else in the pipeline (store, chain) see `pipeline`, whose stages seal and verify are these.",
    "SM4-GCM: head and body. SM3: the digest of the stored bytes. SM2: signing or verifying it.",
    "proof: the leaf and the path of a batch of 256 to its root. rest: head and header with all their checks, HKDF-SM3, \
     the salt and the copies.",
    "share: of the sum of all runs. Times are microseconds per message; per second and core: from the medians.",
    "Providers take turns. times: their least time over that of the chosen one in the same run.",
];

/// A step, or all of them, at one size.
#[derive(Debug, Serialize)]
struct Row {
    /// `seal` or `open`.
    way: &'static str,
    /// The provider.
    by: String,
    step: &'static str,
    #[serde(flatten)]
    measured: Measured,
    /// Of the whole, 0 to 1.
    share: f64,
    /// Of the whole: messages a second on one core.
    per_second: Option<f64>,
    /// Of the whole: megabytes (10^6) a second on one core.
    mb_per_second: Option<f64>,
    /// Of the whole: over the chosen provider's.
    times: Option<f64>,
}

/// Measures.
///
/// # Errors
/// If an algorithm fails, or the files cannot be written.
pub async fn run(lab: &Lab, runs: u32) -> Result<Judgement, Failure> {
    let (name, outlet) = (lab.name, &lab.outlet);
    let measured = tokio::task::spawn_blocking(move || measure(runs, name)).await;
    let results = measured.map_err(|_| internal("the measurement"))??;
    let title = "One record on one core, step by step";
    let report = Report::new("record", title, &NOTES, json!({ "provider": name.to_string() }), results);
    let plots = vec![plot("Sealed", "seal", &report.results), plot("Opened and verified", "open", &report.results)];
    outlet.show(&report, &tables(&report.results), &report.page(1, plots))?;
    Ok(Judgement::Reached)
}

fn measure(runs: u32, chosen: ProviderName) -> Result<Vec<Row>, Failure> {
    let others = PROVIDERS.into_iter().filter(|name| *name != chosen);
    let names: Vec<ProviderName> = std::iter::once(chosen).chain(others).collect();
    let mut progress = Progress::new("record");
    let mut rows = Vec::new();
    for (at, size) in SIZES.into_iter().enumerate() {
        let kit = |name: &ProviderName| -> Result<_, Failure> {
            let provider: &'static dyn Provider = provider(*name);
            Ok((*name, Kit::new(provider, size)?, [Vec::new(), Vec::new()]))
        };
        let mut kits = names.iter().map(kit).collect::<Result<Vec<_>, _>>()?;
        for run in 0..runs as usize {
            for (_, kit, [sealing, opening]) in &mut kits {
                let (sealed, lap) = kit.seal()?;
                sealing.push(lap);
                opening.push(kit.open(&sealed)?);
            }
            progress.at(at * runs as usize + run, SIZES.len() * runs as usize);
        }
        for (place, way) in ["seal", "open"].into_iter().enumerate() {
            rows.extend(rows_of_all(way, size, kits.iter().map(|(name, _, laps)| (*name, &laps[place][..]))));
        }
    }
    Ok(rows)
}

/// The chosen provider's whole and steps, then the others' wholes.
fn rows_of_all<'a>(way: &'static str, size: usize, all: impl Iterator<Item = (ProviderName, &'a [Lap])>) -> Vec<Row> {
    let (mut rows, mut least) = (Vec::new(), f64::NAN);
    for (name, laps) in all {
        let steps = rows_of(way, name, size, laps);
        let first = rows.is_empty();
        for mut row in steps.into_iter().take(if first { usize::MAX } else { 1 }) {
            if row.step == WHOLE {
                least = if first { row.measured.spread.min } else { least };
                row.times = Some(row.measured.spread.min / least);
            }
            rows.push(row);
        }
    }
    rows
}

/// The whole first, then its steps in order.
fn rows_of(way: &'static str, name: ProviderName, size: usize, laps: &[Lap]) -> Vec<Row> {
    let whole: Vec<f64> = laps.iter().map(|lap| lap.iter().map(|(_, time)| time).sum()).collect();
    let sum: f64 = whole.iter().sum();
    let row = |step, times: &[f64]| {
        let spread = Spread::of(times);
        let measured = Measured { bytes: size as u64, runs: times.len() as u64, unit: "us", spread };
        let per_second = (step == WHOLE).then(|| 1e6 / spread.p50);
        let mb_per_second = per_second.map(|messages| messages * number(size) / 1e6);
        let share = times.iter().sum::<f64>() / sum;
        Row { way, by: name.to_string(), step, measured, share, per_second, mb_per_second, times: None }
    };
    let names = laps.first().into_iter().flatten().map(|(name, _)| *name);
    let of = |name| {
        let time = |lap: &Lap| lap.iter().find(|(step, _)| *step == name).map_or(0.0, |(_, time)| *time);
        row(name, &laps.iter().map(time).collect::<Vec<_>>())
    };
    std::iter::once(row(WHOLE, &whole)).chain(names.map(of)).collect()
}

fn tables(rows: &[Row]) -> Vec<String> {
    let (wholes, steps): (Vec<&Row>, Vec<&Row>) = rows.iter().partition(|row| row.step == WHOLE);
    let wholes: Vec<Vec<String>> = wholes.into_iter().map(cells).collect();
    let step = |row: &Row| {
        let (share, time) = (decimal(row.share * 100.0), format!("{:.2}", row.measured.spread.p50));
        vec![row.way.to_owned(), row.measured.bytes.to_string(), row.step.to_owned(), share, time]
    };
    let steps: Vec<Vec<String>> = steps.into_iter().map(step).collect();
    vec![
        table(&["way", "by", "bytes", "runs", "min us", "p50 us", "p95 us", "messages/s", "MB/s", "times"], &wholes),
        table(&["way", "bytes", "step", "% of its time", "p50 us"], &steps),
    ]
}

fn cells(row: &Row) -> Vec<String> {
    let Spread { min, p50, p95, .. } = row.measured.spread;
    let mut cells = vec![row.way.to_owned(), row.by.clone()];
    cells.extend([row.measured.bytes.to_string(), row.measured.runs.to_string()]);
    let (per_second, mb_per_second) = (row.per_second.unwrap_or(f64::NAN), row.mb_per_second.unwrap_or(f64::NAN));
    cells.extend([min, p50, p95, per_second, mb_per_second, row.times.unwrap_or(f64::NAN)].map(decimal));
    cells
}

/// The share of each step.
fn plot(title: &str, way: &str, rows: &[Row]) -> Plot {
    let of_size = |size: usize| {
        rows.iter().filter(move |row| row.way == way && row.step != WHOLE && row.measured.bytes == size as u64)
    };
    let series: Vec<Series> = SIZES
        .into_iter()
        .zip(COLOURS)
        .map(|(size, colour)| {
            let bars = of_size(size).map(|row| Bar::plain(row.share * 100.0));
            Series::new(format!("{size} bytes"), colour, Mark::Bars(bars.collect()))
        })
        .collect();
    Plot {
        title: title.to_owned(),
        across: Axis::places("step", of_size(SIZES[0]).map(|row| row.step.to_owned())),
        left: Axis::from_zero("% of its time", series.iter().flat_map(Series::values)),
        right: None,
        series,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_add_up_to_the_whole_and_every_provider_is_there() {
        let rows = measure(2, ProviderName::RustCrypto).expect("measures");
        for size in SIZES {
            for (way, steps) in [("seal", 5), ("open", 5)] {
                let of = |row: &&Row| row.way == way && row.measured.bytes == size as u64;
                let (wholes, parts): (Vec<&Row>, Vec<&Row>) = rows.iter().filter(of).partition(|row| row.step == WHOLE);
                let by: Vec<&str> = wholes.iter().map(|row| row.by.as_str()).collect();
                assert_eq!((by, parts.len()), (vec!["rustcrypto", "authros", "libsm"], steps), "{way} {size}");
                let sum: f64 = parts.iter().map(|row| row.share).sum();
                assert!((sum - 1.0).abs() < 1e-9 && (wholes[0].share - 1.0).abs() < 1e-9, "{sum}");
                let rate = wholes[0].mb_per_second.expect("of the whole") / wholes[0].per_second.expect("too") * 1e6;
                assert!((rate - number(size)).abs() < 1e-3, "{rate}");
                assert!(parts.iter().all(|row| row.per_second.is_none() && row.measured.spread.max > 0.0), "{parts:?}");
                assert_eq!(wholes[0].times, Some(1.0));
                assert!(wholes.iter().all(|row| row.times > Some(0.0)), "{wholes:?}");
            }
        }
    }
}
