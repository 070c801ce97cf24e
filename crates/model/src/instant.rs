//! Points in time, nanoseconds since the Unix epoch, UTC.

use std::fmt;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Deserializer, Serialize, Serializer};
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

/// Nanoseconds since 1970-01-01T00:00:00Z. Written as RFC 3339 in JSON.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Timestamp(pub u64);

impl Timestamp {
    /// The system clock's current time.
    pub fn now() -> Self {
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or(Duration::ZERO);
        Self(u64::try_from(since.as_nanos()).unwrap_or(u64::MAX))
    }

    /// From whole seconds.
    pub fn from_seconds(seconds: u64) -> Self {
        Self(seconds.saturating_mul(1_000_000_000))
    }

    /// Whole seconds.
    pub fn seconds(self) -> u64 {
        self.0 / 1_000_000_000
    }

    /// This moment, or the next whole second if it has a fraction: ends on the chain are whole seconds.
    pub fn to_whole_second(self) -> Self {
        Self::from_seconds(self.0.div_ceil(1_000_000_000))
    }

    /// The end of a right that lasts `length` from this moment, rounded up to the whole second.
    pub fn end_after(self, length: Duration) -> Self {
        let length = u64::try_from(length.as_nanos()).unwrap_or(u64::MAX);
        Self(self.0.saturating_add(length)).to_whole_second()
    }

    /// `HH:MM:SS`, UTC, for narrow columns.
    pub fn clock(self) -> String {
        let day = self.seconds() % 86_400;
        format!("{:02}:{:02}:{:02}", day / 3600, day / 60 % 60, day % 60)
    }
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
        assert_eq!(Timestamp(whole.0 + 1).end_after(Duration::from_millis(1)), Timestamp::from_seconds(1_700_000_001));
        assert_eq!(whole.end_after(Duration::from_secs(30)), Timestamp::from_seconds(1_700_000_030));
        assert_eq!(Timestamp(u64::MAX).end_after(Duration::MAX).0, u64::MAX);
    }
}
