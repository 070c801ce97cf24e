//! The address of a node, and the ways to it: HTTP and WebSockets, with or without TLS, and sockets of this machine.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use futures_util::{SinkExt as _, StreamExt as _};
use percent_encoding::percent_decode_str;
use reqwest::header::{AUTHORIZATION, CONTENT_TYPE, HeaderValue, InvalidHeaderValue, LOCATION};
use reqwest::redirect::Policy;
use reqwest::{Client, Url};
use serde::de::{DeserializeOwned, IgnoredAny};
use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _};
use tokio::net::{TcpStream, UnixStream};
use tokio_rustls::TlsConnector;
use tokio_rustls::rustls::ClientConfig;
use tokio_rustls::rustls::pki_types::ServerName;
use tokio_tungstenite::tungstenite::client::IntoClientRequest as _;
use tokio_tungstenite::tungstenite::error::CapacityError;
use tokio_tungstenite::tungstenite::protocol::WebSocketConfig;
use tokio_tungstenite::tungstenite::{Bytes, Error, Message};
use tokio_tungstenite::{WebSocketStream, client_async_with_config};
use zeroize::Zeroizing;

use super::{CONNECTING, ChainError, IDLE, Limits, Refused, TOGETHER, TransportError, broken, is_one, read};
use crate::model::{address_without_secrets, clean};

pub(super) struct Address {
    pub shown: String,
    pub place: Place,
}

pub(super) enum Place {
    Http(Server),
    WebSocket(Server),
    /// A Unix socket.
    Local(PathBuf),
}

#[derive(Clone)]
pub(super) struct Server {
    /// Without user name and password.
    pub url: Url,
    /// As HTTP basic authentication.
    pub credentials: Option<HeaderValue>,
    /// For https and wss.
    pub tls: Option<Arc<ClientConfig>>,
}

impl Address {
    /// `roots` is a PEM file of authorities.
    pub(super) fn parse(text: &str, roots: Option<&Path>) -> Result<Self, ChainError> {
        let shown = clean(&address_without_secrets(text), 120);
        let scheme = text.split_once("://").map_or("", |(scheme, _)| scheme);
        // An unparsable URL may hold a secret anywhere.
        let is_web = matches!(scheme, "http" | "https" | "ws" | "wss");
        let refused = || ChainError::Url(if is_web { format!("{scheme}://…") } else { shown.clone() });
        let place = match scheme {
            "http" | "https" => Place::Http(Server::parse(text, roots, &refused)?),
            "ws" | "wss" => Place::WebSocket(Server::parse(text, roots, &refused)?),
            _ => {
                let path = text.strip_prefix("ipc:").or_else(|| text.strip_suffix(".ipc").map(|_| text));
                let path = path.map(PathBuf::from).filter(|path| path.is_absolute());
                Place::Local(path.ok_or_else(refused)?)
            }
        };
        Ok(Self { shown, place })
    }
}

