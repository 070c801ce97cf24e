//! Amounts: moments and spans of time, sizes in bytes, money.

use std::fmt;
use std::str::FromStr;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

use crate::clean;

/// The longest time span, seconds: a hundred years.
const LONGEST: u64 = 100 * 366 * 86_400;

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("'{0}' is not a duration; use a number with ms, s, m, h, d or w, such as 10s, 30d or 2w")]
pub struct SpanError(String);

/// Parses a number followed by its unit; at most a hundred years, 0 allowed.
pub fn time_span(text: &str) -> Result<Duration, SpanError> {
    let wrong = || SpanError(clean(text, 40));
    let text = text.trim();
    let unit_at = text.find(|character: char| !character.is_ascii_digit()).ok_or_else(wrong)?;
    let (digits, unit) = text.split_at(unit_at);
    let factor = match unit {
        "ms" => 1,
        "s" => 1_000,
        "m" => 60_000,
        "h" => 3_600_000,
        "d" => 86_400_000,
        "w" => 604_800_000,
        _ => return Err(wrong()),
    };
    let count: u64 = digits.parse().map_err(|_| wrong())?;
    let milliseconds = count.checked_mul(factor).filter(|length| *length <= LONGEST * 1_000);
    milliseconds.map(Duration::from_millis).ok_or_else(wrong)
}

/// Refuses 0, for uses where nothing could happen within it.
pub fn positive_span(text: &str) -> Result<Duration, SpanError> {
    time_span(text).ok().filter(|span| !span.is_zero()).ok_or_else(|| SpanError(clean(text, 40)))
}

// A number of bytes as people write it: `268435456`, `512 KiB`, `256MiB`, `1.5 GiB`, `10GB`.

/// Units by their suffix, longest first.
const UNITS: [(&str, u64); 9] = [
    ("KiB", 1 << 10),
    ("MiB", 1 << 20),
    ("GiB", 1 << 30),
    ("TiB", 1 << 40),
    ("KB", 1_000),
    ("MB", 1_000_000),
    ("GB", 1_000_000_000),
    ("TB", 1_000_000_000_000),
    ("B", 1),
];

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct ByteSize(pub u64);

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("'{0}' is not a size; give one such as 256MiB, 10GB or 1048576")]
pub struct ByteSizeError(String);

impl FromStr for ByteSize {
    type Err = ByteSizeError;

    fn from_str(text: &str) -> Result<Self, ByteSizeError> {
        let wrong = || ByteSizeError(clean(text, 40));
        let lower = text.trim().to_ascii_lowercase();
        let (number, unit) = UNITS
            .iter()
            .find_map(|(name, unit)| lower.strip_suffix(&name.to_ascii_lowercase()).map(|number| (number, *unit)))
            .unwrap_or((&lower, 1));
        let (whole, part) = number.trim_end().split_once('.').unwrap_or((number.trim_end(), ""));
        let digits = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
        if !digits(whole) || !part.is_empty() && (!digits(part) || part.len() > 6) || number.trim_end().ends_with('.') {
            return Err(wrong());
        }
        let whole: u64 = whole.parse().map_err(|_| wrong())?;
        let scale = 10u128.pow(u32::try_from(part.len()).unwrap_or(0));
        let part = part.parse::<u128>().unwrap_or(0) * u128::from(unit) / scale;
        let bytes = u128::from(whole) * u128::from(unit) + part;
        u64::try_from(bytes).ok().filter(|bytes| *bytes < 1 << 62).map(Self).ok_or_else(wrong)
    }
}

impl fmt::Display for ByteSize {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let fitting = UNITS[..4].iter().rev().find(|(_, unit)| self.0 >= *unit);
        let Some((name, unit)) = fitting else { return write!(formatter, "{} B", self.0) };
        let tenths = u128::from(self.0) * 10 / u128::from(*unit);
        match tenths % 10 {
            0 => write!(formatter, "{} {name}", tenths / 10),
            tenth => write!(formatter, "{}.{tenth} {name}", tenths / 10),
        }
    }
}

const GWEI: u128 = 1_000_000_000;
const ETHER: u128 = GWEI * GWEI;

/// A decimal string in JSON, whose numbers are too small; wei, gwei or ether for people, cut after six decimals.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Wei(pub u128);

