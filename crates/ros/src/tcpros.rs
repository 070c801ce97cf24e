//! Of every ROS 1 node: TCPROS's connection headers and length-prefixed frames, and the slave API for the master and
//! tools such as rosnode.

use std::fmt;
use std::io::{BufRead, BufReader, ErrorKind, Read};
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener, TcpStream, ToSocketAddrs, UdpSocket};
use std::sync::{Arc, mpsc};
use std::time::{Duration, Instant};

use crate::xmlrpc::{Answer, OF_A_NODE, Server, Value};
use crate::{Result, RosError, model::clean};

/// Bytes.
pub const LONGEST_MESSAGE: usize = 64 << 20;

pub(crate) const LONGEST_HEADER: usize = 1 << 20;

const MOST_FIELDS: usize = 64;

#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(crate) struct ConnectionHeader(Vec<(String, String)>);

impl ConnectionHeader {
    pub fn new<'a>(fields: impl IntoIterator<Item = (&'a str, &'a str)>) -> Self {
        Self(fields.into_iter().map(|(key, value)| (key.to_owned(), value.to_owned())).collect())
    }

    pub fn get(&self, key: &str) -> Option<&str> {
        self.0.iter().find(|(name, _)| name == key).map(|(_, value)| value.as_str())
    }

    /// From the bytes after the length; invalid UTF-8 is replaced.
    pub fn parse(mut bytes: &[u8]) -> Result<Self, &'static str> {
        let mut fields = Vec::new();
        while !bytes.is_empty() {
            let (prefix, rest) = bytes.split_first_chunk().ok_or("a field's length is cut short")?;
            let length = usize::try_from(u32::from_le_bytes(*prefix)).map_err(|_| "a field is too long")?;
            let (field, rest) = rest.split_at_checked(length).ok_or("a field is cut short")?;
            let text = String::from_utf8_lossy(field);
            let (key, value) = text.split_once('=').ok_or("a field has no '='")?;
            if fields.len() == MOST_FIELDS {
                return Err("it has too many fields");
            }
            fields.push((key.to_owned(), value.to_owned()));
            bytes = rest;
        }
        Ok(Self(fields))
    }

    /// Total length first. Fields beyond 32 bits are left out.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut body = Vec::new();
        for (key, value) in &self.0 {
            if let Ok(length) = u32::try_from(key.len() + 1 + value.len()) {
                body.extend_from_slice(&length.to_le_bytes());
                body.extend_from_slice(key.as_bytes());
                body.push(b'=');
                body.extend_from_slice(value.as_bytes());
            }
        }
        let total = u32::try_from(body.len()).unwrap_or(u32::MAX);
        [total.to_le_bytes().as_slice(), &body].concat()
    }
}

const BUFFER: usize = 256 << 10;

#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Poll {
    Frame(Vec<u8>),
    /// Nothing complete before the read timed out.
    Pending,
    /// The peer closed, between frames (`true`) or inside one.
    Closed(bool),
    /// The peer announced a frame of this length, beyond the cap; the stream is no longer usable.
    TooLong(u32),
}

/// Keeps an incomplete frame between calls.
pub(crate) struct FrameReader<R> {
    reader: BufReader<R>,
    prefix: Vec<u8>,
    body: Vec<u8>,
}

impl<R: Read> FrameReader<R> {
    /// A stream needs a read timeout if waiting is to end.
    pub fn new(stream: R) -> Self {
        Self { reader: BufReader::with_capacity(BUFFER, stream), prefix: Vec::with_capacity(4), body: Vec::new() }
    }

