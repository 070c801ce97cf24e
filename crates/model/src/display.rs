//! The only sanitiser: every untrusted text passes through it before screen, log or JSON.

use std::borrow::Cow;
use std::cmp::Ordering;

use unicode_width::UnicodeWidthChar;

/// The most consecutive combining marks kept; more would only pile up over other cells.
const MOST_MARKS: usize = 4;

/// At most `width` characters (an ellipsis marks truncation), safe to show. Removed characters become `�`, so that a
/// hostile name cannot pose as a clean one.
pub fn clean(text: &str, width: usize) -> String {
    let mut out = String::with_capacity(text.len().min(width.saturating_mul(4)));
    for (count, (character, shown)) in judged(text).enumerate() {
        if count == width {
            out.pop();
            out.push('…');
            break;
        }
        out.push(if shown { character } else { '\u{fffd}' });
    }
    out
}

/// JSON of the same meaning that is safe on a terminal: characters that must not be shown are `\u` escapes.
pub fn spelt_out(json: &str) -> Cow<'_, str> {
    if json.bytes().all(|byte| matches!(byte, b' '..=b'~')) {
        return Cow::Borrowed(json);
    }
    let mut out = String::with_capacity(json.len() + 16);
    for (character, shown) in judged(json) {
        if shown {
            out.push(character);
        } else {
            out.extend(character.encode_utf16(&mut [0; 2]).iter().map(|unit| format!("\\u{unit:04x}")));
        }
    }
    Cow::Owned(out)
}

/// Each character, with whether it may be shown.
fn judged(text: &str) -> impl Iterator<Item = (char, bool)> {
    let mut marks = 0;
    text.chars().map(move |character| {
        marks = if is_mark(character) { marks + 1 } else { 0 };
        (character, is_shown(character) && marks <= MOST_MARKS)
    })
}

/// A URL without user, password and path, which often holds a key; URLs of files and databases keep their path.
pub fn without_secrets(url: &str) -> String {
    let Some((scheme, rest)) = url.split_once("://") else { return url.to_owned() };
    let is_word = scheme.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'+');
    if !is_word || scheme == "ipc" || scheme.starts_with("redis") {
        return match url.rsplit_once('@') {
            Some((_, rest)) => format!("{scheme}://…@{rest}"),
            None => url.to_owned(),
        };
    }
    let length = rest.find(['/', '?', '#', '\\']).unwrap_or(rest.len());
    let (authority, path) = rest.split_at(length);
    // With an @ behind it, this may be only the beginning of a password.
    if path.contains('@') {
        return format!("{scheme}://…");
    }
    let host = authority.rsplit_once('@').map_or_else(|| authority.to_owned(), |(_, host)| format!("…@{host}"));
    let path = if matches!(path, "" | "/") { path } else { "/…" };
    format!("{scheme}://{host}{path}")
}

/// For text that should be the URL or socket of a server: anything else is hidden.
pub fn address_without_secrets(text: &str) -> String {
    let is_address = text.contains("://") || text.starts_with('/') || text.starts_with("ipc:") || text.is_empty();
    if is_address { without_secrets(text) } else { "…".to_owned() }
}

