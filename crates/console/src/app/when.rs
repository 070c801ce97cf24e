//! Parsing a grant's end as a person writes it: `30d`, `12h`, `2036-12-31`.

use crate::model::{Timestamp, positive_span};

/// The moment `text` means, counted from `now` and rounded up to the whole second; `None` in the answer = no end
/// (empty text).
///
/// # Errors
/// What to write instead.
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

/// Midnight UTC at the beginning of the day.
fn date(text: &str) -> Option<Timestamp> {
    serde_json::from_value(serde_json::Value::String(format!("{text}T00:00:00Z"))).ok()
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
