//! A batch closes at 256 leaves, after a second, or when nothing more comes and no batch waits for a block. It gets
//! wider with the rate, and early closes are paid for by seconds without one: about one transaction a second.

use std::time::{Duration, Instant};

use crate::chain::merkle::MOST_LEAVES;
use crate::model::{Sampling, Timestamp};

/// Leaves at which a batch first closes.
const NARROWEST: usize = 256;
/// How long a record waits for its batch to close, and the cost of an early close.
pub const LONGEST_WAIT: Duration = Duration::from_secs(1);
/// A batch that got nothing new for this long stops waiting.
const LULL: Duration = Duration::from_millis(10);
/// The most credit for early closes.
const MOST_SAVED: Duration = Duration::from_secs(4);

#[derive(Debug)]
pub struct Pace {
    width: usize,
    closed: Option<Instant>,
    /// Time without a close, up to [`MOST_SAVED`], as of the last close.
    saved: Duration,
    /// How many records were waiting at the last check, and since when that many.
    waiting: usize,
    grown: Option<Instant>,
}

impl Default for Pace {
    fn default() -> Self {
        Self { width: NARROWEST, closed: None, saved: MOST_SAVED, waiting: 0, grown: None }
    }
}

impl Pace {
    /// How long until a batch of `waiting` records, the first of which has waited for `oldest`, closes. Early only if
    /// the chain is `idle`: no batch before it waits for a block.
    pub fn due_in(&mut self, waiting: usize, oldest: Duration, idle: bool, now: Instant) -> Duration {
        if waiting >= self.width {
            return Duration::ZERO;
        }
        if waiting != self.waiting {
            (self.waiting, self.grown) = (waiting, Some(now));
        }
        let since = |then: Option<Instant>| then.map_or(Duration::ZERO, |then| now.saturating_duration_since(then));
        let early = LULL.saturating_sub(since(self.grown)).max(LONGEST_WAIT.saturating_sub(self.saved_by(now)));
        let latest = LONGEST_WAIT.saturating_sub(oldest);
        if idle { latest.min(early) } else { latest }
    }

    /// Notes that a batch of `leaves` was closed at `now`: the next is twice as wide if the second had not passed,
    /// half as wide if it was not half full.
    pub fn closed(&mut self, leaves: usize, now: Instant) {
        let early = self.closed.is_some_and(|before| now.saturating_duration_since(before) < LONGEST_WAIT);
        if leaves >= self.width && early {
            self.width = (self.width * 2).min(MOST_LEAVES);
        } else if leaves < self.width / 2 {
            self.width = (self.width / 2).max(NARROWEST);
        }
        self.saved = self.saved_by(now).saturating_sub(LONGEST_WAIT);
        (self.closed, self.waiting, self.grown) = (Some(now), 0, None);
    }

    fn saved_by(&self, now: Instant) -> Duration {
        let passed = self.closed.map_or(Duration::ZERO, |before| now.saturating_duration_since(before));
        self.saved.saturating_add(passed).min(MOST_SAVED)
    }
}

#[derive(Debug, Default)]
pub(super) struct Sampler {
    seen: u64,
    /// When the next message is due, nanoseconds.
    due: u64,
}

impl Sampler {
    /// Takes the first message, and over time no more than the rate.
    pub fn takes(&mut self, sampling: Sampling, at: Timestamp) -> bool {
        let nth = sampling.every.is_none_or(|every| self.seen.is_multiple_of(every.max(1)));
        self.seen = self.seen.wrapping_add(1);
        nth && sampling.rate.is_none_or(|rate| self.is_due(1_000_000_000_000 / rate.max(1), at))
    }

