//! The node receives what is sent to it, but its answers do not come back.

use std::time::Duration;

use super::NO_NODE;
use super::field::{Field, Mode};
use crate::support::{Anvil, Home, Proxy, Spoil, heavy, skipped, wait_until};

const SEND: &str = "eth_sendRawTransaction";

/// Drops this many answers to sent transactions while records are captured.
fn expect_spoilt_answers_survived(mode: Mode, how: Spoil, times: u64, records: usize) {
    let Some(node) = Anvil::start(&[]) else { skipped!(NO_NODE) };
    let proxy = Proxy::before(node.port());
    let robots = if times > 100 { 8 } else { 1 };
    let field = Field::in_home(Home::new(), &proxy.http(), mode, robots, &[]);
    node.set_interval(1);
    proxy.spoil(SEND, how, times);
    field.grow(records);
    wait_until(600, "all are spoilt that are to be", || {
        let all = proxy.spoilt() == times;
        // With few transactions left to send, more records are needed to lose answers for.
        if !all && field.pending() == 0 {
            field.grow(records);
        }
        field.true_records(&node);
        all.then_some(())
    });
    field.expect_settled(&node, 120);
    assert_eq!(proxy.spoilt(), times, "{how:?}");
}

#[test]
fn a_thousand_lost_answers_to_single_uploads_lose_and_double_nothing() {
    let _alone = heavy();
    expect_spoilt_answers_survived(Mode::Each, Spoil::DropAnswer, 1_000, 400);
}

#[test]
fn lost_answers_to_batches_lose_and_double_nothing() {
    expect_spoilt_answers_survived(Mode::Batch, Spoil::DropAnswer, 10, 20);
}

#[test]
fn refused_connections_lose_and_double_nothing() {
    expect_spoilt_answers_survived(Mode::Batch, Spoil::Refuse, 5, 20);
}

#[test]
fn answers_cut_in_the_middle_lose_and_double_nothing() {
    expect_spoilt_answers_survived(Mode::Batch, Spoil::CutAnswer, 5, 20);
}

#[test]
fn answers_that_are_no_whole_json_lose_and_double_nothing() {
    expect_spoilt_answers_survived(Mode::Batch, Spoil::TruncateJson, 5, 20);
}

#[test]
fn answers_that_come_after_the_patience_lose_and_double_nothing() {
    expect_spoilt_answers_survived(Mode::Batch, Spoil::Delay(Duration::from_secs(7)), 2, 20);
}

/// Queries of the watcher and the sender are lost too.
#[test]
fn any_other_lost_answer_is_asked_for_again() {
    let Some(node) = Anvil::start(&[]) else { skipped!(NO_NODE) };
    let proxy = Proxy::before(node.port());
    let field = Field::open(&proxy.http(), Mode::Batch, &[]);
    node.set_interval(1);
    let faults = [
        ("eth_getLogs", Spoil::DropAnswer),
        ("eth_getLogs", Spoil::TruncateJson),
        ("eth_getTransactionReceipt", Spoil::TruncateJson),
        ("eth_getTransactionCount", Spoil::DropAnswer),
        ("eth_getBlockByNumber", Spoil::CutAnswer),
    ];
    for (method, how) in faults {
        proxy.spoil(method, how, 3);
        field.grow(5);
        field.expect_settled(&node, 60);
        // Some queries are sent only now and then; the program must have recovered from the losses.
        assert!(proxy.seen(method) > 0, "{method} is asked at all");
    }
    proxy.calm();
}
