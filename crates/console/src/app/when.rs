//! Times: a grant's end as typed (`30d`, `2036-12-31`), the operator's clock, countdowns of parts.

use jiff::tz::TimeZone;

use super::State;
use crate::model::{Timestamp, positive_span};
use crate::service::reply::PartHealth;

/// Counts from `now`, rounded up to the whole second; empty text = no end.
pub fn expiry(text: &str, now: Timestamp) -> Result<Option<Timestamp>, String> {
    let text = text.trim();
    if text.is_empty() || text == "never" {
        return Ok(None);
    }
    let moment = positive_span(text).ok().map(|span| now.end_after(span));
    let moment = moment
        .or_else(|| date(text))
        .ok_or("enter a duration (45m, 12h, 30d) or a date (2036-12-31), or leave it empty")?;
    if moment <= now { Err("that time has passed; enter a later one".to_owned()) } else { Ok(Some(moment)) }
}

/// Midnight UTC.
fn date(text: &str) -> Option<Timestamp> {
    serde_json::from_value(serde_json::Value::String(format!("{text}T00:00:00Z"))).ok()
}

#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Zone(Option<TimeZone>);

impl Zone {
    pub fn new(zone: TimeZone) -> Self {
        Self(Some(zone))
    }

    /// `15:04:05`.
    pub fn clock(&self, moment: Timestamp) -> Option<String> {
        let zone = self.0.as_ref()?;
        let nanoseconds = i128::from(moment.0);
        let there = jiff::Timestamp::from_nanosecond(nanoseconds).ok()?.to_zoned(zone.clone());
        Some(format!("{:02}:{:02}:{:02}", there.hour(), there.minute(), there.second()))
    }
}

/// A moment as its reader has it, then in UTC: `18:00:41 (17:00:41 UTC)`, with the day unless that is today.
pub fn both(state: &State, moment: Timestamp) -> String {
    let zone = state.settings.zone.0.clone().unwrap_or(TimeZone::UTC);
    let there = |zone: TimeZone, at: Timestamp| {
        let at = jiff::Timestamp::from_nanosecond(i128::from(at.0)).ok()?;
        Some(at.to_zoned(zone))
    };
    let written = |zone: &TimeZone| {
        let (at, now) = (there(zone.clone(), moment)?, there(zone.clone(), state.now)?);
        let form = if at.date() == now.date() { "%H:%M:%S" } else { "%Y-%m-%d %H:%M:%S" };
        Some(at.strftime(form).to_string())
    };
    let utc = written(&TimeZone::UTC).unwrap_or_else(|| moment.to_string());
    match written(&zone).filter(|local| *local != utc) {
        Some(local) => format!("{local} ({utc} UTC)"),
        None => format!("{utc} UTC"),
    }
}

const SECOND: u64 = 1_000_000_000;
const BEGINS: &str = "retry in ";

/// `None` = no countdown on screen.
pub fn moves_at(state: &State) -> Option<Timestamp> {
    let parts = state.site.iter().flat_map(|site| &site.health);
    let gone = gone(state);
    let goes_on = parts.filter_map(|part| part.retry).any(|seconds| seconds > gone + 1);
    (goes_on && !state.is_frozen()).then(|| Timestamp(state.site_at.0.saturating_add((gone + 1) * SECOND)))
}

/// The last second stays until the site reports the attempt.
pub fn tick(state: &mut State) {
    let gone = gone(state);
    if state.is_frozen() {
        return;
    }
    for part in state.site.iter_mut().flat_map(|site| &mut site.health) {
        if let Some(text) = said(part, gone) {
            part.text = text;
        }
    }
}

fn said(part: &PartHealth, gone: u64) -> Option<String> {
    let (seconds, after) = (part.retry?, part.text.strip_prefix(BEGINS)?.split_once(' ')?.1);
    Some(format!("{BEGINS}{} {after}", seconds.saturating_sub(gone).max(1)))
}

/// Whole seconds since the site's answer.
fn gone(state: &State) -> u64 {
    state.now.0.saturating_sub(state.site_at.0) / SECOND
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spans_and_dates() {
        let now = Timestamp::from_seconds(1_700_000_000);
        assert_eq!(expiry("", now), Ok(None));
        assert_eq!(expiry(" 30d ", now), Ok(Some(Timestamp::from_seconds(1_700_000_000 + 30 * 86_400))));
        let later = Timestamp(now.0 + 39_050_923);
        assert_eq!(expiry("30d", later), Ok(Some(Timestamp::from_seconds(1_700_000_001 + 30 * 86_400))));
        assert_eq!(expiry("2023-11-16", now), Ok(Some(Timestamp::from_seconds(1_700_092_800))));
        for bad in ["2020-01-01", "d", "0d", "-1d", "12", "99999999999999999999d", "é", "soon"] {
            assert!(expiry(bad, now).is_err(), "{bad}");
        }
    }
}

#[cfg(test)]
mod zone_tests {
    use super::*;

    #[test]
    fn a_moment_is_told_in_both_times_with_its_day_unless_that_is_today() {
        let mut state = State::new(crate::app::Settings::default());
        // 2023-11-14 22:13:20 UTC.
        state.now = Timestamp::from_seconds(1_700_000_000);
        let at = |seconds: u64| Timestamp::from_seconds(1_700_000_000 - seconds);
        assert_eq!(both(&state, at(20)), "22:13:00 UTC");
        assert_eq!(both(&state, at(86_400)), "2023-11-13 22:13:20 UTC");
        state.settings.zone = Zone::new(TimeZone::fixed(jiff::tz::offset(1)));
        assert_eq!(both(&state, at(20)), "23:13:00 (22:13:00 UTC)");
        assert_eq!(both(&state, at(86_400)), "2023-11-13 23:13:20 (2023-11-13 22:13:20 UTC)");
        // Today there, yesterday in UTC.
        state.settings.zone = Zone::new(TimeZone::fixed(jiff::tz::offset(8)));
        assert_eq!(both(&state, at(0)), "06:13:20 (22:13:20 UTC)");
    }

    #[test]
    fn a_zone_has_its_own_clock() {
        let zone = Zone::new(TimeZone::fixed(jiff::tz::offset(8)));
        assert_eq!(zone.clock(Timestamp::from_seconds(1_700_000_000)).as_deref(), Some("06:13:20"));
        assert_eq!(Zone::default().clock(Timestamp::from_seconds(1)), None);
    }
}
