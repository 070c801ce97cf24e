//! The numbers that a ROS 2 publisher gives its messages: what is missing, what came late, what came twice.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// How long a missing number may still arrive.
const SETTLE: Duration = Duration::from_millis(250);
/// The most gaps that are waited for.
const MOST_GAPS: usize = 256;
/// A step that no loss explains: the publisher is not trusted, and counting starts again.
const LONGEST_STEP: i64 = 1 << 31;

/// The kind of an arriving message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arrival {
    /// One not seen before.
    New,
    /// One that was seen before.
    Twice,
}

/// Messages that never arrived: the first and the last of their numbers.
pub type Gap = (i64, i64);

/// Follows one publisher, across restarts of the program that reads it.
#[derive(Debug, Default)]
pub struct Numbers {
    last: Option<i64>,
    /// By their first number: the last, and when they were found missing.
    missing: BTreeMap<i64, (i64, Instant)>,
}

impl Numbers {
    /// Takes the next message's number.
    pub fn follow(&mut self, number: i64, now: Instant) -> Arrival {
        let Some(last) = self.last.filter(|last| number.saturating_sub(*last) < LONGEST_STEP) else {
            self.last = Some(number);
            return Arrival::New;
        };
        if number > last {
            if number > last + 1 {
                self.missing.insert(last + 1, (number - 1, now));
            }
            self.last = Some(number);
            return Arrival::New;
        }
        let Some((&first, &(end, since))) = self.missing.range(..=number).next_back() else { return Arrival::Twice };
        if number > end {
            return Arrival::Twice;
        }
        self.missing.remove(&first);
        if first < number {
            self.missing.insert(first, (number - 1, since));
        }
        if number < end {
            self.missing.insert(number + 1, (end, since));
        }
        Arrival::New
    }

    /// Gaps that nothing will fill any more; `all` = everything missing.
    pub fn settled(&mut self, now: Instant, all: bool) -> Vec<Gap> {
        let beyond = self.missing.len().saturating_sub(MOST_GAPS);
        let late = |since: Instant| all || now.saturating_duration_since(since) >= SETTLE;
        let gaps: Vec<Gap> = self
            .missing
            .iter()
            .enumerate()
            .filter(|(place, (_, (_, since)))| *place < beyond || late(*since))
            .map(|(_, (first, (last, _)))| (*first, *last))
            .collect();
        self.missing.retain(|first, _| !gaps.iter().any(|(gap, _)| gap == first));
        gaps
    }

    /// Whether a message was ever seen.
    pub fn has_begun(&self) -> bool {
        self.last.is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    #[test]
    fn a_restart_goes_on_where_it_was_and_repeats_count_once() {
        let (now, mut numbers) = (Instant::now(), Numbers::default());
        assert_eq!(numbers.follow(100, now), Arrival::New);
        assert_eq!(numbers.follow(101, now), Arrival::New);
        assert_eq!(numbers.follow(101, now), Arrival::Twice);
        assert_eq!(numbers.follow(50, now), Arrival::Twice);
        assert_eq!(numbers.follow(2100, now), Arrival::New);
        assert!(numbers.settled(now, false).is_empty(), "it may still come");
        assert_eq!(numbers.settled(now + SETTLE, false), [(102, 2099)]);
        assert!(numbers.settled(now + SETTLE, true).is_empty(), "told once");
        // An implausible number is not a loss of billions.
        assert_eq!(numbers.follow(i64::MAX, now), Arrival::New);
        assert!(numbers.settled(now, true).is_empty());
        assert_eq!(numbers.follow(i64::MIN, now), Arrival::Twice);
    }

    #[test]
    fn gaps_are_bounded() {
        let (now, mut numbers) = (Instant::now(), Numbers::default());
        for number in 0..2 * 300 {
            numbers.follow(2 * number, now);
        }
        let told = numbers.settled(now, false).len();
        assert_eq!(told, 599 - MOST_GAPS);
        assert_eq!(numbers.missing.len(), MOST_GAPS);
    }

    proptest! {
        #[test]
        fn missing_is_what_never_came(arrivals in prop::collection::vec(0..60_i64, 1..120)) {
            let (now, mut numbers) = (Instant::now(), Numbers::default());
            let mut seen = BTreeSet::new();
            let first = arrivals[0];
            for number in &arrivals {
                let arrival = numbers.follow(*number, now);
                // Numbers before the first one seen were never promised.
                prop_assert_eq!(arrival == Arrival::New, *number >= first && seen.insert(*number));
            }
            let missed: Vec<i64> = numbers.settled(now, true).into_iter().flat_map(|(from, to)| from..=to).collect();
            let last = seen.last().copied().unwrap_or(first);
            let expected: Vec<i64> = (first..last).filter(|number| !seen.contains(number)).collect();
            prop_assert_eq!(missed, expected);
        }
    }
}
