//! `verify.html` in Chromium, opened from disk and without a network, over the same truths and lies.

use std::path::{Path, PathBuf};
use std::process::Command;

use authros_crypto::record::RecordSecret;
use serde_json::{Value, json};

use super::committed::Commit;
use super::verifiers::{Case, first_difference, judged};
use super::world::World;
use crate::{Outcome, pack};

fn root(part: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(part)
}

/// What the page comes to in each case; `None`, and told, if it cannot be tried here.
fn in_chromium(cases: &[Case]) -> Option<Vec<Value>> {
    let page = root("target/verify.html");
    if !page.exists() {
        println!("SKIPPED verify.html in a browser: tests/run builds it where npm works");
        return None;
    }
    let folder = tempfile::tempdir().expect("directory");
    let file = |name: String, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).expect("written");
        path
    };
    let listed = |(number, case): (usize, &Case)| {
        let bundle = file(format!("{number}.authros"), &case.bundle);
        json!({ "bundle": bundle, "trust": file(format!("{number}.toml"), &case.trust) })
    };
    let listed: Vec<Value> = cases.iter().enumerate().map(listed).collect();
    let input = std::fs::File::open(file("cases".to_owned(), json!(listed).to_string().as_bytes())).expect("opened");
    let driver = root("tests/support/verify_page.mjs");
    let output = Command::new("node").arg(driver).arg(page).stdin(input).output().expect("node, which built the page");
    let said = String::from_utf8_lossy(&output.stderr);
    if said.contains("there is no Chromium") {
        println!("SKIPPED verify.html in a browser: there is no Chromium");
        return None;
    }
    assert!(output.status.success(), "{said}");
    Some(serde_json::from_slice(&output.stdout).expect("JSON"))
}

/// It says what our verifier says, shows these sentences, and loads nothing but itself and its thread.
pub fn expect_the_same_in_chromium(cases: &[Case]) {
    let Some(found) = in_chromium(cases) else { return };
    assert_eq!(found.len(), cases.len());
    for (case, one) in cases.iter().zip(&found) {
        let (what, told) = (&case.what, &one["report"]);
        assert_eq!(first_difference(&judged(case), told), None, "{what}");
        if told["verdict"].is_array() {
            assert_eq!(one["shown"], told["verdict"], "{what}");
        }
        let loaded: Vec<&str> = one["loaded"].as_array().expect("a list").iter().filter_map(Value::as_str).collect();
        let is_own =
            |url: &&str| (url.starts_with("file:") && url.ends_with("/verify.html")) || url.starts_with("blob:");
        assert!(loaded.iter().all(is_own), "{what}: {loaded:?}");
        assert_eq!(one["complaints"], json!([]), "{what}");
    }
}

#[test]
fn bundles_of_clique_qbft_ibft2_and_the_embedded_chain_come_to_the_same_in_chromium() {
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
    let case = |(what, world, outcome): (&str, World, Outcome)| {
        assert_eq!(world.report().outcome, outcome, "{what}");
        let bundle = pack(&world.members()).expect("packs");
        Case { what: what.to_owned(), bundle, trust: World::trust().to_text().expect("text").into_bytes() }
    };
    let cases = [
        ("Clique", clique, Outcome::Holds),
        ("QBFT", sealed(false), Outcome::Holds),
        ("IBFT 2.0", sealed(true), Outcome::Holds),
        ("the embedded chain", embedded, Outcome::Incomplete),
    ];
    expect_the_same_in_chromium(&cases.map(case));
}
