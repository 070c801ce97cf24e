//! `authros bench sm2`, `sm3` and `sm4`: the paper's figures 16 and 17. Ours, libsm, the crates and libgcrypt
//! and OpenSSL take turns, so that what else the machine does falls on all alike; ratios are of the least times.

mod batch;
mod plots;
mod text;
mod work;

use std::time::Instant;

use serde::Serialize;
use serde_json::{Map, Value, json};

use self::work::{Bench, Piece};
use super::judgement::Judgement;
use super::machine::Machine;
use super::outlet::Outlet;
use super::progress::Progress;
use super::report::{Measured, Report};
use super::spread::{Spread, number};
use super::yardstick::Yardstick;
use crate::args::AlgorithmArguments;
use authros_crypto::{Kernel, Provider};
use authros_model::ErrorKind;
use authros_service::Failure;
use authros_service::failure::internal;

/// The paper's largest message.
const LARGEST: usize = 800_000;
/// The length of what SM2 signs and encrypts.
const SIGNED: usize = 32;
/// The paper's four, and the largest.
const SIZES: [usize; 5] = [1024, 2048, 4096, 8192, LARGEST];
/// The paper's time for SM3 of 800 KB, microseconds: the longest it states (section V).
const PAPER_SM3: f64 = 6340.0;
/// The shortest it states.
const PAPER_SM3_LEAST: f64 = 6190.0;
/// A value is an outlier if it exceeds the median by more than this share of it.
const OUTLYING: f64 = 0.25;

/// The algorithm.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Algorithm {
    /// Signatures and envelopes.
    Sm2,
    /// Digests.
    Sm3,
    /// Sealing and opening, and whole records.
    Sm4,
}

impl Algorithm {
    fn name(self) -> &'static str {
        match self {
            Self::Sm2 => "sm2",
            Self::Sm3 => "sm3",
            Self::Sm4 => "sm4",
        }
    }
}

/// One piece of work by one implementation.
#[derive(Debug, Clone, Serialize)]
struct Row {
    /// `digest`, `seal`, `open`, `record`, `sign`, `verify`, `encrypt` or `decrypt`.
    work: &'static str,
    /// `authros`, `authros-known`, `authros-many`, `authros-batch-16` (-64, -256), `crate`, `crates`, `libsm`,
    /// `libsm-gcm`, `libgcrypt` or `openssl`.
    by: &'static str,
    #[serde(flatten)]
    measured: Measured,
    /// 5th percentile.
    p5: f64,
    /// Values far above the median, greatest first.
    outliers: Vec<f64>,
    /// The paper's figure, in the same unit.
    paper: Option<f64>,
    /// Every value.
    #[serde(skip)]
    times: Vec<f64>,
}

/// A figure that must be reached.
#[derive(Debug, Serialize)]
struct Acceptance {
    what: String,
    limit: f64,
    found: f64,
    ok: bool,
}

/// Measures; [`Judgement::Missed`] if an acceptance figure is missed.
///
/// # Errors
/// If an algorithm fails.
pub async fn run(
    algorithm: Algorithm,
    AlgorithmArguments { runs }: AlgorithmArguments,
    provider: &'static dyn Provider,
    outlet: &Outlet,
) -> Result<Judgement, Failure> {
    if let Some(name) = std::env::var_os("AUTHROS_SM4_KERNEL").filter(|name| !name.is_empty()) {
        let kernel: Kernel = crate::read(&name.to_string_lossy())?;
        kernel.force().map_err(|error| Failure::new(ErrorKind::Input, error.to_string()))?;
    }
    let measured = tokio::task::spawn_blocking(move || measure(algorithm, runs, provider)).await;
    let (results, other) = measured.map_err(|_| internal("the measurement"))??;
    let acceptance = acceptance(algorithm, &results);
    let ok = acceptance.iter().all(|one| one.ok);
    let about = about(algorithm, &acceptance, &other);
    let report = Report { name: algorithm.name(), machine: Machine::read(), about, results };
    outlet.show(&report, || text::text(&report, &acceptance, &other), || plots::page(&report, algorithm))?;
    Ok(Judgement::reached(ok))
}

