//! `authros bench memory`: bytes of memory for each of the things of which there may be thousands: idle robots at a
//! gateway, watched topics, records in the ledger. Only memory not backed by a file counts.

mod plots;

use std::path::Path;

use serde::Serialize;
use serde_json::{Map, json};
use tokio::task::block_in_place;

use super::gateway;
use super::growth::fill::record;
use super::growth::life::Life;
use super::judgement::Judgement;
use super::machine::Machine;
use super::network::Directory;
use super::outlet::Outlet;
use super::pipeline::heard;
use super::pipeline::host::Host;
use super::progress::Progress;
use super::report::Report;
use super::spread::number;
use super::usage::anonymous;
use crate::Global;
use crate::args::MemoryArguments;
use authros_crypto::Provider;
use authros_output::table;
use authros_ros::MOST_ROBOTS;
use authros_ros::robot::Load;
use authros_service::Failure;
use authros_service::command::WatchTopic;
use authros_service::failure::internal;
use authros_store::Ledger;

/// Looks while records come, after the first.
const STEPS: u64 = 10;
/// Records in a commit.
const BULK: u64 = 1_000;

const NOTES: [&str; 4] = [
    "idle robot: a connection that has authenticated and is silent, both ends in this process.",
    "watched topic: in a throw-away site; published: its publisher's end of the connection is in this process too. The first \
     half of the topics warms the site up, the second half is counted.",
    "record in the ledger: verified, of 500 topics; the slope of the writing process's memory, from a tenth of them \
     on. Disk space is not included.",
    "Memory is counted in pages of 4 KiB and includes what the allocator keeps in reserve: small numbers show steps, \
     and a figure can be negative if memory was returned meanwhile.",
];

/// One kind of thing.
#[derive(Debug, Serialize)]
struct Row {
    what: &'static str,
    /// Their number.
    count: u64,
    /// Bytes of memory for each one counted.
    bytes_each: f64,
    /// The same for a million.
    mib_a_million: f64,
}

impl Row {
    fn new(what: &'static str, count: u64, bytes_each: f64) -> Self {
        Self { what, count, bytes_each, mib_a_million: bytes_each * 1e6 / 1_048_576.0 }
    }
}

/// Measures.
///
/// # Errors
/// If gateway, site or ledger cannot be created, or /proc does not show the memory.
pub async fn run(
    global: Global<'_>,
    arguments: MemoryArguments,
    provider: &'static dyn Provider,
    outlet: &Outlet,
) -> Result<Judgement, Failure> {
    // First, while the allocator holds nothing that was freed.
    let (robots, limited_by) = idle_robots(provider, arguments.idle_robots).await?;
    let mut results = vec![robots];
    results.extend(topics(global, u64::from(arguments.topics), outlet).await?);
    // Dropped here even if the bench is ended while its thread is still working.
    let directory = Directory::new()?;
    let path = directory.path().to_owned();
    let filled = tokio::task::spawn_blocking(move || records(&path, arguments.records)).await;
    results.push(filled.map_err(|_| internal("the measurement"))??);
    let mut about = Map::new();
    about.insert("limited_by".to_owned(), json!(limited_by));
    about.insert("notes".to_owned(), json!(NOTES));
    let report = Report { name: "memory", machine: Machine::read(), about, results };
    outlet.show(&report, || text(&report, limited_by.as_deref()), || plots::page(&report))?;
    Ok(Judgement::Reached)
}

async fn idle_robots(provider: &'static dyn Provider, asked: u32) -> Result<(Row, Option<String>), Failure> {
    let idle = gateway::idle_connections(provider, asked as usize).await?;
    let (count, bytes) = (idle.connections as u64, number(idle.resident >> 10) * 1024.0);
    Ok((Row::new("idle robot at a gateway", count, bytes / number(count.max(1))), idle.limited_by))
}

/// Topics without publishers, then with them.
async fn topics(global: Global<'_>, silent: u64, outlet: &Outlet) -> Result<[Row; 2], Failure> {
    let host = Host::open(global, 0, outlet.output()).await?;
    let measured = topics_of(&host, silent).await;
    host.close().await;
    measured
}

