//! The address of a node, its credentials, and what TLS to it trusts.

use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use reqwest::Url;
use reqwest::header::{HeaderValue, InvalidHeaderValue};
use tokio::sync::Semaphore;
use tokio_rustls::rustls::ClientConfig;
use tokio_tungstenite::tungstenite::Bytes;
use zeroize::Zeroizing;

use super::{ChainError, IDLE, Limits, TOGETHER, TransportError, WIDE_TOGETHER};
use crate::model::{address_without_secrets, clean};
use crate::web;

/// A node's address.
pub(super) struct Address {
    /// For display.
    pub shown: String,
    /// What it leads to.
    pub place: Place,
}

/// The kind of address.
pub(super) enum Place {
    Http(Server),
    WebSocket(Server),
    /// A socket of this machine.
    Local(PathBuf),
}

/// A server of HTTP or of a WebSocket.
#[derive(Clone)]
pub(super) struct Server {
    /// Without user name and password.
    pub url: Url,
    /// These two, as HTTP's basic authentication.
    pub credentials: Option<HeaderValue>,
    /// For https and wss.
    pub tls: Option<Arc<ClientConfig>>,
}

impl Address {
    /// Parses a URL; `roots` is a PEM file of authorities.
    ///
    /// # Errors
    /// [`ChainError::Url`], [`ChainError::Roots`].
    pub(super) fn parse(text: &str, roots: Option<&Path>) -> Result<Self, ChainError> {
        let shown = clean(&address_without_secrets(text), 120);
        let scheme = text.split_once("://").map_or("", |(scheme, _)| scheme);
        // What cannot be taken apart may hold a secret anywhere.
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
        let tls = is_secured.then(|| web::tls(roots).map(Arc::new).map_err(ChainError::Roots)).transpose()?;
        Ok(Self { url, credentials, tls })
    }
}

/// The header of a URL's user name and password.
fn basic(url: &Url) -> Result<Option<HeaderValue>, InvalidHeaderValue> {
    if url.username().is_empty() && url.password().is_none() {
        return Ok(None);
    }
    let mut pair = Zeroizing::new(unescaped(url.username()));
    pair.push(b':');
    pair.extend_from_slice(&Zeroizing::new(unescaped(url.password().unwrap_or_default())));
    let encoded = Zeroizing::new(STANDARD.encode(&*pair));
    let text = Zeroizing::new(format!("Basic {}", *encoded));
    let mut header = HeaderValue::from_str(&text)?;
    header.set_sensitive(true);
    Ok(Some(header))
}

/// The bytes behind `%41` and the like.
fn unescaped(text: &str) -> Vec<u8> {
    let digit = |byte: Option<&u8>| byte.and_then(|byte| char::from(*byte).to_digit(16));
    let (bytes, mut found, mut at) = (text.as_bytes(), Vec::with_capacity(text.len()), 0);
    while let Some(byte) = bytes.get(at) {
        let pair = (digit(bytes.get(at + 1)), digit(bytes.get(at + 2)));
        match (byte, pair) {
            (b'%', (Some(high), Some(low))) => {
                found.extend(u8::try_from(high * 16 + low));
                at += 3;
            }
            _ => {
                found.push(*byte);
                at += 1;
            }
        }
    }
    found
}

// Connections that stay open between requests. Each carries one request at a time, so an answer is always that of the
// last question; one on which something went wrong is closed.

/// A connection.
pub(super) trait Link: Send + Sized {
    /// Sends a request and reads its answer, of at most `most` bytes.
    fn exchange(&mut self, request: &str, most: usize) -> impl Future<Output = Result<Bytes, TransportError>> + Send;
}

/// Opens a connection whose answers have at most that many bytes.
pub(super) type Opener<L> =
    Box<dyn Fn(usize) -> Pin<Box<dyn Future<Output = Result<L, TransportError>> + Send>> + Send + Sync>;

/// The connections to one node.
pub(super) struct Kept<L> {
    open: Opener<L>,
    usual: Pool<L>,
    wide: Pool<L>,
}

struct Pool<L> {
    places: Semaphore,
    /// Idle connections and since when; the newest is last.
    idle: Mutex<Vec<(L, Instant)>>,
}

impl<L> Pool<L> {
    fn new(places: usize) -> Self {
        Self { places: Semaphore::new(places), idle: Mutex::default() }
    }

    /// The newest idle connection, unless the node may be about to close it.
    fn take(&self) -> Option<L> {
        let mut idle = self.idle.lock().unwrap_or_else(PoisonError::into_inner);
        idle.retain(|(_, since)| since.elapsed() < IDLE);
        idle.pop().map(|(link, _)| link)
    }

    fn give_back(&self, link: L) {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner).push((link, Instant::now()));
    }
}

impl<L: Link> Kept<L> {
    /// Not connected yet.
    pub(super) fn new(open: Opener<L>) -> Self {
        Self { open, usual: Pool::new(TOGETHER), wide: Pool::new(WIDE_TOGETHER) }
    }

    /// Makes a request and returns its answer.
    ///
    /// # Errors
    /// [`TransportError`].
    pub(super) async fn ask(&self, request: &str, limits: Limits) -> Result<Bytes, TransportError> {
        let pool = if limits.is_wide() { &self.wide } else { &self.usual };
        // It is never closed.
        let _place = pool.places.acquire().await.map_err(|error| TransportError::Broken(error.to_string()))?;
        let mut link = match pool.take() {
            Some(link) => link,
            None => (self.open)(limits.bytes).await?,
        };
        let answer = link.exchange(request, limits.bytes).await?;
        pool.give_back(link);
        Ok(answer)
    }
}

#[cfg(test)]
mod tests {
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
