//! A WebSocket, with or without TLS, and a socket of this machine.

use std::path::{Path, PathBuf};

use futures_util::{SinkExt as _, StreamExt as _};
use reqwest::Client;
use reqwest::header::{AUTHORIZATION, CONTENT_TYPE, HeaderValue, LOCATION};
use reqwest::redirect::Policy;
use serde::de::DeserializeOwned;
use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _};
use tokio::net::{TcpStream, UnixStream};
use tokio::sync::Semaphore;
use tokio_rustls::TlsConnector;
use tokio_rustls::rustls::pki_types::ServerName;
use tokio_tungstenite::tungstenite::client::IntoClientRequest as _;
use tokio_tungstenite::tungstenite::error::CapacityError;
use tokio_tungstenite::tungstenite::protocol::WebSocketConfig;
use tokio_tungstenite::tungstenite::{Bytes, Error, Message};
use tokio_tungstenite::{WebSocketStream, client_async_with_config};

use super::address::{Link, Opener, Server};
use super::answer::{self, Refused, broken};
use super::{CONNECTING, ChainError, IDLE, Limits, TOGETHER, TransportError, WIDE_TOGETHER};
use crate::model::clean;

/// Bytes read at once from a local socket.
const PIECE: usize = 64 << 10;

trait Wire: AsyncRead + AsyncWrite + Unpin + Send {}

impl<T: AsyncRead + AsyncWrite + Unpin + Send> Wire for T {}

/// A WebSocket.
pub(super) struct WebSocket {
    stream: WebSocketStream<Box<dyn Wire>>,
}

impl WebSocket {
    /// Opens them to a server.
    pub(super) fn opener(server: Server) -> Opener<Self> {
        Box::new(move |most| {
            let server = server.clone();
            Box::pin(async move { Self::open(&server, most).await })
        })
    }

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
}

impl Link for WebSocket {
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

/// Tries the addresses of the name one by one, and gives each its share of the time.
async fn connected(server: &Server) -> std::io::Result<TcpStream> {
    let port = server.url.port_or_known_default().unwrap_or(443);
    let addresses: Vec<_> = tokio::net::lookup_host((host(server), port)).await?.collect();
    let share = CONNECTING / u32::try_from(addresses.len().max(1)).unwrap_or(u32::MAX);
    let mut failure = std::io::Error::other("its name has no address");
    for address in addresses {
        match tokio::time::timeout(share, TcpStream::connect(address)).await {
            Ok(Ok(stream)) => {
                // A request is one small write, and its answer is waited for.
                stream.set_nodelay(true)?;
                return Ok(stream);
            }
            Ok(Err(error)) => failure = error,
            Err(_) => failure = std::io::Error::other(format!("{address} does not answer")),
        }
    }
    Err(failure)
}

/// Without the brackets around an address of version 6.
fn host(server: &Server) -> &str {
    server.url.host_str().unwrap_or_default().trim_start_matches('[').trim_end_matches(']')
}

/// A socket of this machine: JSON values, one after another.
pub(super) struct Local {
    stream: UnixStream,
}

impl Local {
    /// Opens them to a path.
    pub(super) fn opener(path: PathBuf) -> Opener<Self> {
        Box::new(move |_| {
            let path = path.clone();
            Box::pin(async move { Self::open(&path).await })
        })
    }

    async fn open(path: &Path) -> Result<Self, TransportError> {
        Ok(Self { stream: UnixStream::connect(path).await.map_err(|error| broken(&error))? })
    }
}

impl Link for Local {
    async fn exchange(&mut self, request: &str, most: usize) -> Result<Bytes, TransportError> {
        self.stream.write_all(request.as_bytes()).await.map_err(|error| broken(&error))?;
        let (mut answer, mut value) = (Vec::new(), Value::default());
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
            if read.iter().any(|byte| value.ends_with(*byte)) {
                return Ok(Bytes::from(answer));
            }
        }
    }
}

/// How far an object of JSON has come.
#[derive(Default)]
struct Value {
    depth: usize,
    in_text: bool,
    is_escaped: bool,
}

