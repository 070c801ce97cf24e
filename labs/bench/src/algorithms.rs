//! `sm2`, `sm3` and `sm4`: the paper's figures 16 and 17. Ours, libsm and the crates take turns, so that what else the
//! machine does falls on all alike; ratios are of the least times. The `openssl` command measures itself.

mod batch;
mod openssl;
mod plots;
mod reference;
mod work;

use std::time::Instant;

use serde::Serialize;
use serde_json::json;

use self::work::{Piece, Subject};
use super::Lab;
use super::judgement::{Judgement, Target};
use super::progress::Progress;
use super::report::{Measured, Report};
use super::spread::{Spread, number};
use authros_crypto::{Kernel, Provider};
use authros_output::table;
use authros_service::Failure;
use authros_service::reply::internal;

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

const NOTES: [&str; 8] = [
    "Times are microseconds per message; implementations take turns, run by run. Ratios use the shortest times, which \
     other work on the machine disturbs least.",
    "digest: SM3. seal, open: SM4-GCM with key set-up, 32 bytes of additional data and the tag. record: a whole record \
     with its keys, sealed head and body, SM3 and SM2 signature.",
    "authros: the chosen provider (SM4 by the kernel named above); authros-known: a signer seen before, whose table is \
     cached; authros-many: 16 messages side by side; crate: the crate sm2; crates: sm4, ctr and ghash; libsm: its SM4 \
     behind our GCM, as the program uses it; libsm-gcm: its own GCM.",
    "openssl: what `openssl speed` says of itself, a mean over a second, not in turn with the others. openssl-ctr: SM4 in \
     counter mode without a tag, because OpenSSL 3.0 has no SM4-GCM: less work than seal and open.",
    "authros-batch-N: one signature over the Merkle root of N records' leaves, with every record's path made or \
     checked; per record. A record signed this way cannot stand alone, so none is (ARCHITECTURE.md).",
    "outliers: values more than a quarter above the median, and the three largest.",
    "The paper gives 6.19 to 6.34 ms for SM3 of 800 KB (section V, figure 17). Of SM4 (figure 16) it gives no numbers.",
    "Judge only on an otherwise idle machine.",
];

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
            Self::Sm3 => "figure-17-sm3",
            Self::Sm4 => "figure-16-sm4",
        }
    }

    fn title(self) -> &'static str {
        match self {
            Self::Sm2 => "SM2: signatures and envelopes, microseconds",
            Self::Sm3 => "SM3: digests, microseconds (the paper's figure 17)",
            Self::Sm4 => "SM4-GCM: encryption and decryption, microseconds (the paper's figure 16)",
        }
    }
}

/// One piece of work by one implementation.
#[derive(Debug, Clone, Serialize)]
struct Row {
    /// `digest`, `seal`, `open`, `record`, `sign`, `verify`, `encrypt` or `decrypt`.
    work: &'static str,
    /// `authros`, `authros-known`, `authros-many`, `authros-batch-16` (-64, -256), `crate`, `crates`, `libsm`,
    /// `libsm-gcm`, `openssl` or `openssl-ctr`.
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

/// Measures; [`Judgement::Missed`] if a target is missed.
///
/// # Errors
/// If an algorithm fails, or the files cannot be written.
pub async fn run(lab: &Lab, algorithm: Algorithm, runs: u32) -> Result<Judgement, Failure> {
    let provider = lab.provider;
    let measured = tokio::task::spawn_blocking(move || measure(algorithm, runs, provider)).await;
    let (results, openssl) = measured.map_err(|_| internal("the measurement"))??;
    let targets = targets(algorithm, &results);
    let kernel = authros_crypto::kernel::Available::decided().kernel().to_string();
    let about = json!({ "kernel": kernel, "openssl": openssl, "targets": targets });
    let report = Report::new(algorithm.name(), algorithm.title(), &NOTES, about, results);
    let (columns, plots) = plots::of(&report.results, algorithm);
    let about = format!("SM4 kernel: {kernel}; {openssl}");
    let tables = [about, text(&report.results), Target::lines(&targets)];
    lab.outlet.show(&report, &tables, &report.page(columns, plots))?;
    Ok(Judgement::of(&targets))
}

/// All rows, and the version of openssl or why there are no figures for it.
fn measure(algorithm: Algorithm, runs: u32, provider: &'static dyn Provider) -> Result<(Vec<Row>, String), Failure> {
    let sizes = if algorithm == Algorithm::Sm2 { &[SIGNED][..] } else { &SIZES };
    let mut progress = Progress::new(algorithm.name());
    let (mut rows, all) = (Vec::new(), sizes.len() * runs as usize);
    for (at, &size) in sizes.iter().enumerate() {
        let subject = Subject::new(provider, size)?;
        let pieces = subject.pieces(algorithm);
        let mut times = vec![Vec::with_capacity(runs as usize); pieces.len()];
        for run in 0..runs as usize {
            for (piece, times) in pieces.iter().zip(&mut times) {
                times.push(timed(piece)?);
            }
            progress.at(at * runs as usize + run, all);
        }
        rows.extend(pieces.iter().zip(times).map(|(piece, times)| row(piece.work, piece.by, size, times)));
    }
    drop(progress);
    let told = match openssl::measure(algorithm) {
        Ok((version, means)) => {
            rows.extend(means.into_iter().map(|(work, by, size, mean)| row(work, by, size, vec![mean])));
            version
        }
        Err(why) => format!("openssl was not timed: {why}"),
    };
    Ok((rows, told))
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

fn targets(algorithm: Algorithm, rows: &[Row]) -> Vec<Target> {
    match algorithm {
        Algorithm::Sm2 => targets_of_sm2(rows),
        Algorithm::Sm3 => targets_of_sm3(rows),
        Algorithm::Sm4 => targets_of_sm4(rows),
    }
}

/// Shares of the crate's time in the same run.
fn targets_of_sm2(rows: &[Row]) -> Vec<Target> {
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
        Some(Target::at_most(format!("SM2 {work} by {by} over the crate's"), limit, ratio))
    });
    judged.collect()
}

