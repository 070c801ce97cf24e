//! Clock for decisions that cannot be undone: it follows a jump of the machine's clock only once the jump has held.

use std::sync::{LazyLock, Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::Timestamp;

/// How long a new time must hold before it is believed.
pub const SETTLING: Duration = Duration::from_secs(30);
/// A smaller change between two readings is not a jump: clocks are slewed, at 0.5 ms a second at most.
const TOLERANCE: i128 = 5_000_000_000;

static CLOCK: LazyLock<(Instant, Mutex<SteadyClock>)> =
    LazyLock::new(|| (Instant::now(), Mutex::new(SteadyClock::default())));

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reading {
    pub steady: Timestamp,
    pub machine: Timestamp,
}

impl Reading {
    /// Seconds by which the machine's clock is ahead; 0 if they agree.
    pub fn ahead(&self) -> i64 {
        let nanoseconds = i128::from(self.machine.0) - i128::from(self.steady.0);
        i64::try_from(nanoseconds / 1_000_000_000).unwrap_or(0)
    }
}

/// Must be read regularly, so that a slow drift is followed.
pub fn look() -> Reading {
    let (begun, clock) = &*CLOCK;
    let mut clock = clock.lock().unwrap_or_else(PoisonError::into_inner);
    clock.read(Timestamp::now(), begun.elapsed())
}

pub fn steady_now() -> Timestamp {
    look().steady
}

/// Time of day minus elapsed time, by the machine's clock: constant unless somebody sets it. Nanoseconds.
type Offset = i128;

#[derive(Debug, Default)]
pub struct SteadyClock {
    believed: Option<Offset>,
    /// What the machine's clock says instead, and since when.
    doubted: Option<(Offset, Duration)>,
}

impl SteadyClock {
    /// `passed`: time since a fixed moment.
    pub fn read(&mut self, machine: Timestamp, passed: Duration) -> Reading {
        let since = i128::try_from(passed.as_nanos()).unwrap_or(i128::MAX);
        let told = i128::from(machine.0) - since;
        let believed = *self.believed.get_or_insert(told);
        let stood = match self.doubted {
            _ if (told - believed).abs() <= TOLERANCE => Some(SETTLING),
            Some((doubted, at)) if (told - doubted).abs() <= TOLERANCE => passed.checked_sub(at),
            _ => None,
        };
        match stood {
            Some(stood) if stood >= SETTLING => (self.believed, self.doubted) = (Some(told), None),
            Some(_) => {}
            None => self.doubted = Some((told, passed)),
        }
        let steady = self.believed.unwrap_or(told) + since;
        Reading { steady: Timestamp(u64::try_from(steady).unwrap_or(0)), machine }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DAY: u64 = 86_400;
    const START: u64 = 1_700_000_000;

    /// Reads a clock that is `offset` seconds ahead of the elapsed time.
    fn at(clock: &mut SteadyClock, passed: u64, offset: u64) -> (u64, i64) {
        let reading = clock.read(Timestamp::from_seconds(offset + passed), Duration::from_secs(passed));
        (reading.steady.seconds(), reading.ahead())
    }

    #[test]
    fn a_jump_forth_and_back_leaves_no_trace() {
        let mut clock = SteadyClock::default();
        let day = i64::try_from(DAY).expect("small");
        assert_eq!(at(&mut clock, 0, START), (START, 0));
        assert_eq!(at(&mut clock, 10, START + DAY), (START + 10, day));
        assert_eq!(at(&mut clock, 39, START + DAY), (START + 39, day));
        assert_eq!(at(&mut clock, 40, START), (START + 40, 0));
        assert_eq!(at(&mut clock, 100, START - DAY), (START + 100, -day));
        assert_eq!(at(&mut clock, 129, START), (START + 129, 0));
    }

    #[test]
    fn a_time_that_stands_is_believed_and_one_that_flickers_is_not() {
        let mut clock = SteadyClock::default();
        at(&mut clock, 0, START);
        at(&mut clock, 10, START + DAY);
        assert_eq!(at(&mut clock, 40, START + DAY), (START + 40 + DAY, 0));
        assert_eq!(at(&mut clock, 41, START).0, START + 41 + DAY, "neither is the way back followed at once");
        for passed in 42..200 {
            let offset = START + DAY * (passed / 20 % 2) * 2;
            assert_eq!(at(&mut clock, passed, offset).0, START + passed + DAY, "at {passed}");
        }
    }

    #[test]
    fn a_slow_drift_is_followed() {
        let mut clock = SteadyClock::default();
        at(&mut clock, 0, START);
        for hour in 1..100 {
            let offset = START + hour * 2;
            assert_eq!(at(&mut clock, hour * 3600, offset), (offset + hour * 3600, 0));
        }
    }

    #[test]
    fn this_process_has_one() {
        let reading = look();
        assert!(reading.ahead().abs() < 5 && steady_now() >= reading.steady);
    }
}
