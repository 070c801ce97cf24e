//! Networks whose signers want more than the node quotes, transactions that are cancelled, and what a person is told
//! meanwhile.

use std::time::Duration;

use serde_json::{Value, json};

use super::NO_NODE;
use super::field::{Field, Mode, TOPIC};
use crate::support::{Anvil, Home, Proxy, count, list, long, poll, skipped, text, wait_until};

const GWEI: u64 = 1_000_000_000;

/// The price per gas of the transaction that anchors a record, wei.
fn price_of(node: &Anvil, record: &Value) -> u64 {
    let transaction = node.call("eth_getTransactionByHash", &json!([record["transaction"]]));
    crate::support::anvil::number(&transaction["gasPrice"])
}

/// Registers and captures through a node whose signers want 5 gwei, with a cap of 10.
fn expect_raised(node: &Anvil, options: &[&str]) {
    let proxy = Proxy::before(node.port());
    proxy.swallow_below(5 * GWEI);
    let home = Home::new();
    let authros = home.authros().with(&["--chain", &proxy.http(), "--robots", "1", "--anchor-mode", "each"]);
    let authros = authros.with(options).with_variable("AUTHROS_MAX_FEE", "10");
    authros.json(&["identity", "create"]);
    let registered = authros.json_within(400, &["identity", "register"]);
    assert_eq!(registered["registered"], true, "{registered}");
    assert!(proxy.spoilt() > 0, "the first offer was too low");
    let summary = authros.json_within(400, &["capture", "--topic", TOPIC, "--count", "5"]);
    assert_eq!((count(&summary, "captured"), count(&summary, "verified")), (5, 5), "{summary}");
    for record in authros.records(&["records", "list", "--oldest"]) {
        let price = price_of(node, &record);
        assert!((5 * GWEI..=10 * GWEI).contains(&price), "{price} wei per gas");
    }
}

#[test]
fn what_blocks_pass_by_is_raised_although_the_quote_stays() {
    let Some(node) = Anvil::start(&[]) else { skipped!(NO_NODE) };
    let deployer = Home::new();
    let pin = deployer.authros().with(&["--chain", &node.http(), "--robots", "0"]).json(&["chain", "deploy"]);
    node.set_interval(1);
    expect_raised(&node, &["--contract", &text(&pin, "contract")]);
}

#[test]
fn a_deployment_that_blocks_pass_by_is_raised_too() {
    if !long() {
        return; // Takes over a minute: `tests/run --long`.
    }
    let Some(node) = Anvil::start(&["--block-time", "1"]) else { skipped!(NO_NODE) };
    expect_raised(&node, &[]);
}

#[test]
fn a_lowest_price_is_offered_from_the_start_and_shown_by_name() {
    let Some(node) = Anvil::start(&["--block-time", "1"]) else { skipped!(NO_NODE) };
    let proxy = Proxy::before(node.port());
    proxy.swallow_below(5 * GWEI);
    let home = Home::new();
    let authros = home.authros().with(&["--chain", &proxy.http(), "--robots", "1", "--anchor-mode", "each"]);
    let authros = authros.with_variable("AUTHROS_MAX_FEE", "10").with_variable("AUTHROS_MIN_PRICE", "5");
    authros.enrol();
    authros.capture(&[TOPIC], 5);
    assert_eq!(proxy.spoilt(), 0, "every offer is high enough");
    let status = authros.json(&["chain", "status"]);
    let prices = json!({ "chain.min_price": "5000000000", "chain.max_fee": "10000000000" });
    assert_eq!(status["prices"], prices, "{status}");
    let shown = authros.run(&["chain", "status"]).expect_code(0).stdout;
    assert!(shown.contains("chain.min_price") && shown.contains("5 gwei per gas"), "{shown}");
    let refused = authros.with_variable("AUTHROS_MIN_PRICE", "11").fails(3, &["config", "check"]);
    assert!(refused.contains("chain.min_price") && refused.contains("chain.max_fee"), "{refused}");
}

#[test]
fn until_it_is_mined_health_says_how_many_blocks_passed_it_by() {
    let Some(node) = Anvil::start(&[]) else { skipped!(NO_NODE) };
    let proxy = Proxy::before(node.port());
    let field = Field::open(&proxy.http(), Mode::Batch, &[]);
    node.set_interval(1);
    proxy.swallow_below(1_000_000 * GWEI);
    field.grow(1);
    field.expect_told(&["not included in"], 60);
    field.expect_paused("passed_by", 30);
    let health = field.authros.json(&["status"])["health"].clone();
    let told = health.to_string();
    assert!(["not included in", "gwei per gas", "chain.min_price"].iter().all(|words| told.contains(words)), "{told}");
    proxy.calm();
    field.expect_settled(&node, 90);
}

