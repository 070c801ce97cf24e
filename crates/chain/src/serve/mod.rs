//! The embedded chain's JSON-RPC over HTTP for tools on this machine (cast, web3, curl): reads, and signed
//! transactions.
//!
//! Loopback only, and only while it is explicitly run: anyone on this machine may connect.

use std::net::{IpAddr, SocketAddr};
use std::sync::{Arc, Mutex, PoisonError};
use std::{convert::Infallible, future::poll_fn, time::Duration};

use http_body_util::{BodyExt as _, Full, Limited};
use hyper::body::{Bytes, Incoming};
use hyper::header::{
    ALLOW, CONNECTION, CONTENT_LENGTH, CONTENT_TYPE, HOST, HeaderValue, ORIGIN, TRANSFER_ENCODING,
    X_CONTENT_TYPE_OPTIONS,
};
use hyper::{Method, Request, Response, StatusCode, server::conn::http1, service::service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Semaphore, watch};
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep_until, timeout};

use crate::transport::{TransportError, refused};
use crate::{Chain, ChainError, embedded::Embedded, model::bytes::unhex, transaction::Transaction};

/// Longest request line with all headers, bytes.
const LONGEST_HEAD: usize = 16 * 1024;
const LONGEST_BODY: usize = 1024 * 1024;

#[derive(Debug, Clone, Copy)]
struct Limits {
    connections: usize,
    /// For a request, from the end of the previous answer, and for receiving an answer.
    patience: Duration,
    /// For the chain to answer.
    work: Duration,
}

const LIMITS: Limits = Limits { connections: 256, patience: Duration::from_secs(15), work: Duration::from_secs(30) };

