//! `authros bench fleet`: many robots at one gateway, and at several over the same chain, all of it real and in this
//! process: processor time per record, bytes between gateways, what is lost or doubled, how long a fail-over takes.

mod chance;
mod owner;
mod plots;
mod reckoning;
mod relay;
mod robot;
mod station;
mod world;

use std::collections::{BTreeMap, HashSet};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use serde::Serialize;
use serde_json::{Map, json};

use self::reckoning::{Reckoning, reckon};
use self::robot::{Brought, Pace, TOGETHER};
use self::world::{Plan, World};
use super::judgement::Judgement;
use super::machine::Machine;
use super::outlet::Outlet;
use super::report::{Measured, Report};
use super::spread::{Spread, bars, decimal, number};
use super::usage::{most_files, processor_seconds};
use crate::Global;
use crate::args::FleetArguments;
use authros_crypto::{Provider, forget_signers};
use authros_model::{Digest, ErrorKind};
use authros_output::table;
use authros_service::Failure;

/// What is asked: processor time per record and copy at several gateways over that at one.
const ASKED: f64 = 1.1;
/// Robots, unless it is said how many, and the most.
const ROBOTS: usize = 1000;
const MOST_ROBOTS: usize = 100_000;
/// Bytes of sealed records that are kept in memory at most, and what a record has beside its message.
const MOST_SEALED: u64 = 1 << 30;
const BESIDE: u64 = 512;
/// Descriptors that the process needs: by itself, for each gateway, for each line between two, for each robot.
const FILES: [usize; 4] = [100, 60, 4, 2];
/// How long a stopped gateway and the pause before it take, about.
const A_FAILURE: Duration = Duration::from_secs(7);

const NOTES: [&str; 7] = [
    "one: one gateway. apart: several that do not know each other, so each keeps what its robots bring. reconciling: all name \
     each other, so every gateway checks and keeps every record. failures: the same, while gateways are stopped and begun again.",
    "Gateways, robots and the chain are real and share this process and its cores; processor = all of them together, from the \
     first connection until the last copy was seen to be verified. Records are sealed before that.",
    "per copy: processor divided by gateways that keep the record. A gateway that keeps a record checks it, so reconciling \
     costs more with every gateway, whatever the number of robots.",
    "Robots take turns: each connects, brings its records in uploads of at most 8, and leaves. They know two gateways each. \
     A gateway is stopped as by SIGTERM; kill -9 is for the flows of tests/it/fleet.",
    "between: bytes on the lines between gateways, both ways, per record: what was told, asked and handed over.",
    "fail-over: from the request that failed to the receipt of another gateway, or of the same one if both were away.",
    "lost: acknowledged by a receipt and verified at no gateway. lacking: not verified at a gateway that should have it, one \
     for each record and gateway. doubled: twice in a list that a gateway gives to the owner. left: never acknowledged.",
];

/// One part of the run.
#[derive(Debug, Serialize)]
struct Row {
    part: &'static str,
    gateways: usize,
    /// How many gateways keep each record, on average.
    copies: f64,
    robots: usize,
    connected: usize,
    /// Acknowledged.
    records: u64,
    /// From sending an upload to its receipt.
    #[serde(flatten)]
    measured: Measured,
    /// Until all of it was verified where it should be.
    seconds: f64,
    /// Processor time of everything, microseconds for each record; and what that is of the figure at one gateway.
    processor: f64,
    ratio: f64,
    /// The same for each copy of a record.
    per_copy: f64,
    per_copy_ratio: f64,
    /// Bytes between gateways for each record.
    between: f64,
    failures: u32,
    failovers: usize,
    /// Seconds.
    failover_p50: Option<f64>,
    failover_max: Option<f64>,
    lost: u64,
    lacking: u64,
    doubled: u64,
    left: u64,
    /// Why the last of those left was not acknowledged.
    why: Option<String>,
    /// Records that two gateways anchored, as they saw it.
    anchored_twice: u64,
    /// Whether everything was verified in time.
    settled: bool,
    /// What gateways said against each other meanwhile, and in how many looks, one a second at each.
    problems: BTreeMap<String, u64>,
    paper: Option<f64>,
}

impl Row {
    fn is_whole(&self) -> bool {
        self.settled && self.lost + self.lacking + self.doubled + self.left == 0
    }
}

