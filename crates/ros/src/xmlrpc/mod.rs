//! A small XML-RPC over HTTP, client and server, with a deadline on every call and a cap on every size. Of HTTP/1.x it
//! has one request and one response, then the connection closes.

mod value;

use std::io::{self, BufRead, BufReader, ErrorKind, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use std::{sync::Arc, thread::JoinHandle};

use value::{parse_call, parse_response, write_call, write_fault, write_response};

use crate::model::clean;
use crate::tcpros::{Endpoint, connect, time_left};

pub(super) use value::Value;

const LONGEST_RESPONSE: usize = 8 << 20;

const CONNECT: Duration = Duration::from_millis(1500);

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(crate) enum CallError {
    /// No connection could be made.
    #[error("{0}")]
    Connect(String),
    /// The connection broke, or the answer did not come in time.
    #[error("{0}")]
    Broken(String),
    /// The response is not valid.
    #[error("{0}")]
    Protocol(String),
    #[error("{0}")]
    Refused(String),
}

pub(crate) fn call(peer: &Endpoint, method: &str, params: &[Value], deadline: Instant) -> Result<Value, CallError> {
    let response = forward(peer, &write_call(method, params), deadline)?;
    let response = parse_response(&response).map_err(|error| CallError::Protocol(error.to_string()))?;
    unwrap_answer(response.map_err(|words| CallError::Refused(clean(&words, 200)))?)
}

/// Passes the text of a call on; returns the response's text, unread.
pub(crate) fn forward(peer: &Endpoint, body: &str, deadline: Instant) -> Result<String, CallError> {
    let by = deadline.min(Instant::now() + CONNECT);
    let stream = connect(&peer.host, peer.port, by).map_err(|error| CallError::Connect(error.to_string()))?;
    let response = exchange(&stream, peer, body, deadline);
    // The peer may have closed first.
    let _ = stream.shutdown(Shutdown::Both);
    response
}

fn exchange(stream: &TcpStream, peer: &Endpoint, body: &str, deadline: Instant) -> Result<String, CallError> {
    let broken = |error: std::io::Error| match error.kind() {
        std::io::ErrorKind::InvalidData => CallError::Protocol(error.to_string()),
        _ => CallError::Broken(error.to_string()),
    };
    let request = format!(
        "POST {} HTTP/1.1\r\nHost: {}\r\nUser-Agent: authros\r\nConnection: close\r\nContent-Type: text/xml\r\n\
         Content-Length: {}\r\n\r\n{body}",
        peer.path,
        peer.authority(),
        body.len()
    );
    let mut timed = Timed { stream, deadline };
    timed.write_all(request.as_bytes()).map_err(broken)?;
    let (status, body) = read_message(timed, LONGEST_RESPONSE, true).map_err(broken)?;
    if status.split_whitespace().nth(1) != Some("200") {
        return Err(CallError::Protocol(format!("it answered '{}'", clean(&status, 60))));
    }
    Ok(String::from_utf8_lossy(&body).into_owned())
}

fn unwrap_answer(value: Value) -> Result<Value, CallError> {
    let parts = if let Value::Array(parts) = value { parts } else { Vec::new() };
    let Ok([code, status, value]) = <[Value; 3]>::try_from(parts) else {
        return Err(CallError::Protocol("its answer is not [code, status, value]".into()));
    };
    match code.as_int() {
        Some(1) => Ok(value),
        Some(_) => Err(CallError::Refused(clean(status.as_text().unwrap_or("no reason given"), 200))),
        None => Err(CallError::Protocol("its answer has no code".into())),
    }
}

const LONGEST_REQUEST: usize = 1 << 20;

/// Connections that a node serves at a time; further ones are closed.
pub(crate) const OF_A_NODE: usize = 32;

const LONGEST_CONNECTION: Duration = Duration::from_secs(5);

pub(crate) trait Answer: Send + Sync + 'static {
    /// `None` if there is no such method. Must not block.
    fn answer(&self, method: &str, params: &[Value]) -> Option<Value>;

    /// The whole response of another server, as text; `None` if [`Self::answer`] is to answer.
    fn handed_on(&self, _method: &str, _call: &str) -> Option<String> {
        None
    }
}