/// Reason and advice; ends the connection.
#[derive(Debug, Clone, Copy)]
struct Refusal(StatusCode, &'static str);

const BUSY: Refusal = Refusal(StatusCode::SERVICE_UNAVAILABLE, "too many connections; try again");
const SLOW: Refusal = Refusal(StatusCode::REQUEST_TIMEOUT, "the request did not arrive in time");
const LONG: Refusal = Refusal(StatusCode::SERVICE_UNAVAILABLE, "the chain took too long; request less");
const CUT: Refusal = Refusal(StatusCode::BAD_REQUEST, "the body is cut");

pub async fn listen(address: SocketAddr) -> Result<TcpListener, ChainError> {
    if !address.ip().is_loopback() {
        return Err(ChainError::Input(format!(
            "{address} can be reached by other machines, and the chain cannot tell who is asking; listen on 127.0.0.1 \
             and use an ssh tunnel from elsewhere"
        )));
    }
    TcpListener::bind(address).await.map_err(|error| {
        ChainError::Input(format!("the chain cannot be served at {address}: {error}; choose another port"))
    })
}

impl Chain {
    /// All connections end with `stop`.
    pub async fn serve(&self, listener: TcpListener, stop: impl Future<Output = ()> + Send) -> Result<(), ChainError> {
        self.serve_within(LIMITS, listener, stop).await
    }

    async fn serve_within(
        &self,
        limits: Limits,
        listener: TcpListener,
        stop: impl Future<Output = ()> + Send,
    ) -> Result<(), ChainError> {
        let embedded = self.transport().embedded().cloned();
        let Some(embedded) = embedded else {
            return Err(ChainError::Input(format!(
                "this chain is the node at {}; point other tools there",
                self.url()
            )));
        };
        let service = Arc::new(Service::new(embedded));
        let places = Arc::new(Semaphore::new(limits.connections));
        let turned_away = Arc::new(Semaphore::new(limits.connections));
        // Connections end with this set.
        let mut open = JoinSet::new();
        tokio::pin!(stop);
        loop {
            let accepted = tokio::select! {
                () = &mut stop => return Ok(()),
                accepted = listener.accept() => accepted,
                Some(_) = open.join_next() => continue,
            };
            let Ok((stream, _)) = accepted else {
                // Out of descriptors, for example: not a reason to spin.
                tokio::time::sleep(Duration::from_millis(50)).await;
                continue;
            };
            let Ok(place) = Arc::clone(&places).try_acquire_owned() else {
                turn_away(&mut open, &turned_away, stream, limits);
                continue;
            };
            let service = Arc::clone(&service);
            open.spawn(async move {
                let _place = place;
                // A disconnect concerns only the peer.
                drop(connection(stream, &service, limits).await);
            });
        }
    }
}

fn turn_away(open: &mut JoinSet<()>, waiting: &Arc<Semaphore>, stream: TcpStream, limits: Limits) {
    let Ok(place) = Arc::clone(waiting).try_acquire_owned() else {
        // In a flood, callers get no patience.
        drop(stream.try_write(&raw(BUSY)));
        return;
    };
    open.spawn(async move {
        let _place = place;
        drop(refuse(stream, BUSY, limits).await);
    });
}

async fn connection(stream: TcpStream, service: &Service, limits: Limits) -> std::io::Result<()> {
    stream.set_nodelay(true)?;
    // An unread answer ends the connection, like silence.
    let until = || Instant::now() + 2 * limits.patience;
    let deadline = watch::Sender::new(until());
    let answering = service_fn(|request| {
        deadline.send_replace(until() + limits.work);
        let answer = answer(request, service, limits);
        Box::pin(async {
            let answer = answer.await;
            deadline.send_replace(until());
            Ok::<_, Infallible>(answer)
        })
    });
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(limits.patience).max_buf_size(LONGEST_HEAD).half_close(true);
    let mut exchanges = http.serve_connection(TokioIo::new(stream), answering);
    let ended = loop {
        let last = *deadline.borrow();
        tokio::select! {
            ended = poll_fn(|context| exchanges.poll_without_shutdown(context)) => break ended,
            () = sleep_until(last) => if *deadline.borrow() == last { return Ok(()) },
        }
    };
    let stream = exchanges.into_parts().io.into_inner();
    match ended {
        Err(error) if error.is_timeout() => refuse(stream, SLOW, limits).await,
        _ => close(stream).await,
    }
}

async fn answer(request: Request<Incoming>, service: &Service, limits: Limits) -> Response<Full<Bytes>> {
    let answered = async {
        judge(&request)?;
        let body = Limited::new(request.into_body(), LONGEST_BODY).collect();
        let body = timeout(limits.patience, body).await.map_err(|_| SLOW)?.map_err(|_| CUT)?;
        timeout(limits.work, service.answer(&body.to_bytes())).await.map_err(|_| LONG)
    };
    match answered.await {
        Ok(body) => message(StatusCode::OK, "application/json", body),
        Err(Refusal(status, why)) => message(status, "text/plain; charset=utf-8", format!("{why}\n").into()),
    }
}

/// Accepts only JSON-RPC, and none from web pages.
fn judge(request: &Request<Incoming>) -> Result<(), Refusal> {
    let one = |name, missing, twice| {
        let mut values = request.headers().get_all(name).iter();
        match (values.next().map(HeaderValue::to_str), values.next()) {
            (Some(Ok(value)), None) => Ok(value),
            (None, _) => Err(missing),
            _ => Err(Refusal(StatusCode::BAD_REQUEST, twice)),
        }
    };
    if request.method() != Method::POST {
        return Err(Refusal(StatusCode::METHOD_NOT_ALLOWED, "use POST for JSON-RPC"));
    }
    if request.uri() != "/" {
        return Err(Refusal(StatusCode::NOT_FOUND, "JSON-RPC is at /"));
    }
    if request.headers().contains_key(ORIGIN) {
        return Err(Refusal(StatusCode::FORBIDDEN, "requests from web pages are refused"));
    }
    let missing = Refusal(StatusCode::BAD_REQUEST, "the Host header is missing");
    // If an attacker's DNS name resolves to this machine, Host still holds the attacker's name.
    if !is_this_machine(one(HOST, missing, "there are two Host headers")?) {
        let why = "the Host header must name this machine: localhost or 127.0.0.1";
        return Err(Refusal(StatusCode::FORBIDDEN, why));
    }
    // A browser form cannot send this type to another origin without a preflight request, which is refused.
    let unsupported = Refusal(StatusCode::UNSUPPORTED_MEDIA_TYPE, "set Content-Type: application/json");
    let kind = one(CONTENT_TYPE, unsupported, "there are two Content-Types")?;
    if !kind.split(';').next().unwrap_or_default().trim().eq_ignore_ascii_case("application/json") {
        return Err(unsupported);
    }
    let unknown = Refusal(StatusCode::LENGTH_REQUIRED, "send a Content-Length");
    let length = one(CONTENT_LENGTH, unknown, "the Content-Length is not a single number")?;
    if request.headers().contains_key(TRANSFER_ENCODING) {
        return Err(unknown);
    }
    let fits = length.parse().is_ok_and(|length: usize| length <= LONGEST_BODY);
    let long = Refusal(StatusCode::PAYLOAD_TOO_LARGE, "a body may have at most 1 MiB; send smaller batches");
    if fits { Ok(()) } else { Err(long) }
}

pub fn is_this_machine(host: &str) -> bool {
    let parts = match host.strip_prefix('[') {
        Some(bracketed) => bracketed.split_once(']'),
        None => Some(host.split_at(host.find(':').unwrap_or(host.len()))),
    };
    let Some((name, rest)) = parts else { return false };
    let port = rest.strip_prefix(':').unwrap_or(if rest.is_empty() { "0" } else { "" });
    let numeric = !port.is_empty() && port.bytes().all(|byte| byte.is_ascii_digit());
    let loopback = name.parse().is_ok_and(|address: IpAddr| address.is_loopback());
    numeric && (loopback || name.eq_ignore_ascii_case("localhost"))
}

fn message(status: StatusCode, kind: &'static str, body: Vec<u8>) -> Response<Full<Bytes>> {
    let mut message = Response::new(Full::from(body));
    *message.status_mut() = status;
    let headers = message.headers_mut();
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(kind));
    headers.insert(X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    if !status.is_success() {
        headers.insert(CONNECTION, HeaderValue::from_static("close"));
    }
    if status == StatusCode::METHOD_NOT_ALLOWED {
        headers.insert(ALLOW, HeaderValue::from_static("POST"));
    }
    message
}

/// For a request that was not read.
fn raw(Refusal(status, why): Refusal) -> Vec<u8> {
    format!(
        "HTTP/1.1 {status}\r\nContent-Type: text/plain; charset=utf-8\r\nContent-Length: {}\r\nConnection: close\r\n\
         X-Content-Type-Options: nosniff\r\n\r\n{why}\n",
        why.len() + 1
    )
    .into()
}

async fn refuse(mut stream: TcpStream, refusal: Refusal, limits: Limits) -> std::io::Result<()> {
    timeout(limits.patience, stream.write_all(&raw(refusal))).await.map_err(|_| std::io::ErrorKind::TimedOut)??;
    close(stream).await
}

async fn close(mut stream: TcpStream) -> std::io::Result<()> {
    stream.shutdown().await?;
    // Closing with unread bytes would reset the connection and lose the answer.
    let rest = &mut stream.take(4 * LONGEST_BODY as u64);
    drop(timeout(Duration::from_secs(1), tokio::io::copy(rest, &mut tokio::io::sink())).await);
    Ok(())
}

// JSON-RPC 2.0 over the embedded chain: single requests and bounded batches, reads and raw transactions.

const LONGEST_BATCH: usize = 100;
/// Bytes per HTTP request.
const LONGEST_ANSWER: usize = 32 * 1024 * 1024;

pub struct Service {
    chain: Embedded,
    heavy: Heavy,
}

impl Service {
    pub fn new(chain: Embedded) -> Self {
        Self { chain, heavy: Heavy::new(Instant::now()) }
    }

    /// Empty if no answer is due.
    pub async fn answer(&self, body: &[u8]) -> Vec<u8> {
        let answer = match serde_json::from_slice::<Value>(body) {
            Err(_) => Some(failure(&Value::Null, &refused(-32700, "the body is not JSON"))),
            Ok(Value::Array(batch)) => return self.batch(batch).await,
            Ok(one) => self.single(one).await,
        };
        answer.map(|answer| written(&answer, &Value::Null)).unwrap_or_default()
    }

    async fn batch(&self, batch: Vec<Value>) -> Vec<u8> {
        if batch.is_empty() || batch.len() > LONGEST_BATCH {
            let what = format!("a batch has 1 to {LONGEST_BATCH} requests, this one {}", batch.len());
            return written(&failure(&Value::Null, &refused(-32600, what)), &Value::Null);
        }
        let mut all: Vec<u8> = Vec::new();
        for request in batch {
            let id = request.get("id").cloned().unwrap_or_default();
            let Some(answer) = self.single(request).await else { continue };
            let mut next = written(&answer, &id);
            if all.len() + next.len() > LONGEST_ANSWER {
                next = written(&failure(&id, &too_long()), &id);
            }
            all.push(if all.is_empty() { b'[' } else { b',' });
            all.append(&mut next);
        }
        if !all.is_empty() {
            all.push(b']');
        }
        all
    }

    /// `None` for a notification.
    async fn single(&self, request: Value) -> Option<Value> {
        let Value::Object(mut request) = request else {
            return Some(failure(&Value::Null, &refused(-32600, "a request is an object")));
        };
        let id = request.remove("id");
        let known = id.clone().filter(|id| id.is_string() || id.is_number()).unwrap_or_default();
        let result = match (request.get("jsonrpc"), request.get("method"), request.get("params")) {
            (Some(Value::String(version)), Some(Value::String(method)), params) if version == "2.0" => {
                self.call(method, params.cloned()).await
            }
            _ => Err(refused(-32600, "a request has jsonrpc \"2.0\", a method and an id")),
        };
        id?;
        Some(match result {
            Ok(result) => json!({ "jsonrpc": "2.0", "id": known, "result": result }),
            Err(fault) => failure(&known, &fault),
        })
    }

    async fn call(&self, method: &str, parameters: Option<Value>) -> Result<Value, TransportError> {
        let parameters = match parameters {
            None | Some(Value::Null) => Vec::new(),
            Some(Value::Array(all)) => all,
            Some(_) => return Err(refused(-32602, "parameters come as an array")),
        };
        if method == "eth_sendRawTransaction" {
            let counted = self.heavy.count(parameters.first(), Instant::now());
            counted.map_err(|pause| too_heavy(pause.as_secs() + 1))?;
        }
        self.chain.request(method, Value::Array(parameters)).await
    }
}

fn too_heavy(seconds: u64) -> TransportError {
    refused(-32005, format!("transactions of more than a million gas are rate-limited; send it again in {seconds} s"))
}

fn too_long() -> TransportError {
    refused(-32005, format!("the answer is longer than {LONGEST_ANSWER} bytes; request less"))
}

fn failure(id: &Value, fault: &TransportError) -> Value {
    let (code, message, data) = match fault {
        TransportError::Answered(answer) => (answer.code, answer.message.clone(), answer.data.as_ref()),
        other => (-32603, other.to_string(), None),
    };
    let mut error = json!({ "code": code, "message": message });
    if let Some(data) = data {
        error["data"] = data.clone();
    }
    json!({ "jsonrpc": "2.0", "id": id, "error": error })
}

fn written(answer: &Value, id: &Value) -> Vec<u8> {
    let bytes = serde_json::to_vec(answer).unwrap_or_default();
    if bytes.len() <= LONGEST_ANSWER {
        return bytes;
    }
    serde_json::to_vec(&failure(answer.get("id").unwrap_or(id), &too_long())).unwrap_or_default()
}

// Heavy transactions. Gas is free here, and every user of the machine may send some: a burst passes, then one now and
// then.

/// Several times the gas of an anchor, a registration or a grant.
const HEAVY: u64 = 1_000_000;
/// Burst, for all callers together.
const AT_ONCE: u32 = 40;
/// Time until one more passes.
const PAUSE: Duration = Duration::from_secs(10);

#[derive(Debug)]
pub struct Heavy {
    /// How many are left, as of when.
    left: Mutex<(u32, Instant)>,
}

impl Heavy {
    pub fn new(now: Instant) -> Self {
        Self { left: Mutex::new((AT_ONCE, now)) }
    }

    /// Counts a heavy transaction, in hex; the error is the time to wait.
    pub fn count(&self, raw: Option<&Value>, now: Instant) -> Result<(), Duration> {
        let raw = raw.and_then(Value::as_str).and_then(unhex).unwrap_or_default();
        // The chain refuses what is no transaction.
        let gas = Transaction::parse(&raw).map_or(0, |parsed| parsed.gas_limit);
        if gas <= HEAVY { Ok(()) } else { self.take(now) }
    }

    fn take(&self, now: Instant) -> Result<(), Duration> {
        let mut left = self.left.lock().unwrap_or_else(PoisonError::into_inner);
        let (mut number, mut since) = *left;
        while number < AT_ONCE && now.saturating_duration_since(since) >= PAUSE {
            (number, since) = (number + 1, since + PAUSE);
        }
        if number == AT_ONCE {
            since = now;
        }
        let taken = number.checked_sub(1);
        *left = (taken.unwrap_or(0), since);
        taken.map(drop).ok_or_else(|| PAUSE.saturating_sub(now.saturating_duration_since(since)))
    }
}

#[cfg(test)]
mod tests;

#[cfg(test)]
mod heavy_tests {
    use super::*;
    use crate::model::bytes::hex;

    /// A transaction that may use this much gas; nobody signed it.
    fn raw(gas: u64) -> Value {
        let list = crate::transaction::List::default().add(&1u64).add(&0u64).add(&gas);
        Value::String(format!("0x{}", hex(&list.add_encoded(&[0x80; 6]).end())))
    }

    #[test]
    fn heavy_ones_are_few_and_the_usual_ones_are_not_counted() {
        let begun = Instant::now();
        let heavy = Heavy::new(begun);
        let count = |gas: u64, after: Duration| heavy.count(Some(&raw(gas)), begun + after);
        for _ in 0..AT_ONCE {
            assert_eq!(count(HEAVY + 1, Duration::ZERO), Ok(()));
        }
        assert_eq!(count(10_000_000, Duration::from_secs(3)), Err(Duration::from_secs(7)));
        assert_eq!(count(HEAVY, Duration::ZERO), Ok(()), "a usual one");
        assert_eq!(heavy.count(Some(&Value::Null), begun), Ok(()), "the chain refuses it");
        assert_eq!(heavy.count(None, begun), Ok(()));
        assert_eq!(count(HEAVY + 1, PAUSE), Ok(()));
        assert!(count(HEAVY + 1, PAUSE).is_err(), "one in ten seconds");
        let later = PAUSE * (2 * AT_ONCE);
        assert_eq!((0..2 * AT_ONCE).filter(|_| count(HEAVY + 1, later).is_ok()).count(), 40);
    }
}
