//! `verify.html` over the same truths and lies: the thread that checks in node, and the whole page in Chromium.

use std::cell::RefCell;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use authros_crypto::record::RecordSecret;
use serde_json::{Value, json};

use super::committed::Commit;
use super::world::{World, ours};
use crate::{Bundle, Outcome, Trust, pack, verify};

/// A file with its pins, and what it is.
pub struct Case {
    pub what: String,
    pub bundle: Vec<u8>,
    pub trust: Vec<u8>,
}

impl Case {
    pub fn new(what: &str, bundle: &[u8], trust: &Trust) -> Self {
        let trust = trust.to_text().expect("text").into_bytes();
        Self { what: what.to_owned(), bundle: bundle.to_vec(), trust }
    }
}

fn root(part: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(part)
}

/// What a program in node answers to a list of cases; `None`, and told, if it cannot run here.
fn asked(program: &[&str], needed: &str, cases: &[Case]) -> Option<Vec<Value>> {
    if !root(needed).exists() {
        println!("SKIPPED the page: there is no {needed}; tests/run makes it");
        return None;
    }
    let folder = tempfile::tempdir().expect("directory");
    let file = |number: usize, kind: &str, bytes: &[u8]| {
        let path = folder.path().join(format!("{number}.{kind}"));
        std::fs::write(&path, bytes).expect("written");
        path
    };
    let listed = |(number, case): (usize, &Case)| {
        json!({ "bundle": file(number, "authros", &case.bundle), "trust": file(number, "toml", &case.trust) })
    };
    let listed: Vec<Value> = cases.iter().enumerate().map(listed).collect();
    let mut command = Command::new("node");
    command.args(program.iter().map(|part| root(part))).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut running = match command.spawn() {
        Ok(running) => running,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            println!("SKIPPED the page: no node");
            return None;
        }
        Err(error) => panic!("node: {error}"),
    };
    let text = Value::from(listed).to_string();
    running.stdin.take().expect("piped").write_all(text.as_bytes()).expect("written");
    let output = running.wait_with_output().expect("it ends");
    let said = String::from_utf8_lossy(&output.stderr);
    if said.contains("there is no Chromium") {
        println!("SKIPPED the page in a browser: no chromium");
        return None;
    }
    assert!(output.status.success(), "{said}");
    Some(serde_json::from_slice(&output.stdout).expect("JSON"))
}

/// What all verifiers say alike.
fn reduced(report: &Value) -> Value {
    if report["trust"].is_string() {
        return "unusable pins".into();
    }
    if report["exporter"].is_null() {
        return "no bundle".into();
    }
    let fields = |of: &Value, names: &[&str]| names.iter().map(|name| of[*name].clone()).collect::<Vec<_>>();
    let list = |name: &str| report[name].as_array().cloned().unwrap_or_default();
    let record = |record: &Value| {
        let levels = ["bytes", "key", "anchor", "time", "opened"].map(|name| fields(&record[name], &["standing", "reason"]));
        let about = ["digest", "owner", "person", "signer", "owner_key", "recorder", "topic_id", "seq", "captured_at"];
        let place = ["anchored_at", "block", "seconds_to_anchor", "existed_before", "authority"];
        let shown = ["topic", "type", "publisher", "length", "message_sm3", "tags"];
        json!([fields(record, &about), fields(record, &place), levels, fields(&record["disclosed"], &shown)])
    };
    let stretch = |stretch: &Value| {
        let names = ["owner", "signer", "recorder", "topic_id", "standing", "reason", "own_statements", "first", "last"];
        let counted = ["gaps", "missing", "uncounted", "twice", "heads"];
        json!([fields(stretch, &names), fields(stretch, &counted)])
    };
    json!({
        "outcome": report["outcome"], "verdict": report["verdict"], "pinned": report["pinned"],
        "exporter": report["exporter"]["standing"],
        "records": list("records").iter().map(record).collect::<Vec<_>>(),
        "complete": list("complete").iter().map(stretch).collect::<Vec<_>>(),
    })
}

