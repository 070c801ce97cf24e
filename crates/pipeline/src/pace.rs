//! When a batch closes: at 256 leaves, after a second, or when nothing more comes and no batch before it waits for a
//! block. It gets wider the faster records come, and early closes are paid for by seconds without one, so that there is
//! about one transaction a second.

use std::time::{Duration, Instant};

use crate::chain::merkle::MOST_LEAVES;

/// Leaves at which a batch first closes.
const NARROWEST: usize = 256;
/// How long a record waits for its batch to close, and the cost of an early close.
pub const LONGEST_WAIT: Duration = Duration::from_secs(1);
/// A batch that got nothing new for this long stops waiting.
const LULL: Duration = Duration::from_millis(10);
/// The most credit for early closes.
const MOST_SAVED: Duration = Duration::from_secs(4);

/// The width of an owner's batches.
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

#[cfg(test)]
mod tests {
    use super::*;

    /// One without credit.
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
