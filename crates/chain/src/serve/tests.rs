//! The server over real sockets: through this program's own client, and with hand-written requests.

use std::path::Path;

use serde_json::{Value, json};
use tokio::sync::oneshot;
use tokio::task::JoinHandle;

use super::*;
use crate::crypto::EoaSecret;
use crate::model::ErrorKind;
use crate::{ChainOptions, Consensus, Endpoint};

const BOUND: Duration = Duration::from_secs(60);

/// Whether a call is answered on a connection that stays open.
async fn is_answered(stream: &mut TcpStream, call: &str) -> bool {
    let (mut answer, request) = (vec![0; 17], request(call, "keep-alive"));
    if stream.write_all(request.as_bytes()).await.is_err() {
        return false;
    }
    let read = timeout(BOUND, stream.read_exact(&mut answer)).await.expect("an answer");
    if read.is_err() || answer != b"HTTP/1.1 200 OK\r\n" {
        return false;
    }
    while !answer.ends_with(b"}") {
        answer.push(timeout(BOUND, stream.read_u8()).await.expect("the rest").expect("reads"));
    }
    true
}

struct Served {
    chain: Chain,
    address: SocketAddr,
    stop: oneshot::Sender<()>,
    task: JoinHandle<Result<(), ChainError>>,
}

fn options(endpoint: Endpoint) -> ChainOptions {
    ChainOptions { endpoint, contract: None, pinned: None }
}

async fn embedded(directory: &Path, consensus: Option<Consensus>) -> Chain {
    let endpoint = Endpoint::Embedded { directory: directory.to_owned(), consensus };
    Chain::connect(options(endpoint)).await.expect("opens")
}

async fn serve(directory: &Path, limits: Limits, consensus: Option<Consensus>) -> Served {
    let chain = embedded(directory, consensus).await;
    let listener = listen("127.0.0.1:0".parse().expect("address")).await.expect("listens");
    let address = listener.local_addr().expect("address");
    let (stop, stopped) = oneshot::channel::<()>();
    let served = chain.clone();
    let task = tokio::spawn(async move {
        let stop = async { drop(stopped.await) };
        served.serve_within(limits, listener, stop).await
    });
    Served { chain, address, stop, task }
}

impl Served {
    async fn client(&self) -> Chain {
        let url = format!("http://{}", self.address);
        Chain::connect(options(Endpoint::Node { url, roots: None })).await.expect("connects")
    }

    /// Sends bytes and returns everything received until the end.
    async fn raw(&self, bytes: &[u8]) -> String {
        let mut stream = TcpStream::connect(self.address).await.expect("connects");
        stream.write_all(bytes).await.expect("writes");
        answer_of(&mut stream).await
    }

    /// Sends bytes and no more, and returns everything received until the end.
    async fn cut(&self, bytes: &[u8]) -> String {
        let mut stream = TcpStream::connect(self.address).await.expect("connects");
        // One that refuses the rest has already answered.
        drop(stream.write_all(bytes).await);
        drop(stream.shutdown().await);
        answer_of(&mut stream).await
    }