fn targets_of_sm3(rows: &[Row]) -> Vec<Target> {
    let mut found = Vec::new();
    if let Some(ratio) = ratio(rows, LARGEST, ("digest", "authros"), ("digest", "openssl")) {
        found.push(Target::at_most("SM3 of 800 KB over openssl's", 1.15, ratio));
    }
    if let Some(row) = find(rows, "digest", "authros", LARGEST) {
        let share = row.measured.spread.p50 / PAPER_SM3;
        found.push(Target::at_most("SM3 of 800 KB over the paper's 6.34 ms", 1.0 / 3.0, share));
        let width = (row.measured.spread.p95 - row.p5) / 1e3;
        found.push(Target::at_most("SM3 of 800 KB, p5 to p95, ms", 0.15, width));
    }
    found
}

fn targets_of_sm4(rows: &[Row]) -> Vec<Target> {
    // Only GFNI with AVX-512 is expected to be that much faster than libsm.
    let wide = authros_crypto::kernel::Available::decided().kernel() == Kernel::GfniAvx512;
    let mut found = Vec::new();
    for (bytes, name) in [(8192, "8 KB"), (LARGEST, "800 KB")] {
        for (by, limit) in
            [("libsm-gcm", 40.0), ("openssl-ctr", 1.0)].into_iter().filter(|(by, _)| wide || *by != "libsm-gcm")
        {
            if let Some(ratio) = ratio(rows, bytes, ("seal", by), ("seal", "authros")) {
                found.push(Target::at_least(format!("{by}'s sealing of {name} over ours"), limit, ratio));
            }
        }
    }
    if let Some(ratio) = ratio(rows, LARGEST, ("record", "authros"), ("digest", "authros")) {
        found.push(Target::at_most("sealing, digest and signature of 800 KB over SM3 alone", 1.3, ratio));
    }
    found
}

fn text(rows: &[Row]) -> String {
    let head = ["work", "bytes", "by", "runs", "min", "p5", "p50", "p95", "max", "p5-p95", "outliers", "paper"];
    table(&head, rows.iter().map(cells))
}

fn cells(row: &Row) -> Vec<String> {
    let spread = row.measured.spread;
    let greatest: Vec<String> = row.outliers.iter().take(3).map(|time| format!("{time:.0}")).collect();
    let outliers = match row.outliers.len() {
        0 => "none".to_owned(),
        count => format!("{count} ({})", greatest.join(", ")),
    };
    let time = |value: f64| if value < 100.0 { format!("{value:.2}") } else { format!("{value:.1}") };
    vec![
        row.work.to_owned(),
        row.measured.bytes.to_string(),
        row.by.to_owned(),
        row.measured.runs.to_string(),
        time(spread.min),
        time(row.p5),
        time(spread.p50),
        time(spread.p95),
        time(spread.max),
        time(spread.p95 - row.p5),
        outliers,
        row.paper.map_or("-".to_owned(), |paper| format!("{paper:.0}")),
    ]
}

#[cfg(test)]
mod tests;