    /// Of at most `most` bytes.
    pub fn poll(&mut self, most: usize) -> std::io::Result<Poll> {
        loop {
            let Ok(prefix) = <[u8; 4]>::try_from(self.prefix.as_slice()) else {
                match fill(&mut self.reader, &mut self.prefix, 4)? {
                    Filled::Whole => continue,
                    Filled::TimedOut => return Ok(Poll::Pending),
                    Filled::Closed => return Ok(Poll::Closed(self.prefix.is_empty())),
                }
            };
            let claimed = u32::from_le_bytes(prefix);
            let Some(length) = usize::try_from(claimed).ok().filter(|length| *length <= most) else {
                return Ok(Poll::TooLong(claimed));
            };
            if self.body.capacity() == 0 {
                self.body.reserve_exact(length.min(BUFFER));
            }
            return match fill(&mut self.reader, &mut self.body, length)? {
                Filled::Whole => {
                    self.prefix.clear();
                    Ok(Poll::Frame(std::mem::take(&mut self.body)))
                }
                Filled::TimedOut => Ok(Poll::Pending),
                Filled::Closed => Ok(Poll::Closed(false)),
            };
        }
    }
}

enum Filled {
    Whole,
    TimedOut,
    Closed,
}

fn fill(reader: &mut impl BufRead, into: &mut Vec<u8>, length: usize) -> std::io::Result<Filled> {
    while into.len() < length {
        let available = match reader.fill_buf() {
            Ok([]) => return Ok(Filled::Closed),
            Ok(bytes) => bytes,
            Err(error) => match error.kind() {
                ErrorKind::Interrupted => continue,
                ErrorKind::WouldBlock | ErrorKind::TimedOut => return Ok(Filled::TimedOut),
                _ => return Err(error),
            },
        };
        let taken = available.len().min(length - into.len());
        into.extend_from_slice(&available[..taken]);
        reader.consume(taken);
    }
    Ok(Filled::Whole)
}

pub(super) struct BusLink {
    pub peer: String,
    pub outbound: bool,
    pub topic: String,
}

/// A node's report about itself. Nothing here may block.
pub(super) trait Node: Send + Sync + 'static {
    fn master_uri(&self) -> String;
    fn subscriptions(&self) -> Vec<(String, String)> {
        Vec::new()
    }
    fn publications(&self) -> Vec<(String, String)> {
        Vec::new()
    }
    fn links(&self) -> Vec<BusLink>;
    /// A claim, with the publishers' URIs.
    fn publishers_changed(&self, _topic: &str, _publishers: &[&str]) {}
    /// Host and port where it serves a topic.
    fn outlet(&self, _topic: &str) -> Option<(String, u16)> {
        None
    }
    /// Anyone may ask it to shut down.
    fn shutdown_asked(&self, _by: &str, _reason: &str) {}
}

pub(super) struct SlaveServer {
    pub uri: String,
    _server: Server,
}

impl SlaveServer {
    /// On a free port of `host`.
    pub fn start(host: &str, node: Arc<dyn Node>) -> Result<Self> {
        let server = Server::start(listen(host)?, Arc::new(Slave(node)), OF_A_NODE)
            .map_err(|error| RosError::system("start a thread", &error))?;
        Ok(Self { uri: format!("http://{}/", authority(host, server.port())), _server: server })
    }
}

/// On a free port of `host` only.
pub(super) fn listen(host: &str) -> Result<TcpListener> {
    let address = listen_address(host, Instant::now() + Duration::from_secs(2))?;
    TcpListener::bind(address).map_err(|error| RosError::OwnHost { host: clean(host, 80), reason: error.to_string() })
}

struct Slave(Arc<dyn Node>);

impl Answer for Slave {
    fn answer(&self, method: &str, params: &[Value]) -> Option<Value> {
        let node = &*self.0;
        Some(match method {
            "getPid" => success(Value::Int(i64::from(std::process::id()))),
            "getMasterUri" => success(Value::Text(node.master_uri())),
            "getSubscriptions" => success(pairs(node.subscriptions())),
            "getPublications" => success(pairs(node.publications())),
            "getBusStats" => success(Value::Array(vec![Value::Array(Vec::new()); 3])),
            "getBusInfo" => success(bus_info(node.links())),
            "publisherUpdate" => publisher_update(node, params),
            "requestTopic" => request_topic(node, params),
            "paramUpdate" => success(Value::Int(0)),
            "shutdown" => {
                node.shutdown_asked(text_at(params, 0), text_at(params, 1));
                success(Value::Int(0))
            }
            _ => return None,
        })
    }
}