    /// A connection that was answered and stays open; retried while earlier ones still have their place.
    async fn kept(&self, call: &str) -> TcpStream {
        let deadline = tokio::time::Instant::now() + BOUND;
        loop {
            let mut stream = TcpStream::connect(self.address).await.expect("connects");
            if is_answered(&mut stream, call).await {
                return stream;
            }
            assert!(tokio::time::Instant::now() < deadline, "no place is given back");
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    }

    /// Posts a body on a connection of its own.
    async fn post(&self, body: &str) -> Value {
        let answer = self.raw(request(body, "close").as_bytes()).await;
        let (head, body) = answer.split_once("\r\n\r\n").expect("a head");
        assert!(head.starts_with("HTTP/1.1 200 OK\r\n"), "{head}");
        if body.is_empty() { Value::Null } else { serde_json::from_str(body).expect("JSON") }
    }

    async fn ask(&self, method: &str, parameters: Value) -> Value {
        let body = json!({ "jsonrpc": "2.0", "id": 7, "method": method, "params": parameters });
        let answer = self.post(&body.to_string()).await;
        assert_eq!((&answer["jsonrpc"], &answer["id"]), (&json!("2.0"), &json!(7)));
        answer.get("result").or_else(|| answer.get("error")).cloned().expect("an answer")
    }
}

fn request(body: &str, connection: &str) -> String {
    format!(
        "POST / HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nConnection: {connection}\r\n\
         Content-Length: {}\r\n\r\n{body}",
        body.len()
    )
}

async fn answer_of(stream: &mut TcpStream) -> String {
    let mut answer = Vec::new();
    timeout(BOUND, stream.read_to_end(&mut answer)).await.expect("an end").expect("reads");
    String::from_utf8(answer).expect("text")
}

#[tokio::test(flavor = "multi_thread")]
async fn another_client_reads_and_sends() {
    for consensus in [Consensus::POA, Consensus::Pow { difficulty: 500 }] {
        let home = tempfile::tempdir().expect("folder");
        let served = serve(home.path(), LIMITS, Some(consensus)).await;
        let client = served.client().await;
        let pin = client.deploy(&EoaSecret::generate().expect("key")).await.expect("deploys");
        assert_eq!(served.chain.use_contract(pin.contract).await, Ok(pin.clone()));
        assert_eq!((client.chain_id(), client.genesis()), (served.chain.chain_id(), served.chain.genesis()));
        let (near, far) = (served.chain.events(0, u64::MAX).await, client.events(0, u64::MAX).await);
        assert!(near.as_ref().is_ok_and(|events| !events.is_empty()) && near == far);
        let status = client.status(None).await.expect("status");
        assert_eq!((status.kind.as_str(), status.consensus.as_str()), ("node", consensus.word()));
        assert_eq!(status.client, served.chain.status(None).await.expect("status").client);
        let (near, far) = (served.chain.sealing().await.expect("near"), client.sealing().await.expect("far"));
        match consensus {
            Consensus::Poa { .. } => assert_eq!(far.sealers, near.sealers),
            Consensus::Pow { .. } => assert_eq!(far.difficulty, near.difficulty),
        }
        let stop =
            client.serve(listen("127.0.0.1:0".parse().expect("address")).await.expect("listens"), async {}).await;
        assert!(stop.expect_err("a node").to_string().contains("is the node at"));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn requests_batches_and_mistakes() {
    let home = tempfile::tempdir().expect("folder");
    let served = serve(home.path(), LIMITS, None).await;
    let id = json!(format!("{:#x}", served.chain.chain_id()));
    assert_eq!(served.ask("eth_chainId", json!([])).await, id);
    let code = |answer: &Value| answer["error"]["code"].as_i64();
    for (body, expected) in [
        ("nonsense", -32700),
        ("", -32700),
        ("7", -32600),
        ("[]", -32600),
        (r#"{"jsonrpc":"1.0","id":1,"method":"eth_chainId"}"#, -32600),
        (r#"{"jsonrpc":"2.0","id":1}"#, -32600),
        (r#"{"jsonrpc":"2.0","id":1,"method":"eth_chainId","params":{"a":1}}"#, -32602),
        (r#"{"jsonrpc":"2.0","id":1,"method":"eth_getBalance","params":[]}"#, -32602),
        (r#"{"jsonrpc":"2.0","id":1,"method":"eth_sendTransaction","params":[{}]}"#, -32601),
        (r#"{"jsonrpc":"2.0","id":1,"method":"personal_listAccounts"}"#, -32601),
        (r#"{"jsonrpc":"2.0","id":1,"method":"eth_sign","params":[]}"#, -32601),
        (r#"{"jsonrpc":"2.0","id":1,"method":"personal_unlockAccount"}"#, -32601),
        (r#"{"jsonrpc":"2.0","id":1,"method":"admin_addPeer","params":[]}"#, -32601),
        (r#"{"jsonrpc":"2.0","id":1,"method":"miner_stop"}"#, -32601),
        (r#"{"jsonrpc":"2.0","id":1,"method":"eth_subscribe","params":["newHeads"]}"#, -32601),
        (r#"{"jsonrpc":"2.0","id":1,"method":"eth_sendRawTransaction","params":["0xf8"]}"#, -32000),
    ] {
        assert_eq!(code(&served.post(body).await), Some(expected), "{body}");
    }
    let deep = "[".repeat(100_000);
    assert_eq!(code(&served.post(&deep).await), Some(-32700));
    let one = |id: Value| json!({ "jsonrpc": "2.0", "id": id, "method": "eth_chainId", "params": [] });
    let notification = json!({ "jsonrpc": "2.0", "method": "eth_chainId" });
    let batch = json!([one(json!("a")), notification, one(json!(2)), 5]).to_string();
    let answers = served.post(&batch).await;
    let ids: Vec<&Value> = answers.as_array().expect("a batch").iter().map(|answer| &answer["id"]).collect();
    assert_eq!(ids, [&json!("a"), &json!(2), &Value::Null]);
    assert_eq!(answers[0]["result"], id);
    assert_eq!(code(&answers[2]), Some(-32600));
    assert_eq!(served.post(&notification.to_string()).await, Value::Null);
    assert_eq!(served.post(&json!([notification]).to_string()).await, Value::Null);
    let most: Vec<Value> = (0..100).map(|id| one(json!(id))).collect();
    assert_eq!(served.post(&json!(most).to_string()).await.as_array().map(Vec::len), Some(100));
    let more: Vec<Value> = (0..101).map(|id| one(json!(id))).collect();
    assert_eq!(code(&served.post(&json!(more).to_string()).await), Some(-32600));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_block_is_found_by_number_and_by_hash_and_so_are_its_logs_and_transactions() {
    let home = tempfile::tempdir().expect("folder");
    let served = serve(home.path(), LIMITS, None).await;
    let pin = served.chain.deploy(&EoaSecret::generate().expect("key")).await.expect("deploys");
    let newest = served.ask("eth_getBlockByNumber", json!(["latest", false])).await;
    let found = served.ask("eth_getLogs", json!([{ "blockHash": newest["hash"] }])).await;
    assert!(found.as_array().is_some_and(|found| !found.is_empty()));
    assert_eq!(found[0]["address"], json!(pin.contract.to_string().to_lowercase()));
    assert_eq!(served.ask("eth_getLogs", json!([{ "topics": ["0x12"] }])).await["code"], json!(-32602));
    let number = newest["number"].clone();
    assert_eq!(served.ask("eth_getBlockTransactionCountByNumber", json!([number])).await, json!("0x1"));
    assert_eq!(served.ask("eth_getBlockTransactionCountByHash", json!([newest["hash"]])).await, json!("0x1"));
    assert_eq!(served.ask("eth_getBlockTransactionCountByNumber", json!(["0xffff"])).await, Value::Null);
    let sent = served.ask("eth_getTransactionByBlockNumberAndIndex", json!([number, "0x0"])).await;
    assert_eq!(sent["hash"], newest["transactions"][0]);
    let none = served.ask("eth_getTransactionByBlockHashAndIndex", json!([newest["hash"], "0x1"])).await;
    assert_eq!(none, Value::Null);
}

const CHAIN_ID: &str = r#"{"jsonrpc":"2.0","id":1,"method":"eth_chainId"}"#;

#[tokio::test(flavor = "multi_thread")]
async fn strangers_and_spendthrifts_are_refused() {
    let home = tempfile::tempdir().expect("folder");
    let served = serve(home.path(), LIMITS, None).await;
    let good = request(CHAIN_ID, "close");
    let large = format!("{}{}", request("", "close").replace("Length: 0", "Length: 2000000"), "x".repeat(100_000));
    for (request, status) in [
        (good.replace("localhost", "rebound.example"), "403"),
        (good.replace("Host:", "Origin: http://page.example\r\nHost:"), "403"),
        (good.replace("POST", "GET"), "405"),
        (good.replace("application/json", "text/plain"), "415"),
        (large, "413"),
        ("\u{0}\r\n\r\n".to_owned(), "400"),
    ] {
        let answer = served.raw(request.as_bytes()).await;
        assert!(answer.starts_with(&format!("HTTP/1.1 {status} ")), "{status}: {answer}");
        assert!(!answer.contains("jsonrpc"));
    }
}

const HEADS: &str =
    "POST / HTTP/1.1\r\nHost: 127.0.0.1:8545\r\nConnection: close\r\nContent-Type: application/json\r\n";

#[tokio::test(flavor = "multi_thread")]
async fn only_json_rpc_from_this_machine_is_answered() {
    let home = tempfile::tempdir().expect("folder");
    let served = serve(home.path(), LIMITS, None).await;
    let with = |head: &str| format!("{HEADS}{head}\r\n\r\n");
    let replaced = |from: &str, to: &str| format!("{HEADS}Content-Length: 0\r\n\r\n").replace(from, to);
    for (expected, request) in [
        ("200", replaced("", "")),
        ("405", replaced("POST", "GET")),
        ("405", replaced("POST", "OPTIONS")),
        ("404", replaced("POST /", "POST /x")),
        ("400", replaced("HTTP/1.1", "HTTP/2")),
        ("400", replaced("POST / ", "POST /")),
        ("400", replaced("Host: 127.0.0.1:8545\r\n", "")),
        ("400", replaced("Host: 127.0.0.1:8545\r\n", "Host: localhost\r\nHost: localhost\r\n")),
        ("403", replaced("127.0.0.1:8545", "evil.example:8545")),
        ("403", replaced("127.0.0.1:8545", "127.0.0.1.evil.example")),
        ("403", replaced("127.0.0.1:8545", "localhost:8545@evil.example")),
        ("403", replaced("127.0.0.1:8545", "10.0.0.1")),
        ("403", replaced("Host:", "Origin: http://127.0.0.1\r\nHost:")),
        ("415", replaced("application/json", "text/plain")),
        ("415", replaced("Content-Type", "X-Type")),
        ("411", replaced("Content-Length: 0", "X: y")),
        ("411", replaced("Content-Length: 0", "Transfer-Encoding: chunked")),
        ("400", with("Content-Length: -1")),
        ("400", with("Content-Length: 1\r\nContent-Length: 1")),
        ("413", with("Content-Length: 1048577")),
        ("400", with("Content-Length: 99999999999999999999999")),
        ("400", with("no colon")),
        ("400", with(" folded: line")),
        ("431", with(&"x: y\r\n".repeat(4000))),
        ("431", "P".repeat(20_000)),
        ("400", "\u{e9}\u{e9}\r\n\r\n".to_owned()),
    ] {
        let answer = served.cut(request.as_bytes()).await;
        assert!(answer.starts_with(&format!("HTTP/1.1 {expected} ")), "{request:.300}: {answer}");
        assert!(expected == "200" || answer.contains("onnection: close") || expected == "400" || expected == "431");
    }
    for host in ["127.9.9.9", "[::1]:1", "[::1]", "localhost:1", "LOCALHOST"] {
        let answer = served.cut(replaced("127.0.0.1:8545", host).as_bytes()).await;
        assert!(answer.starts_with("HTTP/1.1 200 "), "{host}");
    }
    for gone in [String::new(), with("Content-Length: 1048576"), HEADS.to_owned()] {
        assert!(!served.cut(gone.as_bytes()).await.contains("jsonrpc"), "{gone}");
    }
    let polite = "POST / HTTP/1.1\nhost: LOCALHOST\ncontent-type: Application/JSON; charset=utf-8\nconnection: Close\n\
                  expect: 100-continue\ncontent-length: 2\n\n[]";
    let answer = served.raw(polite.as_bytes()).await;
    assert!(answer.starts_with("HTTP/1.1 100 Continue\r\n\r\nHTTP/1.1 200 OK\r\n"), "{answer}");
    assert!(answer.to_lowercase().contains("x-content-type-options: nosniff\r\n"), "{answer}");
}

proptest::proptest! {
    #![proptest_config(proptest::prelude::ProptestConfig::with_cases(64))]
    #[test]
    fn noise_is_never_taken_for_a_request(noise in "(POST / HTTP/1.1\r\n|Host: localhost\r\n|Content-Length: |\r\n|\n|[0-9]|.){0,40}") {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("runtime");
        let answer = runtime.block_on(async {
            let home = tempfile::tempdir().expect("folder");
            serve(home.path(), LIMITS, None).await.cut(noise.as_bytes()).await
        });
        proptest::prop_assert!(!answer.contains("jsonrpc"), "{answer}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn two_connections_stay_open_and_there_is_no_third() {
    let home = tempfile::tempdir().expect("folder");
    let served = serve(home.path(), Limits { connections: 2, ..LIMITS }, None).await;
    let (call, good) = (CHAIN_ID, request(CHAIN_ID, "close"));
    let (mut first, mut second) = (served.kept(call).await, served.kept(call).await);
    for stream in [&mut first, &mut second] {
        for _ in 0..3 {
            assert!(is_answered(stream, call).await);
        }
    }
    let mut third = TcpStream::connect(served.address).await.expect("connects");
    assert!(answer_of(&mut third).await.starts_with("HTTP/1.1 503 "));
    drop((first, second));
    let deadline = tokio::time::Instant::now() + BOUND;
    while !served.raw(good.as_bytes()).await.starts_with("HTTP/1.1 200 ") {
        assert!(tokio::time::Instant::now() < deadline, "no place is given back");
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_slow_caller_loses_its_connection() {
    let home = tempfile::tempdir().expect("folder");
    let hasty = Limits { patience: Duration::from_millis(200), ..LIMITS };
    let served = serve(home.path(), hasty, None).await;
    for beginning in [
        "",
        "POST / HT",
        "POST / HTTP/1.1\r\nHost: localhost\r\n",
        &request("{", "close").replace("Length: 1", "Length: 9"),
    ] {
        let answer = served.raw(beginning.as_bytes()).await;
        assert!(answer.starts_with("HTTP/1.1 408 "), "{beginning}: {answer}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_chain_that_takes_too_long_is_not_waited_for() {
    let home = tempfile::tempdir().expect("folder");
    let served = serve(home.path(), Limits { work: Duration::ZERO, ..LIMITS }, None).await;
    let one = json!({ "jsonrpc": "2.0", "id": 1, "method": "eth_chainId" });
    let (batch, deadline) = (json!(vec![one; 100]).to_string(), tokio::time::Instant::now() + BOUND);
    // An answer that is ready at once is given even then.
    while !served.raw(request(&batch, "close").as_bytes()).await.starts_with("HTTP/1.1 503 ") {
        assert!(tokio::time::Instant::now() < deadline, "the chain is waited for");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_end_closes_all_and_frees_the_chain() {
    let home = tempfile::tempdir().expect("folder");
    let Served { chain, address, stop, task } = serve(home.path(), LIMITS, None).await;
    let mut idle = TcpStream::connect(address).await.expect("connects");
    stop.send(()).expect("still serving");
    assert_eq!(timeout(BOUND, task).await.expect("ends").expect("joins"), Ok(()));
    // Closed or reset: either way it ended.
    let mut rest = Vec::new();
    drop(timeout(BOUND, idle.read_to_end(&mut rest)).await.expect("ends"));
    assert!(rest.is_empty() && TcpStream::connect(address).await.is_err());
    let genesis = chain.genesis();
    drop(chain);
    assert_eq!(embedded(home.path(), None).await.genesis(), genesis);
}

#[tokio::test]
async fn only_this_machine_may_ask() {
    for address in ["0.0.0.0:0", "[::]:0", "192.0.2.1:8545"] {
        let error = listen(address.parse().expect("address")).await.expect_err(address);
        assert_eq!(error.kind(), ErrorKind::Input);
        assert!(error.to_string().contains("127.0.0.1"), "{error}");
    }
    let first = listen("127.0.0.1:0".parse().expect("address")).await.expect("listens");
    let taken = listen(first.local_addr().expect("address")).await.expect_err("taken");
    assert!(taken.to_string().contains("another port"), "{taken}");
}