pub(crate) struct Server {
    address: SocketAddr,
    stopping: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Serves at most `most` connections at a time.
    pub fn start(listener: TcpListener, answer: Arc<dyn Answer>, most: usize) -> io::Result<Self> {
        Self::of("ros-slave", listener, most, move |stream| serve(&stream, &*answer))
    }

    /// Handles each connection in its own thread, at most `most` at a time; further ones are closed.
    pub fn of(
        name: &'static str,
        listener: TcpListener,
        most: usize,
        handle: impl Fn(TcpStream) -> io::Result<()> + Send + Sync + 'static,
    ) -> io::Result<Self> {
        let address = listener.local_addr()?;
        let stopping = Arc::new(AtomicBool::new(false));
        let (seen, handle) = (Arc::clone(&stopping), Arc::new(handle));
        let accept = move || accept_all(name, &listener, &seen, &handle, most);
        let thread = std::thread::Builder::new().name(name.into()).spawn(accept)?;
        Ok(Self { address, stopping, thread: Some(thread) })
    }

    pub fn port(&self) -> u16 {
        self.address.port()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stopping.store(true, Ordering::SeqCst);
        // Accepting blocks: connecting to ourselves wakes it.
        let woken = TcpStream::connect_timeout(&self.address, Duration::from_millis(500)).is_ok();
        if let Some(thread) = self.thread.take().filter(|_| woken) {
            let _ = thread.join();
        }
    }
}

fn accept_all<H: Fn(TcpStream) -> io::Result<()> + Send + Sync + 'static>(
    name: &str,
    listener: &TcpListener,
    stopping: &AtomicBool,
    handle: &Arc<H>,
    most: usize,
) {
    // One share for each open connection.
    let open = Arc::new(());
    while !stopping.load(Ordering::SeqCst) {
        let Ok((stream, _)) = listener.accept() else {
            // Out of descriptors, for example: not a reason to spin.
            std::thread::sleep(Duration::from_millis(20));
            continue;
        };
        if stopping.load(Ordering::SeqCst) || Arc::strong_count(&open) > most {
            continue;
        }
        let (place, handle) = (Arc::clone(&open), Arc::clone(handle));
        // Without a thread the peer's connection closes, and it asks again.
        let _ = std::thread::Builder::new().name(format!("{name}-call")).spawn(move || {
            // A failed connection is the peer's concern.
            let _ = handle(stream);
            drop(place);
        });
    }
}

fn serve(stream: &TcpStream, answer: &dyn Answer) -> std::io::Result<()> {
    stream.set_nodelay(true)?;
    let deadline = Instant::now() + LONGEST_CONNECTION;
    let (first, body) = read_message(Timed { stream, deadline }, LONGEST_REQUEST, false)?;
    let (status, body) = if first.starts_with("POST ") {
        ("200 OK", respond(&String::from_utf8_lossy(&body), answer))
    } else {
        ("405 Method Not Allowed", String::new())
    };
    let head = format!(
        "HTTP/1.1 {status}\r\nServer: authros\r\nConnection: close\r\nContent-Type: text/xml\r\n\
         Content-Length: {}\r\n\r\n",
        body.len()
    );
    let mut timed = Timed { stream, deadline };
    timed.write_all(head.as_bytes())?;
    timed.write_all(body.as_bytes())?;
    stream.shutdown(Shutdown::Write)
}

fn respond(text: &str, answer: &dyn Answer) -> String {
    match parse_call(text) {
        Ok((method, params)) => {
            answer.handed_on(&method, text).unwrap_or_else(|| match answer.answer(&method, &params) {
                Some(value) => write_response(&value),
                None => write_fault(-32601, "there is no such method"),
            })
        }
        Err(error) => write_fault(-32700, &error.to_string()),
    }
}

/// Request or status line with headers, bytes.
const LONGEST_HEAD: u64 = 16 * 1024;

/// All reads and writes end at one deadline.
struct Timed<'a> {
    pub stream: &'a TcpStream,
    pub deadline: Instant,
}

impl Read for Timed<'_> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        self.stream.set_read_timeout(Some(time_left(self.deadline)?))?;
        let mut stream = self.stream;
        stream.read(out).map_err(as_timeout)
    }
}

