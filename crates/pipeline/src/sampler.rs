//! Which messages of a topic its rule lets through: every n-th, and at most this many of those a second.

use crate::model::{Timestamp, TopicRule};

/// The sampling state of one topic for one author.
#[derive(Debug, Default)]
pub(super) struct Sampler {
    seen: u64,
    /// When the next message is due, nanoseconds.
    due: u64,
}

impl Sampler {
    /// Whether the rule takes a message of this time. The first is taken; over time no more than the rate.
    pub fn takes(&mut self, rule: &TopicRule, at: Timestamp) -> bool {
        let nth = rule.every.is_none_or(|every| self.seen.is_multiple_of(every.max(1)));
        self.seen = self.seen.wrapping_add(1);
        nth && rule.rate.is_none_or(|rate| self.is_due(1_000_000_000_000 / rate.max(1), at))
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
    use std::collections::BTreeMap;

    fn rule(rate: Option<u64>, every: Option<u64>) -> TopicRule {
        let pattern = "/a".parse().expect("a pattern");
        TopicRule { pattern, line: 1, type_name: None, rate, every, tags: BTreeMap::new(), retention: None }
    }

    /// How many of `count` messages are taken, `gap` nanoseconds apart with jitter.
    fn taken(rule: &TopicRule, count: u64, gap: u64, jitter: u64) -> u64 {
        let mut sampler = Sampler::default();
        let time = |number: u64| Timestamp(1_000_000_000_000 + number * gap + number * 7_919 % (jitter + 1));
        (0..count).filter(|number| sampler.takes(rule, time(*number))).count() as u64
    }

    #[test]
    fn every_tenth_is_every_tenth() {
        assert_eq!(taken(&rule(None, Some(10)), 95, 1_000_000, 0), 10);
        assert_eq!(taken(&rule(None, None), 95, 1_000_000, 0), 95);
    }

    #[test]
    fn a_rate_is_kept_over_time_and_an_even_publisher_of_it_loses_nothing() {
        // 20.3 Hz against 10 Hz over 100 s.
        let kept = taken(&rule(Some(10_000), None), 2030, 49_261_083, 0);
        assert!((995..=1002).contains(&kept), "{kept}");
        assert_eq!(taken(&rule(Some(10_000), None), 1000, 100_000_000, 40_000_000), 1000);
        // Both: every second of 20 Hz, at most 5 Hz.
        let kept = taken(&rule(Some(5_000), Some(2)), 2000, 50_000_000, 0);
        assert!((495..=502).contains(&kept), "{kept}");
    }

    #[test]
    fn the_first_moments_bring_no_burst() {
        // 100 Hz against 5 Hz: at 0, 200, 400 ms (half an interval early is on time), and not several at once.
        let (rule, mut sampler) = (rule(Some(5_000), None), Sampler::default());
        let at = |number: u64| Timestamp(1_000_000_000_000 + number * 10_000_000);
        let taken: Vec<u64> = (0..60).filter(|number| sampler.takes(&rule, at(*number))).collect();
        assert_eq!(taken.first(), Some(&0));
        assert!(taken.windows(2).all(|pair| pair[1] - pair[0] >= 10), "{taken:?}");
        assert!(taken.len() <= 5, "{taken:?}");
    }

    #[test]
    fn a_clock_set_back_does_not_silence_a_topic() {
        let (rule, mut sampler) = (rule(Some(1_000), None), Sampler::default());
        assert!(sampler.takes(&rule, Timestamp(9_000_000_000_000)));
        assert!(sampler.takes(&rule, Timestamp(1_000_000_000_000)));
    }
}
