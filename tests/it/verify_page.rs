//! The page `verify.html` in Chromium, opened from disk and without a network: what `authros evidence verify --json` says, it shows.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use serde_json::{Value, json};

use crate::evidence::{Exported, export, verified};
use crate::support::{Running, heavy, list, skipped, system_program, text};

fn root(part: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(part)
}

/// What is missing for the page to be tried; `None` if nothing is.
fn missing() -> Option<&'static str> {
    let is_there = |name: &str| system_program(name).is_some();
    if !is_there("chromium") && !is_there("google-chrome") {
        return Some("no chromium");
    }
    (!root("target/verify.html").is_file()).then_some("no target/verify.html, which tests/run builds where npm works")
}

/// What the page comes to in each case, in a new Chromium.
fn in_chromium(cases: &[Value]) -> Vec<Value> {
    let mut command = Command::new("node");
    command.arg(root("tests/support/verify_page.mjs")).arg(root("target/verify.html"));
    let mut running = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().expect("node");
    let asked = Value::from(cases).to_string();
    running.stdin.take().expect("piped").write_all(asked.as_bytes()).expect("written");
    let output = running.wait_with_output().expect("it ends");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
    let found: Vec<Value> = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(found.len(), cases.len());
    for (case, one) in cases.iter().zip(&found) {
        expect_harmless(case, one);
    }
    found
}

/// It loaded itself and its own thread, ran nothing of the file, and made no element of its text.
fn expect_harmless(case: &Value, one: &Value) {
    let loaded: Vec<String> = list(one, "loaded")
        .iter()
        .filter_map(Value::as_str)
        .map(|url| url.split(':').next().expect("a scheme").to_owned())
        .collect();
    assert_eq!(loaded, ["file", "blob"], "{case}");
    assert_eq!((&one["executed"], &one["scripts"], &one["foreign"]), (&Value::Null, &1.into(), &0.into()), "{case}");
    assert_eq!(one["complaints"], json!([]), "{case}");
}

fn standings(report: &Value) -> Vec<Value> {
    let levels = ["bytes", "key", "anchor", "time", "opened"];
    let of = |record: &Value| {
        let told = levels.map(|level| [&record[level]["standing"], &record[level]["reason"]].map(Value::clone));
        json!([record["digest"], told, record["block"], record["captured_at"], record["anchored_at"]])
    };
    list(report, "records").iter().map(of).collect()
}

/// The page says what the program says, sentence by sentence and level by level, and shows these sentences.
fn expect_the_same(page: &Value, ours: &Value) {
    let told = &page["report"];
    assert_eq!((&told["outcome"], &told["verdict"]), (&ours["outcome"], &ours["verdict"]));
    assert_eq!((&told["pinned"], &told["exporter"]["standing"]), (&ours["pinned"], &ours["exporter"]["standing"]));
    assert_eq!(standings(told), standings(ours));
    assert_eq!(page["shown"], ours["verdict"]);
    for (mine, theirs) in list(ours, "complete").iter().zip(list(told, "complete")) {
        for field in ["topic_id", "standing", "first", "last", "gaps", "missing", "uncounted", "twice", "heads"] {
            assert_eq!(mine[field], theirs[field], "{field}");
        }
    }
}

