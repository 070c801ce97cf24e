//! One JSON-RPC client for every kind of chain. Every answer has a time limit and a largest size, and no error shows a
//! path or a password.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};
use std::{error::Error, fmt};

use base64::{Engine as _, engine::general_purpose::STANDARD};
use percent_encoding::percent_decode_str;
use reqwest::header::{AUTHORIZATION, CONTENT_TYPE, HeaderValue, InvalidHeaderValue, LOCATION};
use reqwest::{Client, Url, redirect::Policy};
use serde::de::{DeserializeOwned, IgnoredAny};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::{net::UnixStream, sync::Semaphore};
use tokio_rustls::rustls::ClientConfig;
use zeroize::Zeroizing;

use crate::model::{address_without_secrets, clean};
use crate::{ChainError, Endpoint, embedded::Embedded, relay::RelayLine};

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
    Http(Box<Http>),
    Local(Local),
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
        let shown = clean(&address_without_secrets(url), 120);
        // An unparsable URL may hold a secret anywhere.
        let refused = || match url.split_once("://") {
            Some((scheme @ ("http" | "https"), _)) => ChainError::Url(format!("{scheme}://…")),
            _ => ChainError::Url(shown.clone()),
        };
        let line = if url.starts_with("http://") || url.starts_with("https://") {
            Line::Http(Box::new(Http::new(Server::parse(url, roots, &refused)?)?))
        } else {
            let path = url.strip_prefix("ipc:").or_else(|| url.strip_suffix(".ipc").map(|_| url));
            let path = path.map(PathBuf::from).filter(|path| path.is_absolute()).ok_or_else(refused)?;
            Line::Local(Local { path, idle: Mutex::default() })
        };
        Ok(Self::new(line, shown))
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
            Line::Local(local) => read(&local.ask(&request(method, &params), limits.bytes).await?),
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
            405 | 426 => ("does not accept requests of this kind at this path", "check the path in `chain.url`"),
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
            400 if self.is_plain_to_tls() => ("speaks TLS at this port", "use https:// in `chain.url`"),
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

/// An HTTP server in front of a node.
#[derive(Clone)]
struct Server {
    /// Without user name and password.
    url: Url,
    /// As HTTP basic authentication.
    credentials: Option<HeaderValue>,
    tls: Option<ClientConfig>,
}

impl Server {
    fn parse(text: &str, roots: Option<&Path>, refused: &dyn Fn() -> ChainError) -> Result<Self, ChainError> {
        let mut url = Url::parse(text).map_err(|_| refused())?;
        let credentials = basic(&url).map_err(|_| refused())?;
        url.set_username("").and_then(|()| url.set_password(None)).map_err(|()| refused())?;
        let tls = (url.scheme() == "https").then(|| authros_tls::tls(roots).map_err(ChainError::Roots)).transpose()?;
        Ok(Self { url, credentials, tls })
    }
}

fn basic(url: &Url) -> Result<Option<HeaderValue>, InvalidHeaderValue> {
    if url.username().is_empty() && url.password().is_none() {
        return Ok(None);
    }
    let (user, password) = (url.username(), url.password().unwrap_or_default());
    let parts = percent_decode_str(user).chain([b':']).chain(percent_decode_str(password));
    let pair: Zeroizing<Vec<u8>> = Zeroizing::new(parts.collect());
    let encoded = Zeroizing::new(STANDARD.encode(&*pair));
    let text = Zeroizing::new(format!("Basic {}", *encoded));
    let mut header = HeaderValue::from_str(&text)?;
    header.set_sensitive(true);
    Ok(Some(header))
}

/// A Unix socket of this machine: JSON values, one after another. A connection has one request at a time, so an answer is
/// always that of the last question; any error closes it.
struct Local {
    path: PathBuf,
    /// Idle connections and since when; the newest is last.
    idle: Mutex<Vec<(UnixStream, Instant)>>,
}

impl Local {
    /// The answer has at most `most` bytes.
    async fn ask(&self, request: &str, most: usize) -> Result<Vec<u8>, TransportError> {
        // The newest one, unless the node may be about to close it.
        let newest = {
            let mut idle = self.idle.lock().unwrap_or_else(PoisonError::into_inner);
            idle.retain(|(_, since)| since.elapsed() < IDLE);
            idle.pop()
        };
        let mut stream = match newest {
            Some((stream, _)) => stream,
            None => UnixStream::connect(&self.path).await.map_err(|error| broken(&error))?,
        };
        stream.write_all(request.as_bytes()).await.map_err(|error| broken(&error))?;
        let mut answer = Vec::with_capacity(PIECE);
        while !is_whole(&answer) {
            if stream.read_buf(&mut answer).await.map_err(|error| broken(&error))? == 0 {
                return Err(TransportError::Broken("it closed the connection".to_owned()));
            }
            if answer.len() > most {
                return Err(TransportError::TooLong(most));
            }
        }
        self.idle.lock().unwrap_or_else(PoisonError::into_inner).push((stream, Instant::now()));
        Ok(answer)
    }
}

const PIECE: usize = 64 << 10;