/// Measures; [`Judgement::Incomplete`] if a record was lost, doubled or left, [`Judgement::Missed`] if a gateway more
/// costs more for a copy of a record than is asked.
///
/// # Errors
/// If a gateway or the chain cannot be begun, or one does not answer.
pub async fn run(
    global: Global<'_>,
    arguments: &FleetArguments,
    provider: &'static dyn Provider,
    outlet: &Outlet,
) -> Result<Judgement, Failure> {
    let plan = plan(global, arguments, provider)?;
    let mut results = Vec::new();
    outlet.note(&format!("bench fleet: {} robots, first at one gateway, then at {}", plan.robots, arguments.gateways));
    let mut one = Part::new(World::open(&plan, 1).await?);
    let first = one.measure(&plan, "one", 1, None, outlet).await;
    one.world.close().await;
    results.push(first?);
    let gateways = usize::from(arguments.gateways);
    let mut many = Part::new(World::open(&plan, gateways).await?);
    let measured = several(&plan, arguments, &mut many, &mut results, outlet).await;
    many.world.close().await;
    let begun = measured?;
    compare(&mut results);
    let about = Map::from_iter([
        ("seed".to_owned(), json!(arguments.seed)),
        ("asked".to_owned(), json!(ASKED)),
        ("notes".to_owned(), json!(NOTES)),
    ]);
    let report = Report { name: "fleet", machine: Machine::read(), about, results };
    outlet.show(&report, || text(&report), || plots::page(&report))?;
    if !begun || !report.results.iter().all(Row::is_whole) {
        return Ok(Judgement::Incomplete);
    }
    Ok(Judgement::reached(report.results.iter().filter(|row| row.failures == 0).all(|row| row.per_copy_ratio <= ASKED)))
}

/// Returns whether each part was begun: one for which no time is left would show figures of nothing.
async fn several(
    plan: &Plan,
    arguments: &FleetArguments,
    many: &mut Part,
    results: &mut Vec<Row>,
    outlet: &Outlet,
) -> Result<bool, Failure> {
    let in_time = |part: &str| {
        let in_time = Instant::now() < plan.deadline;
        if !in_time {
            outlet.note(&format!("bench fleet: no time is left for '{part}' and what follows; see --seconds"));
        }
        in_time
    };
    if !in_time("apart") {
        return Ok(false);
    }
    let gateways = usize::from(arguments.gateways);
    results.push(many.measure(plan, "apart", 1, None, outlet).await?);
    many.world.name_each_other().await?;
    let (held, begun) = (many.acknowledged.len() as u64, Instant::now());
    let copies = arguments.copies.map_or(gateways, |copies| gateways.min(copies.into()));
    let settled = many.world.settle(held, copies, plan.deadline).await?;
    many.copies = settled.copies;
    if !settled.in_time {
        outlet.note("bench fleet: the gateways did not catch up in time; see --seconds");
    }
    let (took, bytes) = (begun.elapsed().as_secs_f64(), many.world.between());
    outlet.note(&format!(
        "bench fleet: each named all others and had their {held} records after {took:.1} s, {bytes} bytes"
    ));
    if !in_time("reconciling") {
        return Ok(false);
    }
    results.push(many.measure(plan, "reconciling", copies, None, outlet).await?);
    if arguments.failures > 0 {
        if !in_time("failures") {
            return Ok(false);
        }
        let failing = Some((arguments.failures, arguments.seed));
        results.push(many.measure(plan, "failures", copies, failing, outlet).await?);
    }
    Ok(true)
}

/// The flag of the whole program says how many, here without the bound for robots of ROS.
fn robots(global: Global<'_>) -> Result<usize, Failure> {
    let Some(asked) = (global.settings)("robots") else { return Ok(ROBOTS) };
    let robots = asked.parse().ok().filter(|robots| (1..=MOST_ROBOTS).contains(robots));
    robots.ok_or_else(|| Failure::new(ErrorKind::Usage, format!("--robots takes 1 to {MOST_ROBOTS} for this bench")))
}

