//! One account, several processes: nonces collide, and still nothing is lost or anchored twice.

use std::fs;
use std::path::Path;
use std::process::Command;

use serde_json::{Value, json};

use super::NO_NODE;
use super::evidence::{expect_chained, expect_once};
use super::field::{Field, Mode};
use crate::support::{Anvil, Home, skipped, wait_until};

/// A second home with only the keys of the first.
fn with_keys_of(first: &Home) -> Home {
    let second = Home::new();
    fs::create_dir(second.path()).expect("made");
    let copied = Command::new("cp").arg("-a").arg(first.path().join("profiles")).arg(second.path()).status();
    assert!(copied.is_ok_and(|status| status.success()), "the keys are copied");
    private(&second.path());
    second
}

fn private(directory: &Path) {
    use std::os::unix::fs::PermissionsExt;
    fs::set_permissions(directory, fs::Permissions::from_mode(0o700)).expect("its mode is set");
}

fn expect_interleaving(mode: Mode) {
    let Some(node) = Anvil::start(&[]) else { skipped!(NO_NODE) };
    let one = Field::open(&node.http(), mode, &[]);
    let contract = one.contract.clone();
    let other = Field::in_home(with_keys_of(&one.home), &node.http(), mode, 1, &["--contract", &contract]);
    assert_eq!((&one.address, &contract), (&other.address, &other.contract), "the same account");

    node.set_interval(1);
    for field in [&one, &other] {
        field.watch();
    }
    for field in [&one, &other] {
        wait_until(90, "both have taken records", || (field.true_records(&node).len() >= 120).then_some(()));
    }
    for field in [&one, &other] {
        field.rest();
    }
    let all = both_verified(&node, &one, &other);
    let anchors = one.anchors(&node);
    expect_once(&all, &anchors);
    expect_chained(&anchors);
}

fn both_verified(node: &Anvil, one: &Field, other: &Field) -> Vec<Value> {
    [one, other].iter().flat_map(|field| field.expect_verified(node, 180)).collect()
}

#[test]
fn two_sites_of_one_account_interleave_single_uploads() {
    expect_interleaving(Mode::Each);
}

#[test]
fn two_sites_of_one_account_interleave_batches() {
    expect_interleaving(Mode::Batch);
}

/// How many transfers of an account to itself are in blocks.
fn transfers(node: &Anvil, address: &str) -> usize {
    let address = Value::from(address.to_lowercase());
    let of_block = |number: u64| {
        let block = node.call("eth_getBlockByNumber", &json!([format!("{number:#x}"), true]));
        let transactions = block["transactions"].as_array().cloned().unwrap_or_default();
        transactions.iter().filter(|one| one["from"] == address && one["to"] == address).count()
    };
    (0..=node.head()).map(of_block).sum()
}

/// Something else uses the account's nonces while records are anchored with it.
fn expect_foreign_transactions_survived(mode: Mode) {
    let Some(node) = Anvil::start(&[]) else { skipped!(NO_NODE) };
    let field = Field::open(&node.http(), mode, &[]);
    node.set_interval(1);
    node.call("anvil_impersonateAccount", &json!([field.address]));
    field.watch();
    let mut sent = 0;
    wait_until(90, "transfers go in between", || {
        let transfer =
            json!([{ "from": field.address, "to": field.address, "value": "0x1", "gasPrice": "0x2540be400" }]);
        node.call("eth_sendTransaction", &transfer);
        sent += 1;
        field.true_records(&node);
        (sent >= 25).then_some(())
    });
    field.rest();
    field.expect_settled(&node, 180);
    assert!(transfers(&node, &field.address) > 0, "no transfer took a nonce of the lane, of {sent} sent");
}

#[test]
fn transfers_of_the_account_go_in_between_single_uploads() {
    expect_foreign_transactions_survived(Mode::Each);
}

#[test]
fn transfers_of_the_account_go_in_between_batches() {
    expect_foreign_transactions_survived(Mode::Batch);
}
