//! How fast records pass the life line, from the counts of successive answers.

use crate::model::Timestamp;
use crate::service::reply::LifeLine;

/// The shortest time over which a rate is taken, nanoseconds.
const WINDOW: u64 = 2_000_000_000;
/// Without news for so long nothing flows any more, nanoseconds.
const STILL_AFTER: u64 = 6_000_000_000;

/// Records a second at both ends of the life line.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Rates {
    base: Option<(Timestamp, u64, u64)>,
    /// Captured a second.
    pub captured: f64,
    /// Verified a second.
    pub verified: f64,
}

impl Rates {
    /// Takes note of the counts at a moment.
    pub fn observe(&mut self, life: &LifeLine, now: Timestamp) {
        let Some((since, captured, verified)) = self.base else {
            self.base = Some((now, life.captured, life.verified));
            return;
        };
        let nanoseconds = now.0.saturating_sub(since.0);
        if nanoseconds < WINDOW {
            return;
        }
        self.captured = per_second(life.captured.saturating_sub(captured), nanoseconds);
        self.verified = per_second(life.verified.saturating_sub(verified), nanoseconds);
        self.base = Some((now, life.captured, life.verified));
    }

    /// When the rates fall to nothing unless something arrives before.
    pub fn still_at(&self) -> Option<Timestamp> {
        let flows = self.captured > 0.0 || self.verified > 0.0;
        self.base.filter(|_| flows).map(|(since, ..)| Timestamp(since.0.saturating_add(STILL_AFTER)))
    }

    /// Lets the rates fall to nothing when their time has come.
    pub fn settle(&mut self, now: Timestamp) {
        if self.still_at().is_some_and(|at| at <= now) {
            *self = Self::default();
        }
    }
}

fn per_second(count: u64, nanoseconds: u64) -> f64 {
    let count = f64::from(u32::try_from(count).unwrap_or(u32::MAX));
    count / std::time::Duration::from_nanos(nanoseconds).as_secs_f64()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rate_shows_after_two_seconds_and_goes_when_nothing_comes() {
        let life = |captured| LifeLine { captured, ..LifeLine::default() };
        let mut rates = Rates::default();
        rates.observe(&life(100), Timestamp(0));
        rates.observe(&life(140), Timestamp::from_seconds(1));
        assert_eq!(rates.still_at(), None);
        rates.observe(&life(180), Timestamp::from_seconds(2));
        assert!((rates.captured - 40.0).abs() < 1e-9);
        assert_eq!(rates.still_at(), Some(Timestamp::from_seconds(8)));
        rates.settle(Timestamp::from_seconds(8));
        assert_eq!(rates, Rates::default());
    }
}