/// What is wanted, within what this machine allows.
fn plan(global: Global<'_>, arguments: &FleetArguments, provider: &'static dyn Provider) -> Result<Plan, Failure> {
    let (robots, gateways) = (robots(global)?, usize::from(arguments.gateways));
    let records = arguments.records.max(robots as u64);
    if records.saturating_mul(u64::from(arguments.size) + BESIDE) > MOST_SEALED {
        let text = format!(
            "{records} records of {} bytes take more memory than 1 GiB; lower --records or --size",
            arguments.size
        );
        return Err(Failure::new(ErrorKind::Usage, text));
    }
    let [itself, gateway, line, robot] = FILES;
    let fixed = itself + gateway * (gateways + 1) + line * gateways * (gateways - 1);
    let wanted = (arguments.connected as usize).min(robots);
    let connected = wanted.min(most_files().unwrap_or(usize::MAX).saturating_sub(fixed) / robot);
    if connected == 0 {
        let text = format!(
            "{gateways} gateways need more open files than this shell allows; `ulimit -n {}` does",
            fixed + robot * wanted
        );
        return Err(Failure::new(ErrorKind::Usage, text));
    }
    let mut settings = vec![
        ("robots", "0".to_owned()),
        // What a site states of itself would be counted as records.
        ("audit.anchor_every", "86400".to_owned()),
        ("fleet.copies", arguments.copies.map_or_else(|| "all".to_owned(), |copies| copies.to_string())),
    ];
    let crypto = ["crypto.provider", "crypto.sm4_kernel"].map(|name| (name, (global.settings)(name)));
    settings.extend(crypto.into_iter().filter_map(|(name, value)| value.map(|value| (name, value))));
    let (bytes, deadline) = (arguments.size as usize, Instant::now() + Duration::from_secs(arguments.seconds));
    Ok(Plan { robots, records, bytes, connected, settings, provider, deadline })
}

/// A fleet, and what it acknowledged so far.
struct Part {
    world: World,
    acknowledged: HashSet<Digest>,
    /// How many copies there are of these.
    copies: u64,
}

impl Part {
    fn new(world: World) -> Self {
        Self { world, acknowledged: HashSet::new(), copies: 0 }
    }

    /// All robots bring their next records; `failing` = how often gateways are stopped meanwhile, and the seed of that.
    async fn measure(
        &mut self,
        plan: &Plan,
        part: &'static str,
        copies: usize,
        failing: Option<(u32, u64)>,
        outlet: &Outlet,
    ) -> Result<Row, Failure> {
        let sealed = self.world.seal(plan)?;
        outlet.note(&format!("bench fleet: '{part}' begins"));
        // The process has room for the tables of so many signers, and the part before took it.
        forget_signers();
        let rest = failing.map_or(Duration::ZERO, |(times, _)| between_uploads(plan, times));
        let pace = Arc::new(Pace { deadline: plan.deadline, rest, hurry: AtomicBool::new(false) });
        let (begun, processor, bytes) = (Instant::now(), processor_seconds(), self.world.between());
        let stations = Arc::clone(&self.world.stations);
        let disturbed = async {
            match failing {
                Some((times, seed)) => World::disturb(&stations, times, seed, &pace).await,
                None => Ok(()),
            }
        };
        let (brought, disturbed) = tokio::join!(self.world.bring(plan, sealed, &pace, part), disturbed);
        disturbed?;
        let brought = brought?;
        let before = self.acknowledged.len();
        self.acknowledged.extend(brought.acknowledged.iter().copied());
        let all = self.acknowledged.len();
        let settled = self.world.settle(all as u64, copies, plan.deadline).await?;
        let copied = settled.copies.saturating_sub(self.copies);
        self.copies = settled.copies;
        let (ended, used) = settled.end;
        let (seconds, processor) = (ended.duration_since(begun).as_secs_f64(), used - processor);
        let between = self.world.between() - bytes;
        let found = reckon(&self.world, &self.acknowledged, copies).await?;
        let twice = self.world.anchored_twice().await?;
        let records = (all - before) as u64;
        let measured = Measured {
            bytes: plan.bytes as u64,
            runs: brought.waits.len() as u64,
            unit: "ms",
            spread: Spread::of(&brought.waits),
        };
        let each = |sum: f64| sum / number(records.max(1));
        let failures = failing.map_or(0, |(times, _)| times);
        let (processor, between, copies) = (each(processor * 1e6), each(float(between)), each(float(copied)));
        let Reckoning { lost, lacking, doubled } = found;
        let Brought { failovers, left, why, .. } = brought;
        let spread = Spread::of(&failovers);
        Ok(Row {
            part,
            gateways: self.world.scene.places.len(),
            copies,
            robots: plan.robots,
            connected: plan.connected,
            records,
            measured,
            seconds,
            processor,
            ratio: f64::NAN,
            per_copy: processor / copies.max(1.0),
            per_copy_ratio: f64::NAN,
            between,
            failures,
            failovers: failovers.len(),
            failover_p50: Some(spread.p50).filter(|value| value.is_finite()),
            failover_max: Some(spread.max).filter(|value| value.is_finite()),
            lost,
            lacking,
            doubled,
            left,
            why: why.filter(|_| left > 0),
            anchored_twice: twice,
            settled: settled.in_time,
            problems: settled.problems,
            paper: None,
        })
    }
}

