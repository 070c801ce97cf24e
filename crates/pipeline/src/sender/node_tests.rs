//! Lanes with a real node (anvil): costs, losses, refusals and replacements.

use std::io::{BufRead as _, BufReader, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use serde_json::{Value, json};

use super::*;
use crate::chain::{ChainOptions, Endpoint};
use crate::model::RecordState;
use crate::pipeline::fixture::{Process, by_hand, identity};

const GWEI: u128 = 1_000_000_000;

/// A node that ends with its handle.
struct Anvil {
    child: Child,
    url: String,
}

impl Drop for Anvil {
    fn drop(&mut self) {
        drop(self.child.kill());
        drop(self.child.wait());
    }
}

impl Anvil {
    /// `None`, and a line that the test command counts, if there is none.
    fn start(test: &str, arguments: &[&str]) -> Option<Self> {
        let peers = std::env::var_os("AUTHROS_PEERS")
            .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target/peers"), PathBuf::from);
        let program = peers.join("node_modules/.bin/anvil");
        if !program.is_file() {
            let line = format!("\nSKIPPED pipeline::sender::{test}: no anvil; tests/run installs it\n");
            drop(std::io::stderr().write_all(line.as_bytes()));
            return None;
        }
        let mut command = Command::new(program);
        command.args(["--host", "127.0.0.1", "--port", "0"]).args(arguments);
        let mut child = command.stdin(Stdio::null()).stdout(Stdio::piped()).spawn().expect("starts");
        let mut lines = BufReader::new(child.stdout.take().expect("piped")).lines();
        let said = lines.find_map(|line| line.ok()?.split_once("Listening on ").map(|(_, place)| place.to_owned()));
        let url = format!("http://{}", said.expect("it says where").trim());
        std::thread::spawn(move || lines.for_each(drop));
        Some(Self { child, url })
    }

    async fn call(&self, method: &str, parameters: Value) -> Value {
        let body = json!({ "jsonrpc": "2.0", "id": 1, "method": method, "params": parameters }).to_string();
        let request = reqwest::Client::new().post(&self.url).header("content-type", "application/json").body(body);
        let text = request.send().await.expect("answers").text().await.expect("text");
        let answer: Value = serde_json::from_str(&text).expect("JSON");
        assert!(answer.get("error").is_none(), "{method}: {answer}");
        answer["result"].clone()
    }

    async fn fund(&self, account: Address, wei: u128) {
        self.call("anvil_setBalance", json!([account.to_string(), format!("{wei:#x}")])).await;
    }

    /// A registered account with ether, and stored records.
    async fn process(&self, cap: Option<u128>, records: u64) -> Process {
        let options = ChainOptions {
            endpoint: Endpoint::Node { url: self.url.clone(), roots: None },
            contract: None,
            pinned: None,
            confirmations: 1,
        };
        let chain = Chain::connect(options).await.expect("connects");
        let eoa = EoaSecret::generate().expect("key");
        self.fund(eoa.address(), 1_000_000_000 * GWEI).await;
        chain.deploy(&eoa).await.expect("deploys");
        by_hand(&chain, &eoa, &identity(&chain, &eoa)).await;
        let process = Process::new(chain, eoa, Policy { cap }).await;
        process.store(0..records);
        process
    }
}

fn paused(process: &Process) -> Option<PauseReason> {
    process.sender.state_of(process.eoa.address()).expect("state").paused
}

async fn expect_all_once(process: &Process, records: u64) {
    process.rounds_until("all are confirmed", |process| process.count(RecordState::Confirmed) == records).await;
    assert!(process.anchored(0..records).await.into_iter().all(|times| times == 1));
}

#[tokio::test(flavor = "multi_thread")]
async fn dropped_transactions_are_sent_again() {
    let Some(node) = Anvil::start("dropped_transactions_are_sent_again", &[]) else { return };
    let process = node.process(None, 12).await;
    node.call("evm_setAutomine", json!([false])).await;
    process.anchor(12).await;
    let open = process.plant.ledger.open_transactions(process.eoa.address()).expect("open");
    for row in open.iter().skip(2).step_by(3) {
        node.call("anvil_dropTransaction", json!([row.hash.to_string()])).await;
    }
    node.call("evm_setAutomine", json!([true])).await;
    node.call("evm_mine", json!([])).await;
    expect_all_once(&process, 12).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_base_fee_that_rose_a_hundredfold_is_paid_up_to_the_cap() {
    let Some(node) = Anvil::start("a_base_fee_that_rose_a_hundredfold_is_paid_up_to_the_cap", &[]) else { return };
    let process = node.process(Some(150 * GWEI), 5).await;
    node.call("evm_setAutomine", json!([false])).await;
    process.anchor(5).await;
    let dear = json!([format!("{:#x}", 200 * GWEI)]);
    node.call("anvil_setNextBlockBaseFeePerGas", dear).await;
    node.call("evm_mine", json!([])).await;
    process
        .rounds_until("the cap pauses it", |process| matches!(paused(process), Some(PauseReason::FeeCap { .. })))
        .await;
    assert_eq!(process.notes.with("chain.max_fee = 150"), 1);
    assert_eq!(process.count(RecordState::Submitted), 5);
    node.call("anvil_setNextBlockBaseFeePerGas", json!([format!("{:#x}", 100 * GWEI)])).await;
    node.call("evm_mine", json!([])).await;
    process
        .rounds_until("they are replaced", |process| {
            let open = process.plant.ledger.open_transactions(process.eoa.address()).expect("open");
            open.iter().all(|row| crate::chain::offered(&row.raw).is_ok_and(|offer| offer.price >= 100 * GWEI))
        })
        .await;
    node.call("evm_mine", json!([])).await;
    expect_all_once(&process, 5).await;
    process.rounds_until("it goes on", |process| paused(process).is_none()).await;
    assert_eq!(process.notes.with("resumes"), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_empty_account_waits_for_ether() {
    let Some(node) = Anvil::start("an_empty_account_waits_for_ether", &[]) else { return };
    let process = node.process(None, 6).await;
    process.anchor(1).await;
    process.rounds_until("one is confirmed", |process| process.count(RecordState::Confirmed) == 1).await;
    node.fund(process.eoa.address(), 0).await;
    process.anchor(5).await;
    assert_eq!(paused(&process), Some(PauseReason::NoEther), "told at once");
    process.round().await;
    assert_eq!((process.count(RecordState::Submitted), process.notes.with("too little ether")), (5, 1));
    node.fund(process.eoa.address(), 1_000_000_000 * GWEI).await;
    expect_all_once(&process, 6).await;
    process.rounds_until("it goes on", |process| paused(process).is_none()).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_network_without_blocks_is_told() {
    let Some(node) = Anvil::start("a_network_without_blocks_is_told", &[]) else { return };
    let process = node.process(None, 3).await;
    node.call("evm_setAutomine", json!([false])).await;
    process.anchor(3).await;
    process.rounds_until("it is told", |process| paused(process) == Some(PauseReason::Stalled)).await;
    assert_eq!((process.count(RecordState::Submitted), process.notes.with("produces no blocks")), (3, 1));
    node.call("evm_mine", json!([])).await;
    expect_all_once(&process, 3).await;
    process.rounds_until("it goes on", |process| paused(process).is_none()).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn replaced_blocks_are_filled_again() {
    let Some(node) = Anvil::start("replaced_blocks_are_filled_again", &[]) else { return };
    let process = node.process(None, 0).await;
    for (round, depth) in [(0, 1), (1, 8), (2, 16)] {
        process.store(round * 10..round * 10 + 10);
        process
            .work_until("they are confirmed", |process| process.count(RecordState::Confirmed) == round * 10 + 10)
            .await;
        node.call("anvil_reorg", json!([depth, []])).await;
        node.call("evm_mine", json!([])).await;
    }
    process.round().await;
    process.work_until("all are confirmed", |process| process.count(RecordState::Confirmed) == 30).await;
    assert!(process.anchored(0..30).await.into_iter().all(|times| times == 1));
    assert!(process.notes.with("replaced its last") >= 2, "{:?}", process.notes.all());
}

#[tokio::test(flavor = "multi_thread")]
async fn ether_goes_from_one_account_to_another() {
    let Some(node) = Anvil::start("ether_goes_from_one_account_to_another", &[]) else { return };
    let process = node.process(None, 0).await;
    let chain = &process.network.chain;
    let other = Address([0x77; 20]);
    process.sender.transfer(chain, &process.eoa, other, 3 * GWEI, "gift").await.expect("sent");
    assert_eq!(chain.wealth(other).await, Ok(3 * GWEI));
    let too_much = process.sender.transfer(chain, &process.eoa, other, u128::MAX / 2, "gift").await;
    assert!(matches!(too_much, Err(PipelineError::NoEther(account)) if account == process.eoa.address()));
    process.round().await;
    assert_eq!(process.sender.state_of(process.eoa.address()).expect("state").open, 0, "nothing was kept of it");
}