fn text_at(params: &[Value], index: usize) -> &str {
    params.get(index).and_then(Value::as_text).unwrap_or_default()
}

pub(super) fn success(value: Value) -> Value {
    Value::Array(vec![Value::Int(1), "".into(), value])
}

pub(super) fn failure(code: i64, reason: &str) -> Value {
    Value::Array(vec![Value::Int(code), reason.into(), Value::Int(0)])
}

fn pairs(pairs: Vec<(String, String)>) -> Value {
    pairs.into_iter().map(|(topic, kind)| Value::Array(vec![Value::Text(topic), Value::Text(kind)])).collect()
}

fn bus_info(links: Vec<BusLink>) -> Value {
    let row = |(number, link): (i64, BusLink)| {
        Value::Array(vec![
            Value::Int(number),
            Value::Text(link.peer),
            if link.outbound { "o" } else { "i" }.into(),
            "TCPROS".into(),
            Value::Text(link.topic),
            Value::Bool(true),
        ])
    };
    (1..).zip(links).map(row).collect()
}

fn publisher_update(node: &dyn Node, params: &[Value]) -> Value {
    let Some(topic) = params.get(1).and_then(Value::as_text) else {
        return failure(-1, "publisherUpdate needs a topic");
    };
    let uris = params.get(2).and_then(Value::as_array).unwrap_or_default();
    node.publishers_changed(topic, &uris.iter().filter_map(Value::as_text).collect::<Vec<_>>());
    success(Value::Int(0))
}

fn request_topic(node: &dyn Node, params: &[Value]) -> Value {
    let protocols = params.get(2).and_then(Value::as_array).unwrap_or_default();
    let tcpros =
        |protocol: &Value| protocol.as_array().and_then(<[Value]>::first).and_then(Value::as_text) == Some("TCPROS");
    if !protocols.iter().any(tcpros) {
        return failure(0, "only TCPROS is supported");
    }
    match node.outlet(text_at(params, 1)) {
        Some((host, port)) => success(Value::Array(vec!["TCPROS".into(), Value::Text(host), Value::Int(port.into())])),
        None => failure(0, "this topic is not published here"),
    }
}

// Addresses of peers: URIs, name resolution and connecting with a deadline, and this machine's own address.

pub(super) const UNRESOLVED: &str = "its name does not resolve";
const SHORTEST: Duration = Duration::from_millis(1);

#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(super) struct Endpoint {
    pub host: String,
    pub port: u16,
    pub path: String,
}

impl Endpoint {
    pub fn parse(uri: &str) -> Option<Self> {
        let rest = uri.strip_prefix("http://")?;
        let (authority, path) = rest.split_once('/').unwrap_or((rest, ""));
        let (host, port) = authority.rsplit_once(':')?;
        let host = host.strip_prefix('[').and_then(|inner| inner.strip_suffix(']')).unwrap_or(host);
        let host_ok = !host.is_empty()
            && host.len() <= 255
            && host.bytes().all(|b| b.is_ascii_alphanumeric() || b"-._:%".contains(&b));
        let path_ok = path.len() <= 255 && path.bytes().all(|b| b.is_ascii_graphic());
        let port = port.parse().ok().filter(|port| *port != 0)?;
        (host_ok && path_ok).then(|| Self { host: host.to_owned(), port, path: format!("/{path}") })
    }

    pub fn of_master(uri: &str) -> Result<Self> {
        Self::parse(uri).ok_or_else(|| RosError::Address(clean(uri, 120)))
    }

