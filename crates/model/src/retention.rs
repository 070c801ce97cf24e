//! How long, and how much of, each topic's ciphertext is kept; the record that is anchored before any is deleted.

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::text::{as_text, is_name, names};
use crate::topic_rule::{TopicRules, fits};
use crate::wire::{Reader, Wire as _, WireError, put_list, read_list};
use crate::{ByteSize, Digest, Timestamp, TopicId, TopicPattern, clean, counted, time_span};

const MOST_RULES: usize = 100;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RetentionRule {
    /// `*` matches any characters but `/`, `**` any characters.
    pattern: String,
    /// Since capture.
    pub age: Option<Duration>,
    /// The newest messages of each topic, up to this many bytes.
    pub bytes: Option<u64>,
}

/// Rules in order; the first whose pattern matches a topic applies. Without one everything is kept.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct RetentionRules(Vec<RetentionRule>);

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "'{0}' is not a retention rule; use PATTERN=LIMIT, such as /robot*/camera/**=7d+10GiB, where LIMIT is a time (30m, \
     12h, 7d), a size, TIME+SIZE, or ever"
)]
pub struct RetentionError(String);

impl FromStr for RetentionRules {
    type Err = RetentionError;

    fn from_str(text: &str) -> Result<Self, RetentionError> {
        let rules = text.split(',').map(str::trim).filter(|rule| !rule.is_empty());
        let rules: Vec<_> = rules.map(str::parse).collect::<Result<_, _>>()?;
        if rules.len() > MOST_RULES {
            return Err(RetentionError(format!("… more than {MOST_RULES} rules")));
        }
        Ok(Self(rules))
    }
}

impl FromStr for RetentionRule {
    type Err = RetentionError;

    fn from_str(text: &str) -> Result<Self, RetentionError> {
        let wrong = || RetentionError(clean(text, 100));
        let (pattern, limits) = text.split_once('=').ok_or_else(wrong)?;
        let pattern = pattern.trim();
        let good = |byte: u8| byte.is_ascii_alphanumeric() || b"/_*~".contains(&byte);
        if pattern.is_empty() || pattern.len() > 255 || !pattern.bytes().all(good) {
            return Err(wrong());
        }
        let mut rule = Self { pattern: pattern.to_owned(), age: None, bytes: None };
        if limits.trim() == "ever" {
            return Ok(rule);
        }
        for limit in limits.split('+').map(str::trim) {
            match (time_span(limit).ok(), limit.parse::<ByteSize>()) {
                (Some(age), _) if rule.age.is_none() => rule.age = Some(age),
                (None, Ok(size)) if rule.bytes.is_none() => rule.bytes = Some(size.0),
                _ => return Err(wrong()),
            }
        }
        Ok(rule)
    }
}

impl fmt::Display for RetentionRule {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let age = self.age.map(|age| format!("{}s", age.as_secs()));
        let limits: Vec<String> = age.into_iter().chain(self.bytes.map(|bytes| bytes.to_string())).collect();
        write!(formatter, "{}={}", self.pattern, if limits.is_empty() { "ever".to_owned() } else { limits.join("+") })
    }
}

impl RetentionRules {
    pub fn of(&self, topic: &str) -> Option<&RetentionRule> {
        self.0.iter().find(|rule| fits(rule.pattern.as_bytes(), topic.as_bytes()))
    }

    /// Whether nothing is ever deleted.
    pub fn is_empty(&self) -> bool {
        self.0.iter().all(|rule| rule.age.is_none() && rule.bytes.is_none())
    }
}

/// Time limits come from the topic's own rule, else from the setting; the byte budget always from the setting.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Keeping {
    pub topics: TopicRules,
    pub setting: RetentionRules,
}

impl Keeping {
    pub fn of(&self, topic: &str) -> Option<RetentionRule> {
        let setting = self.setting.of(topic);
        let own = self.topics.of(topic).and_then(|rule| Some((rule.pattern.as_str(), rule.retention?)));
        own.map_or_else(
            || setting.cloned(),
            |(pattern, seconds)| {
                let (pattern, age) = (pattern.to_owned(), Some(Duration::from_secs(seconds)));
                Some(RetentionRule { pattern, age, bytes: setting.and_then(|rule| rule.bytes) })
            },
        )
    }

    pub fn is_empty(&self) -> bool {
        self.setting.is_empty() && self.topics.0.iter().all(|rule| rule.retention.is_none())
    }
}

