//! Rules for topics: which type, how many messages, which tags, how long they are kept.

use std::collections::BTreeMap;
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

pub const RETENTION_TAG: &str = "retention";

impl TopicRule {
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