/// All rows, and the other library's version or why there are no figures for it.
fn measure(algorithm: Algorithm, runs: u32, provider: &'static dyn Provider) -> Result<(Vec<Row>, String), Failure> {
    let (library, done_there) = work::elsewhere(algorithm);
    let (mut yardstick, words) = match Yardstick::start(library) {
        Ok(started) => {
            let version = started.version.clone();
            (Some(started), version)
        }
        Err(why) => (None, why),
    };
    let sizes = if algorithm == Algorithm::Sm2 { &[SIGNED][..] } else { &SIZES };
    let mut progress = Progress::new(algorithm.name());
    let (mut rows, all) = (Vec::new(), sizes.len() * runs as usize);
    for (at, &size) in sizes.iter().enumerate() {
        let bench = Bench::new(provider, size)?;
        let pieces = bench.pieces(algorithm);
        let asked = yardstick.as_ref().map_or(&[][..], |_| done_there);
        let mut times = vec![Vec::with_capacity(runs as usize); pieces.len() + asked.len()];
        for run in 0..runs as usize {
            for (piece, times) in pieces.iter().zip(&mut times) {
                times.push(timed(piece)?);
            }
            for ((name, _), times) in asked.iter().zip(&mut times[pieces.len()..]) {
                let answer = yardstick.as_mut().ok_or_else(|| internal(library.name))?.time(name, size);
                times.push(answer.map_err(|why| internal(format!("{}'s program: {why}", library.name)))?);
            }
            progress.at(at * runs as usize + run, all);
        }
        let ours = pieces.iter().map(|piece| (piece.work, piece.by));
        let names = ours.chain(asked.iter().map(|(_, work)| (*work, library.name)));
        rows.extend(names.zip(times).map(|((work, by), times)| row(work, by, size, times)));
    }
    Ok((rows, words))
}

/// Microseconds for each of the messages in a piece of work.
fn timed(piece: &Piece<'_>) -> Result<f64, Failure> {
    // What it needs is prepared before the clock starts.
    let prepared = (piece.prepare)();
    let start = Instant::now();
    let done = (piece.run)(prepared);
    let gone = start.elapsed().as_secs_f64() * 1e6;
    done?;
    Ok(gone / number(piece.messages))
}

fn row(work: &'static str, by: &'static str, bytes: usize, times: Vec<f64>) -> Row {
    let spread = Spread::of(&times);
    let mut sorted = times.clone();
    sorted.sort_by(f64::total_cmp);
    let p5 = sorted.get((times.len() * 5).div_ceil(100).saturating_sub(1)).copied().unwrap_or(f64::NAN);
    let far = spread.p50 * (1.0 + OUTLYING);
    let outliers = sorted.into_iter().rev().take_while(|time| *time > far).collect();
    let paper = (work == "digest" && bytes == LARGEST).then_some(PAPER_SM3);
    let measured = Measured { bytes: bytes as u64, runs: times.len() as u64, unit: "us", spread };
    Row { work, by, measured, p5, outliers, paper, times }
}

/// The row of a piece of work.
fn find<'a>(rows: &'a [Row], work: &str, by: &str, bytes: usize) -> Option<&'a Row> {
    rows.iter().find(|row| row.work == work && row.by == by && row.measured.bytes == bytes as u64)
}

/// How many times as long `over` took as `under`, by their least times; both are (work, by).
fn ratio(rows: &[Row], bytes: usize, over: (&str, &str), under: (&str, &str)) -> Option<f64> {
    let least = |(work, by): (&str, &str)| find(rows, work, by, bytes).map(|row| row.measured.spread.min);
    Some(least(over)? / least(under)?)
}

fn acceptance(algorithm: Algorithm, rows: &[Row]) -> Vec<Acceptance> {
    match algorithm {
        Algorithm::Sm2 => acceptance_of_sm2(rows),
        Algorithm::Sm3 => acceptance_of_sm3(rows),
        Algorithm::Sm4 => acceptance_of_sm4(rows),
    }
}

