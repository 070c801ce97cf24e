//! How fast records pass each stage, from the counts of successive answers.

use crate::model::Timestamp;
use crate::service::reply::LifeLine;

/// The shortest time over which a rate is computed, nanoseconds.
const WINDOW: u64 = 2_000_000_000;
/// After this long without news, the rates are zero, nanoseconds.
const STILL_AFTER: u64 = 6_000_000_000;

/// Stages of a record: captured, sealed, stored, anchored, confirmed, verified.
pub const STATIONS: usize = 6;

/// Records per second at each stage.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Rates {
    base: Option<(Timestamp, [u64; STATIONS])>,
    /// Records per second, by stage.
    pub stations: [f64; STATIONS],
}

fn counts(life: &LifeLine) -> [u64; STATIONS] {
    [life.captured, life.sealed, life.stored, life.anchored, life.confirmed, life.verified]
}

impl Rates {
    /// Takes in the counts at a moment.
    pub fn observe(&mut self, life: &LifeLine, now: Timestamp) {
        let counts = counts(life);
        let Some((since, before)) = self.base else {
            self.base = Some((now, counts));
            return;
        };
        let nanoseconds = now.0.saturating_sub(since.0);
        if nanoseconds < WINDOW {
            return;
        }
        self.stations =
            std::array::from_fn(|place| per_second(counts[place].saturating_sub(before[place]), nanoseconds));
        self.base = Some((now, counts));
    }

    /// Captured per second.
    pub fn captured(&self) -> f64 {
        self.stations[0]
    }

    /// Verified per second.
    pub fn verified(&self) -> f64 {
        self.stations[STATIONS - 1]
    }

    /// When the rates become zero unless something arrives before.
    pub fn still_at(&self) -> Option<Timestamp> {
        let flows = self.stations.iter().any(|rate| *rate > 0.0);
        self.base.filter(|_| flows).map(|(since, ..)| Timestamp(since.0.saturating_add(STILL_AFTER)))
    }

    /// Sets the rates to zero when it is time.
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
        assert!((rates.captured() - 40.0).abs() < 1e-9);
        assert_eq!(rates.still_at(), Some(Timestamp::from_seconds(8)));
        rates.settle(Timestamp::from_seconds(8));
        assert_eq!(rates, Rates::default());
    }
}