    /// With brackets around an IPv6 address.
    pub fn authority(&self) -> String {
        authority(&self.host, self.port)
    }
}

impl fmt::Display for Endpoint {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "http://{}{}", self.authority(), self.path)
    }
}

pub(super) fn authority(host: &str, port: u16) -> String {
    if host.contains(':') { format!("[{host}]:{port}") } else { format!("{host}:{port}") }
}

/// An error once `deadline` has passed.
pub(super) fn time_left(deadline: Instant) -> std::io::Result<Duration> {
    let left = deadline.saturating_duration_since(Instant::now());
    if left.is_zero() { Err(std::io::Error::new(std::io::ErrorKind::TimedOut, "no answer in time")) } else { Ok(left) }
}

/// Resolves a name in its own thread, because resolvers have no timeout.
pub(super) fn resolve(host: &str, port: u16, deadline: Instant) -> std::io::Result<Vec<SocketAddr>> {
    if let Ok(address) = host.parse::<IpAddr>() {
        return Ok(vec![SocketAddr::new(address, port)]);
    }
    let name = host.to_owned();
    let (sender, receiver) = mpsc::channel();
    std::thread::Builder::new().name("ros-resolve".into()).spawn(move || {
        let found = (name.as_str(), port).to_socket_addrs().map(Iterator::collect);
        // The caller may have stopped waiting.
        let _ = sender.send(found);
    })?;
    let late = |_| std::io::Error::new(std::io::ErrorKind::TimedOut, "its name does not resolve in time");
    let answer = receiver.recv_timeout(time_left(deadline)?).map_err(late)?;
    let unknown = |_| std::io::Error::new(std::io::ErrorKind::NotFound, UNRESOLVED);
    let mut found: Vec<SocketAddr> = answer.map_err(unknown)?;
    found.sort_by_key(SocketAddr::is_ipv6);
    found.truncate(8);
    Ok(found)
}

pub(super) fn connect(host: &str, port: u16, deadline: Instant) -> std::io::Result<TcpStream> {
    connect_to_any(&resolve(host, port, deadline)?, deadline)
}

/// Each address gets its share of the time left: a silent one must not use up that of the others.
fn connect_to_any(addresses: &[SocketAddr], deadline: Instant) -> std::io::Result<TcpStream> {
    let mut failure = std::io::Error::new(std::io::ErrorKind::NotFound, "its name has no address");
    for (address, further) in addresses.iter().zip((1..=addresses.len()).rev()) {
        let share = time_left(deadline)? / u32::try_from(further).unwrap_or(u32::MAX);
        match TcpStream::connect_timeout(address, share.max(SHORTEST)) {
            Ok(stream) => {
                stream.set_nodelay(true)?;
                return Ok(stream);
            }
            Err(error) => failure = error,
        }
    }
    Err(failure)
}

/// The host by which other nodes reach us: the given one; loopback if the master is there; otherwise the local address
/// of a route to the master.
pub(super) fn own_host(given: Option<&str>, master: &Endpoint, deadline: Instant) -> Result<String> {
    if let Some(host) = given.filter(|host| !host.is_empty()) {
        return Ok(host.to_owned());
    }
    let unreachable =
        |error: std::io::Error| RosError::Unreachable { uri: master.to_string(), reason: error.to_string() };
    let peer = resolve(&master.host, master.port, deadline).map_err(unreachable)?;
    let Some(peer) = peer.first() else {
        return Err(RosError::Unreachable { uri: master.to_string(), reason: "its name has no address".into() });
    };
    if peer.ip().is_loopback() {
        return Ok(Ipv4Addr::LOCALHOST.to_string());
    }
    // Connecting a datagram socket sends nothing; it only selects the route.
    let any: &str = if peer.is_ipv4() { "0.0.0.0:0" } else { "[::]:0" };
    let route = UdpSocket::bind(any).and_then(|socket| socket.connect(peer).and_then(|()| socket.local_addr()));
    route.map(|local| local.ip().to_string()).map_err(unreachable)
}

