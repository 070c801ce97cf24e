//! A loopback proxy in front of a node's HTTP port, which interferes with chosen requests, or answers some of them as another
//! node would that is behind.

use std::collections::HashMap;
use std::io::{BufRead, BufReader, Error, ErrorKind, Read, Write};
use std::net::{Ipv4Addr, Shutdown, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use serde_json::{Value, json};

use super::anvil::{call, number};
use super::unhex;

/// The way to interfere with a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Spoil {
    /// The node gets the request, but nobody gets its answer: the connection is closed.
    DropAnswer,
    /// The connection is closed before the node gets anything.
    Refuse,
    /// The answer is delayed by this long.
    Delay(Duration),
    /// The connection is closed after half of the answer's bytes.
    CutAnswer,
    /// A complete HTTP answer whose JSON ends in the middle.
    TruncateJson,
    /// The node gets the request, and its answer has this JSON as its result instead.
    Answer(&'static str),
}

/// Matches every method.
pub const EVERY: &str = "*";

#[derive(Debug)]
struct Rule {
    method: String,
    how: Spoil,
    left: u64,
}

/// A second node behind the same URL, which has not the newest blocks yet.
#[derive(Debug, Clone, Copy)]
struct Late {
    /// How many blocks it lacks.
    blocks: u64,
    /// Which of the questions for logs reach it: one in this number.
    every: u64,
    /// Whether every question about blocks reaches it as well.
    is_alone: bool,
    /// Whether it refuses to give logs of a block that it lacks, rather than say that there are none.
    refuses: bool,
    asked: u64,
}

#[derive(Debug, Default)]
struct Shared {
    late: Mutex<Option<Late>>,
    /// Transactions that offer less than this many wei per gas are answered and never passed on; 0 = none.
    least: AtomicU64,
    rule: Mutex<Option<Rule>>,
    seen: Mutex<HashMap<String, u64>>,
    spoilt: AtomicU64,
    ending: AtomicBool,
    open: Mutex<HashMap<u64, TcpStream>>,
}

/// A running proxy; every connection through it ends on drop.
#[derive(Debug)]
pub struct Proxy {
    port: u16,
    shared: Arc<Shared>,
    acceptor: Option<JoinHandle<()>>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Proxy {
    /// One that forwards everything to a port on this machine until instructed otherwise.
    pub fn before(upstream: u16) -> Self {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a free port");
        let port = listener.local_addr().expect("its address").port();
        let shared = Arc::new(Shared::default());
        let state = Arc::clone(&shared);
        let acceptor = std::thread::spawn(move || accept(&listener, upstream, &state));
        Self { port, shared, acceptor: Some(acceptor) }
    }

    /// Its URL for plain requests.
    pub fn http(&self) -> String {
        format!("http://127.0.0.1:{}", self.port)
    }

    /// Interferes with the next `times` requests of a JSON-RPC method; the count starts again.
    pub fn spoil(&self, method: &str, how: Spoil, times: u64) {
        let mut rule = lock(&self.shared.rule);
        self.shared.spoilt.store(0, Ordering::SeqCst);
        *rule = Some(Rule { method: method.to_owned(), how, left: times });
    }

    /// From now on every `every`-th question for logs is answered by a node that lacks the newest `blocks` blocks.
    pub fn answer_logs_late(&self, blocks: u64, every: u64, refuses: bool) {
        *lock(&self.shared.late) = Some(Late { blocks, every, is_alone: false, refuses, asked: 0 });
    }

    /// From now on every question about blocks and logs is answered by a node that lacks the newest `blocks` blocks.
    pub fn fall_behind(&self, blocks: u64) {
        *lock(&self.shared.late) = Some(Late { blocks, every: 1, is_alone: true, refuses: true, asked: 0 });
    }

    /// From now on a transaction that offers less than this price (wei per gas) is answered with its hash and dropped, as by
    /// a network whose signers want more than this node quotes.
    pub fn swallow_below(&self, wei: u64) {
        self.shared.least.store(wei, Ordering::SeqCst);
    }

    /// Forwards everything again.
    pub fn calm(&self) {
        self.shared.least.store(0, Ordering::SeqCst);
        *lock(&self.shared.rule) = None;
        *lock(&self.shared.late) = None;
    }

    /// How many requests were interfered with.
    pub fn spoilt(&self) -> u64 {
        self.shared.spoilt.load(Ordering::SeqCst)
    }

    /// How many requests of a method came, all included.
    pub fn seen(&self, method: &str) -> u64 {
        lock(&self.shared.seen).get(method).copied().unwrap_or(0)
    }
}

impl Drop for Proxy {
    fn drop(&mut self) {
        self.shared.ending.store(true, Ordering::SeqCst);
        // Wakes the thread that accepts.
        drop(TcpStream::connect((Ipv4Addr::LOCALHOST, self.port)));
        for stream in lock(&self.shared.open).values() {
            drop(stream.shutdown(Shutdown::Both));
        }
        if let Some(acceptor) = self.acceptor.take() {
            drop(acceptor.join());
        }
    }
}

impl Shared {
    /// What to do with a request of `method`, which is counted.
    fn decide(&self, method: &str) -> Option<Spoil> {
        *lock(&self.seen).entry(method.to_owned()).or_default() += 1;
        let mut rule = lock(&self.rule);
        let rule = rule.as_mut().filter(|rule| rule.left > 0 && (rule.method == method || rule.method == EVERY))?;
        rule.left -= 1;
        self.spoilt.fetch_add(1, Ordering::SeqCst);
        Some(rule.how)
    }

    /// The answer to a transaction that offers too little.
    fn swallowed(&self, request: &Message) -> Option<Message> {
        let document: Value = serde_json::from_slice(&request.body).ok()?;
        let raw = unhex(document["params"][0].as_str().filter(|_| document["method"] == "eth_sendRawTransaction")?);
        let least = u128::from(self.least.load(Ordering::SeqCst));
        if authros::chain::offered(&raw).ok()?.price >= least {
            return None;
        }
        self.spoilt.fetch_add(1, Ordering::SeqCst);
        let hash = authros::model::Hash(authros::crypto::keccak256(&[&raw])).to_string();
        Some(Message::answer(&json!({ "jsonrpc": "2.0", "id": document["id"], "result": hash })))
    }

    /// The answer of the node that is behind, if this request reaches it.
    fn late_answer(&self, upstream: u16, request: &Message) -> Option<Message> {
        let document: Value = serde_json::from_slice(&request.body).ok()?;
        let method = document["method"].as_str()?;
        let late = {
            let mut late = lock(&self.late);
            let late = late.as_mut()?;
            if method == "eth_getLogs" {
                late.asked += 1;
                if !late.asked.is_multiple_of(late.every) {
                    return None;
                }
            }
            *late
        };
        let mut body = json!({ "jsonrpc": "2.0", "id": document["id"] });
        match late.answer(upstream, method, &document["params"])? {
            Ok(result) => body["result"] = result,
            Err(message) => body["error"] = json!({ "code": -32000, "message": message }),
        }
        self.spoilt.fetch_add(1, Ordering::SeqCst);
        Some(Message::answer(&body))
    }
}

impl Late {
    /// The answer of the node that is behind; `None` for what both nodes answer alike.
    fn answer(self, upstream: u16, method: &str, parameters: &Value) -> Option<Result<Value, &'static str>> {
        let seen = number(&call(upstream, "eth_blockNumber", &json!([]))).saturating_sub(self.blocks);
        let old = format!("{seen:#x}");
        let of = |value: &Value| value.as_str().and_then(|text| u64::from_str_radix(text.strip_prefix("0x")?, 16).ok());
        match method {
            "eth_blockNumber" if self.is_alone => Some(Ok(json!(old))),
            "eth_getBlockByNumber" if self.is_alone => Some(Ok(match of(&parameters[0]) {
                Some(asked) if asked > seen => Value::Null,
                asked => call(upstream, method, &json!([format!("{:#x}", asked.unwrap_or(seen)), parameters[1]])),
            })),
            "eth_getLogs" => Some(match &parameters[0]["blockHash"] {
                Value::Null => Ok(late_logs(upstream, &parameters[0], seen)),
                hash => {
                    let block = call(upstream, "eth_getBlockByHash", &json!([hash, false]));
                    match (of(&block["number"]).is_some_and(|block| block <= seen), self.refuses) {
                        (true, _) => Ok(call(upstream, method, parameters)),
                        (false, true) => Err("unknown block"),
                        (false, false) => Ok(json!([])),
                    }
                }
            }),
            _ => None,
        }
    }
}

/// The logs of a range, as far as the node that is behind has its blocks.
fn late_logs(upstream: u16, filter: &Value, seen: u64) -> Value {
    if filter["fromBlock"].is_string() && number(&filter["fromBlock"]) > seen {
        return json!([]);
    }
    let mut filter = filter.clone();
    if filter["toBlock"].as_str().is_none_or(|to| !to.starts_with("0x")) || number(&filter["toBlock"]) > seen {
        filter["toBlock"] = json!(format!("{seen:#x}"));
    }
    call(upstream, "eth_getLogs", &json!([filter]))
}

fn accept(listener: &TcpListener, upstream: u16, shared: &Arc<Shared>) {
    for number in 0.. {
        let Ok((client, _)) = listener.accept() else { return };
        let Ok(twin) = client.try_clone() else { return };
        lock(&shared.open).insert(number, twin);
        if shared.ending.load(Ordering::SeqCst) {
            return;
        }
        let shared = Arc::clone(shared);
        std::thread::spawn(move || {
            // A broken connection on either side ends this one, as it would without a proxy.
            drop(serve(&client, upstream, &shared));
            drop(client.shutdown(Shutdown::Both));
            lock(&shared.open).remove(&number);
        });
    }
}

fn serve(client: &TcpStream, upstream: u16, shared: &Shared) -> Result<(), Error> {
    client.set_nodelay(true)?;
    let mut requests = BufReader::new(client.try_clone()?);
    let mut node: Option<BufReader<TcpStream>> = None;
    while let Some(request) = Message::read(&mut requests)? {
        let spoil = request.method().and_then(|method| shared.decide(&method));
        if let Some(answer) = shared.swallowed(&request).or_else(|| shared.late_answer(upstream, &request)) {
            if !pass_on(client, &answer, None)? {
                return Ok(());
            }
            continue;
        }
        if spoil == Some(Spoil::Refuse) {
            return Ok(());
        }
        let mut line = match node.take() {
            Some(line) => line,
            None => open(upstream)?,
        };
        line.get_mut().write_all(&request.bytes())?;
        let answer = Message::read(&mut line)?.ok_or(ErrorKind::UnexpectedEof)?;
        node = Some(line);
        if !pass_on(client, &answer, spoil)? {
            return Ok(());
        }
    }
    Ok(())
}

fn open(upstream: u16) -> Result<BufReader<TcpStream>, Error> {
    let stream = TcpStream::connect((Ipv4Addr::LOCALHOST, upstream))?;
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(Duration::from_secs(60)))?;
    Ok(BufReader::new(stream))
}

