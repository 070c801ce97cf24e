//! Where results go: stdout, as JSON or as text; everything else to stderr.

use std::io::Write as _;

use serde::Serialize;

use authros_model::{clean_lines, spelt_out};
use authros_service::Failure;

/// Widest line of text, characters.
const WIDEST: usize = 2000;

/// The result channel.
#[derive(Debug, Clone, Copy)]
pub struct Output {
    json: bool,
}

impl Output {
    /// JSON or text.
    pub fn new(json: bool) -> Self {
        Self { json }
    }

    /// The result: `value` as one JSON document, or `text`.
    pub fn result<T: Serialize>(self, value: &T, text: impl FnOnce() -> String) {
        let line = if self.json {
            spelt_out(&serde_json::to_string(value).unwrap_or_default()).into_owned()
        } else {
            clean_lines(&text(), WIDEST)
        };
        let mut stdout = std::io::stdout().lock();
        // A reader that went away wants no more.
        drop(writeln!(stdout, "{line}").and_then(|()| stdout.flush()));
    }

    /// A file of our own making, as it is.
    pub fn raw(self, text: &str) {
        let mut stdout = std::io::stdout().lock();
        // A reader that went away wants no more.
        drop(stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()));
    }

    /// A word beside the result, for people.
    pub fn note(self, text: &str) {
        drop(writeln!(std::io::stderr().lock(), "{}", clean_lines(text, WIDEST)));
    }

    /// Why it failed.
    pub fn failure(self, failure: &Failure) {
        if self.json {
            let document = serde_json::json!({ "error": { "kind": failure.kind, "message": failure.message } });
            self.result(&document, String::new);
        }
        self.note(&format!("authros: {}", failure.message));
    }
}

/// Columns of text, each as wide as its widest cell.
pub fn table(head: &[&str], rows: &[Vec<String>]) -> String {
    let width = |column: usize| {
        let cells = rows.iter().filter_map(|row| row.get(column)).map(|cell| cell.chars().count());
        cells.chain(head.get(column).map(|cell| cell.chars().count())).max().unwrap_or(0)
    };
    let widths: Vec<usize> = (0..head.len()).map(width).collect();
    let line = |cells: Vec<&str>| {
        let padded = cells.iter().zip(&widths).map(|(cell, width)| format!("{cell:width$}"));
        padded.collect::<Vec<_>>().join("  ").trim_end().to_owned()
    };
    let mut lines = vec![line(head.to_vec())];
    lines.extend(rows.iter().map(|row| line(row.iter().map(String::as_str).collect())));
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use authros_model::is_shown;

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
