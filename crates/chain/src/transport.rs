//! One JSON-RPC client for every kind of chain. Every answer has a time limit and a largest size, and no error shows a
//! path or a password.

mod socket;
#[cfg(test)]
mod tests;

use std::{error::Error, fmt, path::Path, time::Duration};

use serde::de::{DeserializeOwned, IgnoredAny};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use tokio::sync::Semaphore;

use self::socket::{Address, Http, Kept, Local, Place, Server, WebSocket};
use crate::{ChainError, Endpoint, embedded::Embedded, model::clean, relay::RelayLine};

/// Requests to a node at a time; further ones wait.
const TOGETHER: usize = 8;
/// Of these, requests with a wide answer.
const WIDE_TOGETHER: usize = 2;
/// Shorter than servers keep connections, so that no request goes into a closing one.
const IDLE: Duration = Duration::from_secs(4);
/// For all addresses of a name together.
const CONNECTING: Duration = Duration::from_secs(4);
const MIB: usize = 1 << 20;

#[derive(Debug, Clone, Copy)]
struct Limits {
    bytes: usize,
    patience: Duration,
}

/// A number, or one block.
const USUAL: Limits = Limits { bytes: 4 * MIB, patience: Duration::from_secs(5) };
/// All logs of many blocks, or all receipts of one.
const WIDE: Limits = Limits { bytes: 64 * MIB, patience: Duration::from_secs(20) };

impl Limits {
    fn of(method: &str) -> Self {
        if matches!(method, "eth_getLogs" | "eth_getBlockReceipts") { WIDE } else { USUAL }
    }

    /// Such an answer takes so much memory that only a few run at a time.
    fn is_wide(&self) -> bool {
        self.bytes > USUAL.bytes
    }
}

pub struct Transport {
    line: Line,
    url: String,
    /// Each request to a node needs a connection of its own, and a node limits their number.
    places: Semaphore,
    wide_places: Semaphore,
}

enum Line {
    Embedded(Embedded),
    Http(Http),
    WebSocket(Kept<WebSocket>),
    Local(Kept<Local>),
    Relay(RelayLine),
    Absent(ChainError),
}

#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TransportError {
    #[error("{0}")]
    Answered(JsonRpcError),
    /// Not JSON-RPC, or not of the expected shape.
    #[error("{0}")]
    Malformed(String),
    /// The embedded chain cannot continue.
    #[error("{0}")]
    Chain(#[from] ChainError),
    #[error("{0}")]
    Broken(String),
    #[error("no answer within {} s", .0.as_secs())]
    Slow(Duration),
    #[error("an answer of more than {} MiB", .0 / MIB)]
    TooLong(usize),
    /// Unusable with the present settings; the reason is a predicate of the node.
    #[error("the node {reason}")]
    Unusable { reason: String, advice: String },
}

/// A refusal by the embedded chain.
pub fn refused(code: i64, message: impl Into<String>) -> TransportError {
    TransportError::Answered(JsonRpcError { code, message: message.into(), data: None })
}

impl TransportError {
    pub fn explained(self, url: &str, method: &str) -> ChainError {
        let unreachable = |reason: String, advice: &str| ChainError::Unreachable {
            url: url.to_owned(),
            reason: clean(&reason, 300),
            advice: advice.to_owned(),
        };
        match self {
            Self::Answered(answer) => ChainError::from_node(method, &answer),
            Self::Malformed(reason) => {
                ChainError::Answer { url: url.to_owned(), method: method.to_owned(), reason: clean(&reason, 200) }
            }
            Self::Chain(error) => error,
            Self::Broken(_) | Self::Slow(_) => {
                unreachable(format!("does not answer ({self})"), "start it or correct `chain.url`")
            }
            Self::TooLong(bytes) => unreachable(
                format!("sent more than {} MiB, which no answer of {method} has", bytes / MIB),
                "check that `chain.url` is an Ethereum node",
            ),
            Self::Unusable { reason, advice } => unreachable(reason, &advice),
        }
    }
}

impl Transport {
    fn new(line: Line, url: String) -> Self {
        let (places, wide_places) = (Semaphore::new(TOGETHER), Semaphore::new(WIDE_TOGETHER));
        Self { line, url, places, wide_places }
    }

    /// The first request opens the connection to a node.
    pub async fn open(endpoint: &Endpoint) -> Result<Self, ChainError> {
        match endpoint {
            Endpoint::Embedded { directory, consensus } => {
                let url = format!("embedded:{}", directory.display());
                Ok(Self::new(Line::Embedded(Embedded::open(directory.clone(), *consensus).await?), url))
            }
            Endpoint::Node { url, roots } => Self::to_node(url, roots.as_deref()),
            Endpoint::Relay(relay) => Ok(Self::new(Line::Relay(relay.clone()), relay.0.place())),
        }
    }

    fn to_node(url: &str, roots: Option<&Path>) -> Result<Self, ChainError> {
        let address = Address::parse(url, roots)?;
        let line = match address.place {
            Place::Http(server) => Line::Http(Http::new(server)?),
            Place::WebSocket(server) => Line::WebSocket(Kept::new(server)),
            Place::Local(path) => Line::Local(Kept::new(path)),
        };
        Ok(Self::new(line, address.shown))
    }