/// Passes an answer to the client; returns whether the connection continues.
fn pass_on(mut client: &TcpStream, answer: &Message, spoil: Option<Spoil>) -> Result<bool, Error> {
    match spoil {
        Some(Spoil::DropAnswer | Spoil::Refuse) => return Ok(false),
        Some(Spoil::CutAnswer) => {
            let bytes = answer.bytes();
            client.write_all(&bytes[..bytes.len() / 2])?;
            return Ok(false);
        }
        Some(Spoil::TruncateJson) => {
            let body = answer.body[..answer.body.len() / 2].to_vec();
            client.write_all(&Message { head: answer.head.clone(), body }.bytes())?;
        }
        Some(Spoil::Answer(result)) => {
            let mut document: Value = serde_json::from_slice(&answer.body)?;
            document["result"] = serde_json::from_str(result)?;
            let body = serde_json::to_vec(&document)?;
            client.write_all(&Message { head: answer.head.clone(), body }.bytes())?;
        }
        Some(Spoil::Delay(pause)) => {
            std::thread::sleep(pause);
            client.write_all(&answer.bytes())?;
        }
        None => client.write_all(&answer.bytes())?,
    }
    Ok(true)
}

/// A request or an answer of HTTP/1.1 whose body has a stated length.
struct Message {
    /// First line and headers, without the length.
    head: Vec<String>,
    body: Vec<u8>,
}

