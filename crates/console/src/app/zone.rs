//! The operator's own time beside UTC: which zone that is comes from the caller.

use jiff::tz::TimeZone;

use crate::model::Timestamp;

/// A time zone, or none.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Zone(Option<TimeZone>);

impl Zone {
    /// This zone.
    pub fn new(zone: TimeZone) -> Self {
        Self(Some(zone))
    }

    /// `15:04:05` there, at that moment.
    pub fn clock(&self, moment: Timestamp) -> Option<String> {
        let zone = self.0.as_ref()?;
        let nanoseconds = i128::from(moment.0);
        let there = jiff::Timestamp::from_nanosecond(nanoseconds).ok()?.to_zoned(zone.clone());
        Some(format!("{:02}:{:02}:{:02}", there.hour(), there.minute(), there.second()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_zone_has_its_own_clock() {
        let zone = Zone::new(TimeZone::fixed(jiff::tz::offset(8)));
        assert_eq!(zone.clock(Timestamp::from_seconds(1_700_000_000)).as_deref(), Some("06:13:20"));
        assert_eq!(Zone::default().clock(Timestamp::from_seconds(1)), None);
    }
}
