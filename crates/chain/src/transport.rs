//! One JSON-RPC client for every kind of chain: embedded, http, ws, ipc, relayed; with timeouts and reconnection.

use std::fmt::Debug;
use std::path::PathBuf;
use std::sync::{Mutex as StdMutex, PoisonError};
use std::time::Duration;

use async_trait::async_trait;
use ethers::providers::{Http, Ipc, JsonRpcClient, JsonRpcError, ProviderError, RpcError, Ws};
use serde::Serialize;
use serde::de::{DeserializeOwned, Error as _};
use tokio::sync::{Mutex, Semaphore};

use super::embedded::{Embedded, Fault};
use super::relay::RelayLine;
use super::{ChainError, Endpoint};
use crate::model::clean;

/// How long a node may take to answer.
const PATIENCE: Duration = Duration::from_secs(5);
/// How long it may take to collect logs.
const PATIENCE_FOR_LOGS: Duration = Duration::from_secs(20);

/// The most requests to a node at a time; further ones wait.
const TOGETHER: usize = 8;
/// How long a connection is kept that nothing is asked over: shorter than servers keep theirs, so that no request is sent
/// into one that is just being closed.
const IDLE: Duration = Duration::from_secs(4);

/// A connection to a chain.
#[derive(Debug)]
pub struct Transport {
    line: Line,
    url: String,
    /// The embedded chain's last own error.
    trouble: StdMutex<Option<ChainError>>,
}

#[derive(Debug)]
enum Line {
    Embedded(Embedded),
    /// Each request needs a connection to itself, and a node has only so many.
    Http(Http, Semaphore),
    Ws(Mutex<Option<Ws>>),
    Ipc(PathBuf, Mutex<Option<Ipc>>),
    Relay(RelayLine),
    /// Nobody is asked.
    Absent(ChainError),
}

/// Why a request failed.
#[derive(Debug, thiserror::Error)]
pub enum TransportError {
    /// The node answered with an error.
    #[error("{0}")]
    Answered(JsonRpcError),
    /// Its answer is not JSON-RPC, or not of the expected shape.
    #[error("{0}")]
    Malformed(serde_json::Error),
    /// The embedded chain cannot continue.
    #[error("{0}")]
    Chain(ChainError),
    /// The connection broke.
    #[error("{0}")]
    Broken(String),
    /// No answer came in time.
    #[error("no answer within {} s", .0.as_secs())]
    Slow(Duration),
}

impl RpcError for TransportError {
    fn as_error_response(&self) -> Option<&JsonRpcError> {
        if let Self::Answered(error) = self { Some(error) } else { None }
    }

    fn as_serde_error(&self) -> Option<&serde_json::Error> {
        if let Self::Malformed(error) = self { Some(error) } else { None }
    }
}

impl From<TransportError> for ProviderError {
    fn from(error: TransportError) -> Self {
        Self::JsonRpcClientError(Box::new(error))
    }
}

impl From<Fault> for TransportError {
    fn from(fault: Fault) -> Self {
        match fault.cause {
            Some(cause) => Self::Chain(*cause),
            None => Self::Answered(JsonRpcError { code: fault.code, message: fault.message, data: fault.data }),
        }
    }
}

impl Transport {
    /// Opens the embedded chain, or prepares the connection to a node; the first request opens it.
    ///
    /// # Errors
    /// [`ChainError::Url`], or errors from opening the embedded chain.
    pub async fn open(endpoint: &Endpoint) -> Result<Self, ChainError> {
        match endpoint {
            Endpoint::Embedded { directory, consensus } => {
                let url = format!("embedded:{}", directory.display());
                let line = Line::Embedded(Embedded::open(directory.clone(), *consensus).await?);
                Ok(Self { line, url, trouble: StdMutex::default() })
            }
            Endpoint::Node { url } => Ok(Self { line: line(url)?, url: shown(url), trouble: StdMutex::default() }),
            Endpoint::Relay(relay) => {
                Ok(Self { line: Line::Relay(relay.clone()), url: relay.0.place(), trouble: StdMutex::default() })
            }
        }
    }

