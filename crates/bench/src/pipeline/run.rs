//! One load through the line: publishers at a constant rate, the counts read each second, and everything verified
//! before the figures are read.

use std::time::{Duration, Instant};

use serde::Serialize;
use tokio::task::block_in_place;

use super::host::Host;
use crate::progress::Progress;
use crate::spread::{decimal, number};
use crate::usage::{processor_seconds, resident};
use authros_pipeline::stages::Stage;
use authros_ros::robot::Load as Publishers;
use authros_service::Failure;
use authros_service::command::WatchTopic;
use authros_service::failure::internal;
use authros_service::reply::LifeLine;

/// How long subscribing may take.
const PATIENCE: Duration = Duration::from_secs(20);
/// How long the line may take at the end for what is still in flight.
const REST: Duration = Duration::from_secs(180);
/// How often the counts are read.
const TICK: Duration = Duration::from_secs(1);
/// The longest bar, characters.
const LONGEST_BAR: f64 = 50.0;

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
    memory_begin: u64,
    memory_most: u64,
    memory_end: u64,
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
        host.client.ask(WatchTopic { topic: crate::read(&topic)?, type_name: None }).await?;
    }
    heard(&publishers).await?;
    let period = Duration::from_secs_f64(f64::from(load.publishers) / load.per_second);
    let mut watch = Watch::begin();
    publishers.begin(load.bytes, period)?;
    watch.until(host, load, length, Progress::new(load.name)).await?;
    block_in_place(|| publishers.end());
    let (seconds, processor) = (watch.begun.elapsed().as_secs_f64(), processor_seconds() - watch.processor);
    let memory_end = resident().unwrap_or(0);
    let (published, overflowed) = publishers.published();
    let life = watch.settle(host, published - overflowed).await?;
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
        memory_begin: watch.memory_begin,
        memory_most: watch.memory_most,
        memory_end,
        law_asked: watch.asked,
        law_broken: watch.broken,
        stages,
    })
}

async fn heard(publishers: &Publishers) -> Result<(), Failure> {
    let begun = Instant::now();
    while !publishers.is_heard() {
        if begun.elapsed() > PATIENCE {
            return Err(internal("the site has not subscribed to the publishers within 20 s; look at its ROS master"));
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

/// The counts read each second.
struct Watch {
    begun: Instant,
    processor: f64,
    memory_begin: u64,
    memory_most: u64,
    most_pending: u64,
    asked: u64,
    broken: u64,
}

impl Watch {
    fn begin() -> Self {
        let memory = resident().unwrap_or(0);
        Self {
            begun: Instant::now(),
            processor: processor_seconds(),
            memory_begin: memory,
            memory_most: memory,
            most_pending: 0,
            asked: 0,
            broken: 0,
        }
    }

    async fn look(&mut self, host: &Host) -> Result<LifeLine, Failure> {
        let life = host.status().await?.life;
        let known = life.verified + life.pending + life.right_ended + life.quarantined + life.dropped + life.tampered;
        self.asked += 1;
        self.broken += u64::from(known != life.captured);
        self.most_pending = self.most_pending.max(life.pending);
        self.memory_most = self.memory_most.max(resident().unwrap_or(0));
        Ok(life)
    }

    async fn until(
        &mut self,
        host: &Host,
        load: &Load,
        length: Duration,
        mut progress: Progress,
    ) -> Result<(), Failure> {
        let all = (length.as_secs_f64() * load.per_second).round();
        while let Some(left) = length.checked_sub(self.begun.elapsed()).filter(|left| !left.is_zero()) {
            tokio::time::sleep(left.min(TICK)).await;
            let life = self.look(host).await?;
            progress.at(usize::try_from(life.captured).unwrap_or(usize::MAX), whole(all));
        }
        Ok(())
    }

    /// Waits until everything sent is captured or lost, and nothing is pending.
    async fn settle(&mut self, host: &Host, sent: u64) -> Result<LifeLine, Failure> {
        let (begun, mut last) = (Instant::now(), (0, Instant::now()));
        loop {
            let life = self.look(host).await?;
            if life.captured != last.0 {
                last = (life.captured, Instant::now());
            }
            // What has not arrived three seconds after the last arrival never will.
            let arrived = life.captured >= sent || last.1.elapsed() > 3 * TICK;
            if arrived && life.pending == 0 {
                return Ok(life);
            }
            if begun.elapsed() > REST {
                let text =
                    format!("{} messages are not verified 180 s after the load; look at chain and vault", life.pending);
                return Err(internal(text));
            }
            tokio::time::sleep(TICK / 4).await;
        }
    }
}

#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a count for a progress line, never negative"
)]
fn whole(number: f64) -> usize {
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

    /// A bar for each stage, and the conservation law.
    pub fn bars(&self) -> Vec<String> {
        let bar = |busy: &Busy| {
            let length = whole((busy.share * LONGEST_BAR).ceil()).min(whole(LONGEST_BAR));
            format!(
                "  {:<8} {:>6.1} % {:>8.1} us a message |{}",
                busy.stage,
                busy.share * 100.0,
                busy.per_message,
                "#".repeat(length)
            )
        };
        let law = format!(
            "  {:.0} messages a second and core; most pending {}; law asked {} times, broken {}",
            self.per_core, self.most_pending, self.law_asked, self.law_broken
        );
        self.stages.iter().map(bar).chain([law]).collect()
    }
}