pub(super) fn listen_address(host: &str, deadline: Instant) -> Result<SocketAddr> {
    let failed = |reason: String| RosError::OwnHost { host: clean(host, 80), reason };
    let found = resolve(host, 0, deadline).map_err(|error| failed(error.to_string()))?;
    found.first().copied().ok_or_else(|| failed("the name has no address".into()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn broken_headers_are_refused() {
        assert_eq!(ConnectionHeader::parse(&[1, 0, 0]), Err("a field's length is cut short"));
        assert_eq!(ConnectionHeader::parse(&[255, 255, 255, 255, b'a']), Err("a field is cut short"));
        assert_eq!(ConnectionHeader::parse(&[1, 0, 0, 0, b'a']), Err("a field has no '='"));
        assert_eq!(ConnectionHeader::parse(&[2, 0, 0, 0, b'a', b'='].repeat(65)), Err("it has too many fields"));
        assert_eq!(ConnectionHeader::parse(&[]), Ok(ConnectionHeader::default()));
    }

    proptest! {
        #[test]
        fn round_trip_and_every_cut(fields in prop::collection::vec(("[a-z]{1,8}", ".{0,20}"), 1..6)) {
            let header = ConnectionHeader(fields);
            let bytes = header.to_bytes();
            let total = u32::try_from(bytes.len() - 4).expect("short");
            prop_assert_eq!(bytes.first_chunk(), Some(&total.to_le_bytes()));
            prop_assert_eq!(ConnectionHeader::parse(&bytes[4..]), Ok(header.clone()));
            for end in 5..bytes.len() {
                prop_assert_ne!(ConnectionHeader::parse(&bytes[4..end]), Ok(header.clone()));
            }
        }

        #[test]
        fn noise_never_panics(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let _ = ConnectionHeader::parse(&bytes);
        }
    }
}

#[cfg(test)]
mod frame_tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::VecDeque;

    /// Returns its pieces one by one, with a timeout after each.
    struct Dripping(VecDeque<Vec<u8>>, bool);

    impl Read for Dripping {
        fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
            self.1 = !self.1;
            if self.1 {
                return Err(ErrorKind::WouldBlock.into());
            }
            let Some(mut piece) = self.0.pop_front() else { return Ok(0) };
            let taken = piece.len().min(out.len());
            out[..taken].copy_from_slice(&piece[..taken]);
            if taken < piece.len() {
                self.0.push_front(piece.split_off(taken));
            }
            Ok(taken)
        }
    }

    fn frame(body: &[u8]) -> Vec<u8> {
        [u32::try_from(body.len()).expect("short").to_le_bytes().as_slice(), body].concat()
    }

    fn read_all(pieces: Vec<Vec<u8>>, most: usize) -> (Vec<Vec<u8>>, Poll) {
        let mut reader = FrameReader::new(Dripping(pieces.into_iter().filter(|p| !p.is_empty()).collect(), false));
        let mut frames = Vec::new();
        loop {
            match reader.poll(most).expect("no error") {
                Poll::Frame(body) => frames.push(body),
                Poll::Pending => {}
                end => return (frames, end),
            }
        }
    }

    #[test]
    fn a_claim_beyond_the_cap_is_not_followed() {
        assert_eq!(read_all(vec![vec![255, 255, 255, 255, 0]], 1000), (Vec::new(), Poll::TooLong(u32::MAX)));
        assert_eq!(read_all(vec![frame(b"abcd")], 3), (Vec::new(), Poll::TooLong(4)));
    }

    #[test]
    fn a_long_claim_allocates_only_what_arrives() {
        let mut reader = FrameReader::new([0, 0, 0, 4, 1, 2, 3].as_slice());
        assert_eq!(reader.poll(64 << 20).expect("no error"), Poll::Closed(false));
        assert!(reader.body.capacity() <= BUFFER);
    }

    proptest! {
        #[test]
        fn frames_survive_any_cutting(
            bodies in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..50), 0..8),
            cuts in prop::collection::vec(0usize..300, 0..12),
            lost in 0usize..5,
        ) {
            let mut stream: Vec<u8> = bodies.iter().flat_map(|body| frame(body)).collect();
            let lost = lost.min(bodies.last().map_or(0, |body| body.len() + 3));
            stream.truncate(stream.len() - lost);
            let mut cuts: Vec<usize> = cuts.into_iter().map(|cut| cut.min(stream.len())).collect();
            cuts.sort_unstable();
            let mut pieces = Vec::new();
            let mut from = 0;
            for cut in cuts {
                pieces.push(stream[from..cut].to_vec());
                from = cut;
            }
            pieces.push(stream[from..].to_vec());
            let (frames, end) = read_all(pieces, 1000);
            let whole = if lost == 0 { bodies.len() } else { bodies.len() - 1 };
            prop_assert_eq!(frames.as_slice(), &bodies[..whole]);
            prop_assert_eq!(end, Poll::Closed(lost == 0));
        }
    }
}

