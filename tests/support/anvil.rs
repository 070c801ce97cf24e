//! A real Ethereum node (anvil), with the few calls the tests make to it directly.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::PathBuf;
use std::process::Command;
use std::time::Duration;

use serde_json::{Value, json};
use tempfile::TempDir;

use super::process::Running;
use super::{npm_program, poll, unhex};

/// The first account anvil gives ether to, and its published key.
pub const RICH_ADDRESS: &str = "0xf39Fd6e51aad88F6F4ce6aB8827279cffFb92266";
/// Its key, in hex.
pub const RICH_KEY: &str = "ac0974bec39a17e36ba4a6b4d238ff944bacb478cbed5efcae784d7bf4f2ff80";

/// A node on a free port.
#[derive(Debug)]
pub struct Anvil {
    node: Running,
    port: u16,
    directory: TempDir,
}

impl Anvil {
    /// Starts one; `None` if it is not installed.
    pub fn start(arguments: &[&str]) -> Option<Self> {
        let directory = tempfile::Builder::new().prefix("anvil").tempdir().expect("a temporary directory");
        Self::start_at(0, directory, arguments)
    }

    fn start_at(port: u16, directory: TempDir, arguments: &[&str]) -> Option<Self> {
        let program = npm_program("anvil")?;
        let mut command = Command::new(program);
        command.args(["--host", "127.0.0.1", "--port", &port.to_string(), "--ipc"]);
        command.arg(directory.path().join("node.ipc"));
        command.args(arguments).env("HOME", directory.path()).current_dir(directory.path());
        let mut node = Running::start(command);
        let said = node.wait_for_text("Listening on 127.0.0.1:", 30);
        let port = said.rsplit("Listening on 127.0.0.1:").next().and_then(|rest| rest.split_whitespace().next());
        let port = port.and_then(|port| port.parse().ok()).expect("the port it says");
        Some(Self { node, port, directory })
    }

    /// Kills it, which loses all its state, and starts an empty one on the same port.
    pub fn kill_and_start_empty(self, arguments: &[&str]) -> Self {
        self.node.stop("KILL", 10);
        drop(self.directory);
        let directory = tempfile::Builder::new().prefix("anvil").tempdir().expect("a temporary directory");
        Self::start_at(self.port, directory, arguments).expect("it was there before")
    }

    /// Asks it to stop, and starts it on the same port after `meanwhile`.
    pub fn end_and_start_again(self, arguments: &[&str], meanwhile: impl FnOnce()) -> Self {
        self.node.stop("INT", 30);
        meanwhile();
        Self::start_at(self.port, self.directory, arguments).expect("it was there before")
    }

    /// Its port.
    pub fn port(&self) -> u16 {
        self.port
    }

    /// Its URL for plain requests.
    pub fn http(&self) -> String {
        format!("http://127.0.0.1:{}", self.port)
    }

    /// Its local socket.
    pub fn ipc(&self) -> PathBuf {
        self.directory.path().join("node.ipc")
    }

    /// One JSON-RPC call that must succeed.
    pub fn call(&self, method: &str, parameters: &Value) -> Value {
        call(self.port, method, parameters)
    }

    /// Gives an account 100 ether.
    pub fn fund(&self, address: &str) {
        self.set_balance(address, "0x56bc75e2d63100000");
    }

    /// Sets an account's balance, wei in hex.
    pub fn set_balance(&self, address: &str, wei: &str) {
        self.call("anvil_setBalance", &json!([address, wei]));
    }

    /// Every log of a contract, as one line of hex each: topics, then data.
    pub fn logs(&self, contract: &str) -> Vec<String> {
        let line = |log: &Value| format!("{}{}", log["topics"], log["data"]).to_lowercase();
        self.raw_logs(contract).iter().map(line).collect()
    }

    /// Every log of a contract on the chain as it is now.
    pub fn raw_logs(&self, contract: &str) -> Vec<Value> {
        let filter = json!([{ "fromBlock": "0x0", "toBlock": "latest", "address": contract }]);
        self.call("eth_getLogs", &filter).as_array().expect("logs").clone()
    }

    /// Number of the newest block.
    pub fn head(&self) -> u64 {
        number(&self.call("eth_blockNumber", &json!([])))
    }

    /// Mines this many blocks now.
    pub fn mine(&self, blocks: u64) {
        self.call("anvil_mine", &json!([format!("{blocks:#x}")]));
    }

    /// One block every this many seconds from now on; 0 = none automatically.
    pub fn set_interval(&self, seconds: u64) {
        self.call("evm_setIntervalMining", &json!([seconds]));
    }

    /// Replaces the newest blocks by as many empty ones; the node loses their transactions.
    pub fn reorganise(&self, depth: u64) {
        self.call("anvil_reorg", &json!([depth, []]));
    }

    /// How many transactions are pending, including those behind a gap.
    pub fn waiting(&self) -> u64 {
        let status = self.call("txpool_status", &json!([]));
        number(&status["pending"]) + number(&status["queued"])
    }

    /// Waits until at least this many transactions are pending.
    pub fn expect_waiting(&self, least: u64) {
        let enough = poll(60, || (self.waiting() >= least).then_some(()));
        assert!(enough.is_some(), "{} transactions wait at the node, not {least}", self.waiting());
    }

    /// Drops every pending transaction.
    pub fn drop_waiting(&self) {
        self.call("anvil_dropAllTransactions", &json!([]));
    }

    /// Base fee of the newest block, wei.
    pub fn base_fee(&self) -> u64 {
        number(&self.call("eth_getBlockByNumber", &json!(["latest", false]))["baseFeePerGas"])
    }

    /// Sets the base fee of the next block, wei.
    pub fn set_next_base_fee(&self, wei: u64) {
        self.call("anvil_setNextBlockBaseFeePerGas", &json!([format!("{wei:#x}")]));
    }

    /// How many transactions of an account are in blocks.
    pub fn nonce(&self, address: &str) -> u64 {
        number(&self.call("eth_getTransactionCount", &json!([address, "latest"])))
    }
}

/// One JSON-RPC call that must succeed, to any node on this machine.
pub fn call(port: u16, method: &str, parameters: &Value) -> Value {
    let body = json!({ "jsonrpc": "2.0", "id": 1, "method": method, "params": parameters }).to_string();
    let mut stream = TcpStream::connect(("127.0.0.1", port)).expect("the node accepts");
    stream.set_read_timeout(Some(Duration::from_secs(30))).expect("a read limit");
    let head = format!(
        "POST / HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\nConnection: close\r\n\
             Content-Length: {}\r\n\r\n",
        body.len()
    );
    stream.write_all((head + &body).as_bytes()).expect("the request is sent");
    let mut answer = String::new();
    stream.read_to_string(&mut answer).expect("the answer is read");
    let (_, document) = answer.split_once("\r\n\r\n").expect("an HTTP answer");
    let document: Value = serde_json::from_str(document).expect("a JSON answer");
    assert!(document.get("error").is_none(), "{method}: {document}");
    document["result"].clone()
}

/// A quantity of JSON-RPC.
pub fn number(value: &Value) -> u64 {
    let text = value.as_str().unwrap_or_else(|| panic!("no quantity: {value}"));
    u64::from_str_radix(text.trim_start_matches("0x"), 16).unwrap_or_else(|_| panic!("no quantity: {value}"))
}

/// Word `index` of a log's data.
pub fn word(log: &Value, index: usize) -> Vec<u8> {
    unhex(log["data"].as_str().expect("data"))[32 * index..32 * (index + 1)].to_vec()
}
