//! The embedded chain through `chain serve`, and strangers who sign for it with their own keys.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

use ethers::types::transaction::eip2718::TypedTransaction;
use ethers::types::{H160, TransactionRequest};
use ethers_signers::LocalWallet;
use serde_json::{Value, json};

use crate::support::{Home, Running, text};

/// How long an answer may take.
const PATIENCE: Duration = Duration::from_secs(20);

/// Gas for a call of the contract beyond what it needs.
const CALL_GAS: u64 = 1_000_000;

/// The account of a numbered stranger.
pub fn account_of(stranger: u8) -> H160 {
    use ethers_signers::Signer as _;
    LocalWallet::from_bytes(&[stranger; 32]).expect("a key").address()
}

/// A node, over HTTP.
pub struct Line {
    address: SocketAddr,
    chain_id: u64,
    /// The gas price that a transaction offers, wei.
    price: u64,
}

/// An embedded chain that is served.
pub struct Served {
    site: Running,
    line: Line,
}

impl std::ops::Deref for Served {
    type Target = Line;

    fn deref(&self) -> &Line {
        &self.line
    }
}

impl Served {
    /// A new one in `home`.
    pub fn start(home: &Home) -> Self {
        let authros = home.authros().with(&["--robots", "0", "--json"]);
        let mut site = authros.spawn(&["chain", "serve", "--listen", "127.0.0.1:0"]);
        let line = site.wait_for_text("serving", 60);
        let document: Value = line.lines().find_map(|line| serde_json::from_str(line).ok()).expect("one JSON line");
        let address = text(&document["serving"], "url").trim_start_matches("http://").parse().expect("an address");
        Self { site, line: Line::to(address, 0) }
    }

    /// The process that serves it.
    pub fn process(&self) -> u32 {
        self.site.id()
    }
}

impl Line {
    /// To the node at `address`, with this gas price.
    pub fn to(address: SocketAddr, price: u64) -> Self {
        let mut line = Self { address, chain_id: 0, price };
        line.chain_id = number(&line.ask("eth_chainId", json!([])).expect("a chain id"));
        line
    }

    /// Its address.
    pub fn url(&self) -> String {
        format!("http://{}", self.address)
    }

    /// The answer to a body, or nothing if none comes in time.
    pub fn post(&self, body: &Value) -> Option<Value> {
        let body = body.to_string();
        let mut stream = TcpStream::connect(self.address).ok()?;
        stream.set_read_timeout(Some(PATIENCE)).ok()?;
        let head = format!(
            "POST / HTTP/1.1\r\nHost: {}\r\nContent-Type: application/json\r\nConnection: close\r\nContent-Length: {}\r\n\r\n",
            self.address,
            body.len()
        );
        stream.write_all((head + &body).as_bytes()).ok()?;
        let mut answer = String::new();
        stream.read_to_string(&mut answer).ok()?;
        serde_json::from_str(answer.split_once("\r\n\r\n")?.1).ok()
    }

    /// One request: its result, or the text of the refusal.
    pub fn ask(&self, method: &str, parameters: Value) -> Result<Value, String> {
        let body = json!({ "jsonrpc": "2.0", "id": 1, "method": method, "params": parameters });
        let answer = self.post(&body).ok_or("no answer")?;
        match answer.get("error") {
            Some(error) => Err(format!("{} {}", error["code"], error["message"].as_str().unwrap_or("?"))),
            None => Ok(answer["result"].clone()),
        }
    }

    /// Sends a signed transaction.
    pub fn send(&self, raw: &str) -> Result<Value, String> {
        self.ask("eth_sendRawTransaction", json!([raw]))
    }

    /// The block of a transaction.
    pub fn block_of(&self, hash: &Value) -> Option<u64> {
        let receipt = self.ask("eth_getTransactionReceipt", json!([hash])).ok()?;
        receipt.get("blockNumber").map(number)
    }

    /// A creation with `code`, or without it a plain transfer, by a numbered stranger.
    pub fn signed(&self, stranger: u8, nonce: u64, gas: u64, code: Option<&[u8]>) -> String {
        let request = TransactionRequest::new().nonce(nonce).gas(gas);
        self.sign(
            stranger,
            match code {
                Some(code) => request.data(code.to_vec()),
                None => request.to(H160([1; 20])),
            },
        )
    }

    /// A call of a contract by a stranger.
    pub fn signed_call(&self, stranger: u8, nonce: u64, contract: H160, data: Vec<u8>) -> String {
        self.sign(stranger, TransactionRequest::new().nonce(nonce).gas(CALL_GAS).to(contract).data(data))
    }

    fn sign(&self, stranger: u8, request: TransactionRequest) -> String {
        let wallet = LocalWallet::from_bytes(&[stranger; 32]).expect("a key");
        let request: TypedTransaction = request.gas_price(self.price).value(0).chain_id(self.chain_id).into();
        let signature = wallet.sign_transaction_sync(&request).expect("signs");
        request.rlp_signed(&signature).to_string()
    }
}

/// A quantity of JSON-RPC.
pub fn number(value: &Value) -> u64 {
    let digits = value.as_str().unwrap_or_default().trim_start_matches("0x");
    u64::from_str_radix(digits, 16).expect("a quantity")
}
