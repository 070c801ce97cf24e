//! The ring that a robot keeps on its disk: how much of it, of which topics, and the
//! spans that its owner asks for.

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::wire::{Reader, WireError, put_text};
use super::{ByteSize, Timestamp, TopicPattern, clean, time_span};

/// How much a ring keeps; whatever is reached first counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RingLimits {
    /// For this long after capture, at least a second.
    pub time: Duration,
    /// This many bytes on the disk, at least [`Self::LEAST`].
    pub bytes: u64,
}

impl RingLimits {
    /// The smallest ring, bytes.
    pub const LEAST: u64 = 1 << 20;
}

/// Why a text is not the limits of a ring.
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

/// Patterns of topics, in the order written.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct TopicPatterns(pub Vec<TopicPattern>);

/// Why a text is not a list of patterns.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}; write patterns as [\"/camera/**\", \"/odom\"], or with commas between, at most {most}", most = TopicPatterns::MOST)]
pub struct TopicPatternsError(String);

impl TopicPatterns {
    /// The most patterns of a list.
    pub const MOST: usize = 256;

    /// Whether a topic matches one of them.
    pub fn matches(&self, topic: &str) -> bool {
        self.0.iter().any(|pattern| pattern.matches(topic))
    }
}

impl FromStr for TopicPatterns {
    type Err = TopicPatternsError;

    /// A list as TOML has it, or with commas between; no pattern has a quote or a comma in it.
    fn from_str(text: &str) -> Result<Self, TopicPatternsError> {
        let inner = text.trim();
        let inner = inner.strip_prefix('[').and_then(|inner| inner.strip_suffix(']')).unwrap_or(inner);
        let parts = inner.split(',').map(|part| part.trim().trim_matches(['"', '\''])).filter(|part| !part.is_empty());
        let patterns: Result<Vec<TopicPattern>, _> = parts.map(str::parse).collect();
        let patterns =
            patterns.map_err(|error: super::topic_rule::PatternError| TopicPatternsError(error.to_string()))?;
        if patterns.len() > Self::MOST {
            return Err(TopicPatternsError(format!("these are {} patterns", patterns.len())));
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
pub struct RingSpan {
    /// What was captured at this time or later,
    pub since: Timestamp,
    /// and before this time.
    pub until: Timestamp,
    /// Of topics that match one of these; none = of all.
    pub topics: TopicPatterns,
}

impl RingSpan {
    /// Whether a message of this topic, captured then, is asked for.
    pub fn has(&self, topic: &str, captured_at: Timestamp) -> bool {
        (self.since..self.until).contains(&captured_at) && self.has_topic(topic)
    }

    /// Whether messages of this topic are asked for.
    pub fn has_topic(&self, topic: &str) -> bool {
        self.topics.0.is_empty() || self.topics.matches(topic)
    }

    /// Its encoding: `since (8) || until (8) || count (2) || patterns`, texts with their length (2) before them.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = [self.since.0.to_be_bytes(), self.until.0.to_be_bytes()].concat();
        let count = self.topics.0.len().min(TopicPatterns::MOST);
        out.extend_from_slice(&u16::try_from(count).unwrap_or(0).to_be_bytes());
        self.topics.0.iter().take(count).for_each(|pattern| put_text(&mut out, pattern.as_str()));
        out
    }

    /// From its encoding.
    ///
    /// # Errors
    /// [`WireError`] if it is malformed, or the span is empty.
    pub fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(bytes);
        let (since, until) = (Timestamp(reader.u64("since")?), Timestamp(reader.u64("until")?));
        if since >= until {
            return Err(WireError::Value("until"));
        }
        let count = usize::from(reader.u16("pattern count")?);
        if count > TopicPatterns::MOST {
            return Err(WireError::Value("pattern count"));
        }
        let pattern = |_| reader.text("pattern")?.parse().map_err(|_| WireError::Value("pattern"));
        let topics = (0..count).map(pattern).collect::<Result<_, WireError>>()?;
        reader.end()?;
        Ok(Self { since, until, topics: TopicPatterns(topics) })
    }
}

#[cfg(test)]
mod tests {
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
