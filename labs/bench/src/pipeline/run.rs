//! One load through the line: publishers at a constant rate, the counts read each second, and everything verified
//! before the figures are read.

use std::time::{Duration, Instant};

use serde::Serialize;
use tokio::task::block_in_place;

use super::host::Host;
use super::publishers::Publishers;
use super::watch::{Watch, slope};
use crate::progress::Progress;
use crate::spread::{decimal, number};
use crate::usage::{processor_seconds, resident};
use authros_pipeline::stages::Stage;
use authros_service::Failure;
use authros_service::command::WatchTopic;
use authros_service::reply::internal;

/// How long subscribing may take.
const PATIENCE: Duration = Duration::from_secs(20);

/// The load.
#[derive(Debug, Clone, Copy)]
pub struct Load {
    /// Its name.
    pub name: &'static str,
    /// Bytes of a message.
    pub bytes: usize,
    /// Total messages a second of all publishers.
    pub per_second: f64,
    /// Publishers.
    pub publishers: u16,
}

/// A stage and how busy it was.
#[derive(Debug, Serialize)]
struct Busy {
    stage: &'static str,
    seconds: f64,
    /// Share of the load's time.
    share: f64,
    /// Microseconds for each message.
    per_message: f64,
}

/// The result of one load.
#[derive(Debug, Serialize)]
pub struct Summary {
    /// Its name.
    pub load: &'static str,
    bytes: usize,
    publishers: u16,
    asked_per_second: f64,
    seconds: f64,
    published: u64,
    captured: u64,
    verified: u64,
    lost_in_transport: u64,
    dropped: u64,
    tampered: u64,
    /// Captured, a second.
    per_second: f64,
    mb_per_second: f64,
    cores: f64,
    per_core: f64,
    most_pending: u64,
    /// Not yet verified when the last message was published.
    pending_end: u64,
    /// From then until all was verified.
    rest_seconds: f64,
    memory_begin: u64,
    memory_most: u64,
    memory_end: u64,
    /// Bytes not backed by a file, at the beginning and at the end of each minute.
    memory_by_minute: Vec<u64>,
    /// Their growth, bytes per minute, without the first minute; none for a load of less than three minutes.
    memory_slope: Option<f64>,
    /// An fsync of 4 KiB before the load, milliseconds: median and 95th of a hundred.
    fsync_p50: f64,
    fsync_p95: f64,
    /// Records that were in the store before.
    before: u64,
    law_asked: u64,
    law_broken: u64,
    stages: Vec<Busy>,
}

/// Runs a load for `length`.
///
/// # Errors
/// If the publishers cannot start, nobody subscribes, or not everything is verified in time.
pub async fn run(host: &Host, load: &Load, length: Duration) -> Result<Summary, Failure> {
    let master = host.master().await?;
    let mut publishers = block_in_place(|| Publishers::start(&master, load.publishers))?;
    for topic in publishers.topics() {
        let topic = topic.parse().map_err(|_| internal("a topic"))?;
        host.client.ask(WatchTopic { topic, type_name: None, sampling: None }).await?;
    }
    heard(&publishers, usize::from(load.publishers)).await?;
    let period = Duration::from_secs_f64(f64::from(load.publishers) / load.per_second);
    let mut watch = Watch::begin();
    publishers.begin(load.bytes, period)?;
    watch.until(host, load, length, Progress::new(load.name)).await?;
    block_in_place(|| publishers.end());
    let (seconds, processor) = (watch.begun.elapsed().as_secs_f64(), processor_seconds() - watch.processor);
    let (memory_end, ended) = (resident().unwrap_or(0), Instant::now());
    let pending_end = host.status().await?.life.pending;
    let (published, overflowed) = (publishers.published(), publishers.overflowed());
    let life = watch.settle(host, published - overflowed).await?;
    let rest_seconds = ended.elapsed().as_secs_f64();
    let stages = Stage::ALL.map(|stage| busy(host, stage, seconds, published)).into();
    Ok(Summary {
        load: load.name,
        bytes: load.bytes,
        publishers: load.publishers,
        asked_per_second: load.per_second,
        seconds,
        published,
        captured: life.captured,
        verified: life.verified,
        lost_in_transport: published.saturating_sub(life.captured),
        dropped: life.dropped,
        tampered: life.tampered,
        per_second: count(life.captured) / seconds,
        mb_per_second: count(life.captured) / seconds * number(load.bytes) / 1e6,
        cores: processor / seconds,
        per_core: count(life.captured) / processor,
        most_pending: watch.most_pending,
        pending_end,
        rest_seconds,
        memory_begin: watch.memory_begin,
        memory_most: watch.memory_most,
        memory_end,
        memory_slope: slope(&watch.by_minute),
        memory_by_minute: watch.by_minute,
        fsync_p50: host.fsync.p50,
        fsync_p95: host.fsync.p95,
        before: host.before,
        law_asked: watch.asked,
        law_broken: watch.broken,
        stages,
    })
}