impl Message {
    fn answer(body: &Value) -> Self {
        let head = vec!["HTTP/1.1 200 OK".to_owned(), "Content-Type: application/json".to_owned()];
        Self { head, body: body.to_string().into_bytes() }
    }

    /// The next one; `None` if the other side has closed the connection.
    fn read(source: &mut impl BufRead) -> Result<Option<Self>, Error> {
        let (mut head, mut length) = (Vec::new(), 0);
        loop {
            let mut line = String::new();
            if source.read_line(&mut line)? == 0 {
                return if head.is_empty() { Ok(None) } else { Err(ErrorKind::UnexpectedEof.into()) };
            }
            let line = line.trim_end();
            if line.is_empty() {
                break;
            }
            match line.split_once(':').filter(|(name, _)| name.eq_ignore_ascii_case("content-length")) {
                Some((_, value)) => length = value.trim().parse().map_err(|_| Error::from(ErrorKind::InvalidData))?,
                None => head.push(line.to_owned()),
            }
        }
        let mut body = vec![0; length];
        source.read_exact(&mut body)?;
        Ok(Some(Self { head, body }))
    }

    fn bytes(&self) -> Vec<u8> {
        let head = self.head.join("\r\n");
        let head = format!("{head}\r\nContent-Length: {}\r\n\r\n", self.body.len());
        [head.as_bytes(), &self.body].concat()
    }

    /// The JSON-RPC method requested.
    fn method(&self) -> Option<String> {
        let document: Value = serde_json::from_slice(&self.body).ok()?;
        document["method"].as_str().map(str::to_owned)
    }
}
