//! A bench on a node whose accounts hold nothing: one lends it ether, and gets back all that is not spent on gas.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use serde_json::{Value, json};
use support::anvil::{RICH_ADDRESS, RICH_KEY};
use support::{Anvil, Authros, Home, count, heavy, list, skipped, text};

/// Seconds for a whole run.
const LIMIT: u64 = 300;
const INPUT: i32 = 3;
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
    let Some(node) = poor_node(&[]) else { skipped!("no anvil; tests/run installs it into target/peers") };
    let (home, url) = (Home::new(), node.http());
    let bench = Authros::bare(home.root());
    let key = home.file("funder", RICH_KEY, 0o600);
    let before = balance(&node, RICH_ADDRESS);
    let words = ["bench", "size", "--runs", "2", "--networks", "poa", "--node", &url, "--funder", &key];

    let open = home.file("open", RICH_KEY, 0o644);
    let outcome = bench.run(&[&words[..9], &[open.as_str()]].concat());
    assert!(outcome.code != Some(0) && outcome.stderr.contains("open"), "{outcome}");
    bench.run(&["bench", "size", "--funder", &key]).expect_code(2);
    node.set_balance(RICH_ADDRESS, "0x1");
    assert!(bench.fails(REFUSED, &words).contains("--funder"));
    node.set_balance(RICH_ADDRESS, &format!("{before:#x}"));
    assert_eq!(node.nonce(RICH_ADDRESS), 0, "nothing was lent yet");

    let report = bench.json_within(LIMIT, &words);
    let rows: Vec<Value> = list(&report, "results").into_iter().filter(|row| row["network"] == "node").collect();
    assert!(rows.len() == 12 && rows.iter().all(|row| count(row, "succeeded") == 2), "{report}");
    expect_given_back(&node, RICH_ADDRESS, before);
}

#[test]
fn an_interrupted_bench_gives_back_what_it_was_lent() {
    let _alone = heavy();
    let Some(node) = poor_node(&["-b", "1"]) else { skipped!("no anvil; tests/run installs it into target/peers") };
    let (home, url) = (Home::new(), node.http());
    let key = home.file("funder", RICH_KEY, 0o600);
    let before = balance(&node, RICH_ADDRESS);
    // One upload on the chains before it; on the node the accounts are still being registered when it is told to end.
    let words = ["bench", "consensus", "--uploaders", "1", "--difficulty", "1000", "--node", &url, "--funder", &key];
    let running = Authros::bare(home.root()).spawn(&words);
    support::wait_until(120, "both accounts were lent ether", || (node.nonce(RICH_ADDRESS) >= 2).then_some(()));
    let outcome = running.stop("INT", 120);
    assert_eq!(outcome.code, Some(INCOMPLETE), "{outcome}");
    expect_given_back(&node, RICH_ADDRESS, before);
}

#[test]
fn a_profile_of_the_home_lends_as_a_key_file_does_unless_a_site_runs_there() {
    let _alone = heavy();
    let Some(node) = poor_node(&[]) else { skipped!("no anvil; tests/run installs it into target/peers") };
    let (home, url) = (Home::new(), node.http());
    let authros = home.authros();
    let profile = text(&authros.json(&["identity", "create"]), "address");
    let before = balance(&node, RICH_ADDRESS);
    node.set_balance(&profile, &format!("{before:#x}"));
    let words = |funder: &'static str| {
        let words = ["bench", "size", "--runs", "1", "--networks", "poa", "--node", &url, "--funder", funder];
        words.map(str::to_owned)
    };
    let fails = |code: i32, funder: &'static str| {
        let words = words(funder);
        authros.fails(code, &words.each_ref().map(String::as_str))
    };
    assert!(fails(INPUT, "nobody").contains("neither a file nor a profile of that name"));
    let site = authros.serve(&home);
    assert!(fails(REFUSED, "default").contains("a site runs in"));
    site.stop("INT", 60).expect_code(0);

    let own = words("default");
    let report = authros.json_within(LIMIT, &own.each_ref().map(String::as_str));
    let rows: Vec<Value> = list(&report, "results").into_iter().filter(|row| row["network"] == "node").collect();
    assert!(rows.len() == 12 && rows.iter().all(|row| count(row, "succeeded") == 1), "{report}");
    expect_given_back(&node, &profile, before);
}