impl Value {
    /// Whether the object ends with this byte.
    fn ends_with(&mut self, byte: u8) -> bool {
        if self.in_text {
            match byte {
                _ if self.is_escaped => self.is_escaped = false,
                b'\\' => self.is_escaped = true,
                b'"' => self.in_text = false,
                _ => {}
            }
            return false;
        }
        match byte {
            b'"' => self.in_text = true,
            b'{' | b'[' => self.depth += 1,
            b'}' | b']' => {
                self.depth = self.depth.saturating_sub(1);
                return self.depth == 0;
            }
            _ => {}
        }
        false
    }
}

// Requests over HTTP, with or without TLS.

/// The longest page of an error that is looked at, bytes.
const LONGEST_PAGE: usize = 64 << 10;

/// A node that is asked over HTTP.
pub(super) struct Http {
    client: Client,
    server: Server,
    /// Each request needs a connection to itself, and a node has only so many.
    places: Semaphore,
    wide_places: Semaphore,
}

impl Http {
    /// Not connected yet.
    ///
    /// # Errors
    /// [`ChainError::Internal`] if the client cannot be built.
    pub(super) fn new(server: Server) -> Result<Self, ChainError> {
        // Redirects are not followed: only the node that was named gets requests and credentials.
        let client = Client::builder().no_proxy().redirect(Policy::none()).tls_built_in_root_certs(false);
        // Shared among the addresses of a name, so that one which is silent leaves time for the others.
        let client = client.connect_timeout(CONNECTING);
        let client = client.pool_max_idle_per_host(TOGETHER).pool_idle_timeout(IDLE);
        let client = match &server.tls {
            Some(config) => client.use_preconfigured_tls((**config).clone()),
            None => client,
        };
        let client = client.build().map_err(|error| ChainError::Internal(clean(&error.to_string(), 120)))?;
        let (places, wide_places) = (Semaphore::new(TOGETHER), Semaphore::new(WIDE_TOGETHER));
        Ok(Self { client, server, places, wide_places })
    }

    /// Makes a request and reads the result in its answer.
    ///
    /// # Errors
    /// [`TransportError`].
    pub(super) async fn ask<R: DeserializeOwned>(&self, body: String, limits: Limits) -> Result<R, TransportError> {
        let places = if limits.is_wide() { &self.wide_places } else { &self.places };
        // It is never closed.
        let _place = places.acquire().await.map_err(|error| TransportError::Broken(error.to_string()))?;
        let mut request = self.client.post(self.server.url.clone()).header(CONTENT_TYPE, "application/json");
        if let Some(credentials) = &self.server.credentials {
            request = request.header(AUTHORIZATION, credentials.clone());
        }
        let mut response = request.body(body).send().await.map_err(|error| broken(&error))?;
        let status = response.status();
        // A page that says what went wrong may be as long as it likes; more than its beginning is not read.
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
        if !status.is_success() && !answer::is_one(&bytes) {
            let location = response.headers().get(LOCATION).and_then(|place: &HeaderValue| place.to_str().ok());
            return Err(Refused { status: status.as_u16(), location, page: &bytes }.words(&self.server));
        }
        answer::read(&bytes).map_err(|error| if is_page(&bytes) { web_page() } else { error })
    }
}

fn is_page(bytes: &[u8]) -> bool {
    bytes.trim_ascii_start().starts_with(b"<")
}

/// Its text tells nothing, and a fault of JSON is not what is wrong.
fn web_page() -> TransportError {
    TransportError::Malformed("a web page: what stands before the node refused the request".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_object_ends_with_its_own_bracket() {
        for text in [r#"{"a":[1,{"b":"}\"]"}]}"#, r#" {"result":"\\"}"#, "[]"] {
            let mut value = Value::default();
            let ends: Vec<bool> = text.bytes().map(|byte| value.ends_with(byte)).collect();
            assert_eq!(ends.iter().position(|end| *end), Some(text.len() - 1), "{text}");
        }
    }
}
