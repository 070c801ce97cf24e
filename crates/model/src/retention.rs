//! How long, and how much of, each topic's ciphertext is kept; and the body of the record that is anchored before any
//! of it is deleted.

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use super::span::time_span;
use super::topic_rule::{TopicRules, fits};
use super::wire::{Reader, WireError, put_text};
use super::{ByteSize, Digest, TopicId, clean};

/// First bytes of the body.
const LABEL: [u8; 19] = *b"AuthROS/retention/1";
/// The most rules.
const MOST_RULES: usize = 100;

/// What is kept of topics that match a pattern.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RetentionRule {
    /// `*` matches any characters but `/`, `**` any characters.
    pattern: String,
    /// For this long after capture.
    pub age: Option<Duration>,
    /// The newest messages of each topic, up to this many bytes.
    pub bytes: Option<u64>,
}

/// Rules in order; the first whose pattern matches a topic applies. Without one everything is kept.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct RetentionRules(Vec<RetentionRule>);

/// Why a text is not a list of rules.
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
    /// The rule for a topic.
    pub fn of(&self, topic: &str) -> Option<&RetentionRule> {
        self.0.iter().find(|rule| fits(rule.pattern.as_bytes(), topic.as_bytes()))
    }

    /// Whether nothing is ever deleted.
    pub fn is_empty(&self) -> bool {
        self.0.iter().all(|rule| rule.age.is_none() && rule.bytes.is_none())
    }
}

/// What is kept of each topic: by time as its own rule says, otherwise as the setting says; a budget of bytes always
/// comes from the setting.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Keeping {
    topics: TopicRules,
    setting: RetentionRules,
}

impl Keeping {
    /// From the rules of topics and the setting.
    pub fn new(topics: TopicRules, setting: RetentionRules) -> Self {
        Self { topics, setting }
    }

    /// The rule for a topic.
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

    /// Whether nothing is ever deleted.
    pub fn is_empty(&self) -> bool {
        self.setting.is_empty() && self.topics.0.iter().all(|rule| rule.retention.is_none())
    }
}

/// `label (19) || topic id (16) || topic (2 + n) || rule (2 + n) || first seq (8) || last seq (8) || count (8) ||
/// bytes (8) || rolling (32)`, big endian.
///
/// The rolling hash begins with SM3(`AuthROS/retained/1` || domain || owner || topic id) and continues with SM3(rolling
/// || D) for each record's digest D in the order of capture.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RetentionReport {
    /// The topic's pseudonym, as in its records.
    pub topic_id: TopicId,
    /// Its name.
    pub topic: String,
    /// The rule that requires it.
    pub rule: String,
    /// The lowest sequence number deleted.
    pub first_seq: u64,
    /// The highest one.
    pub last_seq: u64,
    /// The number of records whose ciphertext is deleted.
    pub count: u64,
    /// The bytes of their messages.
    pub bytes: u64,
    /// The rolling hash over their digests.
    pub rolling: Digest,
}

impl RetentionReport {
    /// Encodes the bytes to be sealed.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = [&LABEL[..], &self.topic_id.0].concat();
        put_text(&mut out, &self.topic);
        put_text(&mut out, &self.rule);
        for number in [self.first_seq, self.last_seq, self.count, self.bytes] {
            out.extend_from_slice(&number.to_be_bytes());
        }
        out.extend_from_slice(&self.rolling.0);
        out
    }

    /// Parses a whole body.
    ///
    /// # Errors
    /// [`WireError`] if the bytes are not exactly one report.
    pub fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(bytes);
        if reader.array::<19>("label")? != LABEL {
            return Err(WireError::Value("label"));
        }
        let report = Self {
            topic_id: TopicId(reader.array("topic id")?),
            topic: reader.text("topic")?,
            rule: reader.text("rule")?,
            first_seq: reader.u64("first seq")?,
            last_seq: reader.u64("last seq")?,
            count: reader.u64("count")?,
            bytes: reader.u64("bytes")?,
            rolling: Digest(reader.array("rolling hash")?),
        };
        reader.end()?;
        Ok(report)
    }
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
        let keeping = Keeping::new(own.clone(), setting);
        let of = |topic: &str| keeping.of(topic).map(|rule| rule.to_string());
        assert_eq!(of("/robot1/odom").as_deref(), Some("/robot?/odom=60s+1048576"));
        assert_eq!(of("/robot2/odom").as_deref(), Some("/robot?/odom=60s"));
        assert_eq!(of("/robot1/camera").as_deref(), Some("/robot1/**=3600s+1048576"));
        assert_eq!((of("/scan").as_deref(), of("/tf")), (Some("/scan=7200s"), None));
        assert!(!Keeping::new(own, RetentionRules::default()).is_empty());
        assert!(Keeping::new(topics(vec![rule("/scan", None)]), RetentionRules::default()).is_empty());
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
            let _ = RetentionReport::parse(&[&LABEL[..], &noise].concat());
        }
    }
}