/// `12,345`.
pub fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::with_capacity(digits.len() + digits.len() / 3);
    for (place, digit) in digits.char_indices() {
        if place > 0 && (digits.len() - place).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// `1 record`, `8,505 records`, `2 batches`, `2 epochs`.
pub fn counted(count: u64, one: &str) -> String {
    let ending = if one.ends_with('s') || one.ends_with("sh") || one.ends_with("tch") { "es" } else { "s" };
    format!("{} {one}{}", grouped(count), if count == 1 { "" } else { ending })
}

/// [`clean`] for each line of a longer text, keeping the line breaks.
pub fn clean_lines(text: &str, width: usize) -> String {
    text.lines().map(|line| clean(line, width)).collect::<Vec<_>>().join("\n")
}

fn is_mark(character: char) -> bool {
    matches!(character, '\u{300}'..='\u{36f}' | '\u{483}'..='\u{489}' | '\u{591}'..='\u{5bd}'
        | '\u{610}'..='\u{61a}' | '\u{64b}'..='\u{65f}' | '\u{e31}' | '\u{e34}'..='\u{e3a}'
        | '\u{e47}'..='\u{e4e}' | '\u{1ab0}'..='\u{1aff}' | '\u{1dc0}'..='\u{1dff}'
        | '\u{20d0}'..='\u{20ff}' | '\u{fe20}'..='\u{fe2f}')
}

/// Columns that a terminal needs for a cleaned text, which it places character by character.
pub fn columns(text: &str) -> usize {
    text.chars().filter_map(UnicodeWidthChar::width).sum()
}

/// Whether a character may be shown: not a control, not a bidirectional control, not invisible.
pub fn is_shown(character: char) -> bool {
    !(character.is_control()
        || matches!(character,
            '\u{ad}' | '\u{34f}' | '\u{61c}' | '\u{115f}' | '\u{1160}' | '\u{17b4}' | '\u{17b5}'
            | '\u{180b}'..='\u{180f}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}'
            | '\u{2060}'..='\u{206f}' | '\u{3164}' | '\u{fe00}'..='\u{fe0f}' | '\u{feff}' | '\u{ffa0}'
            | '\u{fff0}'..='\u{fffb}' | '\u{13430}'..='\u{1343f}' | '\u{1bca0}'..='\u{1bca3}'
            | '\u{1d173}'..='\u{1d17a}' | '\u{e0000}'..='\u{e0fff}'))
}

/// The order of names for people: digits by their number, so `scout-2` is before `scout-10`, all else as it is. The
/// topics of a robot stay together.
pub fn natural(one: &str, other: &str) -> Ordering {
    let (mut one, mut other) = (one.as_bytes(), other.as_bytes());
    loop {
        let (Some(first), Some(second)) = (one.first(), other.first()) else { return one.len().cmp(&other.len()) };
        let ((whole, digits), (other_whole, other_digits)) = (number(one), number(other));
        if whole > 0 && other_whole > 0 {
            let by_value = digits.len().cmp(&other_digits.len()).then_with(|| digits.cmp(other_digits));
            // Leading zeros decide last, but before what follows.
            match by_value.then(whole.cmp(&other_whole)) {
                Ordering::Equal => (one, other) = (rest(one, whole), rest(other, other_whole)),
                decided => return decided,
            }
        } else if first == second {
            (one, other) = (rest(one, 1), rest(other, 1));
        } else {
            return first.cmp(second);
        }
    }
}

fn rest(text: &[u8], from: usize) -> &[u8] {
    text.get(from..).unwrap_or_default()
}

/// The length of the number at the beginning, and its digits without leading zeros.
fn number(text: &[u8]) -> (usize, &[u8]) {
    let whole = text.iter().take_while(|byte| byte.is_ascii_digit()).count();
    let zeros = text.iter().take(whole).take_while(|byte| **byte == b'0').count();
    (whole, text.get(zeros..whole).unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_url_is_shown_without_what_may_be_secret() {
        for (url, shown) in [
            ("http://127.0.0.1:8545", "http://127.0.0.1:8545"),
            ("http://127.0.0.1:8545/", "http://127.0.0.1:8545/"),
            ("https://node.example/v3/SECRET", "https://node.example/…"),
            ("https://node.example?key=SECRET", "https://node.example/…"),
            ("wss://me:SECRET@node.example:1/x", "wss://…@node.example:1/…"),
            ("ws://me:SE@CRET@node.example", "ws://…@node.example"),
            ("http://me:1/SECRET@node.example", "http://…"),
            ("redis://me:SECRET@host:1/0", "redis://…@host:1/0"),
            ("redis+unix:///run/redis.sock", "redis+unix:///run/redis.sock"),
            ("/run/geth.ipc", "/run/geth.ipc"),
        ] {
            assert_eq!(
                (without_secrets(url), address_without_secrets(url)),
                (shown.to_owned(), shown.to_owned()),
                "{url}"
            );
        }
        assert_eq!(without_secrets("htps://node.example/SECRET"), "htps://node.example/…");
        assert_eq!(address_without_secrets("node.example/SECRET"), "…");
    }

    #[test]
    fn numbers_are_grouped_and_their_nouns_counted() {
        assert_eq!([0, 999, 1_000, 1_234_567].map(grouped), ["0", "999", "1,000", "1,234,567"]);
        assert_eq!([0, 1, 8_505].map(|count| counted(count, "record")), ["0 records", "1 record", "8,505 records"]);
        assert_eq!(["batch", "hash", "loss"].map(|one| counted(1, one)), ["1 batch", "1 hash", "1 loss"]);
        assert_eq!(["batch", "hash", "loss"].map(|one| counted(2, one)), ["2 batches", "2 hashes", "2 losses"]);
        assert_eq!(counted(2, "new epoch"), "2 new epochs");
    }

    #[test]
    fn names_are_in_the_order_of_their_numbers_and_a_robots_topics_stay_together() {
        let sorted = [
            "/a",
            "/robot1/a",
            "/robot1/b",
            "/robot01/a",
            "/robot01/b",
            "/robot2/a",
            "/robot10/a",
            "/robot10/a1",
            "/s",
            "scout-2",
            "scout-10",
            "scout-99999999999999999999",
            "scout-100000000000000000000",
        ];
        for (one, left) in sorted.iter().enumerate() {
            for (two, right) in sorted.iter().enumerate() {
                assert_eq!(natural(left, right), one.cmp(&two), "{left} {right}");
            }
        }
    }

    #[test]
    fn hostile_text_is_defused() {
        assert_eq!(clean("\u{1b}[2Jx", 80), "\u{fffd}[2Jx");
        assert_eq!(clean("a\u{202e}b\u{200b}c\u{9b}d", 80), "a\u{fffd}b\u{fffd}c\u{fffd}d");
        assert_eq!(clean("/robot1/odom", 80), "/robot1/odom");
        assert_eq!(clean("abcdef", 4), "abc…");
        assert_eq!(clean("abcd", 4), "abcd");
        assert_eq!(clean("机器人", 10), "机器人");
        assert_eq!(clean("\u{13430}\u{1bca0}", 80), "\u{fffd}\u{fffd}", "they join, break and hide without a column");
        for mark in ["\u{301}", "\u{488}", "\u{5b0}", "\u{64b}", "\u{e49}"] {
            let tower = clean(&format!("a{}b", mark.repeat(30)), 80);
            assert_eq!(tower, format!("a{}{}b", mark.repeat(4), "\u{fffd}".repeat(26)), "{mark:?}");
        }
    }

    #[test]
    fn columns_are_those_of_a_terminal() {
        // Of Unicode's EastAsianWidth.txt: F and W have two, combining marks none.
        for (text, needed) in [("/odom", 5), ("机器人", 6), ("ｏ", 2), ("e\u{301}", 1), ("한", 2), ("🤖", 2), ("�", 1)]
        {
            assert_eq!(columns(text), needed, "{text}");
        }
    }

    proptest! {
        #[test]
        fn never_a_control_byte_and_never_too_wide(text in any::<String>(), width in 1usize..60) {
            let shown = clean(&text, width);
            prop_assert!(shown.chars().count() <= width);
            prop_assert!(!shown.chars().any(char::is_control));
            prop_assert_eq!(clean(&shown, width), shown);
        }

        #[test]
        fn json_spelt_out_is_clean_and_means_the_same(text in any::<String>(), hostile in "[\u{300}-\u{36f}\u{7f}\u{9b}\u{202e}a]{0,20}") {
            for text in [text, hostile] {
                let json = serde_json::Value::from(text.clone()).to_string();
                let told = spelt_out(&json);
                prop_assert_eq!(clean(&told, usize::MAX), told.as_ref());
                prop_assert_eq!(serde_json::from_str::<String>(&told).ok(), Some(text));
            }
        }
    }
}