impl Write for Timed<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.stream.set_write_timeout(Some(time_left(self.deadline)?))?;
        let mut stream = self.stream;
        stream.write(bytes).map_err(as_timeout)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

fn as_timeout(error: io::Error) -> io::Error {
    if error.kind() == ErrorKind::WouldBlock { io::Error::new(ErrorKind::TimedOut, "no answer in time") } else { error }
}

fn bad(reason: &'static str) -> io::Error {
    io::Error::new(ErrorKind::InvalidData, reason)
}

/// First line and body. Without a length, a response ends with the connection and a request has no body.
fn read_message(from: impl Read, most: usize, to_end: bool) -> io::Result<(String, Vec<u8>)> {
    let mut reader = BufReader::new(from);
    let mut head = reader.by_ref().take(LONGEST_HEAD);
    let first = line(&mut head)?;
    let mut length = None;
    let mut chunked = false;
    loop {
        let header = line(&mut head)?;
        let Some((name, value)) = header.split_once(':') else {
            if header.is_empty() { break } else { return Err(bad("its HTTP header is malformed")) }
        };
        if name.eq_ignore_ascii_case("content-length") {
            length = Some(value.trim().parse::<usize>().map_err(|_| bad("its HTTP length is not a number"))?);
        } else if name.eq_ignore_ascii_case("transfer-encoding") {
            chunked = value.trim().eq_ignore_ascii_case("chunked");
        }
    }
    let body = match length {
        _ if chunked => chunks(&mut reader, most)?,
        Some(length) => exactly(&mut reader, length, most)?,
        None if to_end => {
            let mut body = Vec::new();
            reader.take(most as u64 + 1).read_to_end(&mut body)?;
            if body.len() > most {
                return Err(bad("its HTTP body is too long"));
            }
            body
        }
        None => Vec::new(),
    };
    Ok((first, body))
}

fn line(from: &mut impl BufRead) -> io::Result<String> {
    let mut bytes = Vec::new();
    from.read_until(b'\n', &mut bytes)?;
    if bytes.pop() != Some(b'\n') {
        return Err(bad("its HTTP header ends early or is too long"));
    }
    String::from_utf8(bytes).map(|text| text.trim_end().to_owned()).map_err(|_| bad("its HTTP header is not text"))
}

fn exactly(from: &mut impl Read, length: usize, most: usize) -> io::Result<Vec<u8>> {
    if length > most {
        return Err(bad("its HTTP body is too long"));
    }
    let mut body = Vec::new();
    from.take(length as u64).read_to_end(&mut body)?;
    if body.len() == length { Ok(body) } else { Err(bad("its HTTP body ends early")) }
}

