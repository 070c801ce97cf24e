//! When the next message is due, and the clock that shows capture times.

use std::time::{Duration, Instant};

use crate::model::Timestamp;
use crate::ros::{Advertised, md5sum};
use crate::service::command::Pace;

/// As in `rosbag play --clock`.
pub(super) const TICK: Duration = Duration::from_millis(10);

const CLOCK: &str = "rosgraph_msgs/Clock";
const DEFINITION: &str = "# The time of the capture, as this is played\ntime clock\n";

pub(super) struct Pacer {
    thousandths: Option<u64>,
    begun: Option<(Timestamp, Instant)>,
}

impl Pacer {
    pub fn new(pace: Pace) -> Self {
        let thousandths = match pace {
            Pace::Rated { thousandths } => Some(thousandths.max(1)),
            Pace::AtOnce | Pace::Follow => None,
        };
        Self { thousandths, begun: None }
    }

    pub fn wait(&mut self, at: Timestamp, now: Instant) -> Duration {
        let Some(thousandths) = self.thousandths else { return Duration::ZERO };
        let (first, begun) = *self.begun.get_or_insert((at, now));
        let after = u128::from(at.0.saturating_sub(first.0)) * 1000 / u128::from(thousandths);
        let after = Duration::from_nanos(u64::try_from(after).unwrap_or(u64::MAX));
        after.saturating_sub(now.saturating_duration_since(begun))
    }

    pub fn clock(&self, now: Instant) -> Option<Timestamp> {
        let (first, begun) = self.begun?;
        let since = now.saturating_duration_since(begun).as_nanos() * u128::from(self.thousandths?) / 1000;
        Some(Timestamp(first.0.saturating_add(u64::try_from(since).unwrap_or(u64::MAX))))
    }
}

pub(super) fn clock_topic(topic: String) -> Advertised {
    Advertised {
        topic,
        type_name: CLOCK.to_owned(),
        md5sum: md5sum(CLOCK, DEFINITION).unwrap_or_default(),
        definition: DEFINITION.to_owned(),
        latching: false,
    }
}

pub(super) fn clock_message(at: Timestamp) -> Vec<u8> {
    let (seconds, rest) = (at.0 / 1_000_000_000, at.0 % 1_000_000_000);
    let half = |number: u64| u32::try_from(number).unwrap_or(u32::MAX).to_le_bytes();
    [half(seconds), half(rest)].concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: u64 = 1_000_000_000;

    #[test]
    fn messages_wait_as_long_as_they_were_apart_by_the_rate() {
        let now = Instant::now();
        let mut double = Pacer::new(Pace::Rated { thousandths: 2000 });
        assert_eq!(double.wait(Timestamp(100 * SECOND), now), Duration::ZERO);
        assert_eq!(double.wait(Timestamp(110 * SECOND), now), Duration::from_secs(5));
        assert_eq!(double.wait(Timestamp(110 * SECOND), now + Duration::from_secs(4)), Duration::from_secs(1));
        assert_eq!(double.wait(Timestamp(90 * SECOND), now), Duration::ZERO, "never back");
        assert_eq!(double.clock(now + Duration::from_secs(4)), Some(Timestamp(108 * SECOND)));
        let mut at_once = Pacer::new(Pace::AtOnce);
        assert_eq!(at_once.wait(Timestamp(100 * SECOND), now), Duration::ZERO);
        assert_eq!(at_once.wait(Timestamp(900 * SECOND), now), Duration::ZERO);
        assert_eq!(at_once.clock(now), None);
    }

    #[test]
    fn the_clock_is_ros_s_own() {
        // As `rosmsg md5 rosgraph_msgs/Clock` prints it.
        assert_eq!(clock_topic("/clock".into()).md5sum, "a9c97c1d230cfc112e270351a944ee47");
        assert_eq!(clock_message(Timestamp(3 * SECOND + 7)), [3, 0, 0, 0, 7, 0, 0, 0]);
    }
}
