//! When a frame drawn only because of data may be sent: not too often, not too many bytes.

use std::time::{Duration, Instant};

/// The default over SSH, bytes a second.
pub const OVER_SSH: u32 = 4_000;
/// The shortest time between two frames for data.
const LEAST_GAP: Duration = Duration::from_millis(50);
/// A frame for data takes the line for one part of a second in this many.
const IN_FLIGHT: u32 = 10;

/// Bytes sent and still to be paid for by waiting.
#[derive(Debug)]
pub struct Budget {
    bytes_per_second: Option<u32>,
    next: Instant,
}

impl Budget {
    /// This many bytes a second; `None` = only the gap counts.
    pub fn new(bytes_per_second: Option<u32>, now: Instant) -> Self {
        Self { bytes_per_second: bytes_per_second.filter(|bytes| *bytes > 0), next: now }
    }

    /// The most bytes of a frame for data, whole rows beyond it not counted: what is on its way when a key is pressed
    /// delays the answer. `None` = no limit.
    pub fn most_at_once(&self) -> Option<usize> {
        let rate = self.bytes_per_second?;
        usize::try_from(rate / IN_FLIGHT).ok()
    }

    /// How long a frame for data has to wait.
    pub fn wait(&self, now: Instant) -> Duration {
        self.next.saturating_duration_since(now)
    }

    /// This many bytes were sent, for a key or for data.
    pub fn spend(&mut self, bytes: usize, now: Instant) {
        let bytes = u32::try_from(bytes).unwrap_or(u32::MAX);
        let cost = self
            .bytes_per_second
            .map_or(Duration::ZERO, |rate| Duration::from_secs_f64(f64::from(bytes) / f64::from(rate)));
        // The debt of earlier frames is kept: keys draw at once, data pays for them.
        self.next = self.next.max(now) + cost;
        self.next = self.next.max(now + LEAST_GAP);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn data_waits_until_its_bytes_are_paid() {
        let start = Instant::now();
        let mut budget = Budget::new(Some(4_000), start);
        assert_eq!(budget.wait(start), Duration::ZERO);
        budget.spend(1_000, start);
        assert_eq!(budget.wait(start), Duration::from_millis(250));
        budget.spend(1_000, start);
        assert_eq!(budget.wait(start), Duration::from_millis(500));
        assert_eq!(budget.wait(start + Duration::from_millis(500)), Duration::ZERO);
    }

    #[test]
    fn a_second_of_frames_stays_within_the_budget() {
        let start = Instant::now();
        let mut budget = Budget::new(Some(4_000), start);
        let (mut now, mut sent) = (start, 0);
        while now < start + Duration::from_secs(10) {
            if budget.wait(now).is_zero() {
                budget.spend(700, now);
                sent += 700;
            }
            now += Duration::from_millis(1);
        }
        assert!((38_000..=40_700).contains(&sent), "{sent}");
    }

    #[test]
    fn without_a_limit_frames_keep_their_distance() {
        let start = Instant::now();
        let mut budget = Budget::new(None, start);
        budget.spend(1_000_000, start);
        assert_eq!(budget.wait(start), LEAST_GAP);
        assert_eq!(budget.wait(start + LEAST_GAP), Duration::ZERO);
    }
}