/// Waits until this many topics have a subscriber.
async fn heard(publishers: &Publishers, topics: usize) -> Result<(), Failure> {
    let begun = Instant::now();
    while publishers.heard() < topics {
        if begun.elapsed() > PATIENCE {
            return Err(internal("the site did not subscribe to the publishers within 20 s; check its ROS master"));
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    Ok(())
}

fn busy(host: &Host, stage: Stage, seconds: f64, messages: u64) -> Busy {
    let spent = host.stages().busy(stage).as_secs_f64();
    Busy { stage: stage.word(), seconds: spent, share: spent / seconds, per_message: spent * 1e6 / count(messages) }
}

fn count(number: u64) -> f64 {
    crate::spread::number(number)
}

#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a count for a progress line, never negative"
)]
pub(super) fn whole(number: f64) -> usize {
    number as usize
}

impl Summary {
    /// Each stage's name, and the per cent of the load's time that it was busy.
    pub fn shares(&self) -> Vec<(&'static str, f64)> {
        self.stages.iter().map(|busy| (busy.stage, busy.share * 100.0)).collect()
    }

    /// Names of the columns.
    pub const COLUMNS: [&'static str; 11] = [
        "load",
        "bytes",
        "asked/s",
        "held/s",
        "MB/s",
        "published",
        "captured",
        "verified",
        "lost",
        "cores",
        "memory MiB",
    ];

    /// Whether every message published was verified, and the conservation law always held.
    pub fn is_whole(&self) -> bool {
        self.published == self.verified && self.law_broken == 0
    }

    /// One row.
    pub fn cells(&self) -> Vec<String> {
        let mebibytes = |bytes: u64| (bytes >> 20).to_string();
        let memory = [self.memory_begin, self.memory_most, self.memory_end].map(mebibytes).join(" / ");
        vec![
            self.load.to_owned(),
            self.bytes.to_string(),
            decimal(self.asked_per_second),
            decimal(self.per_second),
            decimal(self.mb_per_second),
            self.published.to_string(),
            self.captured.to_string(),
            self.verified.to_string(),
            (self.lost_in_transport + self.dropped).to_string(),
            decimal(self.cores),
            memory,
        ]
    }

    /// A row for each stage.
    pub fn busy_cells(&self) -> Vec<Vec<String>> {
        let row = |busy: &Busy| {
            vec![self.load.to_owned(), busy.stage.to_owned(), decimal(busy.share * 100.0), decimal(busy.per_message)]
        };
        self.stages.iter().map(row).collect()
    }

    /// The conservation law, the disk, what waited, and the memory.
    pub fn lines(&self) -> String {
        let law = format!(
            "{}: {:.0} messages per second and core; peak pending {}; law checked {} times, broken {}",
            self.load, self.per_core, self.most_pending, self.law_asked, self.law_broken
        );
        let disk = format!(
            "  an fsync of 4 KiB before the load: {:.2} ms (p95 {:.2}); {} pre-existing records",
            self.fsync_p50, self.fsync_p95, self.before
        );
        let rest = format!(
            "  {} not verified when publishing ended; all were {:.1} s later",
            self.pending_end, self.rest_seconds
        );
        [law, disk, rest, self.memory_line()].join("\n")
    }

    fn memory_line(&self) -> String {
        let minutes: Vec<String> = self.memory_by_minute.iter().map(|bytes| (bytes >> 20).to_string()).collect();
        let slope = self.memory_slope.map_or_else(
            || "too short for a slope".to_owned(),
            |slope| format!("{:+.3} MiB a minute after the first", slope / 1_048_576.0),
        );
        format!("  memory not backed by files, minute by minute, MiB: {}; {slope}", minutes.join(" "))
    }
}
