//! Nodes whose logs lag behind their own head, and nodes that find a question too wide: played in front of the embedded
//! chain.

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use async_trait::async_trait;
use serde_json::{Value, json};

use super::*;

/// The widest question is refused like this.
#[derive(Clone, Copy)]
enum Refusal {
    Words,
    WebPage,
    Silence,
}

/// A chain behind a node with faults.
struct Node {
    chain: Chain,
    /// How far its logs lag behind its head.
    behind: AtomicU64,
    /// Whether it refuses to give logs of a block that it does not have, rather than say that there are none.
    refuses: bool,
    /// Whether its headers name the logs of their blocks.
    blooms: bool,
    receipts: bool,
    /// The most blocks of a question for logs.
    most: Option<(u64, Refusal)>,
    asked: Mutex<Vec<String>>,
}

impl Node {
    fn before(chain: &Chain) -> Self {
        Self {
            chain: chain.clone(),
            behind: AtomicU64::new(0),
            refuses: true,
            blooms: true,
            receipts: true,
            most: None,
            asked: Mutex::default(),
        }
    }

    fn times(&self, method: &str) -> usize {
        self.asked.lock().expect("held by nobody").iter().filter(|asked| *asked == method).count()
    }

    async fn logs(&self, filter: &Value) -> Result<Value, RelayError> {
        let seen = self.chain.head().await.expect("head").number.saturating_sub(self.behind.load(Ordering::SeqCst));
        if let Some(hash) = filter.get("blockHash") {
            let block = self.chain.relay("eth_getBlockByHash", &json!([hash, false])).await?;
            if quantity(&block["number"]) > seen {
                let message = "unknown block".to_owned();
                let refused = Err(RelayError::Answered { code: -32000, message, data: None });
                return if self.refuses { refused } else { Ok(json!([])) };
            }
            return self.chain.relay("eth_getLogs", &json!([filter])).await;
        }
        let (from, to) = (quantity(&filter["fromBlock"]), quantity(&filter["toBlock"]));
        if let Some((_, refusal)) = self.most.filter(|(most, _)| to - from >= *most) {
            return match refusal {
                Refusal::Words => {
                    let message = "query returned more than 3 results".to_owned();
                    Err(RelayError::Answered { code: -32005, message, data: None })
                }
                Refusal::WebPage => Ok(json!("<html>413</html>")),
                Refusal::Silence => Err(RelayError::Silent("no answer within 20 s".to_owned())),
            };
        }
        if from > seen {
            return Ok(json!([]));
        }
        let mut filter = filter.clone();
        filter["toBlock"] = json!(format!("{:#x}", to.min(seen)));
        self.chain.relay("eth_getLogs", &json!([filter])).await
    }
}

fn quantity(value: &Value) -> u64 {
    u64::from_str_radix(value.as_str().expect("a quantity").trim_start_matches("0x"), 16).expect("hex")
}

#[async_trait]
impl Relay for Node {
    async fn ask(&self, method: &str, parameters: Value) -> Result<Value, RelayError> {
        self.asked.lock().expect("held by nobody").push(method.to_owned());
        if method == "eth_getLogs" {
            return self.logs(&parameters[0]).await;
        }
        if method == "eth_getTransactionReceipt" && !self.receipts {
            return Ok(Value::Null);
        }
        let mut answer = self.chain.relay(method, &parameters).await?;
        if method == "eth_getBlockByNumber" && !self.blooms && answer.is_object() {
            answer["logsBloom"] = json!(format!("0x{}", "00".repeat(256)));
        }
        Ok(answer)
    }

    fn place(&self) -> String {
        "a node with faults".to_owned()
    }
}

async fn through(node: &Arc<Node>) -> Chain {
    let contract = node.chain.pin().map(|pin| pin.contract);
    let relay: Arc<dyn Relay> = Arc::clone(node) as Arc<dyn Relay>;
    let endpoint = Endpoint::Relay(RelayLine(relay));
    let options = ChainOptions { endpoint, contract, pinned: None };
    Chain::connect(options).await.expect("connects")
}

/// A chain with this number of uploads, each in a block.
async fn uploads(directory: &Path, count: u64) -> (Chain, EoaSecret) {
    let (chain, eoa, _) = site(directory).await;
    for number in 0..count {
        assert!(send(&chain, &eoa, &upload(number, 1)).await.success);
    }
    (chain, eoa)
}

async fn head_of(chain: &Chain) -> u64 {
    chain.head().await.expect("head").number
}

