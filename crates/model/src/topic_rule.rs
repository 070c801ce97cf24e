//! Rules for topics: which type, how many messages, which tags, how long they are kept.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::topic::{LONGEST_NAME, TopicName, TypeName};
use crate::text::{as_text, is_name, names};

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "'{0}' is not a topic pattern; it must start with /; * matches within one part, ** any number of parts, ? one \
     character, as in /robot*/odom"
)]
pub struct PatternError(String);

/// A topic's name, or a pattern for names: `*` within a part, `**` across parts, `?` for one letter.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TopicPattern(String);
names! {
    TopicPattern: |text| {
        let fits = |b: u8| b.is_ascii_alphanumeric() || b"_/*?".contains(&b);
        let is_plain = !text.contains(['*', '?']);
        (text.starts_with('/') || text.starts_with("**"))
            && is_name(text, LONGEST_NAME, fits, fits)
            && (!is_plain || text.parse::<TopicName>().is_ok())
    }, else PatternError by |text| PatternError(super::clean(text, 80));
}
as_text!(TopicPattern);

impl TopicPattern {
    /// All topics of a robot: its name is their first part.
    pub fn of_robot(name: &str) -> Result<Self, PatternError> {
        format!("/{}/**", name.trim_matches('/')).parse()
    }

    /// The name, unless it is a pattern for many.
    pub fn name(&self) -> Option<TopicName> {
        if self.is_plain() { self.0.parse().ok() } else { None }
    }

    /// Whether it is a plain name, not a pattern for many.
    pub fn is_plain(&self) -> bool {
        !self.0.contains(['*', '?'])
    }

    pub fn matches(&self, topic: &str) -> bool {
        fits(self.0.as_bytes(), topic.as_bytes())
    }
}

impl From<TopicName> for TopicPattern {
    fn from(name: TopicName) -> Self {
        Self(name.as_str().to_owned())
    }
}

/// Whether a text matches a pattern. Takes time proportional to at most the product of both lengths.
pub(super) fn fits(pattern: &[u8], text: &[u8]) -> bool {
    // Which prefixes of the text the pattern so far can match.
    let mut reached = vec![false; text.len() + 1];
    if let Some(first) = reached.first_mut() {
        *first = true;
    }
    let mut at = 0;
    while let Some(&letter) = pattern.get(at) {
        let over_parts = letter == b'*' && pattern.get(at + 1) == Some(&b'*');
        reached = match letter {
            b'*' => spread(&reached, text, over_parts),
            _ => step(&reached, text, letter),
        };
        at += if over_parts { 2 } else { 1 };
    }
    reached.last().copied().unwrap_or(false)
}

fn step(reached: &[bool], text: &[u8], letter: u8) -> Vec<bool> {
    let is_it = |byte: u8| byte == letter || letter == b'?' && byte != b'/';
    let moved = reached.iter().zip(text).map(|(&here, &byte)| here && is_it(byte));
    std::iter::once(false).chain(moved).collect()
}

/// `over_parts`: across `/`.
fn spread(reached: &[bool], text: &[u8], over_parts: bool) -> Vec<bool> {
    let mut going = false;
    let mut spread = Vec::with_capacity(reached.len());
    for (index, &here) in reached.iter().enumerate() {
        let before = index.checked_sub(1).and_then(|index| text.get(index));
        going = here || going && (over_parts || before != Some(&b'/'));
        spread.push(going);
    }
    spread
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TopicRule {
    pub pattern: TopicPattern,
    /// Its line in the settings file, from 1.
    pub line: usize,
    /// Messages of other types are not captured.
    pub type_name: Option<TypeName>,
    /// At most this many messages in 1,000 seconds.
    pub rate: Option<u64>,
    /// Only every n-th message, n from 2.
    pub every: Option<u64>,
    /// Added to the sealed head of every message.
    pub tags: BTreeMap<String, String>,
    /// How long ciphertext is kept, seconds.
    pub retention: Option<u64>,
}

/// How many of a topic's messages are kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Sampling {
    /// At most this many messages in 1,000 seconds.
    pub rate: Option<u64>,
    /// Only every n-th message; 1 = all.
    pub every: Option<u64>,
}

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SamplingError {
    #[error("give the rate in messages per second, 0.001 to {most}; '{0}' is not such a number", most = FASTEST)]
    Rate(String),
    #[error("give every as a whole number from 1: 10 keeps one message in ten; '{0}' is not such a number")]
    Every(String),
}

