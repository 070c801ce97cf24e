//! The only parser of time spans as people write them: `500ms`, `10s`, `45m`, `12h`, `30d`, `2w`.

use std::time::Duration;

use crate::display::clean;

/// The longest time span, seconds: a hundred years.
const LONGEST: u64 = 100 * 366 * 86_400;

/// The text is not a time span.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("'{0}' is not a duration; use a number with ms, s, m, h, d or w, such as 10s, 30d or 2w")]
pub struct SpanError(String);

/// Parses a number followed by its unit; at most a hundred years, 0 allowed.
///
/// # Errors
/// [`SpanError`] says how to write it.
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

/// Like [`time_span`], but refuses 0, for uses where nothing could happen within it.
///
/// # Errors
/// [`SpanError`] says how to write it.
pub fn positive_span(text: &str) -> Result<Duration, SpanError> {
    time_span(text).ok().filter(|span| !span.is_zero()).ok_or_else(|| SpanError(clean(text, 40)))
}

#[cfg(test)]
mod tests {
    use super::*;

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
