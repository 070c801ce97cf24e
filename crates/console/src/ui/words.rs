//! Numbers, sizes and times in words; wrapping.

use unicode_width::UnicodeWidthStr;

use crate::model::Timestamp;
pub use crate::model::grouped as count;

/// `20.0`, or `-`.
pub fn rate(rate: Option<f64>) -> String {
    rate.map_or_else(|| "-".to_owned(), |rate| format!("{rate:.1}"))
}

/// kB/s, or `-`.
pub fn kilobytes(bytes: Option<f64>) -> String {
    rate(bytes.map(|bytes| bytes / 1000.0))
}

/// `712 B`, `58.2 kB`, `1.3 MB`.
pub fn size(bytes: u64) -> String {
    let tenths = |unit: u64| format!("{}.{}", bytes / unit, bytes % unit * 10 / unit);
    match bytes {
        0..1_000 => format!("{bytes} B"),
        1_000..1_000_000 => format!("{} kB", tenths(1_000)),
        _ => format!("{} MB", tenths(1_000_000)),
    }
}

/// `once`, `3 times`.
pub fn times(number: u64) -> String {
    if number == 1 { "once".to_owned() } else { format!("{} times", count(number)) }
}

/// `2026-11-22T03:43:21Z`.
pub fn second(at: Timestamp) -> String {
    Timestamp::from_seconds(at.seconds()).to_string()
}

/// `4 s`, `12 min`, `3 h`, `9 d`.
pub fn age(then: Timestamp, now: Timestamp) -> String {
    let seconds = now.0.saturating_sub(then.0) / 1_000_000_000;
    match seconds {
        0..60 => format!("{seconds} s"),
        60..3_600 => format!("{} min", seconds / 60),
        3_600..86_400 => format!("{} h", seconds / 3_600),
        _ => format!("{} d", seconds / 86_400),
    }
}

/// `0.42 s`, `12 s`, `3.1 min`.
pub fn seconds(seconds: f64) -> String {
    match seconds {
        under if under < 10.0 => format!("{under:.2} s"),
        under if under < 120.0 => format!("{under:.0} s"),
        long => format!("{:.1} min", long / 60.0),
    }
}

/// Wraps at spaces if there are any.
pub fn wrap(text: &str, width: u16) -> Vec<String> {
    let width = usize::from(width.max(1));
    let indent = text.len() - text.trim_start_matches(' ').len();
    if indent > 0 && indent < width {
        let lines = wrap(&text[indent..], u16::try_from(width - indent).unwrap_or(1));
        return lines.into_iter().map(|line| format!("{}{line}", " ".repeat(indent))).collect();
    }
    let mut lines = vec![String::new()];
    for word in text.split(' ') {
        let last = lines.last().map_or(0, |line| line.width());
        if last > 0 && last + 1 + word.width() > width {
            lines.push(String::new());
        } else if last > 0 {
            append_word(&mut lines, " ", width);
        }
        append_word(&mut lines, word, width);
    }
    lines
}

fn append_word(lines: &mut Vec<String>, word: &str, width: usize) {
    for character in word.chars() {
        let full = lines.last().is_none_or(|line| line.width() + 1 > width);
        if full {
            lines.push(String::new());
        }
        if let Some(line) = lines.last_mut() {
            line.push(character);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers() {
        assert_eq!([size(712), size(58_234), size(1_300_000)], ["712 B", "58.2 kB", "1.3 MB"]);
        assert_eq!(rate(None), "-");
        let at = Timestamp::from_seconds;
        assert_eq!([age(at(96), at(100)), age(at(0), at(7_200)), age(at(9), at(1))], ["4 s", "2 h", "0 s"]);
        assert_eq!([seconds(0.416), seconds(12.3), seconds(186.0)], ["0.42 s", "12 s", "3.1 min"]);
    }

    #[test]
    fn lines_break_at_spaces_and_long_words_anywhere() {
        assert_eq!(wrap("what was read cannot be recalled", 12), ["what was", "read cannot", "be recalled"]);
        assert_eq!(wrap("0123456789", 4), ["0123", "4567", "89"]);
        assert_eq!(wrap("", 4), [""]);
        assert_eq!(wrap("  nobody but you", 9), ["  nobody", "  but you"]);
    }
}
