//! The part of HTTP/1.1 that JSON-RPC needs, for callers on this machine: bounded heads and bodies, no requests from
//! browsers, one answer each. (The ROS crate has its own: blocking, XML, one request per connection.)

use std::io;
use std::net::IpAddr;

use tokio::io::{AsyncBufRead, AsyncBufReadExt, AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};

/// The longest request line with all headers, bytes.
const LONGEST_HEAD: u64 = 16 * 1024;
/// The longest body, bytes.
pub const LONGEST_BODY: usize = 1024 * 1024;

/// A request that may be answered.
#[derive(Debug, PartialEq, Eq)]
pub struct Request {
    /// Its body.
    pub body: Vec<u8>,
    /// Whether the connection stays open.
    pub keep: bool,
}

/// Why a request is not answered; the connection ends with it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Refusal {
    /// Status code and reason phrase.
    pub status: &'static str,
    /// What to do about it.
    pub why: &'static str,
}

impl Refusal {
    const fn new(status: &'static str, why: &'static str) -> Self {
        Self { status, why }
    }

    const fn bad(why: &'static str) -> Self {
        Self::new("400 Bad Request", why)
    }
}

/// How reading a request ended.
#[derive(Debug)]
pub enum Broken {
    /// The peer closed the connection, or it broke.
    Gone,
    /// The request is refused.
    Refused(Refusal),
}

impl From<io::Error> for Broken {
    fn from(_: io::Error) -> Self {
        Self::Gone
    }
}

impl From<Refusal> for Broken {
    fn from(refusal: Refusal) -> Self {
        Self::Refused(refusal)
    }
}

/// What the head says about the body.
struct Head {
    length: usize,
    keep: bool,
    asks_first: bool,
}

/// Reads one request. A caller that sends "Expect: 100-continue" gets its interim answer before the body is read.
///
/// # Errors
/// [`Broken`].
pub async fn read<S: AsyncRead + AsyncWrite + Unpin>(stream: &mut tokio::io::BufReader<S>) -> Result<Request, Broken> {
    let head = read_head(stream).await?;
    if head.asks_first && head.length > 0 {
        stream.get_mut().write_all(b"HTTP/1.1 100 Continue\r\n\r\n").await?;
    }
    let mut body = Vec::new();
    stream.take(head.length as u64).read_to_end(&mut body).await?;
    if body.len() == head.length { Ok(Request { body, keep: head.keep }) } else { Err(Broken::Gone) }
}

async fn read_head(stream: &mut (impl AsyncBufRead + Unpin)) -> Result<Head, Broken> {
    let mut limited = stream.take(LONGEST_HEAD);
    let first = line(&mut limited).await?;
    let recent = request_line(&first)?;
    let mut headers = Headers::default();
    loop {
        let header = line(&mut limited).await?;
        if header.is_empty() {
            return Ok(headers.settle(recent)?);
        }
        headers.take(&header)?;
    }
}

async fn line(from: &mut (impl AsyncBufRead + Unpin)) -> Result<String, Broken> {
    let mut bytes = Vec::new();
    from.read_until(b'\n', &mut bytes).await?;
    if bytes.is_empty() {
        return Err(Broken::Gone);
    }
    if bytes.pop() != Some(b'\n') {
        return Err(Refusal::new("431 Request Header Fields Too Large", "the head is cut or too long").into());
    }
    if bytes.last() == Some(&b'\r') {
        bytes.pop();
    }
    String::from_utf8(bytes).map_err(|_| Refusal::bad("the head is not text").into())
}

/// Whether it is HTTP/1.1, which keeps connections open by default.
fn request_line(line: &str) -> Result<bool, Refusal> {
    let mut words = line.split(' ');
    let (Some(method), Some(target), Some(version), None) = (words.next(), words.next(), words.next(), words.next())
    else {
        return Err(Refusal::bad("the request line is not METHOD TARGET VERSION"));
    };
    let recent = match version {
        "HTTP/1.1" => true,
        "HTTP/1.0" => false,
        _ => return Err(Refusal::new("505 HTTP Version Not Supported", "use HTTP/1.1")),
    };
    if method != "POST" {
        return Err(Refusal::new("405 Method Not Allowed", "use POST for JSON-RPC"));
    }
    if target != "/" {
        return Err(Refusal::new("404 Not Found", "JSON-RPC is at /"));
    }
    Ok(recent)
}