/// The next waiting transaction, once there is one for which `is_it` holds.
fn next(field: &Field, is_it: impl Fn(&Value) -> bool) -> Value {
    wait_until(60, "a transaction waits", || {
        list(&field.authros.json(&["chain", "status"]), "waiting").into_iter().find(|one| is_it(one))
    })
}

#[test]
fn a_cancelled_transaction_loses_nothing() {
    let Some(node) = Anvil::start(&[]) else { skipped!(NO_NODE) };
    let field = Field::open(&node.http(), Mode::Batch, &[]);
    node.set_interval(0);
    field.grow(5);
    let anchor = next(&field, |one| one["purpose"] == "anchor");
    let nonce = count(&anchor, "nonce").to_string();
    let message = field.authros.fails(2, &["chain", "cancel", &nonce]);
    assert!(message.contains("--yes"), "{message}");
    field.authros.fails(5, &["chain", "cancel", "4711", "--yes"]);

    let cancel = field.authros.with(&["--json"]).spawn(&["chain", "cancel", &nonce, "--yes"]);
    next(&field, |one| one["purpose"] == "cancel");
    node.set_interval(1);
    let cancelled = cancel.wait(120).expect_code(0).document();
    assert!(text(&cancelled, "text").contains("anchored again"), "{cancelled}");
    field.expect_settled(&node, 90);
    let audited = field.authros.json(&["audit", "list", "--limit", "1000"]).to_string();
    assert!(audited.contains("cancel transaction"), "{audited}");

    // A command whose transaction is cancelled says so.
    node.set_interval(0);
    let waits = field.authros.spawn(&["keys", "rotate"]);
    let rotate = next(&field, |one| one["purpose"] != "anchor" && one["purpose"] != "cancel");
    let nonce = count(&rotate, "nonce").to_string();
    let cancel = field.authros.with(&["--json"]).spawn(&["chain", "cancel", &nonce, "--yes"]);
    next(&field, |one| one["purpose"] == "cancel");
    node.set_interval(1);
    cancel.wait(120).expect_code(0);
    let told = waits.wait(120).expect_code(5).stderr;
    assert!(told.contains("was cancelled"), "{told}");
    field.authros.json(&["keys", "rotate"]);
    field.expect_settled(&node, 90);
}

#[test]
fn a_capture_says_what_it_waits_for() {
    let Some(node) = Anvil::start(&[]) else { skipped!(NO_NODE) };
    let field = Field::open(&node.http(), Mode::Batch, &[]);
    node.set_interval(0);
    let mut capture = field.authros.spawn(&["capture", "--topic", TOPIC, "--count", "3"]);
    let said = capture.wait_for_text("waiting,", 40);
    assert!(said.contains("not verified yet") && said.contains("check"), "{said}");
    node.set_interval(1);
    capture.wait(120).expect_code(0);
}

#[test]
fn an_unfunded_home_is_told_who_lacks_how_much() {
    // A chain that is not known as a development node's gives nothing.
    let Some(node) = Anvil::start(&["--block-time", "1"]) else { skipped!(NO_NODE) };
    let proxy = Proxy::before(node.port());
    proxy.spoil("web3_clientVersion", crate::support::Spoil::Answer(r#""Geth/v1.9.7""#), u64::MAX);
    let home = Home::new();
    let authros = home.authros().with(&["--chain", &proxy.http(), "--robots", "0"]);
    let address = text(&authros.json(&["identity", "create"]), "address");
    let told = authros.fails(5, &["identity", "register"]);
    assert!(told.contains(&address) && told.contains("it has 0 wei and needs"), "{told}");
    let status = authros.json(&["chain", "status"]);
    assert_eq!((&status["lacks"]["account"], &status["lacks"]["held"]), (&json!(address), &json!("0")), "{status}");
    let shown = authros.run(&["chain", "status"]).expect_code(0).stdout;
    assert!(shown.contains("it has 0 wei and needs"), "{shown}");
    node.fund(&address);
    let registered = poll(60, || {
        std::thread::sleep(Duration::from_millis(200));
        (authros.run(&["identity", "register"]).code == Some(0)).then_some(())
    });
    assert!(registered.is_some(), "with ether it goes on");
}
