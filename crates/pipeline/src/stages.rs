//! Times from capture to each milestone, and how busy each stage is: counters that cost a few atomic additions a round.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use strum::IntoStaticStr;

use crate::model::Timestamp;

/// Buckets per doubling of time: a percentile is at most 1/16 too high.
const PER_DOUBLING: u64 = 16;
/// Microseconds up to which every value has its own bucket.
const EXACT: u64 = PER_DOUBLING;
/// Buckets per quarter of a doubling.
const QUARTER: usize = 4;
/// Total buckets, up to 2^40 microseconds (twelve days).
const BUCKETS: usize = 16 * 37;

#[derive(Debug, Clone, Copy, PartialEq, Eq, IntoStaticStr)]
#[strum(serialize_all = "lowercase")]
pub enum Milestone {
    Durable,
    /// Its anchor has enough confirmations.
    Confirmed,
    Verified,
}

impl Milestone {
    pub const ALL: [Self; 3] = [Self::Durable, Self::Confirmed, Self::Verified];

    pub fn word(self) -> &'static str {
        self.into()
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, IntoStaticStr)]
#[strum(serialize_all = "lowercase")]
pub enum Stage {
    /// Key derivation, SM4, SM3, SM2 signature.
    Seal,
    /// The commit of rows and ciphertext, fsync included.
    Commit,
    /// Closing batches, signing and sending transactions.
    Anchor,
    Watch,
    /// Re-reading the store: SM3, SM2 verification, proof.
    Verify,
}

impl Stage {
    pub const ALL: [Self; 5] = [Self::Seal, Self::Commit, Self::Anchor, Self::Watch, Self::Verify];

    pub fn word(self) -> &'static str {
        self.into()
    }
}

/// A larger change of time of day against elapsed time means that somebody set the clock, nanoseconds.
const SET: i128 = 1_000_000_000;

/// Notices that the machine's clock was set: times of day from before and after cannot be compared.
#[derive(Debug, Default)]
struct ClockSettings {
    /// Time of day minus elapsed time at the last look, nanoseconds.
    offset: Option<i128>,
    /// By the clock as it is now, when it was last set.
    noticed: Timestamp,
}

impl ClockSettings {
    /// The earliest time of day that may be subtracted from `now`; `passed`: time since a fixed moment.
    fn comparable_since(&mut self, now: Timestamp, passed: Duration) -> Timestamp {
        let offset = i128::from(now.0) - i128::try_from(passed.as_nanos()).unwrap_or(i128::MAX);
        if self.offset.replace(offset).is_some_and(|before| (offset - before).abs() > SET) {
            self.noticed = now;
        }
        self.noticed
    }
}

#[derive(Debug)]
pub struct Stages {
    begun: Instant,
    clock: Mutex<ClockSettings>,
    reached: [[AtomicU64; BUCKETS]; Milestone::ALL.len()],
    busy: [AtomicU64; Stage::ALL.len()],
}

impl Default for Stages {
    fn default() -> Self {
        let zero = |_: usize| AtomicU64::new(0);
        let (begun, clock) = (Instant::now(), Mutex::default());
        Self {
            begun,
            clock,
            reached: std::array::from_fn(|_| std::array::from_fn(zero)),
            busy: std::array::from_fn(zero),
        }
    }
}

impl Stages {
    pub fn reached(&self, milestone: Milestone, captured: impl IntoIterator<Item = Timestamp>) {
        self.reached_at(milestone, captured, Timestamp::now(), self.begun.elapsed());
    }

    /// Leaves out messages whose time is unknown, because the clock was set since their capture.
    fn reached_at(
        &self,
        milestone: Milestone,
        captured: impl IntoIterator<Item = Timestamp>,
        now: Timestamp,
        passed: Duration,
    ) {
        let since = self.clock.lock().unwrap_or_else(PoisonError::into_inner).comparable_since(now, passed);
        for captured in captured.into_iter().filter(|captured| (since..=now).contains(captured)) {
            let microseconds = (now.0 - captured.0) / 1_000;
            self.reached[milestone as usize][bucket(microseconds)].fetch_add(1, Ordering::Relaxed);
        }
    }