async fn topics_of(host: &Host, silent: u64) -> Result<[Row; 2], Failure> {
    let half = silent / 2;
    watch(host, (0..half).map(|number| format!("/silent{number}/data"))).await?;
    let before = memory()?;
    watch(host, (half..silent).map(|number| format!("/silent{number}/data"))).await?;
    let without = grown(before, memory()?) / number(silent - half);
    let master = host.master().await?;
    let publishers = block_in_place(|| Load::start(&master, MOST_ROBOTS))?;
    let mut topics = publishers.topics();
    let second = topics.split_off(topics.len() / 2);
    watch(host, topics.iter().cloned()).await?;
    heard(&publishers, topics.len()).await?;
    let before = memory()?;
    watch(host, second.iter().cloned()).await?;
    heard(&publishers, topics.len() + second.len()).await?;
    let with = grown(before, memory()?) / number(second.len());
    block_in_place(|| drop(publishers));
    Ok([Row::new("watched topic", silent, without), Row::new("watched topic, published", u64::from(MOST_ROBOTS), with)])
}

async fn watch(host: &Host, topics: impl Iterator<Item = String>) -> Result<(), Failure> {
    for topic in topics {
        host.client.ask(WatchTopic { topic: crate::read(&topic)?, type_name: None }).await?;
    }
    Ok(())
}

/// How much the memory of a process grows that writes this many records and has them verified.
fn records(directory: &Path, wanted: u64) -> Result<Row, Failure> {
    let ledger = Ledger::open(&directory.join("ledger.db"))?;
    let (mut life, mut progress) = (Life::default(), Progress::new("records"));
    let (mut seen, mut there) = (vec![memory()?], 0);
    let most = usize::try_from(BULK).unwrap_or(usize::MAX);
    for step in 1..=STEPS {
        let end = wanted * step / STEPS;
        while there < end {
            let next = end.min(there + BULK);
            ledger.append((there..next).map(record).collect())?;
            life.verify(&ledger, most)?;
            there = next;
            progress.at(usize::try_from(there).unwrap_or(usize::MAX), usize::try_from(wanted).unwrap_or(usize::MAX));
        }
        seen.push(memory()?);
    }
    let of_step = super::pipeline::slope(&seen).unwrap_or(f64::NAN);
    Ok(Row::new("record in the ledger", wanted, of_step / (number(wanted) / number(STEPS))))
}

/// Bytes now.
fn memory() -> Result<u64, Failure> {
    anonymous().ok_or_else(|| internal("/proc/self/status does not show the memory in use"))
}

/// Bytes more than before; fewer if memory was given back.
fn grown(before: u64, now: u64) -> f64 {
    (number(now >> 10) - number(before >> 10)) * 1024.0
}

fn text(report: &Report<Row>, limited_by: Option<&str>) -> String {
    let cells = |row: &Row| {
        vec![
            row.what.to_owned(),
            row.count.to_string(),
            format!("{:.1}", row.bytes_each),
            format!("{:.1}", row.mib_a_million),
        ]
    };
    let mut lines = vec![
        "memory: cost of each of many".to_owned(),
        format!("machine: {}", report.machine.line()),
        String::new(),
        table(&["what", "count", "bytes each", "MiB a million"], &report.results.iter().map(cells).collect::<Vec<_>>()),
        String::new(),
    ];
    lines.extend(limited_by.map(str::to_owned));
    lines.extend(NOTES.map(str::to_owned));
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_record_is_written_and_its_memory_told_in_two_units() {
        let directory = tempfile::tempdir().expect("a directory");
        let row = records(directory.path(), 20_000).expect("measured");
        // Other tests in this process take memory meanwhile, so the amount cannot be judged here.
        assert!(row.count == 20_000 && row.bytes_each.is_finite(), "{row:?}");
        assert!((row.mib_a_million - row.bytes_each / 1.048_576).abs() < 1e-6, "{row:?}");
        let ledger = Ledger::open(&directory.path().join("ledger.db")).expect("a ledger");
        assert_eq!(ledger.counts(None).expect("counted").pending(), 0);
    }
}