/// Messages a second.
const FASTEST: f64 = 100_000.0;
const LARGEST_STEP: u64 = 1 << 32;

impl Sampling {
    /// Messages in 1,000 seconds; `None` for a rate out of bounds.
    pub fn rate_of(a_second: f64) -> Option<u64> {
        if !(0.001..=FASTEST).contains(&a_second) {
            return None;
        }
        let in_thousand_seconds = (a_second * 1000.0).round();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "between 1 and 10^8")]
        Some(in_thousand_seconds as u64)
    }

    pub fn every_of(step: u64) -> Option<u64> {
        Some(step).filter(|step| (1..=LARGEST_STEP).contains(step))
    }

    /// As people type it; without either there is no rule.
    pub fn read(rate: Option<&str>, every: Option<&str>) -> Result<Option<Self>, SamplingError> {
        let rate_in = |text: &str| {
            let rate = text.parse().ok().and_then(Self::rate_of);
            rate.ok_or_else(|| SamplingError::Rate(super::clean(text, 40)))
        };
        let every_in = |text: &str| {
            let every = text.parse().ok().and_then(Self::every_of);
            every.ok_or_else(|| SamplingError::Every(super::clean(text, 40)))
        };
        let sampling = Self { rate: rate.map(rate_in).transpose()?, every: every.map(every_in).transpose()? };
        Ok(Some(sampling).filter(|sampling| *sampling != Self::default()))
    }

    pub fn is_all(&self) -> bool {
        self.rate.is_none() && self.every.is_none_or(|every| every <= 1)
    }

    /// Messages a second, as it is typed.
    pub fn rate_text(&self) -> Option<String> {
        let text = self.rate.map(|rate| format!("{}.{:03}", rate / 1000, rate % 1000))?;
        Some(text.trim_end_matches('0').trim_end_matches('.').to_owned())
    }
}

/// `1 in 10, at most 5/s`.
impl fmt::Display for Sampling {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let every = self.every.filter(|every| *every > 1).map(|every| format!("1 in {every}"));
        let rate = self.rate_text().map(|rate| format!("at most {rate}/s"));
        let parts: Vec<String> = every.into_iter().chain(rate).collect();
        formatter.write_str(&if parts.is_empty() { "every message".to_owned() } else { parts.join(", ") })
    }
}

pub const RETENTION_TAG: &str = "retention";

impl TopicRule {
    pub fn sampling(&self) -> Sampling {
        Sampling { rate: self.rate, every: self.every }
    }

    /// Its tags, with its retention as one of them, in seconds: `retention=2592000s`.
    pub fn all_tags(&self) -> impl Iterator<Item = (String, String)> {
        let retention = self.retention.map(|seconds| (RETENTION_TAG.to_owned(), format!("{seconds}s")));
        self.tags.clone().into_iter().chain(retention)
    }
}

/// All rules, in order: the first that matches a topic applies.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct TopicRules(pub Vec<Arc<TopicRule>>);