fn at_most(what: impl Into<String>, limit: f64, found: f64) -> Acceptance {
    Acceptance { what: format!("{}, at most", what.into()), limit, found, ok: found <= limit }
}

fn at_least(what: impl Into<String>, limit: f64, found: f64) -> Acceptance {
    Acceptance { what: format!("{}, at least", what.into()), limit, found, ok: found >= limit }
}

/// Shares of the crate's time in the same run.
fn acceptance_of_sm2(rows: &[Row]) -> Vec<Acceptance> {
    let limits = [
        ("sign", "authros", 0.3),
        ("verify", "authros", 0.25),
        ("verify", work::KNOWN, 0.15),
        ("encrypt", "authros", 0.3),
        ("decrypt", "authros", 0.3),
    ];
    // Another provider in our place promises nothing.
    let ours = find(rows, "verify", work::KNOWN, SIGNED).is_some();
    let judged = limits.into_iter().filter(|_| ours).filter_map(|(work, by, limit)| {
        let ratio = ratio(rows, SIGNED, (work, by), (work, "crate"))?;
        Some(at_most(format!("SM2 {work} by {by} over the crate's"), limit, ratio))
    });
    judged.collect()
}

fn acceptance_of_sm3(rows: &[Row]) -> Vec<Acceptance> {
    let mut found = Vec::new();
    if let Some(ratio) = ratio(rows, LARGEST, ("digest", "authros"), ("digest", "libgcrypt")) {
        found.push(at_most("SM3 of 800 KB over libgcrypt's", 1.15, ratio));
    }
    if let Some(row) = find(rows, "digest", "authros", LARGEST) {
        found.push(at_most("SM3 of 800 KB over the paper's 6.34 ms", 1.0 / 3.0, row.measured.spread.p50 / PAPER_SM3));
        let width = |row: &Row| (row.measured.spread.p95 - row.p5) / 1e3;
        // The machine's overhead is in both.
        let other =
            find(rows, "digest", "libgcrypt", LARGEST).map(|row| format!(" (libgcrypt's here: {:.3})", width(row)));
        found.push(at_most(format!("SM3 of 800 KB, p5 to p95, ms{}", other.unwrap_or_default()), 0.15, width(row)));
    }
    found
}

fn acceptance_of_sm4(rows: &[Row]) -> Vec<Acceptance> {
    // Only GFNI with AVX-512 is expected to reach twice libgcrypt's speed.
    let wide = authros_crypto::kernel::Available::decided().kernel() == Kernel::GfniAvx512;
    let mut found = Vec::new();
    for (bytes, name) in [(8192, "8 KB"), (LARGEST, "800 KB")] {
        let against = |by: &str, limit: f64, found: &mut Vec<Acceptance>| {
            if let Some(ratio) = ratio(rows, bytes, ("seal", by), ("seal", "authros")) {
                found.push(at_least(format!("{by}'s SM4-GCM of {name} over ours"), limit, ratio));
            }
        };
        if wide {
            against("libsm-gcm", 40.0, &mut found);
        }
        against("libgcrypt", if wide { 2.0 } else { 1.0 }, &mut found);
    }
    if let Some(ratio) = ratio(rows, LARGEST, ("record", "authros"), ("digest", "authros")) {
        found.push(at_most("sealing, digest and signature of 800 KB over SM3 alone", 1.3, ratio));
    }
    found
}

fn about(algorithm: Algorithm, acceptance: &[Acceptance], other: &str) -> Map<String, Value> {
    let kernel = authros_crypto::kernel::Available::decided().kernel();
    let mut about = Map::new();
    about.insert("kernel".to_owned(), json!(kernel.to_string()));
    about.insert(work::elsewhere(algorithm).0.name.to_owned(), json!(other));
    about.insert("acceptance".to_owned(), json!(acceptance));
    about.insert("notes".to_owned(), json!(text::NOTES));
    about
}

#[cfg(test)]
mod tests;
