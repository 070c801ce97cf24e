//! The address of a node, its credentials, and what TLS to it trusts.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use reqwest::Url;
use reqwest::header::{HeaderValue, InvalidHeaderValue};
use tokio_rustls::rustls::ClientConfig;
use zeroize::Zeroizing;

use super::ChainError;
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
