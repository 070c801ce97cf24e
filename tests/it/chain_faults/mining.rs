//! Transactions that do not get into a block: forgotten, too cheap, unpaid, or because no block comes.

use serde_json::json;

use super::NO_NODE;
use super::evidence::says_mined;
use super::field::{Field, Mode};
use crate::support::{Anvil, long, skipped, wait_until};

/// A site with some verified records, on a node that makes no further blocks by itself.
fn frozen(node: &Anvil, mode: Mode) -> (Field, usize) {
    let field = Field::open(&node.http(), mode, &[]);
    field.grow(5);
    let records = field.expect_settled(node, 60);
    node.set_interval(0);
    (field, records.len())
}

fn expect_drops_survived(mode: Mode) {
    let Some(node) = Anvil::start(&[]) else { skipped!(NO_NODE) };
    let (field, verified) = frozen(&node, mode);
    field.grow(10);
    for _ in 0..3 {
        node.expect_waiting(1);
        node.drop_waiting();
        field.expect_still(&node, verified);
    }
    node.set_interval(1);
    field.expect_settled(&node, 90);
}

#[test]
fn single_uploads_that_the_node_forgot_are_sent_again() {
    expect_drops_survived(Mode::Each);
}

#[test]
fn batches_that_the_node_forgot_are_sent_again() {
    expect_drops_survived(Mode::Batch);
}

/// One transaction from the middle of the lane: those after it wait behind a gap.
#[test]
fn a_gap_in_the_lane_is_found_and_refilled() {
    let Some(node) = Anvil::start(&[]) else { skipped!(NO_NODE) };
    let (field, verified) = frozen(&node, Mode::Each);
    field.grow(10);
    node.expect_waiting(10);
    let next = node.nonce(&field.address);
    let pool = node.call("txpool_content", &json!([]));
    let of_account = pool["pending"].as_object().expect("accounts").values().next().expect("the account's");
    let first = of_account[next.to_string()]["hash"].as_str().expect("its hash");
    node.call("anvil_dropTransaction", &json!([first]));
    node.mine(1);
    // The gap may be refilled before or after that block; a record is in a block if the chain says so.
    assert!(field.true_records(&node).len() > verified);
    node.set_interval(1);
    field.expect_settled(&node, 90);
}

fn expect_standstill_survived(mode: Mode) {
    let Some(node) = Anvil::start(&[]) else { skipped!(NO_NODE) };
    let (field, verified) = frozen(&node, mode);
    let records = field.grow(20);
    node.expect_waiting(1);
    field.expect_still(&node, verified);
    assert!(field.pending() > 0, "chain status tells of transactions without a block");
    field.expect_told(&["no block"], 90);
    field.expect_paused("stalled", 30);

    // More is captured meanwhile, and a new process continues the work.
    let more = field.grow(10);
    assert!(more.len() > records.len());
    field.restart_site();
    field.expect_still(&node, verified);
    node.set_interval(1);
    field.expect_settled(&node, 90);
    assert_eq!(field.pending(), 0);
}

#[test]
fn while_no_block_comes_single_uploads_wait_and_nothing_is_lost() {
    if long() {
        expect_standstill_survived(Mode::Each);
    }
}

#[test]
fn while_no_block_comes_batches_wait_and_nothing_is_lost() {
    expect_standstill_survived(Mode::Batch);
}

fn expect_fee_jump_survived(mode: Mode) {
    let Some(node) = Anvil::start(&[]) else { skipped!(NO_NODE) };
    let (field, verified) = frozen(&node, mode);
    field.grow(10);
    node.expect_waiting(1);
    let high = node.base_fee() * 100;
    node.set_next_base_fee(high);
    node.mine(1);
    field.expect_still(&node, verified);
    // The fee stays high: only more expensive transactions get in.
    wait_until(120, "all are in blocks at the high fee", || {
        node.set_next_base_fee(high);
        node.mine(1);
        assert!(node.base_fee() >= high, "the node's fee is what was asked for");
        std::thread::sleep(std::time::Duration::from_millis(500));
        field.true_records(&node).iter().all(says_mined).then_some(())
    });
    node.set_interval(1);
    field.expect_settled(&node, 60);
}

#[test]
fn a_hundredfold_base_fee_is_paid_by_replaced_uploads() {
    expect_fee_jump_survived(Mode::Each);
}

#[test]
fn a_hundredfold_base_fee_is_paid_by_replaced_batches() {
    expect_fee_jump_survived(Mode::Batch);
}

/// A million times the fee of a quiet chain exceeds the default cap.
#[test]
fn a_fee_beyond_the_cap_pauses_the_lane_and_says_so() {
    let Some(node) = Anvil::start(&[]) else { skipped!(NO_NODE) };
    let (field, verified) = frozen(&node, Mode::Batch);
    let usual = node.base_fee();
    let beyond = usual * 1_000_000;
    node.set_next_base_fee(beyond);
    node.mine(1);
    field.grow(10);
    for _ in 0..10 {
        node.set_next_base_fee(beyond);
        node.mine(1);
        assert_eq!(field.true_records(&node).iter().filter(|one| says_mined(one)).count(), verified);
    }
    field.expect_told(&["max_fee"], 60);
    field.expect_paused("fee_cap", 30);
    node.set_next_base_fee(usual);
    node.mine(1);
    node.set_interval(1);
    field.expect_settled(&node, 90);
}

fn expect_poverty_survived(mode: Mode) {
    let Some(node) = Anvil::start(&[]) else { skipped!(NO_NODE) };
    let field = Field::open(&node.http(), mode, &[]);
    field.grow(5);
    let verified = field.expect_settled(&node, 60).len();
    node.set_balance(&field.address, "0x0");
    node.set_interval(1);
    let records = field.grow(10);
    assert!(records.len() >= verified + 10);
    field.expect_told(&["too little ether"], 60);
    field.expect_paused("no_ether", 30);
    field.expect_still(&node, verified);
    node.fund(&field.address);
    field.expect_settled(&node, 90);
}

#[test]
fn an_account_without_ether_waits_for_it_with_single_uploads() {
    expect_poverty_survived(Mode::Each);
}

#[test]
fn an_account_without_ether_waits_for_it_with_batches() {
    expect_poverty_survived(Mode::Batch);
}
