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
        self.process_at(&self.url, cap, records).await
    }

    async fn process_at(&self, url: &str, cap: Option<u128>, records: u64) -> Process {
        let options = ChainOptions {
            endpoint: Endpoint::Node { url: url.to_owned(), roots: None },
            contract: None,
            pinned: None,
        };
        let chain = Chain::connect(options).await.expect("connects");
        let eoa = EoaSecret::generate().expect("key");
        self.fund(eoa.address(), 1_000_000_000 * GWEI).await;
        chain.deploy(&eoa).await.expect("deploys");
        by_hand(&chain, &eoa, &identity(&chain, &eoa)).await;
        let process = Process::new(chain, eoa, Policy { cap, floor: 0 }).await;
        process.store(0..records);
        process
    }
}

/// A port before the node's that answers a transaction offering less than `least` wei per gas, and drops it.
struct Dear {
    url: String,
    least: Arc<std::sync::atomic::AtomicU64>,
}

impl Dear {
    fn before(node: &Anvil) -> Self {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
        let url = format!("http://{}", listener.local_addr().expect("its address"));
        let least = Arc::new(std::sync::atomic::AtomicU64::new(0));
        let (upstream, limit) = (node.url.trim_start_matches("http://").to_owned(), Arc::clone(&least));
        std::thread::spawn(move || {
            for stream in listener.incoming() {
                let (stream, upstream, limit) = (stream.expect("accepted"), upstream.clone(), Arc::clone(&limit));
                // A client that goes away ends it.
                std::thread::spawn(move || drop(answer_one(stream, &upstream, &limit)));
            }
        });
        Self { url, least }
    }
}

