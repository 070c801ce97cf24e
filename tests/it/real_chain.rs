//! With a real Ethereum node: three ways of connecting, its usual gas price, and a restart in between.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use serde_json::{Value, json};
use support::anvil::{RICH_ADDRESS, RICH_KEY};
use support::{Anvil, Authros, Home, count, is_verified, skipped, text, wait_until};

const NO_NODE: &str = "no anvil; tests/run installs it into target/peers";
const TOPIC: &str = "/robot1/odom";

/// A profile with ether of its own, registered on the node.
fn funded(home: &Home, node: &Anvil, url: &str) -> Authros {
    // One by one, so that each digest is in a log; batches are tested with anvil in tests/it/chain_faults.
    let authros = home.authros().with(&["--chain", url, "--robots", "1", "--anchor-mode", "each"]);
    let made = authros.json(&["identity", "create"]);
    node.fund(&text(&made, "address"));
    assert_eq!(authros.json(&["identity", "register"])["registered"], true);
    authros
}

/// How many of the contract's logs name each digest.
fn logs_of(node: &Anvil, contract: &str, records: &[Value]) -> Vec<usize> {
    let logs = node.logs(contract);
    let named = |digest: &str| logs.iter().filter(|log| log.contains(digest)).count();
    records.iter().map(|record| named(&text(record, "digest"))).collect()
}

fn expect_anchored_once(node: &Anvil, authros: &Authros) -> Vec<Value> {
    let contract = text(&authros.json(&["chain", "status"]), "contract");
    let records = authros.records(&["records", "list", "--oldest"]);
    assert!(records.iter().all(is_verified));
    let logs = logs_of(node, &contract, &records);
    assert!(logs.iter().all(|&times| times == 1), "every digest is in one log: {logs:?}");
    for record in records.iter().step_by(10) {
        let receipt = node.call("eth_getTransactionReceipt", &json!([record["transaction"]]));
        assert_eq!(
            (&receipt["status"], &receipt["blockNumber"]),
            (&"0x1".into(), &format!("0x{:x}", count(record, "block")).into())
        );
    }
    records
}

fn expect_fifty_anchored(node: &Anvil, url: &str) {
    let home = Home::new();
    let authros = funded(&home, node, url);
    authros.capture(&[TOPIC], 50);
    let status = authros.json(&["chain", "status"]);
    assert_eq!(
        (&status["kind"], &status["chain_id"], &status["pending"]),
        (&"node".into(), &31337.into(), &0.into()),
        "{status}"
    );
    assert_eq!(expect_anchored_once(node, &authros).len(), 50);
    let price = node.call("eth_gasPrice", &json!([]));
    assert_ne!(price, "0x0", "this node's transactions cost ether");
}

#[test]
fn fifty_records_are_anchored_over_http() {
    let Some(node) = Anvil::start(&[]) else { skipped!(NO_NODE) };
    expect_fifty_anchored(&node, &node.http());
}

#[test]
fn fifty_records_are_anchored_over_a_local_socket() {
    let Some(node) = Anvil::start(&[]) else { skipped!(NO_NODE) };
    expect_fifty_anchored(&node, node.ipc().to_str().expect("UTF-8"));
}

#[test]
fn more_confirmations_are_waited_for() {
    let Some(node) = Anvil::start(&["--block-time", "1"]) else { skipped!(NO_NODE) };
    let home = Home::new();
    let authros = funded(&home, &node, &node.http()).with(&["--confirmations", "3"]);
    authros.capture(&[TOPIC], 5);
    let head = count(&authros.json(&["chain", "status"]), "block");
    let newest = authros.records(&["records", "list", "--oldest"]).iter().map(|record| count(record, "block")).max();
    assert!(newest.is_some_and(|block| block + 2 <= head), "block {newest:?} is three deep under {head}");
}

#[test]
fn an_account_the_operator_already_has_is_used() {
    let Some(node) = Anvil::start(&[]) else { skipped!(NO_NODE) };
    let home = Home::new();
    let authros = home.authros().with(&["--chain", &node.http(), "--robots", "1"]);
    authros.json(&["identity", "create"]);
    let key = home.file("eoa.hex", RICH_KEY, 0o600);
    assert_eq!(authros.json(&["keys", "load", "--eoa", &key])["address"], RICH_ADDRESS);
    assert_eq!(authros.json(&["identity", "register"])["address"], RICH_ADDRESS);
    authros.capture(&[TOPIC], 3);
}