/// A whole object of JSON.
fn is_whole(answer: &[u8]) -> bool {
    answer.trim_ascii_end().ends_with(b"}") && serde_json::from_slice::<IgnoredAny>(answer).is_ok()
}

/// Longest error page read, bytes.
const LONGEST_PAGE: usize = 64 << 10;

struct Http {
    client: Client,
    server: Server,
}

impl Http {
    fn new(server: Server) -> Result<Self, ChainError> {
        // No redirects: only the named node gets requests and credentials.
        let client = Client::builder().no_proxy().redirect(Policy::none()).tls_built_in_root_certs(false);
        // Shared by the addresses of a name, so that a silent one leaves time for the others.
        let client = client.connect_timeout(CONNECTING);
        let client = client.pool_max_idle_per_host(TOGETHER).pool_idle_timeout(IDLE);
        let client = match &server.tls {
            Some(config) => client.use_preconfigured_tls(config.clone()),
            None => client,
        };
        let client = client.build().map_err(|error| ChainError::Internal(clean(&error.to_string(), 120)))?;
        Ok(Self { client, server })
    }

    async fn ask<R: DeserializeOwned>(&self, body: String, limits: Limits) -> Result<R, TransportError> {
        let mut request = self.client.post(self.server.url.clone()).header(CONTENT_TYPE, "application/json");
        if let Some(credentials) = &self.server.credentials {
            request = request.header(AUTHORIZATION, credentials.clone());
        }
        let mut response = request.body(body).send().await.map_err(|error| broken(&error))?;
        let status = response.status();
        // Reads only the beginning of an error page.
        let most = if status.is_success() { limits.bytes } else { LONGEST_PAGE.min(limits.bytes) };
        let mut bytes = Vec::new();
        while let Some(piece) = response.chunk().await.map_err(|error| broken(&error))? {
            if bytes.len() + piece.len() > most {
                if status.is_success() {
                    return Err(TransportError::TooLong(most));
                }
                break;
            }
            bytes.extend_from_slice(&piece);
        }
        if !status.is_success() && !is_one(&bytes) {
            let location = response.headers().get(LOCATION).and_then(|place: &HeaderValue| place.to_str().ok());
            return Err(Refused { status: status.as_u16(), location, page: &bytes }.words(&self.server));
        }
        // The text of a web page says nothing, and a fault of JSON is not what is wrong.
        let is_page = bytes.trim_ascii_start().starts_with(b"<");
        let page =
            || TransportError::Malformed("a web page: the proxy in front of the node refused the request".into());
        read(&bytes).map_err(|error| if is_page { page() } else { error })
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

#[cfg(test)]
mod address_tests {
    use super::*;

    fn parse(text: &str) -> Result<Transport, ChainError> {
        Transport::to_node(text, None)
    }

    #[test]
    fn urls() {
        for good in ["http://127.0.0.1:8545", "ipc:/tmp/geth.ipc", "/tmp/geth.ipc"] {
            assert!(parse(good).is_ok(), "{good}");
        }
        for bad in [
            "",
            "127.0.0.1:8545",
            "ftp://node",
            "ws://node:8546",
            "ipc:geth.ipc",
            "geth.ipc",
            "http://",
            "https://",
            "/tmp/x",
        ] {
            assert!(matches!(parse(bad), Err(ChainError::Url(_))), "{bad}");
        }
    }

    #[test]
    fn credentials_are_sent_and_not_shown() {
        // python3: base64.b64encode(b"op:p@ss/w#rd:%1")
        let expected = "Basic b3A6cEBzcy93I3JkOiUx";
        let transport = parse("http://op:p%40ss%2Fw%23rd:%251@node.example:1/v3/KEY").expect("a URL");
        let Line::Http(http) = &transport.line else { panic!("a server") };
        let credentials = http.server.credentials.as_ref().map(|header| header.to_str().expect("text"));
        assert_eq!((credentials, http.server.url.as_str()), (Some(expected), "http://node.example:1/v3/KEY"));
        assert_eq!(transport.url, "http://…@node.example:1/…");
        let Line::Http(http) = parse("http://node.example").expect("a URL").line else { panic!("a server") };
        assert_eq!(http.server.credentials, None);
    }

    #[test]
    fn a_refused_url_shows_no_secret() {
        for bad in [
            "http://me:SECRET@",
            "https://me:SECRET@:x/",
            "nothing://me:SECRET@host/SECRET",
            "http://[SECRET/",
            "node.example/SECRET",
        ] {
            let Err(error) = parse(bad) else { panic!("{bad} is accepted") };
            assert!(!error.to_string().contains("SECRET"), "{error}");
        }
    }
}

#[cfg(test)]
mod bracket_tests {
    use super::*;

    #[test]
    fn an_object_ends_with_its_own_bracket() {
        for text in [r#"{"a":[1,{"b":"}\"]"}]}"#, r#" {"result":"\\"}"#, "{}\n"] {
            let whole = |length: &usize| is_whole(&text.as_bytes()[..*length]);
            assert_eq!((0..=text.len()).find(whole), Some(text.trim_end().len()), "{text}");
        }
    }
}

#[cfg(test)]
mod tests;
