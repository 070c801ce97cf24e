//! A real Ethereum node (anvil), with the few calls the tests make to it themselves.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::PathBuf;
use std::process::Command;
use std::time::Duration;

use serde_json::{Value, json};
use tempfile::TempDir;

use super::npm_program;
use super::process::Running;

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
    /// Starts one; `None` where it is not installed.
    pub fn start(arguments: &[&str]) -> Option<Self> {
        let program = npm_program("anvil")?;
        let directory = tempfile::Builder::new().prefix("anvil").tempdir().expect("a temporary directory");
        let mut command = Command::new(program);
        command.args(["--host", "127.0.0.1", "--port", "0", "--ipc"]).arg(directory.path().join("node.ipc"));
        command.args(arguments).env("HOME", directory.path()).current_dir(directory.path());
        let mut node = Running::start(command);
        let said = node.wait_for_text("Listening on 127.0.0.1:", 30);
        let port = said.rsplit("Listening on 127.0.0.1:").next().and_then(|rest| rest.split_whitespace().next());
        let port = port.and_then(|port| port.parse().ok()).expect("the port it says");
        Some(Self { node, port, directory })
    }

    /// Its URL for plain requests.
    pub fn http(&self) -> String {
        format!("http://127.0.0.1:{}", self.port)
    }

    /// Its URL for a WebSocket.
    pub fn ws(&self) -> String {
        format!("ws://127.0.0.1:{}", self.port)
    }

    /// Its local socket.
    pub fn ipc(&self) -> PathBuf {
        self.directory.path().join("node.ipc")
    }

    /// One JSON-RPC call that must succeed.
    pub fn call(&self, method: &str, parameters: &Value) -> Value {
        let body = json!({ "jsonrpc": "2.0", "id": 1, "method": method, "params": parameters }).to_string();
        let mut stream = TcpStream::connect(("127.0.0.1", self.port)).expect("the node accepts");
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

    /// Gives an account 100 ether.
    pub fn fund(&self, address: &str) {
        self.call("anvil_setBalance", &json!([address, "0x56bc75e2d63100000"]));
    }

    /// Every log of a contract, as one line of hex each: topics, then data.
    pub fn logs(&self, contract: &str) -> Vec<String> {
        let filter = json!([{ "fromBlock": "0x0", "toBlock": "latest", "address": contract }]);
        let logs = self.call("eth_getLogs", &filter);
        let line = |log: &Value| format!("{}{}", log["topics"], log["data"]).to_lowercase();
        logs.as_array().expect("logs").iter().map(line).collect()
    }
}