#[cfg(test)]
mod address_tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn uris() {
        let endpoint = Endpoint::parse("http://127.0.0.1:11311").expect("plain");
        assert_eq!(endpoint.to_string(), "http://127.0.0.1:11311/");
        let endpoint = Endpoint::parse("http://[::1]:5/RPC2").expect("v6");
        assert_eq!((endpoint.host.as_str(), endpoint.port, endpoint.path.as_str()), ("::1", 5, "/RPC2"));
        assert_eq!(endpoint.authority(), "[::1]:5");
        for bad in ["", "http://", "http://h", "http://h:0", "http://h:99999/", "https://h:1/", "http://a b:1/", "h:1"]
        {
            assert_eq!(Endpoint::parse(bad), None, "{bad}");
        }
    }

    #[test]
    fn own_host_is_the_given_one_or_loopback_beside_a_loopback_master() {
        let deadline = Instant::now() + Duration::from_secs(2);
        let master = Endpoint::parse("http://127.0.0.1:11999/").expect("uri");
        assert_eq!(own_host(Some("robot7"), &master, deadline).as_deref(), Ok("robot7"));
        assert_eq!(own_host(Some(""), &master, deadline).as_deref(), Ok("127.0.0.1"));
        assert_eq!(own_host(None, &master, deadline).as_deref(), Ok("127.0.0.1"));
    }

    proptest! {
        #[test]
        fn noise_never_panics_and_good_ones_round_trip(text in "(http://)?[ -~]{0,40}") {
            if let Some(endpoint) = Endpoint::parse(&text) {
                prop_assert_eq!(Endpoint::parse(&endpoint.to_string()), Some(endpoint));
            }
        }
    }

    #[test]
    fn an_address_that_is_silent_leaves_time_for_the_next() {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("binds");
        // One whose queue of connections is full does not answer further ones.
        let full = SilentListener::new();
        let addresses = [full.address, listener.local_addr().expect("an address")];
        let connected = connect_to_any(&addresses, Instant::now() + Duration::from_secs(4));
        assert_eq!(connected.expect("the second answers").peer_addr().ok(), Some(addresses[1]));
    }

    /// A listener that lets nobody in any more.
    struct SilentListener {
        address: SocketAddr,
        _listener: std::net::TcpListener,
        _queue: Vec<TcpStream>,
    }

    impl SilentListener {
        fn new() -> Self {
            let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("binds");
            let address = listener.local_addr().expect("an address");
            let mut queue = Vec::new();
            while let Ok(stream) = TcpStream::connect_timeout(&address, Duration::from_millis(300)) {
                queue.push(stream);
                assert!(queue.len() < 10_000, "the queue is never full");
            }
            Self { address, _listener: listener, _queue: queue }
        }
    }
}