impl fmt::Display for Wei {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (unit, word) = match self.0 {
            0..1_000_000 => return write!(f, "{} wei", self.0),
            1_000_000..1_000_000_000_000_000 => (GWEI, "gwei"),
            _ => (ETHER, "ether"),
        };
        let part = self.0 % unit / (unit / 1_000_000);
        let number = format!("{}.{part:06}", self.0 / unit);
        write!(f, "{} {word}", number.trim_end_matches('0').trim_end_matches('.'))
    }
}

impl Serialize for Wei {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(&self.0)
    }
}

impl<'de> Deserialize<'de> for Wei {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        text.parse().map(Self).map_err(|_| D::Error::custom("an amount in wei is a decimal number in quotes"))
    }
}

/// Nanoseconds since 1970-01-01T00:00:00Z. Written as RFC 3339 in JSON.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Timestamp(pub u64);

crate::layout!(Timestamp(0));

impl Timestamp {
    pub fn now() -> Self {
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or(Duration::ZERO);
        Self(u64::try_from(since.as_nanos()).unwrap_or(u64::MAX))
    }

    pub fn from_seconds(seconds: u64) -> Self {
        Self(seconds.saturating_mul(1_000_000_000))
    }

    /// The end of a span whose last moment this is; `None` after the last that the ledger holds (2^63 - 1).
    pub fn next(self) -> Option<Self> {
        self.0.checked_add(1).filter(|next| i64::try_from(*next).is_ok()).map(Self)
    }

    pub fn seconds(self) -> u64 {
        self.0 / 1_000_000_000
    }

    /// Rounded up: ends on the chain are whole seconds.
    pub fn to_whole_second(self) -> Self {
        Self::from_seconds(self.0.div_ceil(1_000_000_000))
    }

    /// With exactly three digits of its second, so that columns stand still: `2026-11-22T03:43:21.549Z`.
    pub fn in_milliseconds(self) -> String {
        let second = Self::from_seconds(self.seconds()).to_string();
        format!("{}.{:03}Z", second.trim_end_matches('Z'), self.0 / 1_000_000 % 1_000)
    }

    /// `2026-11-27 18:00:00 UTC`, for sentences.
    pub fn in_utc(self) -> String {
        Self::from_seconds(self.seconds()).to_string().replace('T', " ").replace('Z', " UTC")
    }

    /// `HH:MM:SS`, UTC, for narrow columns.
    pub fn clock(self) -> String {
        let day = self.seconds() % 86_400;
        format!("{:02}:{:02}:{:02}", day / 3600, day / 60 % 60, day % 60)
    }
}

/// A length in its largest fitting unit, rounded: `45 s`, `12 min`, `20 h`, `3 d`.
pub fn coarse(length: Duration) -> String {
    let seconds = length.as_secs();
    let (unit, word) = match seconds {
        0..120 => (1, "s"),
        120..7_170 => (60, "min"),
        7_170..171_000 => (3_600, "h"),
        _ => (86_400, "d"),
    };
    format!("{} {word}", seconds.saturating_add(unit / 2) / unit)
}

impl fmt::Display for Timestamp {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = OffsetDateTime::from_unix_timestamp_nanos(i128::from(self.0))
            .ok()
            .and_then(|moment| moment.format(&Rfc3339).ok())
            .unwrap_or_else(|| format!("{} ns", self.0));
        formatter.write_str(&text)
    }
}