/// `label (19) || topic id (16) || topic (2 + n) || rule (2 + n) || first seq (8) || last seq (8) || count (8) ||
/// bytes (8) || rolling (32)`, big endian.
/// The rolling hash begins with SM3(`AuthROS/retained/1` || domain || owner || topic id) and continues with SM3(rolling
/// || D) for each record's digest D in the order of capture.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RetentionReport {
    pub topic_id: TopicId,
    pub topic: String,
    pub rule: String,
    pub first_seq: u64,
    pub last_seq: u64,
    pub count: u64,
    /// The bytes of their messages.
    pub bytes: u64,
    pub rolling: Digest,
}

crate::layout!(RetentionReport {
    topic_id: "topic id",
    topic: "topic",
    rule: "rule",
    first_seq: "first seq",
    last_seq: "last seq",
    count: "count",
    bytes: "bytes",
    rolling: "rolling hash",
});
crate::body!(RetentionReport behind b"AuthROS/retention/1", "label");

// The ring that a robot keeps on its disk.

/// How much a ring keeps; whatever is reached first counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RingLimits {
    /// For this long after capture, at least a second.
    pub time: Duration,
    /// This many bytes on the disk, at least [`Self::LEAST`].
    pub bytes: u64,
}

impl RingLimits {
    pub const LEAST: u64 = 1 << 20;
}

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("'{0}' does not limit a ring; write a time from 1s on and a size from 1MiB on, as \"5m, 500MiB\"")]
pub struct RingLimitsError(String);

impl FromStr for RingLimits {
    type Err = RingLimitsError;

    fn from_str(text: &str) -> Result<Self, RingLimitsError> {
        let wrong = || RingLimitsError(clean(text, 60));
        let (time, bytes) = text.split_once([',', '+']).ok_or_else(wrong)?;
        let time = time_span(time).ok().filter(|time| *time >= Duration::from_secs(1)).ok_or_else(wrong)?;
        let bytes: ByteSize = bytes.parse().map_err(|_| wrong())?;
        if bytes.0 < Self::LEAST {
            return Err(wrong());
        }
        Ok(Self { time, bytes: bytes.0 })
    }
}

impl fmt::Display for RingLimits {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}s, {}", self.time.as_secs(), ByteSize(self.bytes))
    }
}

#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct TopicPatterns(pub Vec<TopicPattern>);

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}; write patterns as [\"/camera/**\", \"/odom\"], or with commas between, at most {most}", most = TopicPatterns::MOST)]
pub struct TopicPatternsError(String);

impl TopicPatterns {
    pub const MOST: usize = 256;

    pub fn matches(&self, topic: &str) -> bool {
        self.0.iter().any(|pattern| pattern.matches(topic))
    }
}

impl FromStr for TopicPatterns {
    type Err = TopicPatternsError;

    /// As in TOML, or with commas between; no pattern contains a quote or a comma.
    fn from_str(text: &str) -> Result<Self, TopicPatternsError> {
        let inner = text.trim();
        let inner = inner.strip_prefix('[').and_then(|inner| inner.strip_suffix(']')).unwrap_or(inner);
        let parts = inner.split(',').map(|part| part.trim().trim_matches(['"', '\''])).filter(|part| !part.is_empty());
        let patterns: Result<Vec<TopicPattern>, _> = parts.map(str::parse).collect();
        let patterns =
            patterns.map_err(|error: crate::topic_rule::PatternError| TopicPatternsError(error.to_string()))?;
        if patterns.len() > Self::MOST {
            return Err(TopicPatternsError(format!("these are {}", counted(patterns.len() as u64, "pattern"))));
        }
        Ok(Self(patterns))
    }
}

impl fmt::Display for TopicPatterns {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let parts: Vec<&str> = self.0.iter().map(TopicPattern::as_str).collect();
        formatter.write_str(&parts.join(", "))
    }
}

/// A span of a robot's ring that its owner asks for.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RingSpan {
    /// Inclusive, by capture time.
    pub since: Timestamp,
    /// Exclusive.
    pub until: Timestamp,
    /// Empty = all topics.
    pub topics: TopicPatterns,
}

impl RingSpan {
    pub fn has(&self, topic: &str, captured_at: Timestamp) -> bool {
        (self.since..self.until).contains(&captured_at) && self.has_topic(topic)
    }

    pub fn has_topic(&self, topic: &str) -> bool {
        self.topics.0.is_empty() || self.topics.matches(topic)
    }

