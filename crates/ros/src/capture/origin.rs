//! Where a message claims to come from, and which publishers with the same caller id overlapped in time.
//!
//! ROS 1 has no authentication: caller id, host and type are what a publisher states. What can be observed here is
//! whether two processes with one caller id existed at once, which never happens in a restart.

use std::collections::HashMap;
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use crate::ros::address::{Endpoint, resolve};

/// The most caller ids of a topic whose end is remembered.
const MOST_ENDED: usize = 256;

/// Counts the publishers seen by this process.
static MET: AtomicU64 = AtomicU64::new(1);

/// The number of the next publisher.
pub(crate) fn next_number() -> u64 {
    MET.fetch_add(1, Ordering::Relaxed)
}

/// A publisher with the same caller id that was still being read when another one registered.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Rival {
    /// Its number.
    pub number: u64,
    /// Its URI, as the master listed it.
    pub uri: String,
}

/// Who sends the messages of a connection, as far as ROS 1 reveals it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Origin {
    /// Unique in this process, kept across reconnections for as long as the master keeps listing its URI.
    pub number: u64,
    /// The node name it stated: clean it before it is shown.
    pub caller_id: Arc<str>,
    /// The host part of its URI, in lower case; if the bytes come from an address that does not belong to this name,
    /// that address.
    pub host: String,
    /// Its URI, as listed by the master.
    pub uri: String,
    /// Its type, `package/Type`.
    pub type_name: Arc<str>,
    /// The type's md5sum, as it stated it.
    pub md5sum: Arc<str>,
    /// When an answer of the master first listed it.
    pub listed_at: Instant,
    /// The publisher with the same caller id that it replaces or coexists with.
    pub rival: Option<Rival>,
    /// Its node's name is still to come: there is nothing to pin yet.
    pub unnamed: bool,
}

/// The host of an origin: the name in its URI, if the peer's address is one of that name's.
pub(super) fn host_of(endpoint: &Endpoint, peer: Option<SocketAddr>, deadline: Instant) -> String {
    let name = endpoint.host.to_ascii_lowercase();
    let Some(peer) = peer.map(|peer| plain(peer.ip())) else { return name };
    let known = resolve(&endpoint.host, endpoint.port, deadline).unwrap_or_default();
    if known.iter().any(|address| plain(address.ip()) == peer) { name } else { peer.to_string() }
}

fn plain(address: IpAddr) -> IpAddr {
    match address {
        IpAddr::V6(six) => six.to_ipv4_mapped().map_or(address, IpAddr::V4),
        IpAddr::V4(_) => address,
    }
}

/// A connection that ended.
struct Ended {
    number: u64,
    endpoint: Endpoint,
    at: Instant,
    /// By then its caller id was registered to somebody else.
    taken: bool,
}

/// When connections ended, by caller id, and since when the master's answers are known not to list somebody.
#[derive(Default)]
pub(super) struct Lineage {
    ended: HashMap<Arc<str>, Ended>,
    /// When the last answer of the master was requested.
    asked: Option<Instant>,
}

impl Lineage {
    /// The master was queried then, and answered or was down.
    pub fn asked(&mut self, at: Instant) {
        self.asked = Some(at);
    }

    /// The last moment at which a publisher that the next answer lists for the first time was not registered yet.
    pub fn absent_until(&self) -> Option<Instant> {
        self.asked
    }

    /// A connection ended; `taken` if the master then had somebody else under its caller id.
    pub fn ended(&mut self, caller_id: &Arc<str>, (number, endpoint): (u64, &Endpoint), at: Instant, taken: bool) {
        if self.ended.len() >= MOST_ENDED
            && let Some(oldest) = self.ended.iter().min_by_key(|(_, ended)| ended.at).map(|(name, _)| Arc::clone(name))
        {
            self.ended.remove(&oldest);
        }
        self.ended.insert(Arc::clone(caller_id), Ended { number, endpoint: endpoint.clone(), at, taken });
    }

    /// A publisher with this caller id whose connection may have ended only after `number` had registered, which was no
    /// earlier than `absent_until`.
    pub fn rival(&self, caller_id: &str, number: u64, absent_until: Option<Instant>) -> Option<Rival> {
        let former = self.ended.get(caller_id)?;
        let overlapped = former.taken || absent_until.is_none_or(|absent| former.at >= absent);
        let rival = || Rival { number: former.number, uri: former.endpoint.to_string() };
        (former.number != number && overlapped).then(rival)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    fn endpoint(port: u16) -> Endpoint {
        Endpoint { host: "Robot".into(), port, path: "/".into() }
    }

    #[test]
    fn a_restart_has_a_look_between_and_a_takeover_has_none() {
        let begun = Instant::now();
        let at = |seconds| begun + Duration::from_secs(seconds);
        let mut lineage = Lineage::default();
        let name: Arc<str> = "/driver".into();
        assert_eq!(lineage.absent_until(), None);
        lineage.asked(at(1));
        lineage.ended(&name, (1, &endpoint(10)), at(2), false);
        // Listed in the answer to the very next query: it had registered while the former was still there.
        let taken = lineage.rival(&name, 2, lineage.absent_until());
        assert_eq!(taken, Some(Rival { number: 1, uri: "http://Robot:10/".into() }));
        // A query after the end that did not list it: it came later.
        lineage.asked(at(3));
        assert_eq!(lineage.rival(&name, 3, lineage.absent_until()), None);
        // The same publisher again is not a rival, nor is another name.
        assert_eq!(lineage.rival(&name, 1, Some(at(1))), None);
        assert_eq!(lineage.rival("/other", 4, Some(at(1))), None);
        // However much later: its name was already somebody else's when it ended.
        lineage.ended(&name, (5, &endpoint(11)), at(4), true);
        lineage.asked(at(5));
        assert_eq!(lineage.rival("/driver", 6, lineage.absent_until()).map(|rival| rival.number), Some(5));
    }

    #[test]
    fn what_is_remembered_is_bounded() {
        let mut lineage = Lineage::default();
        for number in 0..2 * MOST_ENDED as u64 {
            lineage.ended(&format!("/n{number}").into(), (number, &endpoint(1)), Instant::now(), false);
        }
        assert_eq!(lineage.ended.len(), MOST_ENDED);
        assert!(lineage.rival("/n511", 9999, None).is_some() && lineage.rival("/n0", 9999, None).is_none());
    }

    #[test]
    fn the_host_is_where_the_bytes_come_from() {
        let soon = || Instant::now() + Duration::from_secs(2);
        let of = |host: &str, peer: &str| {
            let endpoint = Endpoint { host: host.into(), port: 1, path: "/".into() };
            host_of(&endpoint, Some(peer.parse().expect("address")), soon())
        };
        assert_eq!(of("127.0.0.1", "127.0.0.1:9"), "127.0.0.1");
        assert_eq!(of("LocalHost", "127.0.0.1:9"), "localhost");
        assert_eq!(of("127.0.0.1", "127.0.0.2:9"), "127.0.0.2");
        assert_eq!(of("127.0.0.1", "[::ffff:127.0.0.1]:9"), "127.0.0.1");
    }
}
