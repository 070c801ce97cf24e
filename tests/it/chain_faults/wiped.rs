//! The node dies and comes back empty: anchoring stops, the operator decides, nothing is lost.

use super::NO_NODE;
use super::evidence::{expect_once, says_mined};
use super::field::{Field, Mode, digests, states};
use crate::support::{Anvil, skipped, text, wait_until};

fn expect_empty_restart_survived(mode: Mode, restarted: bool) {
    let Some(node) = Anvil::start(&[]) else { skipped!(NO_NODE) };
    let field = Field::open(&node.http(), mode, &[]);
    field.grow(10);
    let before = field.expect_settled(&node, 60);

    // Nothing of what comes now is mined before the node dies.
    node.set_interval(0);
    field.watch();
    let node = node.kill_and_start_empty(&[]);
    field.expect_told(&["chain adopt"], 60);
    wait_until(60, "what comes meanwhile is acknowledged", || (field.records().len() > before.len() + 5).then_some(()));
    field.rest();

    // Nothing is put on a chain that nobody decided for.
    let waiting = field.records();
    let fresh: Vec<_> = waiting.iter().filter(|one| !digests(&before).contains(&text(one, "digest"))).collect();
    assert!(fresh.iter().all(|record| !says_mined(record)), "{:?}", states(&waiting));
    assert_eq!(node.nonce(&field.address), 0, "no transaction was mined");
    assert_eq!(node.waiting(), 0, "and none was sent");
    if restarted {
        field.restart_site_unready(&["chain adopt"]);
        assert_eq!(node.nonce(&field.address), 0, "nor by a new process");
    }

    node.fund(&field.address);
    field.authros.json(&["chain", "adopt"]);
    if restarted {
        field.restart_site();
    }
    let contract = text(&field.authros.json(&["chain", "status"]), "contract");
    field.contract.replace(contract);
    let after = wait_until(120, "everything is anchored on the adopted chain", || {
        Some(field.records()).filter(|records| states(records).keys().all(|word| word == "verified"))
    });
    assert!(after.iter().any(|record| record["kind"] == "adoption"), "the adoption is evidence itself");
    let on_chain = field.anchors(&node);
    let named: Vec<_> = after
        .iter()
        .filter(|one| on_chain.iter().any(|it| one["transaction"] == it.transaction.as_str()))
        .cloned()
        .collect();
    expect_once(&named, &on_chain);
    for record in after.iter().filter(|one| !digests(&before).contains(&text(one, "digest"))) {
        assert!(digests(&named).contains(&text(record, "digest")), "not on the adopted chain: {record}");
    }
    field.grow(5);
}

#[test]
fn single_uploads_stop_at_an_emptied_node_until_it_is_adopted() {
    expect_empty_restart_survived(Mode::Each, true);
}

#[test]
fn batches_stop_at_an_emptied_node_until_it_is_adopted() {
    expect_empty_restart_survived(Mode::Batch, false);
}

/// The node is away for a while and comes back unchanged.
#[test]
fn a_node_that_comes_back_with_its_blocks_is_used_again() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let state = directory.path().join("state.json");
    let state = ["--state", state.to_str().expect("UTF-8"), "--preserve-historical-states"];
    let Some(node) = Anvil::start(&state) else { skipped!(NO_NODE) };
    let field = Field::open(&node.http(), Mode::Batch, &[]);
    field.grow(10);
    let before = field.expect_settled(&node, 60).len();
    let node = node.end_and_start_again(&state, || {
        field.grow(10);
        field.expect_told(&["does not answer"], 60);
    });
    let after = field.expect_settled(&node, 90);
    assert!(after.len() >= before + 10);
}