    /// Its encoding: `since (8) || until (8) || count (2) || patterns`, texts with their length (2) before them.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = (self.since, self.until).encoded();
        put_list::<u16>(&mut out, &self.topics.0, TopicPatterns::MOST);
        out
    }

    pub fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(bytes);
        let (since, until) = (Timestamp(reader.u64("since")?), Timestamp(reader.u64("until")?));
        if since >= until {
            return Err(WireError::Value("until"));
        }
        let topics = read_list::<u16, _>(&mut reader, 0..=TopicPatterns::MOST, ("pattern count", "pattern"))?;
        reader.end()?;
        Ok(Self { since, until, topics: TopicPatterns(topics) })
    }
}

// Incidents: spans of time and topics that an operator keeps together.

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("'{0}' is not a valid name; use 1 to 64 letters, digits, '.', '-' and '_', starting with a letter or a digit")]
pub struct IncidentNameError(String);

/// An incident's name, given by its owner: 1 to 64 ASCII letters, digits, `.`, `-` and `_`.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct IncidentName(String);
names! {
    IncidentName: |text| {
        let fits = |b: u8| b.is_ascii_alphanumeric() || b"._-".contains(&b);
        is_name(text, IncidentName::LONGEST, |b| b.is_ascii_alphanumeric(), fits)
    }, else IncidentNameError by |text| IncidentNameError(clean(text, IncidentName::LONGEST));
}
as_text!(IncidentName);

impl IncidentName {
    pub const LONGEST: usize = 64;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::TopicRule;
    use proptest::prelude::*;

    #[test]
    fn the_first_rule_that_fits_counts() {
        let rules: RetentionRules = "/tf=ever, /robot*/camera/**=7d+10GiB, /big=5MB, **=12h".parse().expect("rules");
        let of = |topic: &str| rules.of(topic).map(ToString::to_string);
        assert_eq!(of("/tf").as_deref(), Some("/tf=ever"));
        assert_eq!(of("/robot1/camera/a/b").as_deref(), Some("/robot*/camera/**=604800s+10737418240"));
        assert_eq!(of("/big").as_deref(), Some("/big=5000000"));
        assert_eq!(of("/robot1/x/camera/a").as_deref(), Some("**=43200s"));
        let one: RetentionRules = "/robot*/odom=1s".parse().expect("rules");
        assert!(one.of("/robot1/odom").is_some() && one.of("/robot/odom").is_some() && !one.is_empty());
        assert!(one.of("/robot1/a/odom").is_none() && one.of("/robot1/odom2").is_none() && one.of("x").is_none());
        assert!(
            RetentionRules::default().is_empty() && "/a=ever".parse::<RetentionRules>().expect("a rule").is_empty()
        );
        for bad in ["/a", "=1d", "/a=", "/a=1d+2d", "/a=x", "/a b=1d", "/a=-1d", "/a=99999w"] {
            let read = bad.parse::<RetentionRules>();
            assert!(read.is_err(), "{bad}: {read:?}");
        }
    }

    #[test]
    fn a_topics_own_rule_says_how_long_and_the_setting_how_much() {
        let rule = |pattern: &str, retention| TopicRule {
            pattern: pattern.parse().expect("a pattern"),
            line: 1,
            type_name: None,
            rate: None,
            every: None,
            tags: std::collections::BTreeMap::default(),
            retention,
        };
        let topics = |rules: Vec<TopicRule>| TopicRules(rules.into_iter().map(std::sync::Arc::new).collect());
        let own = topics(vec![rule("/robot?/odom", Some(60)), rule("/scan", None)]);
        let setting: RetentionRules = "/robot1/**=1h+1MiB, /scan=2h".parse().expect("rules");
        let keeping = Keeping { topics: own.clone(), setting };
        let of = |topic: &str| keeping.of(topic).map(|rule| rule.to_string());
        assert_eq!(of("/robot1/odom").as_deref(), Some("/robot?/odom=60s+1048576"));
        assert_eq!(of("/robot2/odom").as_deref(), Some("/robot?/odom=60s"));
        assert_eq!(of("/robot1/camera").as_deref(), Some("/robot1/**=3600s+1048576"));
        assert_eq!((of("/scan").as_deref(), of("/tf")), (Some("/scan=7200s"), None));
        assert!(!Keeping { topics: own, ..Keeping::default() }.is_empty());
        assert!(Keeping { topics: topics(vec![rule("/scan", None)]), ..Keeping::default() }.is_empty());
    }