fn answer_one(
    mut client: std::net::TcpStream,
    upstream: &str,
    least: &std::sync::atomic::AtomicU64,
) -> std::io::Result<()> {
    use std::io::Read as _;
    let mut reader = BufReader::new(client.try_clone()?);
    let (mut length, mut line) = (0, String::new());
    while reader.read_line(&mut line)? > 2 {
        let lower = line.to_lowercase();
        length = lower.strip_prefix("content-length:").map_or(length, |text| text.trim().parse().expect("a length"));
        line.clear();
    }
    let mut body = vec![0; length];
    reader.read_exact(&mut body)?;
    let request: Value = serde_json::from_slice(&body)?;
    let raw = request["params"][0].as_str().filter(|_| request["method"] == "eth_sendRawTransaction");
    let raw = raw.map(|text| crate::model::bytes::unhex(text).expect("hex"));
    let is_poor = |raw: &Vec<u8>| {
        let price = crate::chain::offered(raw).expect("an offer").price;
        price < u128::from(least.load(std::sync::atomic::Ordering::SeqCst))
    };
    let told = if let Some(raw) = raw.filter(is_poor) {
        let hash = Hash(crate::crypto::keccak256(&[&raw])).to_string();
        json!({ "jsonrpc": "2.0", "id": request["id"], "result": hash }).to_string()
    } else {
        let mut node = std::net::TcpStream::connect(upstream)?;
        let head =
            format!("POST / HTTP/1.1\r\nHost: n\r\nContent-Type: application/json\r\nContent-Length: {length}\r\n");
        node.write_all(&[head.as_bytes(), b"Connection: close\r\n\r\n", &body].concat())?;
        let mut answer = String::new();
        node.read_to_string(&mut answer)?;
        answer.split_once("\r\n\r\n").expect("an answer").1.to_owned()
    };
    let head = "HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nConnection: close\r\nContent-Length: ";
    client.write_all(format!("{head}{}\r\n\r\n{told}", told.len()).as_bytes())
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
    let open = process.plant.ledger.lanes.open_transactions(process.eoa.address()).expect("open");
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
            let open = process.plant.ledger.lanes.open_transactions(process.eoa.address()).expect("open");
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
    assert!(matches!(paused(&process), Some(PauseReason::NoEther(_))), "told at once");
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
    assert!(matches!(too_much, Err(PipelineError::NoEther(lacking)) if lacking.account == process.eoa.address()));
    process.round().await;
    assert_eq!(process.sender.state_of(process.eoa.address()).expect("state").open, 0, "nothing was kept of it");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cancelled_transaction_gives_its_records_back() {
    let Some(node) = Anvil::start("a_cancelled_transaction_gives_its_records_back", &[]) else { return };
    let process = node.process(None, 3).await;
    let (chain, account) = (process.network.chain.clone(), process.eoa.address());
    node.call("evm_setAutomine", json!([false])).await;
    process.anchor(3).await;
    let first = process.plant.ledger.lanes.open_lane(account).expect("open")[0].clone();
    let cancelled = process.sender.cancel(&chain, &process.eoa, first.nonce).await.expect("cancelled");
    assert_eq!((cancelled.anchors, cancelled.purpose.as_str()), (true, "dataUpload"));
    assert_eq!((process.count(RecordState::Stored), process.count(RecordState::Submitted)), (1, 2));
    let replaced = process.plant.ledger.lanes.raw_transaction(first.hash).expect("read").expect("kept");
    let old = crate::chain::offered(&replaced).expect("offer").price;
    assert!((cancelled.price.0 - old) * 8 >= old, "an eighth more: {old} {}", cancelled.price);
    // A cancelled one can be cancelled again, at a higher price.
    let again = process.sender.cancel(&chain, &process.eoa, first.nonce).await.expect("cancelled");
    assert!(again.price > cancelled.price && !again.anchors);
    let error = process.sender.cancel(&chain, &process.eoa, first.nonce + 77).await.expect_err("not ours");
    assert!(error.to_string().contains("no transaction with nonce"), "{error}");
    node.call("evm_setAutomine", json!([true])).await;
    node.call("evm_mine", json!([])).await;
    assert!(process.sender.wait_cancelled(&chain, &process.eoa, &again).await.expect("mined").is_some());
    let error = process.sender.cancel(&chain, &process.eoa, first.nonce).await.expect_err("mined");
    assert!(error.to_string().contains("nonce"), "{error}");
    process.work_until("all are confirmed", |process| process.count(RecordState::Confirmed) == 3).await;
    assert!(process.anchored(0..3).await.into_iter().all(|times| times == 1));
}

#[tokio::test(flavor = "multi_thread")]
async fn the_caller_of_a_cancelled_call_is_told() {
    let Some(node) = Anvil::start("the_caller_of_a_cancelled_call_is_told", &[]) else { return };
    let process = node.process(None, 0).await;
    let chain = process.network.chain.clone();
    node.call("evm_setAutomine", json!([false])).await;
    let call = Call::Lend { device: crate::model::SignerId([5; 32]), until: None };
    let cancelling = async {
        let nonce = loop {
            let open = process.plant.ledger.lanes.open_lane(process.eoa.address()).expect("open");
            match open.first() {
                Some(row) => break row.nonce,
                None => tokio::time::sleep(Duration::from_millis(20)).await,
            }
        };
        process.sender.cancel(&chain, &process.eoa, nonce).await.expect("cancelled");
        node.call("evm_setAutomine", json!([true])).await;
        node.call("evm_mine", json!([])).await;
    };
    let (sent, ()) = tokio::join!(process.sender.send(&chain, &process.eoa, call, "lend"), cancelling);
    assert!(matches!(sent, Err(PipelineError::Cancelled(ref purpose)) if purpose == "lend"), "{sent:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_act_that_cannot_be_paid_says_what_is_lacking_and_keeps_nothing() {
    let Some(node) = Anvil::start("an_act_that_cannot_be_paid_says_what_is_lacking_and_keeps_nothing", &[]) else {
        return;
    };
    let process = node.process(None, 0).await;
    node.fund(process.eoa.address(), 7).await;
    let call = Call::Lend { device: crate::model::SignerId([5; 32]), until: None };
    let error = process.sender.send(&process.network.chain, &process.eoa, call, "lend").await.expect_err("poor");
    assert!(matches!(&error, PipelineError::NoEther(lacking) if lacking.held.0 == 7 && lacking.needed.0 > 1_000_000));
    let text = error.to_string();
    assert!(text.contains(&process.eoa.address().to_string()) && text.contains("it has 7 wei and needs"), "{text}");
    assert_eq!(process.sender.state_of(process.eoa.address()).expect("state").open, 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_node_that_is_behind_its_own_head_raises_no_alarm_about_money() {
    let name = "a_node_that_is_behind_its_own_head_raises_no_alarm_about_money";
    let Some(node) = Anvil::start(name, &[]) else { return };
    let process = node.process(None, 1).await;
    process.sender.see_head(1_000_000);
    node.fund(process.eoa.address(), 0).await;
    process.anchor(1).await;
    assert!(
        matches!(paused(&process), Some(PauseReason::CatchingUp { highest: 1_000_000, .. })),
        "{:?}",
        paused(&process)
    );
    assert_eq!((process.notes.with("ether"), process.notes.with("catching up")), (0, 0));
    node.fund(process.eoa.address(), 1_000_000_000 * GWEI).await;
    expect_all_once(&process, 1).await;
    assert_eq!(process.notes.with("resumes"), 0, "nothing was told");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_floor_that_was_raised_is_offered_by_what_waits() {
    let Some(node) = Anvil::start("a_floor_that_was_raised_is_offered_by_what_waits", &[]) else { return };
    let process = node.process(Some(50 * GWEI), 2).await;
    node.call("evm_setAutomine", json!([false])).await;
    process.anchor(2).await;
    process.sender.note_needed(40 * GWEI);
    process
        .rounds_until("both are offered at what was needed", |process| {
            let open = process.plant.ledger.lanes.open_transactions(process.eoa.address()).expect("open");
            open.iter().all(|row| crate::chain::offered(&row.raw).is_ok_and(|offer| offer.price == 40 * GWEI))
        })
        .await;
    node.call("evm_setAutomine", json!([true])).await;
    node.call("evm_mine", json!([])).await;
    expect_all_once(&process, 2).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_blocks_pass_by_is_raised_until_it_is_taken_and_the_rest_follows() {
    let name = "what_blocks_pass_by_is_raised_until_it_is_taken_and_the_rest_follows";
    let Some(node) = Anvil::start(name, &["--block-time", "0.1"]) else { return };
    let dear = Dear::before(&node);
    let process = node.process_at(&dear.url, Some(20 * GWEI), 3).await;
    let quoted = process.network.chain.market().await.expect("market").offer();
    let least = u64::try_from(quoted * 2).expect("small");
    dear.least.store(least, std::sync::atomic::Ordering::SeqCst);
    process.anchor(3).await;
    process
        .rounds_until("it is told", |process| {
            matches!(paused(process), Some(PauseReason::PassedBy { blocks: 6.., .. }))
        })
        .await;
    expect_all_once(&process, 3).await;
    for row in 0..3 {
        let record =
            process.plant.ledger.records.find(crate::pipeline::fixture::digest(row)).expect("read").expect("kept");
        let raw =
            process.plant.ledger.lanes.raw_transaction(record.transaction.expect("one")).expect("read").expect("kept");
        let price = crate::chain::offered(&raw).expect("offer").price;
        assert!((u128::from(least)..=20 * GWEI).contains(&price), "{price}");
    }
    process.rounds_until("it goes on", |process| paused(process).is_none()).await;
    assert_eq!((process.notes.with("not included in"), process.notes.with("resumes")), (1, 1));
    assert!(process.sender.policy().floor >= u128::from(least), "the next ones offer it from the start");
}