impl Server {
    fn parse(text: &str, roots: Option<&Path>, refused: &dyn Fn() -> ChainError) -> Result<Self, ChainError> {
        let mut url = Url::parse(text).map_err(|_| refused())?;
        let credentials = basic(&url).map_err(|_| refused())?;
        url.set_username("").and_then(|()| url.set_password(None)).map_err(|()| refused())?;
        let is_secured = matches!(url.scheme(), "https" | "wss");
        let tls = is_secured.then(|| authros_tls::tls(roots).map(Arc::new).map_err(ChainError::Roots)).transpose()?;
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

// Kept connections: one request at a time, so an answer is always that of the last question; any error closes them.

pub(super) trait Link: Send + Sized {
    /// What it leads to.
    type Place: Sync;

    /// Opens a connection whose answers have at most `most` bytes.
    fn open(place: &Self::Place, most: usize) -> impl Future<Output = Result<Self, TransportError>> + Send;

    /// The answer has at most `most` bytes.
    fn exchange(&mut self, request: &str, most: usize) -> impl Future<Output = Result<Bytes, TransportError>> + Send;
}

pub(super) struct Kept<L: Link> {
    place: L::Place,
    usual: Idle<L>,
    wide: Idle<L>,
}

/// Idle connections and since when; the newest is last.
type Idle<L> = Mutex<Vec<(L, Instant)>>;

impl<L: Link> Kept<L> {
    pub(super) fn new(place: L::Place) -> Self {
        Self { place, usual: Idle::default(), wide: Idle::default() }
    }

    pub(super) async fn ask(&self, request: &str, limits: Limits) -> Result<Bytes, TransportError> {
        let idle = || {
            let kept = if limits.is_wide() { &self.wide } else { &self.usual };
            kept.lock().unwrap_or_else(PoisonError::into_inner)
        };
        // The newest one, unless the node may be about to close it.
        let newest = {
            let mut kept = idle();
            kept.retain(|(_, since)| since.elapsed() < IDLE);
            kept.pop()
        };
        let mut link = match newest {
            Some((link, _)) => link,
            None => L::open(&self.place, limits.bytes).await?,
        };
        let answer = link.exchange(request, limits.bytes).await?;
        idle().push((link, Instant::now()));
        Ok(answer)
    }
}

const PIECE: usize = 64 << 10;

trait Wire: AsyncRead + AsyncWrite + Unpin + Send {}

impl<T: AsyncRead + AsyncWrite + Unpin + Send> Wire for T {}

pub(super) struct WebSocket {
    stream: WebSocketStream<Box<dyn Wire>>,
}

impl Link for WebSocket {
    type Place = Server;

    async fn open(server: &Server, most: usize) -> Result<Self, TransportError> {
        let failed = |error: Error| failed(&error, server, most);
        let wire = wire(server).await?;
        let mut request = server.url.as_str().into_client_request().map_err(failed)?;
        if let Some(credentials) = &server.credentials {
            request.headers_mut().insert(AUTHORIZATION, credentials.clone());
        }
        let config = WebSocketConfig::default().max_message_size(Some(most)).max_frame_size(Some(most));
        let (stream, _) = client_async_with_config(request, wire, Some(config)).await.map_err(failed)?;
        Ok(Self { stream })
    }

    async fn exchange(&mut self, request: &str, most: usize) -> Result<Bytes, TransportError> {
        let broke = |error: Error| misread(&error, most);
        self.stream.send(Message::text(request)).await.map_err(broke)?;
        loop {
            match self.stream.next().await.ok_or_else(closed)?.map_err(broke)? {
                Message::Text(text) => return Ok(text.into()),
                Message::Binary(bytes) => return Ok(bytes),
                Message::Close(_) => return Err(closed()),
                Message::Ping(_) | Message::Pong(_) | Message::Frame(_) => {}
            }
        }
    }
}

fn failed(error: &Error, server: &Server, most: usize) -> TransportError {
    match error {
        Error::Http(response) => {
            let location = response.headers().get(LOCATION).and_then(|place| place.to_str().ok());
            let page = response.body().as_deref().unwrap_or_default();
            Refused { status: response.status().as_u16(), location, page }.words(server)
        }
        error => misread(error, most),
    }
}

fn misread(error: &Error, most: usize) -> TransportError {
    match error {
        Error::Capacity(CapacityError::MessageTooLong { .. }) => TransportError::TooLong(most),
        error => broken(error),
    }
}

fn closed() -> TransportError {
    TransportError::Broken("it closed the connection".to_owned())
}

async fn wire(server: &Server) -> Result<Box<dyn Wire>, TransportError> {
    let tcp = connected(server).await.map_err(|error| broken(&error))?;
    let Some(config) = &server.tls else { return Ok(Box::new(tcp)) };
    let name = ServerName::try_from(host(server).to_owned()).map_err(|error| broken(&error))?;
    let tls = TlsConnector::from(config.clone()).connect(name, tcp).await.map_err(|error| broken(&error))?;
    Ok(Box::new(tls))
}

/// Tries the addresses of the name in turn, each for its share of the time.
async fn connected(server: &Server) -> std::io::Result<TcpStream> {
    let port = server.url.port_or_known_default().unwrap_or(443);
    let addresses: Vec<_> = tokio::net::lookup_host((host(server), port)).await?.collect();
    let share = CONNECTING / u32::try_from(addresses.len().max(1)).unwrap_or(u32::MAX);
    let mut failure = std::io::Error::other("its name has no address");
    for address in addresses {
        match tokio::time::timeout(share, TcpStream::connect(address)).await {
            Ok(Ok(stream)) => {
                // A request is one small write before a wait.
                stream.set_nodelay(true)?;
                return Ok(stream);
            }
            Ok(Err(error)) => failure = error,
            Err(_) => failure = std::io::Error::other(format!("{address} does not answer")),
        }
    }
    Err(failure)
}

/// Without the brackets around an IPv6 address.
fn host(server: &Server) -> &str {
    server.url.host_str().unwrap_or_default().trim_start_matches('[').trim_end_matches(']')
}

/// A Unix socket: JSON values, one after another.
pub(super) struct Local {
    stream: UnixStream,
}

impl Link for Local {
    type Place = PathBuf;

    async fn open(path: &PathBuf, _: usize) -> Result<Self, TransportError> {
        Ok(Self { stream: UnixStream::connect(path).await.map_err(|error| broken(&error))? })
    }

    async fn exchange(&mut self, request: &str, most: usize) -> Result<Bytes, TransportError> {
        self.stream.write_all(request.as_bytes()).await.map_err(|error| broken(&error))?;
        let mut answer = Vec::new();
        let mut piece = vec![0; PIECE];
        loop {
            let length = self.stream.read(&mut piece).await.map_err(|error| broken(&error))?;
            let read = piece.get(..length).unwrap_or_default();
            if read.is_empty() {
                return Err(closed());
            }
            if answer.len() + read.len() > most {
                return Err(TransportError::TooLong(most));
            }
            answer.extend_from_slice(read);
            if is_whole(&answer) {
                return Ok(Bytes::from(answer));
            }
        }
    }
}

/// A whole object of JSON.
fn is_whole(answer: &[u8]) -> bool {
    answer.trim_ascii_end().ends_with(b"}") && serde_json::from_slice::<IgnoredAny>(answer).is_ok()
}

/// Longest error page read, bytes.
const LONGEST_PAGE: usize = 64 << 10;

pub(super) struct Http {
    client: Client,
    server: Server,
}

impl Http {
    pub(super) fn new(server: Server) -> Result<Self, ChainError> {
        // No redirects: only the named node gets requests and credentials.
        let client = Client::builder().no_proxy().redirect(Policy::none()).tls_built_in_root_certs(false);
        // Shared by the addresses of a name, so that a silent one leaves time for the others.
        let client = client.connect_timeout(CONNECTING);
        let client = client.pool_max_idle_per_host(TOGETHER).pool_idle_timeout(IDLE);
        let client = match &server.tls {
            Some(config) => client.use_preconfigured_tls((**config).clone()),
            None => client,
        };
        let client = client.build().map_err(|error| ChainError::Internal(clean(&error.to_string(), 120)))?;
        Ok(Self { client, server })
    }

    pub(super) async fn ask<R: DeserializeOwned>(&self, body: String, limits: Limits) -> Result<R, TransportError> {
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
mod address_tests {
    use super::*;

    fn parse(text: &str) -> Result<Address, ChainError> {
        Address::parse(text, None)
    }

    #[test]
    fn urls() {
        for good in ["http://127.0.0.1:8545", "ws://localhost:8546/x", "ipc:/tmp/geth.ipc", "/tmp/geth.ipc"] {
            assert!(parse(good).is_ok(), "{good}");
        }
        for bad in ["", "127.0.0.1:8545", "ftp://node", "ipc:geth.ipc", "geth.ipc", "http://", "https://", "/tmp/x"] {
            assert!(matches!(parse(bad), Err(ChainError::Url(_))), "{bad}");
        }
    }

    #[test]
    fn credentials_are_sent_and_not_shown() {
        // python3: base64.b64encode(b"op:p@ss/w#rd:%1")
        let expected = "Basic b3A6cEBzcy93I3JkOiUx";
        for scheme in ["http", "ws"] {
            let address = parse(&format!("{scheme}://op:p%40ss%2Fw%23rd:%251@node.example:1/v3/KEY")).expect("a URL");
            let (Place::Http(server) | Place::WebSocket(server)) = address.place else { panic!("a server") };
            assert_eq!(server.credentials.as_ref().map(|header| header.to_str().expect("text")), Some(expected));
            assert_eq!(server.url.as_str(), format!("{scheme}://node.example:1/v3/KEY"));
            assert_eq!(address.shown, format!("{scheme}://…@node.example:1/…"));
        }
        let Place::Http(server) = parse("http://node.example").expect("a URL").place else { panic!("a server") };
        assert_eq!(server.credentials, None);
    }

    #[test]
    fn a_refused_url_shows_no_secret() {
        for bad in [
            "http://me:SECRET@",
            "https://me:SECRET@:x/",
            "nothing://me:SECRET@host/SECRET",
            "ws://[SECRET/",
            "node.example/SECRET",
        ] {
            let Err(error) = parse(bad) else { panic!("{bad} is accepted") };
            assert!(!error.to_string().contains("SECRET"), "{error}");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_object_ends_with_its_own_bracket() {
        for text in [r#"{"a":[1,{"b":"}\"]"}]}"#, r#" {"result":"\\"}"#, "{}\n"] {
            let whole = |length: &usize| is_whole(&text.as_bytes()[..*length]);
            assert_eq!((0..=text.len()).find(whole), Some(text.trim_end().len()), "{text}");
        }
    }
}