    /// A line to no chain; every request fails with this error.
    pub fn absent(error: ChainError) -> Self {
        let trouble = StdMutex::new(Some(error.clone()));
        Self { line: Line::Absent(error), url: "nowhere".to_owned(), trouble }
    }

    /// Where it leads, without credentials.
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

    async fn ask<T, R>(&self, method: &str, parameters: T) -> Result<R, TransportError>
    where
        T: Debug + Serialize + Send + Sync,
        R: DeserializeOwned + Send,
    {
        match &self.line {
            Line::Embedded(embedded) => {
                let parameters = serde_json::to_value(parameters).map_err(TransportError::Malformed)?;
                let value = embedded.request(method, parameters).await.inspect_err(|fault| self.note(fault))?;
                serde_json::from_value(value).map_err(TransportError::Malformed)
            }
            Line::Relay(relay) => {
                let parameters = serde_json::to_value(parameters).map_err(TransportError::Malformed)?;
                let value = relay.0.ask(method, parameters).await?;
                serde_json::from_value(value).map_err(TransportError::Malformed)
            }
            Line::Http(client, places) => {
                // It is never closed.
                let _place = places.acquire().await.map_err(|error| TransportError::Broken(error.to_string()))?;
                through(client, method, parameters).await
            }
            Line::Absent(error) => Err(TransportError::Chain(error.clone())),
            Line::Ws(slot) => {
                let open = Ws::connect_with_reconnects(self.url.as_str(), 0);
                kept(slot, open, method, parameters).await
            }
            Line::Ipc(path, slot) => kept(slot, Ipc::connect(path), method, parameters).await,
        }
    }

    fn note(&self, fault: &Fault) {
        if fault.cause.is_some() {
            self.trouble.lock().unwrap_or_else(PoisonError::into_inner).clone_from(&fault.cause.as_deref().cloned());
        }
    }

    /// The embedded chain's own error, behind the text of one that went through ethers, which drops the type.
    pub fn trouble_behind(&self, words: &str) -> Option<ChainError> {
        let trouble = self.trouble.lock().unwrap_or_else(PoisonError::into_inner).clone();
        trouble.filter(|trouble| words.contains(&trouble.to_string()))
    }

    /// Closes a broken connection, so that the next request opens a new one.
    async fn hang_up(&self) {
        match &self.line {
            Line::Ws(slot) => *slot.lock().await = None,
            Line::Ipc(_, slot) => *slot.lock().await = None,
            Line::Embedded(_) | Line::Http(..) | Line::Relay(_) | Line::Absent(_) => {}
        }
    }
}

fn line(url: &str) -> Result<Line, ChainError> {
    let refused = || ChainError::Url(clean(&shown(url), 120));
    if url.starts_with("http://") {
        let client = reqwest::Client::builder().no_proxy().pool_max_idle_per_host(TOGETHER).pool_idle_timeout(IDLE);
        let client = client.build().map_err(|_| refused())?;
        let parsed = reqwest::Url::parse(url).map_err(|_| refused())?;
        return Ok(Line::Http(Http::new_with_client(parsed, client), Semaphore::new(TOGETHER)));
    }
    if url.starts_with("ws://") {
        reqwest::Url::parse(url).map_err(|_| refused())?;
        return Ok(Line::Ws(Mutex::default()));
    }
    let path = url.strip_prefix("ipc:").or_else(|| url.strip_suffix(".ipc").map(|_| url));
    match path.map(PathBuf::from) {
        Some(path) if path.is_absolute() => Ok(Line::Ipc(path, Mutex::default())),
        _ => Err(refused()),
    }
}

