//! Whether nodes can be reached by the names they gave, and this machine by the name it gives: the most common fault of
//! a ROS network, which shows only as topics without messages.

use std::collections::BTreeSet;
use std::net::TcpListener;
use std::time::{Duration, Instant};

use super::{Graph, PATIENCE, master_error, rows};
use crate::model::clean;
use crate::ros::RosError;
use crate::ros::address::{Endpoint, connect, own_host, resolve};
use crate::ros::xmlrpc::call;

/// The most nodes tried.
const MOST_NODES: usize = 20;
/// How long each attempt may take.
const EACH: Duration = Duration::from_millis(800);

/// A publisher that cannot be reached at its stated address.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Unreached {
    /// The node's name, cleaned.
    pub node: String,
    /// The host and port it stated, cleaned.
    pub place: String,
    /// The reason, cleaned.
    pub reason: String,
}

impl Graph {
    /// Tries the addresses that publishers gave the master; returns how many were tried, and those that do not answer.
    ///
    /// # Errors
    /// Errors of the master.
    pub fn unreached(&self) -> Result<(usize, Vec<Unreached>), RosError> {
        let nodes: BTreeSet<String> = self.topics()?.into_iter().flat_map(|topic| topic.publishers).collect();
        let mut found = Vec::new();
        let tried = nodes.iter().take(MOST_NODES);
        let count = tried.len();
        for node in tried {
            if let Err((place, reason)) = self.try_node(node) {
                let (place, reason) = (clean(&place, 120), clean(&reason, 160));
                found.push(Unreached { node: clean(node, 120), place, reason });
            }
        }
        Ok((count, found))
    }

    /// The name of the node that publishes a topic from this address, if the master has one.
    pub(crate) fn node_at(&self, topic: &str, place: &Endpoint) -> Option<String> {
        let state = self.ask("getSystemState", Instant::now() + PATIENCE).ok()?;
        let nodes = rows(state.as_array()?.first()?).find(|(name, _)| *name == topic)?.1.texts();
        nodes.into_iter().take(MOST_NODES).find(|node| self.place_of(node).is_ok_and(|found| found == *place))
    }

    /// Where a node is, according to the master; otherwise what is wrong, and with whom.
    fn place_of(&self, node: &str) -> Result<Endpoint, (String, String)> {
        let parameters = [self.node_name.as_str().into(), node.into()];
        let uri = call(&self.master, "lookupNode", &parameters, Instant::now() + PATIENCE)
            .map_err(|error| ("the master".to_owned(), master_error(&self.master, "lookupNode", error).to_string()))?;
        let uri = uri.as_text().unwrap_or_default().to_owned();
        Endpoint::parse(&uri).ok_or_else(|| (uri.clone(), "which is not an address".to_owned()))
    }

    fn try_node(&self, node: &str) -> Result<(), (String, String)> {
        let place = self.place_of(node)?;
        let connected = connect(&place.host, place.port, Instant::now() + EACH);
        connected.map(drop).map_err(|error| (place.authority(), error.to_string()))
    }

    /// The host that this machine would give other nodes, and what is wrong with it: `given` is `ros.host` or
    /// ROS_HOSTNAME.
    ///
    /// # Errors
    /// Why other nodes cannot use it, in words.
    pub fn own_name(&self, given: Option<&str>) -> Result<String, (String, String)> {
        let deadline = Instant::now() + PATIENCE;
        let host = own_host(given, &self.master, deadline)
            .map_err(|error| (given.unwrap_or_default().to_owned(), error.to_string()))?;
        let fault = |reason: String| (clean(&host, 120), reason);
        let places = resolve(&host, 0, deadline).map_err(|error| fault(format!("does not resolve: {error}")))?;
        // An address that can be listened on is this machine's.
        if !places.iter().any(|place| TcpListener::bind(place).is_ok()) {
            return Err(fault(format!("resolves to {places:?}, none of which belongs to this machine")));
        }
        let master_is_here = matches!(self.master.host.as_str(), "localhost" | "127.0.0.1" | "::1");
        if !master_is_here && places.iter().all(|place| place.ip().is_loopback()) {
            return Err(fault("resolves only to loopback, so other machines would connect to themselves".to_owned()));
        }
        Ok(host)
    }
}
