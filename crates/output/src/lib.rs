//! Output: results go to stdout, as JSON or as text; everything else to stderr.

use std::io::Write as _;

use serde::Serialize;

use authros_model::{Timestamp, clean, clean_lines, columns, spelt_out};
use authros_service::{Failure, NoticeLevel};

/// Widest line of text, characters.
const WIDEST: usize = 2000;
/// The widest cell that widens its column, in columns: a fingerprint with a word beside it.
const WIDEST_CELL: usize = 80;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Log {
    #[default]
    Text,
    /// One JSON object per line; on stdout too, unless the output is JSON anyway.
    Json,
}

#[derive(Debug, Clone, Copy)]
pub struct Output {
    json: bool,
    log: Log,
}

#[derive(Serialize)]
struct Line<'a> {
    time: String,
    level: &'static str,
    source: String,
    message: &'a str,
}

impl Output {
    pub fn new(json: bool) -> Self {
        Self { json, log: Log::Text }
    }

    pub fn logging(self, log: Log) -> Self {
        Self { log, ..self }
    }

    pub fn log(self) -> Log {
        self.log
    }

    /// The result: `value` as one JSON document, or `text`.
    pub fn result<T: Serialize>(self, value: &T, text: impl FnOnce() -> String) {
        let line = match (self.json, self.log) {
            (true, _) => spelt_out(&serde_json::to_string(value).unwrap_or_default()).into_owned(),
            (false, Log::Text) => lines(&text()),
            (false, Log::Json) => log_line(Timestamp::now(), NoticeLevel::Info, PROGRAM, &text()),
        };
        let mut stdout = std::io::stdout().lock();
        // A closed stdout is no error.
        drop(writeln!(stdout, "{line}").and_then(|()| stdout.flush()));
    }

    /// Writes text as it is, without sanitising it.
    pub fn raw(self, text: &str) {
        let mut stdout = std::io::stdout().lock();
        // A closed stdout is no error.
        drop(stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()));
    }

    pub fn note(self, text: &str) {
        self.beside(NoticeLevel::Info, text);
    }

    /// An event of a site at a given time; `about` is its subject.
    pub fn notice(self, at: Timestamp, level: NoticeLevel, about: Option<&str>, text: &str) {
        match self.log {
            Log::Text => self.note(&format!("{at} {text}")),
            Log::Json => to_stderr(&log_line(at, level, about.unwrap_or(SITE), text)),
        }
    }

    pub fn failure(self, failure: &Failure) {
        if self.json {
            let document = serde_json::json!({ "error": { "kind": failure.kind, "message": failure.message } });
            self.result(&document, String::new);
        }
        self.beside(NoticeLevel::Error, &format!("authros: {}", failure.message));
    }

    fn beside(self, level: NoticeLevel, text: &str) {
        match self.log {
            Log::Text => to_stderr(&lines(text)),
            Log::Json => {
                let text = text.strip_prefix("authros: ").unwrap_or(text);
                to_stderr(&log_line(Timestamp::now(), level, PROGRAM, text));
            }
        }
    }
}

/// Sources of the process's own messages, and of site events without a subject.
const PROGRAM: &str = "authros";
const SITE: &str = "site";

fn to_stderr(line: &str) {
    drop(writeln!(std::io::stderr().lock(), "{line}"));
}

/// Text as it is written: every line cleaned.
pub fn lines(text: &str) -> String {
    clean_lines(text, WIDEST)
}

/// One JSON object on one line, without control characters.
pub fn log_line(at: Timestamp, level: NoticeLevel, source: &str, text: &str) -> String {
    let line =
        Line { time: at.in_milliseconds(), level: level.word(), source: clean(source, 200), message: &lines(text) };
    spelt_out(&serde_json::to_string(&line).unwrap_or_default()).into_owned()
}

/// Aligned columns. A cell longer than [`WIDEST_CELL`] shifts only its own line, and no cell breaks a line.
pub fn table<R: AsRef<[String]>>(head: &[&str], rows: impl IntoIterator<Item = R>) -> String {
    let cleaned = |row: R| row.as_ref().iter().map(|cell| clean(cell, WIDEST)).collect();
    let rows: Vec<Vec<String>> = rows.into_iter().map(cleaned).collect();
    let width = |column: usize| {
        let cells = rows.iter().filter_map(|row| row.get(column)).map(|cell| columns(cell));
        let cells = cells.filter(|width| *width <= WIDEST_CELL);
        cells.chain(head.get(column).map(|cell| columns(cell))).max().unwrap_or(0)
    };
    let widths: Vec<usize> = (0..head.len()).map(width).collect();
    let line = |cells: Vec<&str>| {
        let blanks = |cell: &str, width: usize| " ".repeat(width.saturating_sub(columns(cell)));
        let padded = cells.iter().zip(&widths).map(|(cell, width)| format!("{cell}{}", blanks(cell, *width)));
        padded.collect::<Vec<_>>().join("  ").trim_end().to_owned()
    };
    let mut lines = vec![line(head.to_vec())];
    lines.extend(rows.iter().map(|row| line(row.iter().map(String::as_str).collect())));
    lines.join("\n")
}