    proptest! {
        #[test]
        fn patterns_without_stars_fit_themselves_alone(one in "/[a-c/]{0,8}", other in "/[a-c/]{0,8}") {
            prop_assert_eq!(fits(one.as_bytes(), other.as_bytes()), one == other);
            prop_assert!(fits(b"**", one.as_bytes()));
            let middle = [b"/**", &one.as_bytes()[1..]].concat();
            prop_assert!(fits(&middle, one.as_bytes()));
        }

        #[test]
        fn round_trip_and_every_cut_is_refused(topic in "/[a-z]{0,20}", rule in "[ -~]{0,20}", numbers: [u64; 4], rolling: [u8; 32], noise: Vec<u8>) {
            let [first_seq, last_seq, count, bytes] = numbers;
            let (topic_id, rolling) = (TopicId([3; 16]), Digest(rolling));
            let report = RetentionReport { topic_id, topic, rule, first_seq, last_seq, count, bytes, rolling };
            let encoded = report.encode();
            prop_assert_eq!(RetentionReport::parse(&encoded), Ok(report));
            prop_assert!((0..encoded.len()).all(|cut| RetentionReport::parse(&encoded[..cut]).is_err()));
            prop_assert!(RetentionReport::parse(&[encoded, vec![0]].concat()).is_err());
            let _ = RetentionReport::parse(&[&b"AuthROS/retention/1"[..], &noise].concat());
        }
    }
}

#[cfg(test)]
mod disk_ring_tests {
    use super::*;

    #[test]
    fn limits_are_a_time_and_a_size() {
        let five = RingLimits { time: Duration::from_secs(300), bytes: 500 << 20 };
        for text in ["5m, 500 MiB", "300s,524288000", "5m+500MiB"] {
            assert_eq!(text.parse(), Ok(five), "{text}");
        }
        assert_eq!(five.to_string().parse(), Ok(five));
        for bad in ["", "5m", "500MiB", "500MiB, 5m", "0s, 5MiB", "5m, 1KiB", "5m, 5m", "5m, 5MiB, 5MiB"] {
            assert!(bad.parse::<RingLimits>().is_err(), "{bad}");
        }
    }

    #[test]
    fn patterns_are_read_from_a_list_and_from_a_variable() {
        let both: TopicPatterns = "[\"/camera/**\", '/odom']".parse().expect("a list");
        assert_eq!("/camera/**, /odom".parse(), Ok(both.clone()));
        assert!(both.matches("/camera/front/image") && both.matches("/odom") && !both.matches("/odom2"));
        assert_eq!("[]".parse(), Ok(TopicPatterns::default()));
        let many = vec!["/a"; 257].join(",");
        for bad in ["odom", "/a b", "[[\"/a\"]]", many.as_str()] {
            assert!(bad.parse::<TopicPatterns>().is_err(), "{bad}");
        }
    }

    #[test]
    fn a_span_is_read_as_written_and_nothing_else_is() {
        let topics: TopicPatterns = "/a,/b/**".parse().expect("patterns");
        let span = RingSpan { since: Timestamp(5), until: Timestamp(9), topics };
        let bytes = span.encode();
        // By hand: two times, two patterns of two and five letters with their lengths.
        assert_eq!(bytes, *b"\0\0\0\0\0\0\0\x05\0\0\0\0\0\0\0\x09\0\x02\0\x02/a\0\x05/b/**");
        assert_eq!(RingSpan::parse(&bytes), Ok(span.clone()));
        let longer = [&bytes[..], &[0]].concat();
        for wrong in (0..bytes.len()).map(|cut| &bytes[..cut]).chain([&longer[..]]) {
            assert!(RingSpan::parse(wrong).is_err());
        }
        let backwards = RingSpan { until: Timestamp(5), ..span.clone() };
        assert!(RingSpan::parse(&backwards.encode()).is_err());
        assert!(span.has("/a", Timestamp(5)) && !span.has("/a", Timestamp(9)) && !span.has("/c", Timestamp(6)));
        assert!(RingSpan { topics: TopicPatterns::default(), ..span }.has("/c", Timestamp(6)));
    }
}

#[cfg(test)]
mod incident_tests {
    use super::*;

    #[test]
    fn a_name_is_short_and_plain_or_it_is_refused_with_its_text_cleaned() {
        let long = "a".repeat(64);
        for good in ["crash", "2026-11-21_bay.3", long.as_str()] {
            let name: IncidentName = good.parse().expect(good);
            assert_eq!((name.as_str(), name.to_string()), (good, good.to_owned()));
        }
        let longer = "a".repeat(65);
        for bad in ["", "-a", ".a", "a b", "a/b", "ä", "a\u{1b}[2J", "a:b", "a\0", longer.as_str()] {
            let refused = bad.parse::<IncidentName>().expect_err(bad).to_string();
            assert!(!refused.contains(['\u{1b}', '\0']), "{refused:?}");
        }
        assert!(serde_json::from_str::<IncidentName>("\"../x\"").is_err());
    }
}
