//! All who verify bundles: this crate, the package in Python, and the page's thread where node is there. Each is given the same
//! cases, and says what `--json` has of each.

use std::path::Path;
use std::process::{Command, Stdio};

use serde_json::{Value, json};

use super::world::ours;
use crate::{Bundle, Trust, verify};

/// A file with its pins, and what it is.
pub struct Case {
    pub what: String,
    pub bundle: Vec<u8>,
    pub trust: Vec<u8>,
}

const LEVELS: [&str; 5] = ["bytes", "key", "anchor", "time", "opened"];

/// Another verifier: its name, and a program that reads a list of paths and answers with a list of reports.
struct Other {
    name: &'static str,
    program: &'static str,
    script: &'static str,
}

const PYTHON: Other = Other {
    name: "tools/verify",
    program: "python3",
    script: concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/support/judge.py"),
};
const PAGE: Other = Other {
    name: "verify.html",
    program: "node",
    script: concat!(env!("CARGO_MANIFEST_DIR"), "/../../tools/verify-page/test/judge.js"),
};

impl Other {
    /// What it says of each case; nothing if it is not here.
    fn judge(&self, cases: &[Case]) -> Option<Vec<Value>> {
        let is_known = Command::new(self.program).arg("--version").stdout(Stdio::null()).status().is_ok();
        let needs = Path::new(self.script).parent().and_then(Path::parent).map(|folder| folder.join("node_modules"));
        let is_installed = self.program != "node" || needs.is_some_and(|folder| folder.exists());
        if !is_known || !is_installed {
            println!("SKIPPED {}: no {}, or its packages are not installed", self.name, self.program);
            return None;
        }
        let folder = tempfile::tempdir().expect("directory");
        let place = |number: usize, kind: &str| folder.path().join(format!("{number}.{kind}"));
        let given: Vec<Value> = (0..cases.len())
            .map(|number| json!({"bundle": place(number, "authros"), "trust": place(number, "toml")}))
            .collect();
        for (number, case) in cases.iter().enumerate() {
            std::fs::write(place(number, "authros"), &case.bundle).expect("written");
            std::fs::write(place(number, "toml"), &case.trust).expect("written");
        }
        std::fs::write(folder.path().join("cases"), json!(given).to_string()).expect("written");
        let input = std::fs::File::open(folder.path().join("cases")).expect("opened");
        let output = Command::new(self.program).arg(self.script).stdin(input).output().expect("it runs");
        assert!(output.status.success(), "{}: {}", self.name, String::from_utf8_lossy(&output.stderr));
        let found: Vec<Value> = serde_json::from_slice(&output.stdout).expect("a list");
        assert_eq!(found.len(), cases.len(), "{}", self.name);
        Some(found)
    }
}

/// What this crate says of a case, as the other verifiers say it.
pub fn judged(case: &Case) -> Value {
    let Ok(trust) = Trust::parse(&case.trust) else { return json!({"trust": "it cannot be used"}) };
    match Bundle::parse(&case.bundle, ours()) {
        Ok(bundle) => serde_json::to_value(verify(&bundle, Some(&trust), ours())).expect("JSON"),
        Err(error) => json!({"outcome": "refused", "exporter": null, "why": error.to_string()}),
    }
}

/// How a verifier ends over this.
pub fn code(told: &Value) -> i32 {
    match told["outcome"].as_str() {
        Some("holds") => 0,
        Some("incomplete") => 8,
        Some("refused") => 6,
        _ => 3,
    }
}

fn list<'a>(told: &'a Value, name: &str) -> &'a [Value] {
    told[name].as_array().map(Vec::as_slice).unwrap_or_default()
}

/// Standing and reason of a level.
pub fn level(told: &Value) -> String {
    [&told["standing"], &told["reason"]].iter().filter_map(|word| word.as_str()).collect::<Vec<_>>().join(" ")
}

/// A number of any size; JavaScript writes those beyond 2^53 as texts.
fn number(told: &Value) -> String {
    told.as_str().map_or_else(|| told.to_string(), str::to_owned)
}

/// What verifiers have to agree on, one line for each part.
fn summary(told: &Value) -> Vec<String> {
    if code(told) == 3 {
        return vec!["the trust file cannot be used".to_owned()];
    }
    if told["exporter"].is_null() {
        return vec!["refused: it is no bundle".to_owned()];
    }
    let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    let mut found = vec![text(&told["outcome"]), text(&told["exporter"]["standing"])];
    found.extend(list(told, "verdict").iter().map(text));
    found.extend(list(told, "records").iter().map(|record| {
        let levels = LEVELS.map(|name| level(&record[name])).join(", ");
        format!("{}: {levels} {}", text(&record["digest"]), text(&record["disclosed"]["message_sm3"]))
    }));
    found.extend(list(told, "complete").iter().map(|topic| {
        let numbers = ["first", "last", "missing"].map(|name| number(&topic[name])).join(", ");
        let of = ["owner", "signer", "recorder", "topic_id"].map(|name| text(&topic[name]).to_lowercase()).join(" ");
        format!("{of}: {}, {numbers}, {}", level(topic), number(&topic["heads"]["number"]))
    }));
    found
}

/// The first thing in which two verifiers differ.
pub fn first_difference(own: &Value, other: &Value) -> Option<String> {
    let (own, other) = (summary(own), summary(other));
    if own.len() != other.len() {
        return Some(format!("{own:#?}\n{other:#?}"));
    }
    own.iter().zip(&other).find(|(own, other)| own != other).map(|(own, other)| format!("'{own}' and '{other}'"))
}

/// What each says of each case, ours first; all say the same.
fn agreed(cases: &[Case], others: &[Other]) -> Vec<Value> {
    let own: Vec<Value> = cases.iter().map(judged).collect();
    for other in others {
        let Some(theirs) = other.judge(cases) else { continue };
        let each = cases.iter().zip(own.iter().zip(&theirs));
        let apart: Vec<String> = each
            .filter_map(|(case, (own, theirs))| Some(format!("{}: {}", case.what, first_difference(own, theirs)?)))
            .collect();
        let (some, all) = (apart.len(), cases.len());
        assert!(apart.is_empty(), "{some} of {all}, ours and {}:\n{}", other.name, apart.join("\n"));
    }
    own
}

/// What all verifiers say, ours by its words.
pub fn agree(cases: &[Case]) -> Vec<Value> {
    agreed(cases, &[PYTHON, PAGE])
}

/// The same without the page, for a single case.
pub fn agree_on(case: Case) -> Value {
    agreed(&[case], &[PYTHON]).remove(0)
}