impl TopicRules {
    pub fn of(&self, topic: &str) -> Option<&Arc<TopicRule>> {
        self.0.iter().find(|rule| rule.pattern.matches(topic))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn matches(pattern: &str, topic: &str) -> bool {
        pattern.parse::<TopicPattern>().expect(pattern).matches(topic)
    }

    fn by_definition(pattern: &[u8], topic: &[u8]) -> bool {
        match (pattern, topic) {
            ([], _) => topic.is_empty(),
            ([b'*', b'*', rest @ ..], _) => (0..=topic.len()).any(|taken| by_definition(rest, &topic[taken..])),
            ([b'*', rest @ ..], _) => {
                let part = topic.iter().position(|letter| *letter == b'/').unwrap_or(topic.len());
                (0..=part).any(|taken| by_definition(rest, &topic[taken..]))
            }
            ([letter, rest @ ..], [first, after @ ..]) => {
                (letter == first || *letter == b'?' && *first != b'/') && by_definition(rest, after)
            }
            ([_, ..], []) => false,
        }
    }

    #[test]
    fn a_rule_is_read_as_it_is_typed_and_said_in_words() {
        let read = |rate, every| Sampling::read(rate, every).map(|found| found.map(|found| found.to_string()));
        assert_eq!(read(None, None), Ok(None));
        assert_eq!(read(Some("5"), None), Ok(Some("at most 5/s".to_owned())));
        assert_eq!(read(Some("0.25"), Some("10")), Ok(Some("1 in 10, at most 0.25/s".to_owned())));
        assert_eq!(read(None, Some("1")), Ok(Some("every message".to_owned())), "despite a rule of the settings");
        for wrong in ["", "0", "-1", "fast", "NaN", "inf", "100001"] {
            assert!(matches!(read(Some(wrong), None), Err(SamplingError::Rate(_))), "{wrong}");
        }
        for wrong in ["", "0", "-1", "2.5", "4294967297"] {
            assert!(matches!(read(None, Some(wrong)), Err(SamplingError::Every(_))), "{wrong}");
        }
        let typed = |rate| Sampling { rate: Some(rate), every: None }.rate_text();
        assert_eq!([typed(5_000), typed(250), typed(100_000_000)].map(Option::unwrap), ["5", "0.25", "100000"]);
    }

    #[test]
    fn stars_stay_in_a_part_and_double_ones_do_not() {
        assert!(matches("/robot*/odom", "/robot12/odom") && matches("/robot*/odom", "/robot/odom"));
        assert!(!matches("/robot*/odom", "/robot1/base/odom") && !matches("/robot*/odom", "/robot1/odom2"));
        assert!(matches("/robot1/**", "/robot1/camera/image") && !matches("/robot1/**", "/robot10/odom"));
        assert!(matches("**/odom", "/a/b/odom") && matches("**", "/x") && matches("/**/odom", "/a/odom"));
        assert!(matches("/a?c", "/abc") && !matches("/a?c", "/a/c") && matches("/a", "/a") && !matches("/a", "/ab"));
        for bad in ["", "odom", "*", "/a b", "/a[1]", "/\u{202e}", "/", "/1x", "/a//b"] {
            assert!(bad.parse::<TopicPattern>().is_err(), "{bad}");
        }
    }

    proptest! {
        #[test]
        fn hostile_patterns_take_no_time(stars in 1..80_usize, length in 1..200_usize) {
            let pattern = format!("/{}b", "*a".repeat(stars));
            let matched = matches(&pattern, &format!("/{}", "a".repeat(length)));
            prop_assert!(!matched);
        }

        /// Against a matcher by recursion, which takes exponential time and is easy to believe.
        #[test]
        fn patterns_match_as_their_definition_says(pattern in "/[ab/*?]{0,7}", topic in "/[ab/]{0,7}") {
            if let Ok(read) = pattern.parse::<TopicPattern>() {
                prop_assert_eq!(read.matches(&topic), by_definition(pattern.as_bytes(), topic.as_bytes()), "{} {}", pattern, topic);
            }
        }

        #[test]
        fn a_robot_has_the_topics_under_its_name_and_no_others(robot in "[a-z][a-z0-9_]{0,8}", rest in "[a-z]{1,5}(/[a-z]{1,5}){0,2}") {
            let own = TopicPattern::of_robot(&robot).expect("a name");
            let (under, beside) = (format!("/{robot}/{rest}"), format!("/{robot}0/{rest}"));
            let within = format!("/x{rest}/{robot}/odom");
            prop_assert!(own.matches(&under) && !own.matches(&beside) && !own.matches(&within));
            prop_assert!(under.parse::<TopicPattern>().expect("a name").name().is_some() && own.name().is_none());
        }

        #[test]
        fn a_name_matches_itself_and_everything(name in "/[a-z]{1,9}(/[a-z]{1,9}){0,3}") {
            prop_assert!(matches(&name, &name) && matches("**", &name));
        }
    }
}