    pub fn count<T>(&self, stage: Stage, work: impl FnOnce() -> T) -> T {
        let begun = Instant::now();
        let done = work();
        self.spent(stage, begun.elapsed());
        done
    }

    pub fn spent(&self, stage: Stage, time: Duration) {
        let nanoseconds = u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
        self.busy[stage as usize].fetch_add(nanoseconds, Ordering::Relaxed);
    }

    pub fn busy(&self, stage: Stage) -> Duration {
        Duration::from_nanos(self.busy[stage as usize].load(Ordering::Relaxed))
    }

    pub fn count_of(&self, milestone: Milestone) -> u64 {
        self.reached[milestone as usize].iter().map(|bucket| bucket.load(Ordering::Relaxed)).sum()
    }

    /// How many messages reached a milestone within each of these powers of two, microseconds; the total number; and
    /// the total of their seconds, at most 1/16 too high.
    pub fn within_powers(&self, milestone: Milestone, powers: &[u32]) -> (Vec<u64>, u64, f64) {
        let (mut within, mut all, mut seconds) = (vec![0; powers.len()], 0, 0.0);
        for (index, bucket) in self.reached[milestone as usize].iter().enumerate() {
            let (count, end) = (bucket.load(Ordering::Relaxed), end_of(index));
            all += count;
            seconds += Duration::from_micros(end).as_secs_f64() * to_float(count);
            for (held, _) in within.iter_mut().zip(powers).filter(|(_, power)| end < 1 << **power) {
                *held += count;
            }
        }
        (within, all, seconds)
    }

    /// Messages by the longest time of their quarter of a doubling, microseconds; only times that occurred.
    pub fn spread(&self, milestone: Milestone) -> Vec<(u64, u64)> {
        let buckets = &self.reached[milestone as usize];
        let counted = buckets.chunks(QUARTER).enumerate().map(|(place, quarter)| {
            let count = quarter.iter().map(|bucket| bucket.load(Ordering::Relaxed)).sum();
            (end_of(place * QUARTER + QUARTER - 1), count)
        });
        counted.filter(|(_, count)| *count > 0).collect()
    }

    /// The time within which `percent` of a hundred messages reached a milestone; `None` if none did.
    pub fn within(&self, milestone: Milestone, percent: u64) -> Option<Duration> {
        let all = self.count_of(milestone);
        let rank = (all * percent).div_ceil(100).max(1);
        let mut seen = 0;
        let buckets = &self.reached[milestone as usize];
        let found = buckets.iter().position(|bucket| {
            seen += bucket.load(Ordering::Relaxed);
            seen >= rank
        });
        found.filter(|_| all > 0).map(|index| Duration::from_micros(end_of(index)))
    }
}

#[expect(clippy::cast_precision_loss, reason = "counts of messages stay below 2^53")]
fn to_float(count: u64) -> f64 {
    count as f64
}

/// The bucket of a time: exact below 16 us, then sixteen buckets for each doubling.
fn bucket(microseconds: u64) -> usize {
    let index = if microseconds < EXACT {
        microseconds
    } else {
        let doubling = u64::from(microseconds.ilog2());
        (doubling - 3) * PER_DOUBLING + (microseconds >> (doubling - 4)) % PER_DOUBLING
    };
    usize::try_from(index).unwrap_or(BUCKETS).min(BUCKETS - 1)
}