impl Serialize for Timestamp {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for Timestamp {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        let moment = OffsetDateTime::parse(&text, &Rfc3339).map_err(serde::de::Error::custom)?;
        u64::try_from(moment.unix_timestamp_nanos()).map(Self).map_err(serde::de::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_length_is_told_in_its_largest_fitting_unit() {
        let cases = [(0, "0 s"), (119, "119 s"), (120, "2 min"), (7_169, "119 min"), (7_170, "2 h"), (170_999, "47 h")];
        for (seconds, text) in cases.into_iter().chain([(171_000, "2 d"), (259_168, "3 d")]) {
            assert_eq!(coarse(Duration::from_secs(seconds)), text);
        }
        assert!(coarse(Duration::MAX).ends_with(" d"));
    }

    #[test]
    fn moments_in_a_column_have_one_width() {
        for (nanoseconds, text) in [
            (0, "1970-01-01T00:00:00.000Z"),
            (1_700_000_000_123_456_789, "2023-11-14T22:13:20.123Z"),
            (1_700_000_000_999_999_999, "2023-11-14T22:13:20.999Z"),
            (1_700_000_000_040_000_000, "2023-11-14T22:13:20.040Z"),
        ] {
            assert_eq!(Timestamp(nanoseconds).in_milliseconds(), text);
        }
    }

    #[test]
    fn the_last_moment_of_the_ledger_has_none_after_it() {
        let last = i64::MAX.cast_unsigned();
        assert_eq!(Timestamp(last - 1).next(), Some(Timestamp(last)));
        assert_eq!((Timestamp(last).next(), Timestamp(u64::MAX).next()), (None, None));
    }

    #[test]
    fn every_unit_is_read() {
        let read = |text| time_span(text).map(|span| span.as_millis());
        let known = [
            ("0s", 0),
            ("500ms", 500),
            (" 10s ", 10_000),
            ("45m", 2_700_000),
            ("12h", 43_200_000),
            ("30d", 2_592_000_000),
            ("2w", 1_209_600_000),
            ("36600d", 3_162_240_000_000),
        ];
        for (text, milliseconds) in known {
            assert_eq!(read(text), Ok(milliseconds), "{text}");
        }
    }

    #[test]
    fn anything_else_says_how_to_write_it() {
        for text in ["", "d", "30", "-1d", "+1d", "1.5h", "1y", "36601d", "99999999999999999999d", "é", "3 d", "3D"] {
            let error = time_span(text).expect_err(text);
            assert!(error.to_string().contains("30d or 2w"), "{error}");
        }
        assert!(positive_span("0s").is_err() && positive_span("1ms").is_ok());
        assert!(!time_span("1\u{1b}[2J").expect_err("control").to_string().contains('\u{1b}'));
    }
}

#[cfg(test)]
mod byte_size_tests {
    use super::*;

    #[test]
    fn sizes_as_people_write_them() {
        let read = |text: &str| text.parse::<ByteSize>().map(|size| size.0).ok();
        assert_eq!(read("0"), Some(0));
        assert_eq!(
            (read("256MiB"), read("256 mib"), read("1.5 KiB")),
            (Some(268_435_456), Some(268_435_456), Some(1536))
        );
        assert_eq!((read("10GB"), read("12 b"), read("2TiB")), (Some(10_000_000_000), Some(12), Some(2 << 40)));
        for bad in ["", "MiB", "-1", "1.", "1.x MB", "1e9", "9999999999TiB", "10 XB", "1 2"] {
            assert_eq!(read(bad), None, "{bad}");
        }
        assert_eq!(ByteSize(268_435_456).to_string(), "256 MiB");
        assert_eq!((ByteSize(1536).to_string(), ByteSize(900).to_string()), ("1.5 KiB".into(), "900 B".into()));
    }
}

#[cfg(test)]
mod wei_tests {
    use super::*;

    #[test]
    fn amounts_have_the_unit_that_suits_them() {
        for (wei, text) in [
            (0, "0 wei"),
            (999_999, "999999 wei"),
            (1_000_000, "0.001 gwei"),
            (1_875_000_000, "1.875 gwei"),
            (100 * GWEI, "100 gwei"),
            (2 * ETHER / 1_000, "0.002 ether"),
            (5 * ETHER + ETHER / 2, "5.5 ether"),
            (100 * ETHER, "100 ether"),
            (u128::MAX, "340282366920938463463.374607 ether"),
        ] {
            assert_eq!(Wei(wei).to_string(), text);
            let json = serde_json::to_string(&Wei(wei)).expect("json");
            assert_eq!(
                (json.as_str(), serde_json::from_str(&json).ok()),
                (format!("\"{wei}\"").as_str(), Some(Wei(wei)))
            );
        }
        assert!(serde_json::from_str::<Wei>("\"-1\"").is_err());
    }
}

#[cfg(test)]
mod instant_tests {
    use super::*;

    #[test]
    fn rfc3339_round_trip() {
        let moment = Timestamp(1_700_000_000_123_456_789);
        assert_eq!(moment.to_string(), "2023-11-14T22:13:20.123456789Z");
        let json = serde_json::to_string(&moment).expect("json");
        assert_eq!(serde_json::from_str::<Timestamp>(&json).expect("back"), moment);
        assert_eq!(moment.clock(), "22:13:20");
    }

    #[test]
    fn ends_are_rounded_up_to_the_second() {
        let whole = Timestamp::from_seconds(1_700_000_000);
        assert_eq!(whole.to_whole_second(), whole);
        for fraction in [1, 39_050_923, 999_999_999] {
            assert_eq!(Timestamp(whole.0 + fraction).to_whole_second(), Timestamp::from_seconds(1_700_000_001));
        }
    }
}