#[test]
fn a_homes_bundle_comes_to_the_same_in_a_browser_as_in_the_program() {
    if let Some(why) = missing() {
        skipped!(why);
    }
    let Exported { home, bundle, trust, .. } = export();
    let (other, altered) = (home.root().join("other.toml"), home.root().join("altered.authros"));
    let pins = std::fs::read_to_string(&trust).expect("text");
    let signers = pins.lines().find(|line| line.starts_with("signers")).expect("signers");
    let strange = "signers = [\"0x0101010101010101010101010101010101010101\"]";
    std::fs::write(&other, pins.replace(signers, strange)).expect("written");
    let mut bytes = std::fs::read(&bundle).expect("read");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(&altered, bytes).expect("written");
    let unusable = home.root().join("unusable.toml");
    std::fs::write(&unusable, pins.replace("sealed_by_exporter", "sealed_by_nobody")).expect("written");
    let found = in_chromium(&[
        json!({ "bundle": bundle, "trust": trust }),
        json!({ "bundle": bundle, "trust": trust, "drop": true }),
        json!({ "bundle": bundle }),
        json!({ "bundle": bundle, "trust": other }),
        json!({ "bundle": altered, "trust": trust }),
        json!({ "bundle": bundle, "trust": unusable }),
    ]);
    let [chosen, dropped, unpinned, strangers, broken, untold] = found.as_slice() else { panic!("{found:?}") };
    let ours = verified(&bundle, Some(&trust)).expect_code(8).document();
    expect_the_same(chosen, &ours);
    expect_the_same(dropped, &ours);
    expect_the_same(unpinned, &verified(&bundle, None).expect_code(8).document());
    expect_the_same(strangers, &verified(&bundle, Some(&other)).expect_code(6).document());
    verified(&altered, Some(&trust)).expect_code(6);
    assert_eq!(text(&broken["report"], "outcome"), "refused", "{broken}");
    assert!(list(broken, "shown")[0].as_str().is_some_and(|first| first.starts_with("REFUSED")), "{broken}");
    verified(&bundle, Some(&unusable)).expect_code(3);
    assert!(
        list(untold, "shown")[0].as_str().is_some_and(|told| told.starts_with("Not checked: the trust file")),
        "{untold}"
    );
}

#[test]
fn ten_thousand_records_are_checked_while_the_page_answers() {
    if let Some(why) = missing() {
        skipped!(why);
    }
    let _turn = heavy();
    let folder = tempfile::tempdir().expect("a folder");
    let made =
        Command::new("node").arg(root("tools/verify-page/test/many.js")).arg("10000").arg(folder.path()).status();
    assert!(made.expect("node").success());
    let (bundle, trust) = (folder.path().join("many.authros"), folder.path().join("many.toml"));
    let found = in_chromium(&[json!({ "bundle": bundle, "trust": trust })]);
    let mut command = Command::new(env!("CARGO_BIN_EXE_authros"));
    command
        .env("HOME", folder.path())
        .args(["evidence", "verify"])
        .arg(&bundle)
        .arg("--trust")
        .arg(&trust)
        .arg("--json");
    let ours = Running::start(command).wait(300).expect_code(0).document();
    assert_eq!(list(&ours, "records").len(), 10_000);
    expect_the_same(&found[0], &ours);
    let [whole, first, pause] =
        ["milliseconds", "first_after", "frozen"].map(|name| found[0][name].as_u64().expect("a number"));
    let told =
        format!("10,000 records in verify.html: {whole} ms, first words after {first} ms, longest pause {pause} ms\n");
    // Past the harness's capture, so that it shows in every run.
    std::io::stderr().write_all(told.as_bytes()).expect("written");
    assert!(pause * 2 < whole, "the page answers while it checks: {told}");
}

#[test]
fn hostile_files_run_nothing_and_are_refused_before_they_are_read() {
    if let Some(why) = missing() {
        skipped!(why);
    }
    let _turn = heavy();
    let folder = tempfile::tempdir().expect("a folder");
    let made = Command::new("node").arg(root("tools/verify-page/test/hostile.js")).arg(folder.path()).status();
    assert!(made.expect("node").success());
    let file = |name: &str| folder.path().join(name);
    let names = [
        ("names.authros", "holds"),
        ("member.authros", "refused"),
        ("members.authros", "refused"),
        ("claim.authros", "refused"),
        ("long.authros", "refused"),
        ("messages.authros", "refused"),
        ("deep.authros", "refused"),
        ("wide.authros", "refused"),
    ];
    let cases = names.map(|(name, _)| json!({ "bundle": file(name), "trust": file("names.toml") }));
    for ((name, outcome), found) in names.iter().zip(in_chromium(&cases)) {
        assert_eq!(text(&found["report"], "outcome"), *outcome, "{name}: {found}");
        let ours = verified(&file(name), Some(&file("names.toml")));
        assert_eq!(ours.code, Some(if *outcome == "holds" { 0 } else { 6 }), "{name}: {ours}");
        if *outcome == "holds" {
            expect_the_same(&found, &ours.document());
        }
    }
}
