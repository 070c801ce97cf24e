//! A different chain in place of the pinned one: everything stops until the operator adopts it.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::process::Command;

use serde_json::{Value, json};
use support::{Authros, Home, Running, count, free_port, is_verified, npm_program, skipped, text, wait_until};

const TOPIC: &str = "/robot1/odom";

fn steps_of(authros: &Authros, record: &Value) -> String {
    authros.json(&["uploads", "show", &text(record, "id")])["steps"].to_string()
}

#[test]
fn a_home_whose_embedded_chain_is_gone_adopts_the_new_one() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1"]);
    authros.enrol();
    authros.capture(&[TOPIC], 4);
    let old = authros.records(&["uploads", "list"]);
    let before = authros.json(&["chain", "status"]);
    let refused = authros.fails(5, &["chain", "adopt"]);
    assert!(refused.contains("nothing to adopt"), "{refused}");

    std::fs::rename(home.path().join("chain"), home.root().join("lost")).expect("moved away");
    let message = authros.fails(5, &["chain", "status"]);
    assert!(message.contains("not the pinned one") && message.contains("authros chain adopt"), "{message}");
    let adopted = authros.json(&["chain", "adopt"]);
    // The message definition is a record too.
    assert!(text(&adopted, "text").contains("5 verified records keep their anchors"), "{adopted}");
    let after = authros.json(&["chain", "status"]);
    assert_ne!(before["genesis"], after["genesis"]);
    authros.capture(&[TOPIC], 3);

    let words = authros.records(&["uploads", "list", "--kind", "adoption"]);
    assert!(words.len() == 1 && is_verified(&words[0]), "{words:?}");
    let records = authros.records(&["uploads", "list"]);
    assert!(records.len() == 7 && records.iter().all(is_verified), "{records:?}");
    for record in &old {
        let now = authros.json(&["shared", "open", &text(record, "id")]);
        assert_eq!(now["verdict"], "unanchored", "its anchor stayed behind: {now}");
        assert!(steps_of(&authros, record).contains("earlier chain"));
    }
    for record in records.iter().filter(|record| old.iter().all(|other| other["id"] != record["id"])) {
        assert_eq!(authros.json(&["shared", "open", &text(record, "id")])["verdict"], "verified");
        assert!(count(record, "block") > count(&words[0], "block"), "the word about the adoption comes first");
    }
}

fn anvil(port: u16, directory: &std::path::Path) -> Option<Running> {
    let mut command = Command::new(npm_program("anvil")?);
    command.args(["--host", "127.0.0.1", "--port", &port.to_string()]).env("HOME", directory).current_dir(directory);
    let mut node = Running::start(command);
    node.wait_for_text("Listening on 127.0.0.1:", 30);
    Some(node)
}

fn ask(port: u16, method: &str, parameters: &Value) {
    let body = json!({ "jsonrpc": "2.0", "id": 1, "method": method, "params": parameters }).to_string();
    let url = format!("http://127.0.0.1:{port}");
    let answer =
        support::process::output_of("curl", &["-s", "-H", "content-type: application/json", "-d", &body, &url]);
    assert!(!answer.contains("\"error\""), "{answer}");
}

#[test]
fn a_node_that_came_back_empty_is_adopted_while_records_wait() {
    let (home, port) = (Home::new(), free_port());
    let Some(node) = anvil(port, home.root()) else { skipped!("no anvil; tests/run installs it into target/peers") };
    if support::system_program("curl").is_none() {
        skipped!("no curl");
    }
    let authros = home.authros().with(&["--robots", "1", "--chain", &format!("http://127.0.0.1:{port}")]);
    authros.enrol();
    authros.capture(&[TOPIC], 3);
    let mut site = authros.serve(&home);
    ask(port, "evm_setAutomine", &json!([false]));
    authros.run(&["topics", "watch", TOPIC]).expect_code(0);
    let pending = |authros: &Authros| {
        authros.records(&["uploads", "list"]).iter().filter(|record| record["state"] == "submitted").count()
    };
    wait_until(60, "records wait for a block", || (pending(&authros) > 5).then_some(()));
    node.stop("KILL", 10);
    let _empty = anvil(port, home.root()).expect("starts again");
    site.wait_for_text("authros chain adopt", 60);
    let message = authros.fails(5, &["chain", "status"]);
    assert!(message.contains("authros chain adopt"), "{message}");
    let waiting = authros.records(&["uploads", "list"]).len();
    authros.json(&["chain", "adopt"]);
    authros.run(&["topics", "unwatch", TOPIC]).expect_code(0);
    let records = wait_until(120, "everything is verified", || {
        let records = authros.records(&["uploads", "list"]);
        records.iter().all(is_verified).then_some(records)
    });
    assert!(records.len() >= waiting);
    let verdicts = |record: &Value| authros.json(&["shared", "check", &text(record, "id")])["verdict"].clone();
    let unanchored = records.iter().filter(|record| verdicts(record) == "unanchored").count();
    assert_eq!(unanchored, 3, "only what was verified on the lost chain stayed behind");
}

