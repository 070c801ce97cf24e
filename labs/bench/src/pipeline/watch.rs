//! The queries made each second while a load runs: the counts and their balance, what waits, and the memory.

use std::time::{Duration, Instant};

use super::host::Host;
use super::run::{Load, whole};
use crate::progress::Progress;
use crate::spread::number;
use crate::usage::{anonymous, processor_seconds, resident};
use authros_service::Failure;
use authros_service::reply::LifeLine;
use authros_service::reply::internal;

/// How long the line may take at the end for what is still in flight.
const REST: Duration = Duration::from_secs(180);
/// How often the counts are queried.
const TICK: Duration = Duration::from_secs(1);
const MINUTE: Duration = Duration::from_secs(60);

/// The observations.
pub(super) struct Watch {
    pub begun: Instant,
    pub processor: f64,
    pub memory_begin: u64,
    pub memory_most: u64,
    /// Bytes not backed by a file, at the beginning and at the end of each minute.
    pub by_minute: Vec<u64>,
    pub most_pending: u64,
    pub asked: u64,
    pub broken: u64,
}

impl Watch {
    pub fn begin() -> Self {
        let memory = resident().unwrap_or(0);
        Self {
            begun: Instant::now(),
            processor: processor_seconds(),
            memory_begin: memory,
            memory_most: memory,
            by_minute: vec![anonymous().unwrap_or(0)],
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

    /// Observes until the load has run for `length`.
    pub async fn until(
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
            let minutes = self.begun.elapsed().as_secs() / MINUTE.as_secs();
            if minutes >= self.by_minute.len() as u64 {
                self.by_minute.push(anonymous().unwrap_or(0));
            }
            progress.at(usize::try_from(life.captured).unwrap_or(usize::MAX), whole(all));
        }
        Ok(())
    }

    /// Waits until everything sent is captured, or lost, and nothing is pending.
    pub async fn settle(&mut self, host: &Host, sent: u64) -> Result<LifeLine, Failure> {
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
                    format!("{} messages are not verified 180 s after the load; check chain and disk", life.pending);
                return Err(internal(text));
            }
            tokio::time::sleep(TICK / 4).await;
        }
    }
}

/// The growth of the memory, bytes per minute: the slope of the line fitted to the values at the ends of minutes,
/// except the first minute, in which buffers and tables fill; none if there are fewer than three.
pub(crate) fn slope(by_minute: &[u64]) -> Option<f64> {
    let seen = by_minute.get(1..).filter(|seen| seen.len() >= 3)?;
    let points = || seen.iter().enumerate().map(|(minute, bytes)| (number(minute), number(*bytes >> 10) * 1024.0));
    let count = number(seen.len());
    let (minutes, bytes) = points().fold((0.0, 0.0), |sum, point| (sum.0 + point.0, sum.1 + point.1));
    let (minute, middle) = (minutes / count, bytes / count);
    let (over, under) = points()
        .fold((0.0, 0.0), |sum, (at, bytes)| (sum.0 + (at - minute) * (bytes - middle), sum.1 + (at - minute).powi(2)));
    Some(over / under)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_slope_is_of_all_minutes_but_the_first() {
        let of = |kibibytes: &[u64]| slope(&kibibytes.iter().map(|one| one << 10).collect::<Vec<_>>());
        assert_eq!(of(&[100, 900, 1_000, 1_100, 1_200]), Some(102_400.0));
        assert_eq!(of(&[0, 500, 500, 500]), Some(0.0));
        // The line fitted to 10, 20, 60: its slope is half of the difference between the ends.
        assert_eq!(of(&[7, 10, 20, 60]), Some(25.0 * 1024.0));
        assert_eq!(of(&[1, 2, 3]), None);
    }
}