    fn is_due(&mut self, interval: u64, at: Timestamp) -> bool {
        // Half an interval early is on time: a publisher at exactly this rate is never quite even.
        if at.0.saturating_add(interval / 2) < self.due {
            // A clock that was set back does not silence the topic.
            if self.due - at.0 <= interval.saturating_mul(2) {
                return false;
            }
            self.due = at.0;
        }
        // The first message starts the count: nothing is owed for the time before it.
        let owed = if self.due == 0 { at.0 } else { at.0.saturating_sub(interval) };
        self.due = self.due.max(owed) + interval;
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spent(now: Instant) -> Pace {
        Pace { saved: Duration::ZERO, closed: Some(now), ..Pace::default() }
    }

    /// When batches close, in milliseconds, if this many records come at those milliseconds.
    fn closes(pace: &mut Pace, begin: Instant, until: u64, come: impl Fn(u64) -> usize) -> Vec<u64> {
        let (mut waiting, mut oldest, mut closes) = (0usize, 0u64, Vec::new());
        for millisecond in 0..until {
            let (new, now) = (come(millisecond), begin + Duration::from_millis(millisecond));
            if waiting == 0 && new > 0 {
                oldest = millisecond;
            }
            waiting += new;
            if waiting > 0 && pace.due_in(waiting, Duration::from_millis(millisecond - oldest), true, now).is_zero() {
                pace.closed(waiting, now);
                waiting = 0;
                closes.push(millisecond);
            }
        }
        closes
    }

    #[test]
    fn a_batch_closes_at_256_leaves_or_after_a_second() {
        let now = Instant::now();
        let mut pace = spent(now);
        assert_eq!(pace.due_in(256, Duration::ZERO, true, now), Duration::ZERO);
        assert_eq!(pace.due_in(255, Duration::from_millis(400), true, now), Duration::from_millis(600));
        assert_eq!(pace.due_in(1, Duration::from_secs(5), true, now), Duration::ZERO);
    }

    #[test]
    fn a_burst_is_closed_when_it_is_over() {
        let begin = Instant::now();
        let burst = |millisecond| usize::from(millisecond < 100);
        assert_eq!(closes(&mut Pace::default(), begin, 1_000, burst), [109]);
        assert_eq!(closes(&mut spent(begin), begin, 1_500, burst), [1_000], "nothing was saved for it");
    }

    #[test]
    fn while_a_batch_waits_for_a_block_the_next_one_takes_its_second() {
        let begin = Instant::now();
        let mut pace = Pace::default();
        assert_eq!(pace.due_in(3, Duration::ZERO, false, begin), LONGEST_WAIT);
        let later = begin + Duration::from_millis(50);
        assert_eq!(pace.due_in(3, Duration::from_millis(50), false, later), Duration::from_millis(950));
        assert_eq!(pace.due_in(3, Duration::from_millis(50), true, later), Duration::ZERO);
    }

    #[test]
    fn early_closes_are_paid_for() {
        for apart in [30, 100, 300, 999] {
            let come = |millisecond: u64| usize::from(millisecond.is_multiple_of(apart));
            let closes = closes(&mut Pace::default(), Instant::now(), 60_000, come);
            assert!(closes.len() <= 64, "{} batches in a minute, records {apart} ms apart", closes.len());
        }
        let rare = closes(&mut Pace::default(), Instant::now(), 60_000, |at| usize::from(at.is_multiple_of(1_500)));
        assert!(rare.iter().all(|at| at % 1_500 == 10), "a record that is alone waits for nobody: {rare:?}");
    }

    #[test]
    fn one_batch_a_second_at_any_rate() {
        for rate in [100, 1_000, 5_000, 16_000] {
            let come = |at: u64| rate / 1000 + usize::from(rate < 1000 && at.is_multiple_of(10));
            let all = closes(&mut Pace::default(), Instant::now(), 20_000, come);
            let late = all.iter().filter(|at| **at > 10_000).count();
            assert!((8..=12).contains(&late), "{late} batches in ten seconds at {rate}/s");
        }
    }

    #[test]
    fn the_width_has_bounds_and_comes_back() {
        let (mut pace, mut now) = (Pace::default(), Instant::now());
        for _ in 0..20 {
            now += Duration::from_millis(10);
            pace.closed(MOST_LEAVES, now);
        }
        assert_eq!(pace.width, MOST_LEAVES);
        for _ in 0..20 {
            now += LONGEST_WAIT;
            pace.closed(1, now);
        }
        assert_eq!(pace.width, NARROWEST);
    }
}

#[cfg(test)]
mod sampler_tests {
    use super::*;

    fn rule(rate: Option<u64>, every: Option<u64>) -> Sampling {
        Sampling { rate, every }
    }

    /// How many of `count` messages are taken, `gap` nanoseconds apart with jitter.
    fn taken(rule: Sampling, count: u64, gap: u64, jitter: u64) -> u64 {
        let mut sampler = Sampler::default();
        let time = |number: u64| Timestamp(1_000_000_000_000 + number * gap + number * 7_919 % (jitter + 1));
        (0..count).filter(|number| sampler.takes(rule, time(*number))).count() as u64
    }

    #[test]
    fn every_tenth_is_every_tenth() {
        assert_eq!(taken(rule(None, Some(10)), 95, 1_000_000, 0), 10);
        assert_eq!(taken(rule(None, None), 95, 1_000_000, 0), 95);
    }

    #[test]
    fn a_rate_is_kept_over_time_and_an_even_publisher_of_it_loses_nothing() {
        // 20.3 Hz against 10 Hz over 100 s.
        let kept = taken(rule(Some(10_000), None), 2030, 49_261_083, 0);
        assert!((995..=1002).contains(&kept), "{kept}");
        assert_eq!(taken(rule(Some(10_000), None), 1000, 100_000_000, 40_000_000), 1000);
        // Both: every second of 20 Hz, at most 5 Hz.
        let kept = taken(rule(Some(5_000), Some(2)), 2000, 50_000_000, 0);
        assert!((495..=502).contains(&kept), "{kept}");
    }

    #[test]
    fn the_first_moments_bring_no_burst() {
        // 100 Hz against 5 Hz: at 0, 200, 400 ms (half an interval early is on time), and not several at once.
        let (rule, mut sampler) = (rule(Some(5_000), None), Sampler::default());
        let at = |number: u64| Timestamp(1_000_000_000_000 + number * 10_000_000);
        let taken: Vec<u64> = (0..60).filter(|number| sampler.takes(rule, at(*number))).collect();
        assert_eq!(taken.first(), Some(&0));
        assert!(taken.windows(2).all(|pair| pair[1] - pair[0] >= 10), "{taken:?}");
        assert!(taken.len() <= 5, "{taken:?}");
    }

    #[test]
    fn a_clock_set_back_does_not_silence_a_topic() {
        let (rule, mut sampler) = (rule(Some(1_000), None), Sampler::default());
        assert!(sampler.takes(rule, Timestamp(9_000_000_000_000)));
        assert!(sampler.takes(rule, Timestamp(1_000_000_000_000)));
    }
}