fn chunks(from: &mut impl BufRead, most: usize) -> io::Result<Vec<u8>> {
    let mut body = Vec::new();
    loop {
        let size = line(&mut from.take(LONGEST_HEAD))?;
        let digits = size.split(';').next().unwrap_or_default().trim();
        let size = usize::from_str_radix(digits, 16).map_err(|_| bad("an HTTP chunk has no size"))?;
        if size == 0 {
            return Ok(body);
        }
        body.extend(exactly(from, size, most - body.len())?);
        line(&mut from.take(2))?;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ros::tcpros::Endpoint;

    struct Echo;

    impl Answer for Echo {
        fn answer(&self, method: &str, params: &[Value]) -> Option<Value> {
            match method {
                "echo" => Some(Value::Array(vec![Value::Int(1), "".into(), Value::Array(params.to_vec())])),
                "no" => Some(Value::Array(vec![Value::Int(-1), "not \u{1b}now".into(), Value::Int(0)])),
                _ => None,
            }
        }
    }

    fn soon() -> Instant {
        Instant::now() + Duration::from_secs(2)
    }

    fn serve_echo() -> (Server, Endpoint) {
        let listener = TcpListener::bind("127.0.0.1:0").expect("bind");
        let uri = format!("http://{}/", listener.local_addr().expect("address"));
        (Server::start(listener, Arc::new(Echo), OF_A_NODE).expect("start"), Endpoint::parse(&uri).expect("uri"))
    }

    #[test]
    fn calls_are_answered_refused_and_unknown() {
        let (server, peer) = serve_echo();
        let params = [Value::from("a<b>&c"), Value::Int(7)];
        assert_eq!(call(&peer, "echo", &params, soon()), Ok(Value::Array(params.to_vec())));
        assert_eq!(call(&peer, "no", &[], soon()), Err(CallError::Refused("not \u{fffd}now".into())));
        assert!(matches!(call(&peer, "other", &[], soon()), Err(CallError::Refused(_))));
        drop(server);
        assert!(matches!(call(&peer, "echo", &[], soon()), Err(CallError::Connect(_))));
    }

    #[test]
    fn a_silent_peer_does_not_hold_the_caller() {
        let listener = TcpListener::bind("127.0.0.1:0").expect("bind");
        let uri = format!("http://{}/", listener.local_addr().expect("address"));
        let peer = Endpoint::parse(&uri).expect("uri");
        let deadline = Instant::now() + Duration::from_millis(100);
        assert!(matches!(call(&peer, "echo", &[], deadline), Err(CallError::Broken(_))));
    }

    #[test]
    fn other_methods_and_noise_do_not_stop_the_server() {
        let (_server, peer) = serve_echo();
        for noise in ["GET / HTTP/1.0\r\n\r\n", "\0\0\0\0\n\n", "POST / HTTP/1.1\r\nContent-Length: 3\r\n\r\nabc"] {
            let mut stream = TcpStream::connect((peer.host.as_str(), peer.port)).expect("connect");
            stream.write_all(noise.as_bytes()).expect("write");
            let mut answer = Vec::new();
            let _ = stream.read_to_end(&mut answer);
            assert!(!answer.starts_with(b"HTTP/1.1 200") || answer.windows(5).any(|part| part == b"fault"));
        }
        assert!(call(&peer, "echo", &[], soon()).is_ok());
    }
}

#[cfg(test)]
mod http_tests {
    use super::*;
    use proptest::prelude::*;

    fn read(text: &str, most: usize, to_end: bool) -> io::Result<(String, Vec<u8>)> {
        read_message(text.as_bytes(), most, to_end)
    }

    #[test]
    fn lengths_chunks_and_ends() {
        let (first, body) = read("POST / HTTP/1.1\r\nContent-Length: 3\r\n\r\nabcd", 9, false).expect("length");
        assert_eq!((first.as_str(), body.as_slice()), ("POST / HTTP/1.1", b"abc".as_slice()));
        let chunked = "HTTP/1.1 200 OK\r\ntransfer-encoding: chunked\r\n\r\n2\r\nab\r\n1;x=y\r\nc\r\n0\r\n\r\n";
        assert_eq!(read(chunked, 3, true).expect("chunks").1, b"abc");
        assert_eq!(read("HTTP/1.0 200 OK\n\nabc", 3, true).expect("end").1, b"abc");
        assert_eq!(read("GET / HTTP/1.0\r\n\r\nabc", 3, false).expect("none").1, b"");
    }

    #[test]
    fn beyond_the_caps_and_cut_short() {
        assert!(read("P\r\nContent-Length: 4\r\n\r\nabcd", 3, false).is_err());
        assert!(read("P\r\nContent-Length: 4\r\n\r\nabc", 9, false).is_err());
        assert!(read("P\r\nContent-Length: -1\r\n\r\n", 9, false).is_err());
        assert!(read("P\n\nabcd", 3, true).is_err());
        assert!(read("P\r\ntransfer-encoding: chunked\r\n\r\n2\r\nab\r\n2\r\ncd\r\n0\r\n\r\n", 3, true).is_err());
        assert!(read(&format!("P\r\nx: {}\r\n\r\n", "y".repeat(20_000)), 9, true).is_err());
        assert!(read(&"x: y\r\n".repeat(20_000), 9, true).is_err());
    }

    proptest! {
        #[test]
        fn noise_never_panics_and_stays_under_the_cap(
            noise in "(Content-Length: |Transfer-Encoding: chunked|\r\n|\n|[0-9a-f]|.){0,40}", most in 0usize..20
        ) {
            if let Ok((_, body)) = read(&noise, most, true) {
                prop_assert!(body.len() <= most);
            }
        }
    }
}
