//! The results of a bench: one JSON document, comma-separated lines, a text with tables, a page of plots.

use serde::Serialize;
use serde_json::Value;

use super::machine::Machine;
use super::plot::{Page, Plot};
use super::spread::Spread;

/// The result of a bench.
#[derive(Debug, Serialize)]
pub struct Report<R> {
    /// Name of its files.
    pub name: &'static str,
    /// What was measured.
    pub title: &'static str,
    /// Where it ran.
    pub machine: Machine,
    /// What must be known to read it.
    pub notes: &'static [&'static str],
    /// More fields about the run: an object.
    #[serde(flatten)]
    pub about: Value,
    /// One entry for each combination measured.
    pub results: Vec<R>,
}

impl<R> Report<R> {
    /// Of this machine.
    pub fn new(
        name: &'static str,
        title: &'static str,
        notes: &'static [&'static str],
        about: Value,
        results: Vec<R>,
    ) -> Self {
        Self { name, title, machine: Machine::read(), notes, about, results }
    }

    /// For people.
    pub fn text(&self, tables: &[String]) -> String {
        let head = format!("\n{}\nmachine: {}", self.title, self.machine.line());
        format!("{head}\n\n{}\n\n{}", tables.join("\n\n"), self.notes.join("\n"))
    }

    /// A page of plots.
    pub fn page(&self, columns: usize, plots: Vec<Plot>) -> Page {
        let notes = self.notes.iter().map(|note| (*note).to_owned()).collect();
        Page { title: self.title.to_owned(), machine: self.machine.line(), columns, plots, notes }
    }
}

/// The part of a result common to all benches.
#[derive(Debug, Clone, Serialize)]
pub struct Measured {
    /// Length of a message, bytes.
    pub bytes: u64,
    /// The number of values in the spread.
    pub runs: u64,
    /// Their unit.
    pub unit: &'static str,
    /// The values.
    #[serde(flatten)]
    pub spread: Spread,
}

/// One line of column names, one line per result; nested fields are named `outer.inner`.
pub fn csv(results: &[Value]) -> String {
    let rows: Vec<Vec<(String, String)>> = results.iter().map(row).collect();
    let mut names: Vec<&str> = Vec::new();
    for (name, _) in rows.iter().flatten() {
        if !names.contains(&name.as_str()) {
            names.push(name);
        }
    }
    let cell = |row: &Vec<(String, String)>, name: &str| {
        row.iter().find(|(found, _)| found == name).map_or(String::new(), |(_, value)| quoted(value))
    };
    let line = |row: &Vec<(String, String)>| names.iter().map(|name| cell(row, name)).collect::<Vec<_>>().join(",");
    std::iter::once(names.join(",")).chain(rows.iter().map(line)).collect::<Vec<_>>().join("\n")
}

fn row(result: &Value) -> Vec<(String, String)> {
    let mut cells = Vec::new();
    flatten("", result, &mut cells);
    cells
}

fn flatten(name: &str, value: &Value, cells: &mut Vec<(String, String)>) {
    match value {
        Value::Object(fields) => {
            for (inner, value) in fields {
                let name = if name.is_empty() { inner.clone() } else { format!("{name}.{inner}") };
                flatten(&name, value, cells);
            }
        }
        Value::Null => cells.push((name.to_owned(), String::new())),
        Value::String(text) => cells.push((name.to_owned(), text.clone())),
        other => cells.push((name.to_owned(), other.to_string())),
    }
}

/// Quoted as in RFC 4180.
fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn lines_have_the_columns_of_all_results() {
        let results = vec![json!({ "a": 1, "b": { "c": "x, \"y\"" } }), json!({ "a": 2, "d": null })];
        let report = Report::new("test", "A test", &["a note"], json!({ "more": 7 }), results);
        assert_eq!(csv(&report.results), "a,b.c,d\n1,\"x, \"\"y\"\"\",\n2,,");
        let document = serde_json::to_value(&report).expect("JSON");
        assert!(document["machine"]["cores"].is_u64() && document["results"].is_array());
        assert_eq!((&document["more"], &document["notes"]), (&json!(7), &json!(["a note"])));
    }
}