#[derive(Default)]
struct Headers {
    host: Option<String>,
    length: Option<usize>,
    json: bool,
    close: Option<bool>,
    asks_first: bool,
}

impl Headers {
    fn take(&mut self, header: &str) -> Result<(), Refusal> {
        let (name, value) = header.split_once(':').ok_or(Refusal::bad("a header has no colon"))?;
        if name.is_empty() || !name.bytes().all(|byte| byte.is_ascii_graphic()) {
            return Err(Refusal::bad("a header's name is not valid"));
        }
        let value = value.trim();
        match name.to_ascii_lowercase().as_str() {
            "host" if self.host.is_some() => return Err(Refusal::bad("there are two Host headers")),
            "host" => self.host = Some(value.to_owned()),
            "content-length" => self.length = Some(self.length(value)?),
            "transfer-encoding" => return Err(Refusal::new("411 Length Required", "send a Content-Length")),
            "content-type" => self.json = media_type(value) == "application/json",
            "connection" => self.close = Some(value.eq_ignore_ascii_case("close")),
            "expect" => self.asks_first = value.eq_ignore_ascii_case("100-continue"),
            "origin" => return Err(Refusal::new("403 Forbidden", "requests from web pages are refused")),
            _ => {}
        }
        Ok(())
    }

    fn length(&self, value: &str) -> Result<usize, Refusal> {
        if self.length.is_some() || value.is_empty() || !value.bytes().all(|byte| byte.is_ascii_digit()) {
            return Err(Refusal::bad("the Content-Length is not a single number"));
        }
        let length = value.parse().ok().filter(|length| *length <= LONGEST_BODY);
        length.ok_or(Refusal::new("413 Content Too Large", "a body may have at most 1 MiB; send smaller batches"))
    }

    fn settle(self, recent: bool) -> Result<Head, Refusal> {
        let host = self.host.ok_or(Refusal::bad("the Host header is missing"))?;
        // If an attacker's DNS name resolves to this machine, Host still holds the attacker's name.
        if !is_this_machine(&host) {
            return Err(Refusal::new(
                "403 Forbidden",
                "the Host header must name this machine: localhost or 127.0.0.1",
            ));
        }
        // A browser form cannot send this type to another origin without a preflight request, which is refused.
        if !self.json {
            return Err(Refusal::new("415 Unsupported Media Type", "set Content-Type: application/json"));
        }
        let length = self.length.ok_or(Refusal::new("411 Length Required", "send a Content-Length"))?;
        let keep = match self.close {
            Some(close) => !close && recent,
            None => recent,
        };
        Ok(Head { length, keep, asks_first: self.asks_first })
    }
}

fn media_type(value: &str) -> String {
    value.split(';').next().unwrap_or_default().trim().to_ascii_lowercase()
}

