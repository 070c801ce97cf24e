//! A bench on a node whose accounts hold nothing: one lends it ether, and gets back all that is not spent on gas.

use serde_json::{Value, json};

use crate::support::anvil::{RICH_ADDRESS, RICH_KEY};
use crate::support::{Anvil, Bench, count, heavy, list, tell_skipped, text, wait_until};

const NO_NODE: &str = "no anvil; tests/run installs it into target/peers";
const REFUSED: i32 = 5;
const INCOMPLETE: i32 = 8;

fn wei(value: &Value) -> u128 {
    let digits = value.as_str().expect("a quantity").trim_start_matches("0x");
    u128::from_str_radix(digits, 16).expect("a quantity")
}

fn balance(node: &Anvil, address: &str) -> u128 {
    wei(&node.call("eth_getBalance", &json!([address, "latest"])))
}

/// All that was paid for gas so far, and to whom this account gave something.
fn paid(node: &Anvil, giver: &str) -> (u128, Vec<String>) {
    let (mut fees, mut given) = (0, Vec::new());
    for number in 1..=node.head() {
        let block = node.call("eth_getBlockByNumber", &json!([format!("{number:#x}"), true]));
        for transaction in list(&block, "transactions") {
            let receipt = node.call("eth_getTransactionReceipt", &json!([transaction["hash"]]));
            fees += wei(&receipt["gasUsed"]) * wei(&receipt["effectiveGasPrice"]);
            if text(&transaction, "from").eq_ignore_ascii_case(giver) {
                given.push(text(&transaction, "to"));
            }
        }
    }
    (fees, given)
}

/// Nothing was lost but gas, and nothing is left in the accounts of the bench.
fn expect_given_back(node: &Anvil, giver: &str, before: u128) {
    let (fees, given) = paid(node, giver);
    assert!(given.len() == 2 && fees > 0, "{given:?}");
    for account in &given {
        assert_eq!(balance(node, account), 0, "{account}");
    }
    assert_eq!(before - balance(node, giver), fees);
}

/// A node on which one account alone has ether.
fn poor_node(more: &[&str]) -> Option<Anvil> {
    let node = Anvil::start(&[&["--gas-limit", "4294967295"][..], more].concat())?;
    let accounts = node.call("eth_accounts", &json!([]));
    let others = accounts.as_array().expect("accounts").iter().filter_map(Value::as_str);
    others.filter(|one| !one.eq_ignore_ascii_case(RICH_ADDRESS)).for_each(|one| node.set_balance(one, "0x0"));
    Some(node)
}

#[test]
fn ether_is_lent_to_a_bench_and_comes_back_but_for_gas() {
    let _alone = heavy();
    let place = "funder::ether_is_lent_to_a_bench_and_comes_back_but_for_gas";
    let Some(node) = poor_node(&[]) else { return tell_skipped(place, NO_NODE) };
    let (bench, url) = (Bench::new(), node.http());
    let key = bench.file("funder", RICH_KEY, 0o600);
    let before = balance(&node, RICH_ADDRESS);
    let words = ["size", "--runs", "2", "--node", &url, "--funder"];
    let run = |file: &str| bench.run(&[&words[..], &[file]].concat());

    let open = bench.file("open", RICH_KEY, 0o644);
    let outcome = run(&open);
    assert!(outcome.code != Some(0) && outcome.stderr.contains("open"), "{outcome}");
    node.set_balance(RICH_ADDRESS, "0x1");
    assert!(run(&key).expect_code(REFUSED).stderr.contains("--funder"));
    node.set_balance(RICH_ADDRESS, &format!("{before:#x}"));
    assert_eq!(node.nonce(RICH_ADDRESS), 0, "nothing was lent yet");

    run(&key).expect_code(0);
    let rows = list(&bench.report("figure-12-size"), "results");
    assert!(rows.len() == 12 && rows.iter().all(|row| count(row, "succeeded") == 2), "{rows:?}");
    expect_given_back(&node, RICH_ADDRESS, before);
}

#[test]
fn an_interrupted_bench_gives_back_what_it_was_lent() {
    let _alone = heavy();
    let place = "funder::an_interrupted_bench_gives_back_what_it_was_lent";
    let Some(node) = poor_node(&["-b", "1"]) else { return tell_skipped(place, NO_NODE) };
    let (bench, url) = (Bench::new(), node.http());
    let key = bench.file("funder", RICH_KEY, 0o600);
    let before = balance(&node, RICH_ADDRESS);
    // The signal arrives while its accounts are still being registered.
    let running = bench.spawn(&["consensus", "--uploaders", "1", "--node", &url, "--funder", &key]);
    wait_until(120, "both accounts were lent ether", || (node.nonce(RICH_ADDRESS) >= 2).then_some(()));
    running.stop("INT", 120).expect_code(INCOMPLETE);
    expect_given_back(&node, RICH_ADDRESS, before);
}
