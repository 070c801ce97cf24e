//! When a batch closes: at 256 leaves or after a second, and wider the faster records come, so that
//! the transactions a second stay the same at any message rate.

use std::time::{Duration, Instant};

use crate::chain::merkle::MOST_LEAVES;

/// Leaves at which a batch closes at first.
const NARROWEST: usize = 256;
/// How long a record waits for its batch to close.
pub const LONGEST_WAIT: Duration = Duration::from_secs(1);

/// The width of an owner's batches.
#[derive(Debug)]
pub struct Pace {
    width: usize,
    closed: Option<Instant>,
}

impl Default for Pace {
    fn default() -> Self {
        Self { width: NARROWEST, closed: None }
    }
}

impl Pace {
    /// How long until a batch of `waiting` records, the first of which has waited for `oldest`, closes.
    pub fn due_in(&self, waiting: usize, oldest: Duration) -> Duration {
        if waiting >= self.width { Duration::ZERO } else { LONGEST_WAIT.saturating_sub(oldest) }
    }

    /// Notes that a batch of `leaves` was closed at `now`: twice as wide where the second had not
    /// passed, half as wide where it was not half full.
    pub fn closed(&mut self, leaves: usize, now: Instant) {
        let early = self.closed.is_some_and(|before| now.saturating_duration_since(before) < LONGEST_WAIT);
        if leaves >= self.width && early {
            self.width = (self.width * 2).min(MOST_LEAVES);
        } else if leaves < self.width / 2 {
            self.width = (self.width / 2).max(NARROWEST);
        }
        self.closed = Some(now);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_batch_closes_at_256_leaves_or_after_a_second() {
        let pace = Pace::default();
        assert_eq!(pace.due_in(256, Duration::ZERO), Duration::ZERO);
        assert_eq!(pace.due_in(255, Duration::from_millis(400)), Duration::from_millis(600));
        assert_eq!(pace.due_in(1, Duration::from_secs(5)), Duration::ZERO);
    }

    #[test]
    fn one_batch_a_second_at_any_rate() {
        for rate in [100, 1_000, 5_000, 16_000] {
            let (mut pace, begin) = (Pace::default(), Instant::now());
            let (mut waiting, mut oldest, mut late) = (0usize, 0u64, Vec::new());
            for millisecond in 0..20_000u64 {
                waiting += rate / 1000 + usize::from(rate < 1000 && millisecond % 10 == 0);
                let age = Duration::from_millis(millisecond - oldest);
                if waiting > 0 && pace.due_in(waiting, age).is_zero() {
                    pace.closed(waiting, begin + Duration::from_millis(millisecond));
                    (waiting, oldest) = (0, millisecond);
                    late.extend((millisecond > 10_000).then_some(millisecond));
                }
            }
            assert!((8..=12).contains(&late.len()), "{} batches in ten seconds at {rate}/s", late.len());
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
            now += Duration::from_secs(1);
            pace.closed(1, now);
        }
        assert_eq!(pace.width, NARROWEST);
    }
}