/// One name and value a line; no value breaks its line.
pub fn pairs(rows: &[(&str, String)]) -> String {
    let width = rows.iter().map(|(name, _)| name.len()).max().unwrap_or(0);
    let line = |(name, value): &(&str, String)| format!("{:width$}  {}", clean(name, WIDEST), clean(value, WIDEST));
    rows.iter().map(line).collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use authros_model::is_shown;

    #[test]
    fn a_line_of_the_log_is_one_object_with_milliseconds_and_nothing_that_terminals_act_on() {
        let at = Timestamp(1_700_000_000_007_900_000);
        let line = log_line(at, NoticeLevel::Warning, "alert\u{1b} disk", "a\u{202e}\nb\u{9b}2J");
        assert!(line.chars().all(is_shown), "{line:?}");
        let told: serde_json::Value = serde_json::from_str(&line).expect("JSON");
        // date -u -d @1700000000 +%FT%T
        assert_eq!(told["time"], "2023-11-14T22:13:20.007Z");
        assert_eq!((&told["level"], told.as_object().map(serde_json::Map::len)), (&"warning".into(), Some(4)));
        let message = told["message"].as_str().expect("a text");
        assert_eq!(message.lines().count(), 2, "{message:?}");
        assert!(message.chars().all(|character| is_shown(character) || character == '\n'), "{message:?}");
        let whole = log_line(Timestamp(1_700_000_000_000_000_000), NoticeLevel::Info, "site", "t");
        assert!(whole.contains("22:13:20.000Z"), "{whole}");
    }

    #[test]
    fn a_long_name_widens_no_line_but_its_own() {
        let row = |topic: &str| vec![topic.to_owned(), "verified".to_owned()];
        let long = format!("/{}", "x".repeat(60_000));
        let told = table(&["topic", "state"], &[row("/odom"), row(&long), row(&"y".repeat(WIDEST_CELL))]);
        let lines: Vec<&str> = told.lines().collect();
        assert_eq!(lines[1], format!("{:WIDEST_CELL$}  verified", "/odom"));
        assert!(lines[2].starts_with("/xxx") && lines[2].ends_with("  verified"), "nothing of it is lost");
        let told = table(&["topic", "state"], &[row("/odom"), row(&long)]);
        assert_eq!(told.lines().nth(1), Some("/odom  verified"));
    }

    #[test]
    fn wide_and_combined_characters_push_no_neighbour() {
        let rows = [["/机器人", "verified"], ["/e\u{301}", "verified"]].map(|row| row.map(str::to_owned));
        let told = table(&["topic", "state"], &rows);
        assert_eq!(told, "topic    state\n/机器人  verified\n/e\u{301}       verified", "seven columns each");
    }

    #[test]
    fn foreign_text_makes_no_line_of_its_own() {
        let hostile = || "/odom\nverified  by everybody\u{2028}x\r".to_owned();
        let rows = [("topic", hostile()), ("type", "a/B".to_owned())];
        assert_eq!(pairs(&rows), "topic  /odom\u{fffd}verified  by everybody\u{fffd}x\u{fffd}\ntype   a/B");
        assert_eq!(table(&["topic"], &[vec![hostile()], vec!["/b".to_owned()]]).lines().count(), 3);
    }

    #[test]
    fn json_keeps_its_meaning_and_loses_what_terminals_act_on() {
        let hostile = "a\u{9b}2J\u{202e}b\u{200b}\u{e0041}\u{1b}";
        let plain = serde_json::to_string(hostile).expect("a string");
        let json = spelt_out(&plain);
        assert!(json.chars().all(is_shown), "{json}");
        assert_eq!(serde_json::from_str::<String>(&json).expect("still JSON"), hostile);
        assert_eq!(spelt_out("{\"a\":\"机é\"}"), "{\"a\":\"机é\"}");
    }
}
