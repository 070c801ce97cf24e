//! Addresses of peers: URIs, name resolution and connecting with a deadline, and this machine's own address.

use std::fmt;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpStream, ToSocketAddrs, UdpSocket};
use std::sync::mpsc;
use std::time::{Duration, Instant};

use super::{Result, RosError};
use crate::model::clean;

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