fn is_this_machine(host: &str) -> bool {
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

/// An answer with a JSON body; empty if the request was only a notification.
pub fn answer(body: &[u8], keep: bool) -> Vec<u8> {
    message("200 OK", "application/json", body, keep)
}

/// An answer to a refused request.
pub fn refusal(refusal: Refusal) -> Vec<u8> {
    message(refusal.status, "text/plain; charset=utf-8", format!("{}\n", refusal.why).as_bytes(), false)
}

fn message(status: &str, kind: &str, body: &[u8], keep: bool) -> Vec<u8> {
    let connection = if keep { "keep-alive" } else { "close" };
    let allow = if status.starts_with("405") { "Allow: POST\r\n" } else { "" };
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nConnection: {connection}\r\n{allow}\
         X-Content-Type-Options: nosniff\r\n\r\n",
        body.len()
    );
    [head.as_bytes(), body].concat()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The result of reading a request from these bytes, and what was written meanwhile.
    async fn given(bytes: &[u8]) -> (Result<Request, Broken>, Vec<u8>) {
        let (near, far) = tokio::io::duplex(4 << 20);
        let (mut reading, mut writing) = tokio::io::split(far);
        writing.write_all(bytes).await.expect("writes");
        writing.shutdown().await.expect("ends");
        let mut stream = tokio::io::BufReader::new(near);
        let request = read(&mut stream).await;
        drop(stream);
        let mut written = Vec::new();
        reading.read_to_end(&mut written).await.expect("reads");
        (request, written)
    }

    async fn status(bytes: &[u8]) -> String {
        match given(bytes).await.0 {
            Ok(_) => "200".to_owned(),
            Err(Broken::Gone) => "gone".to_owned(),
            Err(Broken::Refused(refusal)) => refusal.status[..3].to_owned(),
        }
    }

    const HEADS: &str = "POST / HTTP/1.1\r\nHost: 127.0.0.1:8545\r\nContent-Type: application/json\r\n";

    #[tokio::test]
    async fn requests() {
        let (request, written) = given(format!("{HEADS}Content-Length: 3\r\n\r\nabcd").as_bytes()).await;
        assert_eq!(request.expect("a request"), Request { body: b"abc".to_vec(), keep: true });
        assert!(written.is_empty());
        let (request, written) = given(
            b"POST / HTTP/1.1\nhost: LOCALHOST\ncontent-type: Application/JSON; charset=utf-8\nconnection: Close\n\
              expect: 100-continue\ncontent-length: 2\n\n[]",
        )
        .await;
        assert_eq!(request.expect("a request"), Request { body: b"[]".to_vec(), keep: false });
        assert_eq!(written, b"HTTP/1.1 100 Continue\r\n\r\n");
    }

    #[tokio::test]
    async fn refusals() {
        let with = |head: &str| format!("{HEADS}{head}\r\n\r\n");
        let replaced = |from: &str, to: &str| format!("{HEADS}Content-Length: 0\r\n\r\n").replace(from, to);
        for (expected, request) in [
            ("200", replaced("", "")),
            ("405", replaced("POST", "GET")),
            ("405", replaced("POST", "OPTIONS")),
            ("404", replaced("POST /", "POST /x")),
            ("505", replaced("HTTP/1.1", "HTTP/2")),
            ("400", replaced("POST / ", "POST /")),
            ("400", replaced("Host: 127.0.0.1:8545\r\n", "")),
            ("400", replaced("Host: 127.0.0.1:8545\r\n", "Host: localhost\r\nHost: localhost\r\n")),
            ("403", replaced("127.0.0.1:8545", "evil.example:8545")),
            ("403", replaced("127.0.0.1:8545", "127.0.0.1.evil.example")),
            ("403", replaced("127.0.0.1:8545", "localhost:8545@evil.example")),
            ("403", replaced("127.0.0.1:8545", "10.0.0.1")),
            ("403", replaced("Host:", "Origin: http://127.0.0.1\r\nHost:")),
            ("415", replaced("application/json", "text/plain")),
            ("415", replaced("Content-Type", "X-Type")),
            ("411", replaced("Content-Length: 0", "X: y")),
            ("411", replaced("Content-Length: 0", "Transfer-Encoding: chunked")),
            ("400", with("Content-Length: -1")),
            ("400", with("Content-Length: 1\r\nContent-Length: 1")),
            ("413", with("Content-Length: 1048577")),
            ("413", with("Content-Length: 99999999999999999999999")),
            ("400", with("no colon")),
            ("400", with(" folded: line")),
            ("431", with(&"x: y\r\n".repeat(4000))),
            ("431", "P".repeat(20_000)),
            ("gone", String::new()),
            ("gone", with("Content-Length: 1048576")),
            ("gone", HEADS.to_owned()),
        ] {
            assert_eq!(status(request.as_bytes()).await, expected, "{request:.300}");
        }
        for host in ["127.9.9.9", "[::1]:1", "[::1]", "localhost:1"] {
            assert_eq!(status(replaced("127.0.0.1:8545", host).as_bytes()).await, "200", "{host}");
        }
        assert_eq!(status(b"\xff\xfe\n").await, "400");
    }

    proptest! {
        #[test]
        fn noise_never_panics(noise in "(POST / HTTP/1.1\r\n|Host: localhost\r\n|Content-Length: |\r\n|\n|[0-9]|.){0,40}") {
            let runtime = tokio::runtime::Builder::new_current_thread().build().expect("runtime");
            if let (Ok(request), _) = runtime.block_on(given(noise.as_bytes())) {
                prop_assert!(request.body.len() <= LONGEST_BODY);
            }
        }
    }
}