#[test]
fn devices_are_lent_and_recalled() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "0"]);
    authros.enrol();
    let id = "ab".repeat(32);
    authros.json(&["devices", "lend", &id, "--until", "2h"]);
    authros.fails(3, &["devices", "lend", "abab"]);
    let row = authros.json(&["devices", "list"])["devices"][0].clone();
    assert!(row["device"] == id.as_str() && row["state"] == "lent" && row["until"].is_string(), "{row}");
    authros.json(&["devices", "recall", &id[..16]]);
    assert_eq!(authros.json(&["devices", "list"])["devices"][0]["state"], "recalled");
    let again = authros.fails(5, &["devices", "recall", &id]);
    assert!(again.contains("no such device"), "{again}");
}

/// Every record of the home opens as verified, and a full audit finds nothing.
fn expect_sound(authros: &Authros, records: &[Value]) {
    for record in records {
        let opened = authros.json(&["shared", "open", &text(record, "id")]);
        assert!(opened["verdict"] == "verified" && is_verified(record), "{opened}");
    }
    authros.run(&["audit", "--deep"]).expect_code(0);
}

#[test]
fn a_home_moves_to_a_newer_contract_on_its_chain_and_what_it_had_stays_verified() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1"]);
    authros.json(&["chain", "deploy", "--revision", "1"]);
    authros.enrol();
    authros.capture(&[TOPIC], 3);
    authros.with(&["--anchor-mode", "each"]).capture(&[TOPIC], 2);
    let (old, before) = (authros.records(&["uploads", "list"]), authros.json(&["chain", "status"]));
    assert_eq!((old.len(), &before["administration"]["revision"]), (5, &json!(1)));

    let adopted = text(&authros.json(&["chain", "adopt"]), "text");
    assert!(adopted.contains("stay anchored in the earlier contract"), "{adopted}");
    let after = authros.json(&["chain", "status"]);
    assert_eq!((&before["genesis"], &before["chain_id"]), (&after["genesis"], &after["chain_id"]));
    assert!(before["contract"] != after["contract"] && after["administration"]["revision"] == 2, "{after}");
    let refused = authros.fails(5, &["chain", "adopt"]);
    assert!(refused.contains("nothing to adopt"), "{refused}");
    authros.capture(&[TOPIC], 2);

    let records = authros.records(&["uploads", "list"]);
    assert_eq!(records.len(), 7);
    expect_sound(&authros, &records);
    let contract_of = |record: &Value| {
        let directory = home.root().join(text(record, "id"));
        let place = directory.to_str().expect("UTF-8");
        authros.run(&["uploads", "export", &text(record, "id"), "--dir", place, "--addresses"]).expect_code(0);
        let proof = std::fs::read(directory.join("proof.json")).expect("written");
        serde_json::from_slice::<Value>(&proof).expect("JSON")["contract"].clone()
    };
    for record in &records {
        let is_old = old.iter().any(|other| other["id"] == record["id"]);
        assert_eq!(contract_of(record), if is_old { &before } else { &after }["contract"], "{record}");
        assert_eq!(steps_of(&authros, record).contains("earlier contract"), is_old);
    }
}

#[test]
fn a_site_moves_to_a_newer_contract_while_it_captures() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1"]);
    authros.json(&["chain", "deploy", "--revision", "1"]);
    let mut site = authros.serve(&home);
    authros.enrol();
    authros.run(&["topics", "watch", TOPIC]).expect_code(0);
    let verified =
        |authros: &Authros| authros.records(&["uploads", "list"]).iter().filter(|record| is_verified(record)).count();
    wait_until(60, "some are verified", || (verified(&authros) > 20).then_some(()));
    authros.json(&["chain", "adopt"]);
    let then = authros.records(&["uploads", "list"]).len();
    wait_until(60, "more are captured", || (authros.records(&["uploads", "list"]).len() > then + 20).then_some(()));
    authros.run(&["topics", "unwatch", TOPIC]).expect_code(0);
    let records = wait_until(120, "everything is verified", || {
        let records = authros.records(&["uploads", "list"]);
        records.iter().all(is_verified).then_some(records)
    });
    site.expect_running();
    for record in records.iter().step_by(7) {
        assert_eq!(authros.json(&["shared", "check", &text(record, "id")])["verdict"], "verified", "{record}");
    }
    site.stop("INT", 30).expect_code(0);
    authros.run(&["audit", "--deep"]).expect_code(0);
}