    /// Every request fails with this error.
    pub fn absent(error: ChainError) -> Self {
        Self::new(Line::Absent(error), "nowhere".to_owned())
    }

    /// Without credentials and path.
    pub fn url(&self) -> &str {
        &self.url
    }

    pub fn kind(&self) -> &'static str {
        match self.line {
            Line::Relay(_) => "relay",
            Line::Embedded(_) => "embedded",
            _ => "node",
        }
    }

    pub fn embedded(&self) -> Option<&Embedded> {
        if let Line::Embedded(embedded) = &self.line { Some(embedded) } else { None }
    }

    pub async fn request<R: DeserializeOwned>(&self, method: &str, parameters: Value) -> Result<R, TransportError> {
        self.request_within(method, parameters, Limits::of(method)).await
    }

    /// Bounded more tightly, since a tree of values takes many times its bytes.
    pub async fn request_for_another(&self, method: &str, parameters: Value) -> Result<Value, TransportError> {
        let limits = Limits { bytes: USUAL.bytes, ..Limits::of(method) };
        self.request_within(method, parameters, limits).await
    }

    async fn request_within<R: DeserializeOwned>(
        &self,
        method: &str,
        parameters: Value,
        limits: Limits,
    ) -> Result<R, TransportError> {
        let asked = self.ask(method, parameters, limits);
        if let Line::Embedded(_) = self.line {
            return asked.await;
        }
        let in_turn = async {
            let places = if limits.is_wide() { &self.wide_places } else { &self.places };
            let is_node = !matches!(self.line, Line::Relay(_) | Line::Absent(_));
            // It is never closed.
            let place = if is_node { Some(places.acquire().await) } else { None };
            let _place = place.transpose().map_err(|error| TransportError::Broken(error.to_string()))?;
            asked.await
        };
        let answered = tokio::time::timeout(limits.patience, in_turn).await;
        answered.unwrap_or(Err(TransportError::Slow(limits.patience)))
    }

    async fn ask<R: DeserializeOwned>(&self, method: &str, params: Value, limits: Limits) -> Result<R, TransportError> {
        match &self.line {
            Line::Embedded(embedded) => shaped(embedded.request(method, params).await?),
            Line::Relay(relay) => shaped(relay.0.ask(method, params).await?),
            Line::Absent(error) => Err(TransportError::Chain(error.clone())),
            Line::Http(http) => http.ask(request(method, &params), limits).await,
            Line::WebSocket(kept) => read(&kept.ask(&request(method, &params), limits).await?),
            Line::Local(kept) => read(&kept.ask(&request(method, &params), limits).await?),
        }
    }
}

/// Hides credentials.
impl fmt::Debug for Transport {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.debug_struct("Transport").field("url", &self.url).finish_non_exhaustive()
    }
}

/// Longest error, bytes; the largest known one has the data of a revert.
const LONGEST_ERROR: usize = MIB;

#[derive(Debug, Clone, PartialEq, Deserialize, thiserror::Error)]
#[error("{message} (code {code})")]
pub struct JsonRpcError {
    /// Nodes do not agree on codes.
    pub code: i64,
    #[serde(default)]
    pub message: String,
    /// Revert data, in the shape that this node likes.
    #[serde(default)]
    pub data: Option<Value>,
}

#[derive(Serialize)]
struct Request<'a> {
    jsonrpc: &'static str,
    /// A connection has one request at a time.
    id: u64,
    method: &'a str,
    params: &'a Value,
}

fn request(method: &str, params: &Value) -> String {
    serde_json::to_string(&Request { jsonrpc: "2.0", id: 1, method, params }).unwrap_or_default()
}

/// Skips the content.
#[derive(Deserialize)]
struct Kind {
    #[serde(default)]
    error: Option<IgnoredAny>,
    #[serde(default)]
    result: Option<IgnoredAny>,
}

#[derive(Deserialize)]
struct Failed {
    error: JsonRpcError,
}

#[derive(Deserialize)]
#[serde(bound = "R: DeserializeOwned")]
struct Succeeded<R> {
    #[serde(deserialize_with = "R::deserialize")]
    result: R,
}

/// Never builds what was not asked for.
fn read<R: DeserializeOwned>(bytes: &[u8]) -> Result<R, TransportError> {
    let malformed = |error: serde_json::Error| TransportError::Malformed(error.to_string());
    let kind: Kind = serde_json::from_slice(bytes).map_err(malformed)?;
    if kind.error.is_none() {
        return serde_json::from_slice(bytes).map(|answer: Succeeded<R>| answer.result).map_err(malformed);
    }
    if bytes.len() > LONGEST_ERROR {
        return Err(TransportError::TooLong(LONGEST_ERROR));
    }
    let failed: Failed = serde_json::from_slice(bytes).map_err(malformed)?;
    Err(TransportError::Answered(failed.error))
}