/// Uploads are spread over the time that the failures take.
fn between_uploads(plan: &Plan, times: u32) -> Duration {
    let uploads = plan.robots * usize::try_from(plan.records / plan.robots as u64).unwrap_or(1).div_ceil(TOGETHER);
    let of_each = uploads.div_ceil(plan.connected).max(1);
    (A_FAILURE * times).checked_div(u32::try_from(of_each).unwrap_or(u32::MAX)).unwrap_or_default()
}

/// A count of bytes as a float, in steps of 1 KiB beyond what a float counts exactly.
fn float(bytes: u64) -> f64 {
    match u32::try_from(bytes) {
        Ok(bytes) => f64::from(bytes),
        Err(_) => number(bytes >> 10) * 1024.0,
    }
}

/// Each figure beside that of one gateway.
fn compare(results: &mut [Row]) {
    let Some(one) = results.first().map(|row| row.processor) else { return };
    for row in results {
        (row.ratio, row.per_copy_ratio) = (row.processor / one, row.per_copy / one);
    }
}

fn text(report: &Report<Row>) -> String {
    let ratio = |value: f64| if value.is_finite() { format!("{value:.2}") } else { "-".to_owned() };
    let seconds = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.2}"));
    let head = ["part", "gateways", "records", "copies", "s", "us/record", "of one", "us/copy", "of one", "between B"];
    let cells = |row: &Row| {
        vec![
            row.part.to_owned(),
            row.gateways.to_string(),
            row.records.to_string(),
            decimal(row.copies),
            decimal(row.seconds),
            decimal(row.processor),
            ratio(row.ratio),
            decimal(row.per_copy),
            ratio(row.per_copy_ratio),
            decimal(row.between),
        ]
    };
    let rows: Vec<Vec<String>> = report.results.iter().map(cells).collect();
    let outcome = |row: &Row| {
        vec![
            row.part.to_owned(),
            row.failures.to_string(),
            row.failovers.to_string(),
            seconds(row.failover_p50),
            seconds(row.failover_max),
            row.lost.to_string(),
            row.lacking.to_string(),
            row.doubled.to_string(),
            row.left.to_string(),
            row.anchored_twice.to_string(),
        ]
    };
    let outcomes: Vec<Vec<String>> = report.results.iter().map(outcome).collect();
    let ends =
        ["part", "failures", "fail-overs", "p50 s", "max s", "lost", "lacking", "doubled", "left", "anchored twice"];
    let size = report.results.first().map_or((0, 0, 0), |row| (row.robots, row.connected, row.measured.bytes));
    let mut lines = vec![
        "a fleet: robots at one gateway and at several".to_owned(),
        format!("machine: {}", report.machine.line()),
        format!("{} robots, {} connected at once, messages of {} bytes", size.0, size.1, size.2),
        String::new(),
        table(&head, &rows),
        String::new(),
        table(&ends, &outcomes),
        "\nprocessor time per record".to_owned(),
    ];
    lines
        .extend(bars(&report.results.iter().map(|row| (row.part.to_owned(), row.processor)).collect::<Vec<_>>(), "us"));
    lines.extend(report.results.iter().filter_map(|row| row.why.as_ref().map(|why| format!("{}: {why}", row.part))));
    for row in &report.results {
        lines.extend(row.problems.iter().map(|(problem, times)| format!("{}: {times} x {problem}", row.part)));
    }
    lines.push(format!("\nasked: a copy at several gateways at most {ASKED} times the processor time of one gateway"));
    lines.push(String::new());
    lines.extend(NOTES.map(str::to_owned));
    lines.join("\n")
}
