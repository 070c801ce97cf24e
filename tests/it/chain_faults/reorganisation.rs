//! Blocks are replaced: what was anchored in them no longer is, says so, and is anchored again.

use serde_json::Value;

use super::NO_NODE;
use super::evidence::says_mined;
use super::field::{Field, Mode, digests};
use crate::support::{Anvil, count, is_verified, skipped, text, wait_until};

/// How long the program may take to notice, seconds.
const NOTICE: u64 = 30;

/// Splits verified records at the block from which everything is replaced.
fn split(records: &[Value], first_gone: u64) -> (Vec<Value>, Vec<Value>) {
    records.iter().cloned().partition(|record| count(record, "block") < first_gone)
}

fn replace_blocks(node: &Anvil, field: &Field, depth: u64) {
    node.set_interval(0);
    let before = field.true_records(node);
    // Empty blocks may have come since: at least as deep as the newest record.
    let newest = before.iter().map(|record| count(record, "block")).max().expect("records");
    let depth = depth.max(node.head() + 1 - newest);
    let (kept, gone) = split(&before, node.head() + 1 - depth);
    assert!(!gone.is_empty() && !kept.is_empty(), "{} stay and {} go at depth {depth}", kept.len(), gone.len());

    node.reorganise(depth);
    let after = field.expect_truth_within(node, NOTICE);
    for record in &after {
        if digests(&kept).contains(&text(record, "digest")) {
            assert!(is_verified(record), "its block is still there (depth {depth})");
        } else {
            assert!(!says_mined(record), "its block is gone: {record}");
        }
    }
    field.expect_still(node, kept.len());

    node.set_interval(1);
    let settled = field.expect_settled(node, 120);
    assert_eq!(settled.len(), before.len(), "depth {depth}: none more, none less");
}

fn expect_reorganisations_survived(mode: Mode) {
    let Some(node) = Anvil::start(&[]) else { skipped!(NO_NODE) };
    let field = Field::open(&node.http(), mode, &[]);
    field.grow(10);
    field.expect_settled(&node, 60);
    // The rest must not reach down to the contract itself.
    node.mine(70);
    for depth in [1, 8, 64] {
        node.set_interval(1);
        field.grow(12);
        field.expect_settled(&node, 60);
        if depth > 32 {
            node.mine(depth / 2);
            field.grow(12);
            field.expect_settled(&node, 60);
        }
        replace_blocks(&node, &field, depth);
    }
}

#[test]
fn single_uploads_of_replaced_blocks_are_sent_again() {
    expect_reorganisations_survived(Mode::Each);
}

#[test]
fn batches_of_replaced_blocks_are_anchored_again() {
    expect_reorganisations_survived(Mode::Batch);
}

#[test]
fn records_below_the_confirmations_wait_and_a_replaced_block_costs_nothing() {
    let Some(node) = Anvil::start(&[]) else { skipped!(NO_NODE) };
    let field = Field::open(&node.http(), Mode::Batch, &["--confirmations", "12"]);
    node.mine(20);
    node.set_interval(0);
    field.grow(10);
    node.expect_waiting(1);
    node.mine(1);
    let mined = wait_until(30, "they are mined", || {
        Some(field.true_records(&node)).filter(|records| records.iter().any(says_mined))
    });
    assert!(mined.iter().all(|record| record["state"] != "confirmed" && record["state"] != "verified"), "{mined:?}");

    node.reorganise(8);
    let after = field.expect_truth_within(&node, NOTICE);
    assert!(!after.iter().any(says_mined), "{after:?}");
    node.set_interval(1);
    field.expect_settled(&node, 120);
}
