//! One JSON-RPC client for every kind of chain: embedded, http, https, ws, wss, ipc, relayed. Every answer has a time limit
//! and a largest size, and no error shows a path or a password.

mod address;
mod answer;
mod socket;
#[cfg(test)]
mod tests;

use std::fmt;
use std::path::Path;
use std::time::Duration;

use serde::de::DeserializeOwned;
use serde_json::Value;

pub(super) use self::answer::JsonRpcError;

use self::address::{Address, Kept, Place};
use self::socket::{Http, Local, WebSocket};
use crate::embedded::{Embedded, Fault};
use crate::model::clean;
use crate::relay::RelayLine;
use crate::{ChainError, Endpoint};

/// The most requests to a node at a time; further ones wait.
const TOGETHER: usize = 8;
/// The most of those with a wide answer.
const WIDE_TOGETHER: usize = 2;
/// How long a connection is kept that nothing is asked over: shorter than servers keep theirs, so that no request is sent
/// into one that is just being closed.
const IDLE: Duration = Duration::from_secs(4);
/// How long connecting may take, to all addresses of a name together.
const CONNECTING: Duration = Duration::from_secs(4);
/// Bytes of a megabyte, as people are told of it.
const MIB: usize = 1 << 20;

/// What a request may cost.
#[derive(Debug, Clone, Copy)]
struct Limits {
    /// The most bytes of its answer.
    bytes: usize,
    /// How long it may take in all.
    patience: Duration,
}

/// Most answers are a number or one block.
const USUAL: Limits = Limits { bytes: 4 * MIB, patience: Duration::from_secs(5) };
/// All logs of many blocks, or all receipts of one.
const WIDE: Limits = Limits { bytes: 64 * MIB, patience: Duration::from_secs(20) };

impl Limits {
    fn of(method: &str) -> Self {
        if matches!(method, "eth_getLogs" | "eth_getBlockReceipts") { WIDE } else { USUAL }
    }

    /// Whether such an answer takes so much memory that there are only a few of them at a time.
    fn is_wide(&self) -> bool {
        self.bytes > USUAL.bytes
    }
}

/// A connection to a chain.
pub struct Transport {
    line: Line,
    url: String,
}

enum Line {
    Embedded(Embedded),
    Http(Http),
    WebSocket(Kept<WebSocket>),
    Local(Kept<Local>),
    Relay(RelayLine),
    /// Nobody is asked.
    Absent(ChainError),
}

/// Why a request failed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "each variant's line names its fields")]
pub enum TransportError {
    /// The node answered with an error.
    #[error("{0}")]
    Answered(JsonRpcError),
    /// Its answer is not JSON-RPC, or not of the expected shape.
    #[error("{0}")]
    Malformed(String),
    /// The embedded chain cannot continue.
    #[error("{0}")]
    Chain(ChainError),
    /// The connection broke.
    #[error("{0}")]
    Broken(String),
    /// No answer came in time.
    #[error("no answer within {} s", .0.as_secs())]
    Slow(Duration),
    /// The answer has more than this many bytes.
    #[error("an answer of more than {} MiB", .0 / MIB)]
    TooLong(usize),
    /// The node, or what stands before it, cannot be used with the present settings; the reason is a predicate
    /// of the node.
    #[error("the node {reason}")]
    Unusable { reason: String, advice: String },
}

impl From<Fault> for TransportError {
    fn from(fault: Fault) -> Self {
        match fault.cause {
            Some(cause) => Self::Chain(*cause),
            None => Self::Answered(JsonRpcError { code: fault.code, message: fault.message, data: fault.data }),
        }
    }
}

impl TransportError {
    /// What it means for who asked the node at `url` for `method`.
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
    /// Opens the embedded chain, or prepares the connection to a node; the first request opens it.
    ///
    /// # Errors
    /// [`ChainError::Url`], [`ChainError::Roots`], or errors from opening the embedded chain.
    pub async fn open(endpoint: &Endpoint) -> Result<Self, ChainError> {
        match endpoint {
            Endpoint::Embedded { directory, consensus } => {
                let url = format!("embedded:{}", directory.display());
                let line = Line::Embedded(Embedded::open(directory.clone(), *consensus).await?);
                Ok(Self { line, url })
            }
            Endpoint::Node { url, roots } => Self::to_node(url, roots.as_deref()),
            Endpoint::Relay(relay) => Ok(Self { line: Line::Relay(relay.clone()), url: relay.0.place() }),
        }
    }

    fn to_node(url: &str, roots: Option<&Path>) -> Result<Self, ChainError> {
        let address = Address::parse(url, roots)?;
        let line = match address.place {
            Place::Http(server) => Line::Http(Http::new(server)?),
            Place::WebSocket(server) => Line::WebSocket(Kept::new(WebSocket::opener(server))),
            Place::Local(path) => Line::Local(Kept::new(Local::opener(path))),
        };
        Ok(Self { line, url: address.shown })
    }

    /// A line to no chain; every request fails with this error.
    pub fn absent(error: ChainError) -> Self {
        Self { line: Line::Absent(error), url: "nowhere".to_owned() }
    }

    /// Where it leads, without credentials and path.
    pub fn url(&self) -> &str {
        &self.url
    }

    /// Whether requests go through a relay.
    pub fn is_relayed(&self) -> bool {
        matches!(self.line, Line::Relay(_))
    }

    /// The embedded chain behind it.
    pub fn embedded(&self) -> Option<&Embedded> {
        if let Line::Embedded(embedded) = &self.line { Some(embedded) } else { None }
    }

    /// Makes one request.
    ///
    /// # Errors
    /// [`TransportError`].
    pub async fn request<R: DeserializeOwned>(&self, method: &str, parameters: Value) -> Result<R, TransportError> {
        self.request_within(method, parameters, Limits::of(method)).await
    }

    /// Makes one request whose answer is passed on as it is: as a tree of values it takes many times its bytes.
    ///
    /// # Errors
    /// [`TransportError`].
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
        let answered = tokio::time::timeout(limits.patience, asked).await;
        answered.unwrap_or(Err(TransportError::Slow(limits.patience)))
    }

    async fn ask<R: DeserializeOwned>(
        &self,
        method: &str,
        parameters: Value,
        limits: Limits,
    ) -> Result<R, TransportError> {
        match &self.line {
            Line::Embedded(embedded) => answer::shaped(embedded.request(method, parameters).await?),
            Line::Relay(relay) => answer::shaped(relay.0.ask(method, parameters).await?),
            Line::Absent(error) => Err(TransportError::Chain(error.clone())),
            Line::Http(http) => http.ask(answer::request(method, &parameters), limits).await,
            Line::WebSocket(kept) => answer::read(&kept.ask(&answer::request(method, &parameters), limits).await?),
            Line::Local(kept) => answer::read(&kept.ask(&answer::request(method, &parameters), limits).await?),
        }
    }
}

/// Without what its parts hold: credentials among them.
impl fmt::Debug for Transport {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.debug_struct("Transport").field("url", &self.url).finish_non_exhaustive()
    }
}