#[test]
fn an_account_with_too_little_ether_is_told_so() {
    let Some(node) = Anvil::start(&[]) else { skipped!(NO_NODE) };
    let home = Home::new();
    let authros = home.authros().with(&["--chain", &node.http(), "--robots", "0"]);
    let address = text(&authros.json(&["identity", "create"]), "address");
    // One wei: a development node gives ether only to an account that holds nothing.
    node.call("anvil_setBalance", &json!([address, "0x1"]));
    let message = authros.fails(5, &["identity", "register"]);
    assert!(message.contains("ether"), "{message}");
    assert_eq!(authros.json(&["identity", "show"])["registered"], false);
}

#[test]
fn a_development_node_pays_for_a_newcomer() {
    let Some(node) = Anvil::start(&[]) else { skipped!(NO_NODE) };
    let home = Home::new();
    let authros = home.authros().with(&["--chain", &node.http(), "--robots", "1"]);
    authros.capture(&[TOPIC], 2);
    let balance = text(&authros.json(&["chain", "status"]), "balance");
    assert!(balance.parse::<u128>().is_ok_and(|wei| wei > 0), "{balance}");
}

#[test]
fn two_profiles_share_over_a_real_node() {
    let Some(node) = Anvil::start(&[]) else { skipped!(NO_NODE) };
    let home = Home::new();
    let [(alice, alice_address), (bob, bob_address)] = ["alice", "bob"].map(|name| {
        let authros = home.profile(name).with(&["--chain", &node.http(), "--robots", "1"]);
        let address = text(&authros.json(&["identity", "create"]), "address");
        node.fund(&address);
        authros.json(&["identity", "register"]);
        (authros, address)
    });
    let _site = alice.serve(&home);
    alice.json(&["grant", "add", &bob_address]);
    alice.capture(&[TOPIC], 3);
    for record in bob.records(&["received", "list", "--oldest"]) {
        assert_eq!(bob.json(&["records", "open", &text(&record, "id")])["verdict"], "verified");
        let answer = bob.json(&["records", "check", &text(&record, "id")])["contract"].clone();
        assert_eq!((&answer["authorised"], text(&answer, "reader")), (&true.into(), bob_address.clone()), "{answer}");
    }
    let told =
        bob.run(&["records", "check", &text(&bob.records(&["received", "list", "--oldest"])[0], "id")]).expect_code(0);
    assert!(
        told.stdout.contains(&format!("the contract lets {bob_address} read epoch 1 of {alice_address}")),
        "{told}"
    );
    assert_eq!(bob.records(&["received", "list", "--oldest"]).len(), 3);
    alice.json(&["grant", "end", &bob_address]);
    alice.capture(&[TOPIC], 2);
    let newest = &alice.json(&["records", "list"])["records"][0];
    bob.is_refused(&["records", "open", &text(newest, "id")]);
}

#[test]
fn a_site_killed_between_blocks_anchors_the_rest_and_nothing_twice() {
    let Some(node) = Anvil::start(&["--block-time", "1"]) else { skipped!(NO_NODE) };
    let home = Home::new();
    let authros = funded(&home, &node, &node.http());
    let site = authros.serve(&home);
    authros.run(&["topics", "watch", TOPIC]).expect_code(0);
    let before = wait_until(60, "some are anchored and some are not", || {
        let records = authros.records(&["records", "list", "--oldest"]);
        let verified = records.iter().filter(|record| is_verified(record)).count();
        (verified > 5 && verified < records.len()).then_some(records)
    });
    site.stop("KILL", 10);

    let _site = authros.serve(&home);
    authros.run(&["topics", "unwatch", TOPIC]).expect_code(0);
    wait_until(120, "everything is verified", || {
        authros.records(&["records", "list", "--oldest"]).iter().all(is_verified).then_some(())
    });
    let after = expect_anchored_once(&node, &authros);
    for record in &before {
        assert!(after.iter().any(|kept| kept["digest"] == record["digest"]), "lost: {record}");
    }
}