/// The longest time of a bucket, microseconds.
fn end_of(index: usize) -> u64 {
    let index = index as u64;
    if index < EXACT {
        return index;
    }
    let (doubling, part) = (index / PER_DOUBLING + 3, index % PER_DOUBLING);
    ((PER_DOUBLING + part + 1) << (doubling - 4)) - 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_time_lies_in_its_bucket_and_at_most_a_sixteenth_below_its_end() {
        for microseconds in (0..2_000).chain([65_535, 65_536, 1_000_000, 30_000_000, 86_400_000_000]) {
            let end = end_of(bucket(microseconds));
            assert!(end >= microseconds && end - microseconds <= microseconds / 16, "{microseconds}: {end}");
            assert!(bucket(microseconds) == 0 || end_of(bucket(microseconds) - 1) < microseconds, "{microseconds}");
        }
        assert_eq!(bucket(u64::MAX), BUCKETS - 1);
    }

    #[test]
    fn messages_count_by_the_time_that_they_took() {
        let stages = Stages::default();
        let now = Timestamp::now();
        let ago = |milliseconds: u64| Timestamp(now.0 - milliseconds * 1_000_000);
        stages.reached(Milestone::Durable, (1..=100).map(|number| ago(number * 100)));
        let (within, all, seconds) = stages.within_powers(Milestone::Durable, &[22, 23]);
        assert_eq!(all, 100);
        assert!((40..=41).contains(&within[0]) && (82..=83).contains(&within[1]), "{within:?}");
        assert!((505.0..590.0).contains(&seconds), "{seconds}");
        assert_eq!(stages.within_powers(Milestone::Verified, &[22]).1, 0);
        let median = stages.within(Milestone::Durable, 50).expect("a median").as_millis();
        assert!((5_000..5_900).contains(&median), "{median}");
        assert_eq!(stages.within(Milestone::Verified, 50), None);
    }

    #[test]
    fn messages_captured_before_the_clock_was_set_are_left_out() {
        const DAY: u64 = 86_400;
        let stages = Stages::default();
        // Seconds of the day's clock at capture and at the milestone, and elapsed ones.
        let reached = |captured: u64, now: u64, passed: u64| -> (u64, u64) {
            let captured = [Timestamp::from_seconds(captured)];
            stages.reached_at(Milestone::Verified, captured, Timestamp::from_seconds(now), Duration::from_secs(passed));
            // All, and those within about two seconds.
            let (within, all, _) = stages.within_powers(Milestone::Verified, &[21]);
            (all, within[0])
        };
        assert_eq!(reached(10 * DAY, 10 * DAY + 1, 1), (1, 1));
        assert_eq!(reached(10 * DAY, 12 * DAY + 2, 2), (1, 1), "set two days ahead");
        assert_eq!(reached(12 * DAY + 3, 12 * DAY + 4, 4), (2, 2), "both by the new time");
        assert_eq!(reached(12 * DAY + 4, 10 * DAY + 5, 5), (2, 2), "set back");
        assert_eq!(reached(12 * DAY + 4, 10 * DAY + 6, 6), (2, 2), "captured in a future that is over");
        assert_eq!(reached(10 * DAY + 6, 10 * DAY + 7, 7), (3, 3));
        assert_eq!(reached(10 * DAY + 7, 10 * DAY + 7 + DAY, 7 + DAY).0, 4, "a day offline is true");
    }

    #[test]
    fn a_time_just_below_a_power_of_two_is_within_it_and_one_of_it_is_not() {
        let stages = Stages::default();
        for microseconds in [1_023, 1_024, 4_095, 70_000] {
            stages.reached[0][bucket(microseconds)].fetch_add(1, Ordering::Relaxed);
        }
        assert_eq!(stages.spread(Milestone::Durable), [(1_023, 1), (1_279, 1), (4_095, 1), (81_919, 1)]);
        assert!(stages.spread(Milestone::Verified).is_empty());
        let (within, all, seconds) = stages.within_powers(Milestone::Durable, &[10, 12, 14]);
        assert_eq!((within, all), (vec![1, 3, 3], 4));
        assert!((0.076_142..0.081).contains(&seconds), "{seconds}");
    }

    #[test]
    fn busy_time_adds_up() {
        let stages = Stages::default();
        stages.spent(Stage::Seal, Duration::from_millis(3));
        assert_eq!(stages.count(Stage::Verify, || 7), 7);
        stages.spent(Stage::Seal, Duration::from_millis(4));
        assert_eq!(stages.busy(Stage::Seal), Duration::from_millis(7));
    }
}