/// Any answer of JSON-RPC.
fn is_one(bytes: &[u8]) -> bool {
    serde_json::from_slice(bytes).is_ok_and(|answer: Kind| answer.error.is_some() || answer.result.is_some())
}

fn shaped<R: DeserializeOwned>(value: Value) -> Result<R, TransportError> {
    serde_json::from_value(value).map_err(|error| TransportError::Malformed(error.to_string()))
}

// Plain words for a server that refuses before its node gets to see the request.

const ROOTS: &str = "`chain.roots`";

/// An HTTP answer that is not JSON-RPC.
struct Refused<'a> {
    pub status: u16,
    pub location: Option<&'a str>,
    /// Its beginning.
    pub page: &'a [u8],
}

impl Refused<'_> {
    fn words(&self, server: &Server) -> TransportError {
        let (what, advice) = match self.status {
            401 if server.credentials.is_some() => (
                "does not accept the user name and password in its URL",
                "correct them in `chain.url`; write characters other than letters and digits as %40 and the like",
            ),
            401 => {
                ("requires a user name and password", "put them into `chain.url`, as https://USER:PASSWORD@HOST:PORT")
            }
            403 => ("forbids the request", "ask its operator to allow this machine and this host name"),
            404 => ("serves nothing at this path", "correct the path in `chain.url`"),
            405 | 426 => (
                "does not accept requests of this kind at this path",
                "check the path in `chain.url`, and whether it is ws:// (wss://) or http:// (https://)",
            ),
            413 => (
                "rejects the request as too large",
                "raise the limit of the proxy in front of the node (nginx: client_max_body_size)",
            ),
            429 => ("limits how often it may be queried", "wait, or ask its operator for a higher limit"),
            502..=504 => {
                ("cannot be reached by the proxy in front of it", "start the node, or raise the proxy's timeout")
            }
            500..=599 => ("has an internal error", "check its log, or that of the proxy in front of it"),
            301..=303 | 307 | 308 => return self.redirect(server),
            400 if self.is_plain_to_tls() => ("speaks TLS at this port", "use https:// or wss:// in `chain.url`"),
            _ => ("answers with a web page instead of JSON-RPC", "check that `chain.url` is an Ethereum node"),
        };
        TransportError::Unusable { reason: format!("{what} (HTTP {})", self.status), advice: advice.to_owned() }
    }

    fn redirect(&self, server: &Server) -> TransportError {
        let place = authros_tls::redirected(&server.url, self.location);
        let reason = format!("redirects to {place} (HTTP {}), which is not followed", self.status);
        TransportError::Unusable { reason, advice: "set `chain.url` to that address".to_owned() }
    }

    /// nginx and Go's servers say so in words only.
    fn is_plain_to_tls(&self) -> bool {
        let text = String::from_utf8_lossy(self.page).to_lowercase();
        text.contains("https port") || text.contains("https server")
    }
}

fn broken(error: &(dyn Error + 'static)) -> TransportError {
    match authros_tls::tls_fault(error, ROOTS) {
        Some(fault) => TransportError::Unusable { reason: fault.reason, advice: fault.advice },
        None => TransportError::Broken(authros_tls::innermost(error)),
    }
}

#[cfg(test)]
mod answer_tests {
    use super::*;
    use serde_json::json;

    fn read_as<R: DeserializeOwned>(answer: &Value) -> Result<R, TransportError> {
        read(answer.to_string().as_bytes())
    }

    #[test]
    fn an_answer_is_a_result_or_an_error() {
        assert_eq!(read_as(&json!({"jsonrpc": "2.0", "id": 1, "result": "0x1"})), Ok("0x1".to_owned()));
        assert_eq!(read_as::<Option<String>>(&json!({"id": 7, "result": null, "error": null})), Ok(None));
        let error = json!({"result": null, "error": {"code": -32000, "message": "no", "data": ["x"]}});
        let told = JsonRpcError { code: -32000, message: "no".to_owned(), data: Some(json!(["x"])) };
        assert_eq!(read_as::<String>(&error), Err(TransportError::Answered(told)));
        assert!(read_as::<Option<String>>(&json!({"id": 1})).is_err(), "no result is not the result null");
        for other in [json!({"result": 5}), json!({}), json!([]), json!("text"), json!({"error": "text"})] {
            assert!(matches!(read_as::<String>(&other), Err(TransportError::Malformed(_))), "{other}");
        }
    }

    #[test]
    fn an_error_is_not_as_long_as_logs_may_be() {
        let error = json!({"error": {"code": 1, "message": "x", "data": "y".repeat(LONGEST_ERROR)}});
        assert_eq!(read_as::<String>(&error), Err(TransportError::TooLong(LONGEST_ERROR)));
    }

    #[test]
    fn a_request_has_all_four_members() {
        let text = request("eth_call", &json!([1, "latest"]));
        let value: Value = serde_json::from_str(&text).expect("JSON");
        assert_eq!(value, json!({"jsonrpc": "2.0", "id": 1, "method": "eth_call", "params": [1, "latest"]}));
    }
}