fn own(case: &Case) -> Value {
    let Ok(trust) = Trust::parse(&case.trust) else { return "unusable pins".into() };
    let Ok(bundle) = Bundle::parse(&case.bundle, ours()) else { return "no bundle".into() };
    reduced(&serde_json::to_value(verify(&bundle, Some(&trust), ours())).expect("JSON"))
}

fn expect_own(cases: &[Case], found: impl Iterator<Item = Value>) {
    let found: Vec<Value> = found.collect();
    assert_eq!(cases.len(), found.len());
    for (case, found) in cases.iter().zip(found) {
        if found == "no bundle" || found == "unusable pins" {
            assert_eq!(own(case), found, "{}", case.what);
        } else {
            let own = own(case);
            let part = |name: &str| assert_eq!(own[name], found[name], "{}: {name}", case.what);
            ["outcome", "verdict", "exporter", "records", "complete", "pinned"].map(part);
        }
    }
}

/// The page's thread says of each what our verifier says, word by word.
pub fn expect_the_same(cases: &[Case]) {
    let program = ["tools/verify-page/test/judge.js"];
    let Some(found) = asked(&program, "tools/verify-page/node_modules", cases) else { return };
    expect_own(cases, found.iter().map(reduced));
}

thread_local! {
    static TOLD: RefCell<Vec<Case>> = const { RefCell::new(Vec::new()) };
}

/// One more for the browser, which judges all of a test together.
pub fn tell(case: Case) {
    TOLD.with_borrow_mut(|told| told.push(case));
}

/// What this test told, in Chromium: from a file, without a network. It says the same, shows it, and loads nothing.
pub fn expect_the_same_in_chromium() {
    let cases = TOLD.take();
    let program = ["tests/support/verify_page.mjs", "target/verify.html"];
    let Some(found) = asked(&program, "target/verify.html", &cases) else { return };
    expect_own(&cases, found.iter().map(|one| reduced(&one["report"])));
    for (case, one) in cases.iter().zip(&found) {
        let loaded: Vec<&str> = one["loaded"].as_array().expect("a list").iter().filter_map(Value::as_str).collect();
        let is_own = |url: &&str| url.starts_with("file://") && url.ends_with("/verify.html") || url.starts_with("blob:");
        assert!(loaded.iter().all(is_own), "{}: {loaded:?}", case.what);
        assert_eq!(one["complaints"], json!([]), "{}", case.what);
        if one["report"]["verdict"].is_array() {
            assert_eq!(one["shown"], one["report"]["verdict"], "{}", case.what);
        }
    }
}

#[test]
fn bundles_of_clique_qbft_ibft2_and_the_embedded_chain_come_to_the_same_in_chromium() {
    let trust = World::trust();
    let mut clique = World::new();
    let secret = RecordSecret::of(&clique.topic_key, &clique.record.header);
    clique.disclose(&clique.keys.clone(), secret);
    let mut vanity = [0; 32];
    vanity[..28].copy_from_slice(b"AuthROS chain file version 1");
    let embedded = World { vanity, ..World::new() };
    let sealed = |ibft2: bool| {
        let commit = Commit { ibft2, named: vec![1, 2, 3], ..Commit::by(&[1, 2]) };
        World { commit: Some(commit), sealers: vec![0], ..World::new() }
    };
    for (what, world, outcome) in [
        ("Clique", clique, Outcome::Holds),
        ("QBFT", sealed(false), Outcome::Holds),
        ("IBFT 2.0", sealed(true), Outcome::Holds),
        ("the embedded chain", embedded, Outcome::Incomplete),
    ] {
        assert_eq!(world.report().outcome, outcome, "{what}");
        tell(Case::new(what, &pack(&world.members()).expect("packs"), &trust));
    }
    expect_the_same_in_chromium();
}