#[tokio::test(flavor = "multi_thread")]
async fn a_block_is_read_whole_though_the_logs_of_its_node_come_late() {
    let home = tempfile::tempdir().expect("folder");
    let (chain, _) = uploads(home.path(), 6).await;
    let head = head_of(&chain).await;
    for (behind, refuses) in [(1, true), (2, false), (5, true), (5, false)] {
        let node = Arc::new(Node { behind: AtomicU64::new(behind), refuses, ..Node::before(&chain) });
        let client = through(&node).await;
        let all = chain.events(0, head).await.expect("events");
        for number in 0..=head {
            let read = client.block_events(number).await.expect("answers").expect("there");
            let expected: Vec<_> = all.iter().filter(|at| at.block == number).cloned().collect();
            assert_eq!((read.events, read.completeness), (expected, Completeness::Whole), "block {number}");
        }
        assert_eq!(client.events(0, u64::MAX).await, Ok(all), "{behind} behind");
        assert_eq!(client.block_events(head + 1).await, Ok(None));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_block_without_events_costs_one_question_and_one_with_events_two() {
    let home = tempfile::tempdir().expect("folder");
    let (chain, eoa) = uploads(home.path(), 1).await;
    let with = head_of(&chain).await;
    let nonce = chain.nonce(eoa.address(), true).await.expect("nonce");
    let transfer = chain.sign_transfer(&eoa, nonce, eoa.address(), 0, 0).expect("signs");
    chain.broadcast(&transfer.raw).await.expect("sent");
    let without = mined(&chain, transfer.hash).await.block;
    let node = Arc::new(Node::before(&chain));
    let client = through(&node).await;
    client.block_events(with).await.expect("the first one also asks whether there are blooms");
    let before = node.asked.lock().expect("held by nobody").len();
    assert!(client.block_events(with).await.expect("answers").is_some());
    assert_eq!(node.asked.lock().expect("held by nobody").len() - before, 2);
    // An empty bloom over a transaction may be that of a node that makes none, so that block is asked for as well.
    let bare = client.block_events(without).await.expect("answers").expect("there");
    assert_eq!((bare.events.len(), bare.completeness), (0, Completeness::Unconfirmed));
    let before = node.asked.lock().expect("held by nobody").len();
    assert!(client.block_events(0).await.expect("answers").is_some());
    assert_eq!(node.asked.lock().expect("held by nobody").len() - before, 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_header_names_and_nobody_gives_is_doubted() {
    let home = tempfile::tempdir().expect("folder");
    let (chain, _) = uploads(home.path(), 1).await;
    let head = head_of(&chain).await;
    for refuses in [true, false] {
        let behind = AtomicU64::new(1);
        let node = Arc::new(Node { behind, refuses, receipts: false, ..Node::before(&chain) });
        let client = through(&node).await;
        let read = client.block_events(head).await.expect("answers").expect("there");
        assert_eq!((read.events.len(), read.completeness), (0, Completeness::Doubtful));
        assert!(node.times("eth_getLogs") <= 3 && node.times("eth_getTransactionReceipt") == 1, "a bounded effort");
        node.behind.store(0, Ordering::SeqCst);
        let read = client.block_events(head).await.expect("answers").expect("there");
        assert_eq!((read.events.len(), read.completeness), (1, Completeness::Whole));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn where_headers_name_nothing_an_answer_waits_to_be_confirmed() {
    let home = tempfile::tempdir().expect("folder");
    let (chain, _) = uploads(home.path(), 1).await;
    let head = head_of(&chain).await;
    let node = Arc::new(Node { behind: AtomicU64::new(1), refuses: false, blooms: false, ..Node::before(&chain) });
    let client = through(&node).await;
    let read = client.block_events(head).await.expect("answers").expect("there");
    assert_eq!((read.events.len(), read.completeness), (0, Completeness::Unconfirmed));
    // A node that refuses is believed: then the receipts are asked.
    let node = Arc::new(Node { behind: AtomicU64::new(1), blooms: false, ..Node::before(&chain) });
    let read = through(&node).await.block_events(head).await.expect("answers").expect("there");
    assert_eq!((read.events.len(), read.completeness), (1, Completeness::Whole));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wide_question_is_asked_in_halves_whatever_is_wrong_with_it() {
    let home = tempfile::tempdir().expect("folder");
    let (chain, _) = uploads(home.path(), NEAR + 10).await;
    let all = chain.events(0, u64::MAX).await;
    for refusal in [Refusal::Words, Refusal::WebPage, Refusal::Silence] {
        for most in [1, 3] {
            let node = Arc::new(Node { most: Some((most, refusal)), ..Node::before(&chain) });
            let client = through(&node).await;
            assert_eq!(client.pin(), chain.pin(), "the block of the contract is found");
            assert_eq!(client.events(0, u64::MAX).await, all);
        }
    }
    let node = Arc::new(Node { most: Some((0, Refusal::WebPage)), ..Node::before(&chain) });
    let options = ChainOptions {
        endpoint: Endpoint::Relay(RelayLine(node as Arc<dyn Relay>)),
        contract: None,
        pinned: chain.pin(),
    };
    let client = Chain::connect(options).await.expect("connects");
    let error = client.events(0, u64::MAX).await.expect_err("not even one block");
    assert!(matches!(error, ChainError::Answer { .. }), "{error}");
}
