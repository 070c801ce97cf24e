//! The node dies and comes back empty: anchoring stops, the operator is told what to do, nothing is lost.

use super::NO_NODE;
use super::evidence::says_mined;
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
    field.expect_told(&["authros --home new records import old"], 60);
    wait_until(60, "what comes meanwhile is acknowledged", || (field.records().len() > before.len() + 5).then_some(()));
    field.rest();

    // Nothing is put on a chain that nobody decided for.
    let waiting = field.records();
    let fresh: Vec<_> = waiting.iter().filter(|one| !digests(&before).contains(&text(one, "digest"))).collect();
    assert!(fresh.iter().all(|record| !says_mined(record)), "{:?}", states(&waiting));
    assert_eq!(node.nonce(&field.address), 0, "no transaction was mined");
    assert_eq!(node.waiting(), 0, "and none was sent");
    if restarted {
        field.restart_site_unready(&["authros --home new records import old"]);
        assert_eq!(node.nonce(&field.address), 0, "nor by a new process");
    }
}

#[test]
fn single_uploads_stop_at_an_emptied_node() {
    expect_empty_restart_survived(Mode::Each, true);
}

#[test]
fn batches_stop_at_an_emptied_node() {
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