/// A URL without user name and password.
fn shown(url: &str) -> String {
    let Some((scheme, rest)) = url.split_once("://") else { return url.to_owned() };
    let authority = rest.split(['/', '?', '#']).next().unwrap_or(rest);
    match authority.rsplit_once('@') {
        Some((secret, _)) => format!("{scheme}://{}", &rest[secret.len() + 1..]),
        None => url.to_owned(),
    }
}

async fn through<C, T, R>(client: &C, method: &str, parameters: T) -> Result<R, TransportError>
where
    C: JsonRpcClient,
    T: Debug + Serialize + Send + Sync,
    R: DeserializeOwned + Send,
{
    let translate = |error: C::Error| match (error.as_error_response(), error.as_serde_error()) {
        (Some(answer), _) => TransportError::Answered(answer.clone()),
        (None, Some(reason)) => TransportError::Malformed(serde_json::Error::custom(clean(
            &page(&error).unwrap_or(reason.to_string()),
            200,
        ))),
        (None, None) => TransportError::Broken(innermost(&error)),
    };
    client.request(method, parameters).await.map_err(translate)
}

/// What to say of a web page: its text tells nothing, and a fault of JSON is not what is wrong.
fn page(error: &dyn std::error::Error) -> Option<String> {
    let words = error.to_string();
    let (_, body) = words.split_once("Response: ")?;
    let is_page = body.trim_start().starts_with('<');
    is_page.then(|| "a web page: what stands before the node refused the request".to_owned())
}

/// Uses a connection that is kept open, opening it first if necessary.
async fn kept<C, E, T, R>(
    slot: &Mutex<Option<C>>,
    open: impl Future<Output = Result<C, E>> + Send,
    method: &str,
    parameters: T,
) -> Result<R, TransportError>
where
    C: JsonRpcClient + Clone,
    E: std::error::Error,
    T: Debug + Serialize + Send + Sync,
    R: DeserializeOwned + Send,
{
    let client = {
        let mut slot = slot.lock().await;
        match &*slot {
            Some(client) => client.clone(),
            None => slot.insert(open.await.map_err(|error| TransportError::Broken(innermost(&error)))?).clone(),
        }
    };
    through(&client, method, parameters).await
}

/// The root cause: "connection refused" rather than three layers around it.
fn innermost(error: &dyn std::error::Error) -> String {
    let mut cause = error;
    while let Some(deeper) = cause.source() {
        cause = deeper;
    }
    clean(&cause.to_string(), 160)
}

#[async_trait]
impl JsonRpcClient for Transport {
    type Error = TransportError;

    async fn request<T, R>(&self, method: &str, parameters: T) -> Result<R, TransportError>
    where
        T: Debug + Serialize + Send + Sync,
        R: DeserializeOwned + Send,
    {
        if let Line::Embedded(_) = self.line {
            return self.ask(method, parameters).await;
        }
        let patience = if method == "eth_getLogs" { PATIENCE_FOR_LOGS } else { PATIENCE };
        let answered = tokio::time::timeout(patience, self.ask(method, parameters)).await;
        let result = answered.unwrap_or(Err(TransportError::Slow(patience)));
        if matches!(result, Err(TransportError::Broken(_) | TransportError::Slow(_))) {
            self.hang_up().await;
        }
        result
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn urls() {
        for good in ["http://127.0.0.1:8545", "ws://localhost:8546/x", "ipc:/tmp/geth.ipc", "/tmp/geth.ipc"] {
            assert!(line(good).is_ok(), "{good}");
        }
        for bad in ["", "127.0.0.1:8545", "https://node", "wss://node", "ipc:geth.ipc", "geth.ipc", "http://", "/tmp/x"]
        {
            assert!(line(bad).is_err(), "{bad}");
        }
        assert_eq!(shown("http://me:secret@host:1/a@b"), "http://host:1/a@b");
        assert_eq!(shown("http://host:1/a@b"), "http://host:1/a@b");
    }
}
