//! Who is on a topic of a graph, and whether two addresses lead to the same graph: checked before anything is
//! published.

use std::time::Instant;

use super::{Graph, PATIENCE, rows};
use crate::ros::RosError;
use crate::ros::address::{Endpoint, resolve};

/// The nodes of one topic, as the master named them: clean the names before they are shown.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Presence {
    /// Nodes that publish it.
    pub publishers: Vec<String>,
    /// Nodes that subscribe to it.
    pub subscribers: Vec<String>,
}

impl Graph {
    /// The nodes on a topic now.
    ///
    /// # Errors
    /// See [`Graph::topics`].
    pub fn presence(&self, topic: &str) -> Result<Presence, RosError> {
        let state = self.ask("getSystemState", Instant::now() + PATIENCE)?;
        let nodes = |index: usize| {
            let of_state = state.as_array().and_then(|parts| parts.get(index));
            let found = of_state.and_then(|part| rows(part).find(|(name, _)| *name == topic));
            found.map(|(_, nodes)| nodes.texts()).unwrap_or_default()
        };
        Ok(Presence { publishers: nodes(0), subscribers: nodes(1) })
    }

    /// Whether another URI leads to this master, as far as names and addresses show.
    pub fn is_at(&self, uri: &str) -> bool {
        let Some(other) = Endpoint::parse(uri) else { return false };
        if other.port != self.master.port {
            return false;
        }
        let places = |endpoint: &Endpoint| resolve(&endpoint.host, endpoint.port, Instant::now() + PATIENCE);
        match (places(&self.master), places(&other)) {
            (Ok(ours), Ok(theirs)) => {
                ours.iter().any(|place| theirs.iter().any(|other| place == other || both_loopback(place, other)))
            }
            _ => other.host == self.master.host,
        }
    }
}

fn both_loopback(one: &std::net::SocketAddr, other: &std::net::SocketAddr) -> bool {
    one.ip().is_loopback() && other.ip().is_loopback()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ros::{EmbeddedMaster, Fleet, FleetOptions};

    #[test]
    fn a_topic_s_nodes_are_named_and_an_unknown_one_has_none() {
        let master = EmbeddedMaster::start().expect("master");
        let graph = Graph::new(master.uri(), "/test").expect("uri");
        let _fleet = Fleet::start(master.uri(), 1, FleetOptions::default()).expect("fleet");
        let presence = graph.presence("/robot1/odom").expect("asked");
        assert_eq!(presence.publishers, ["/robot1_sim"]);
        assert_eq!(graph.presence("/nobody").expect("asked"), Presence::default());
    }

    #[test]
    fn one_master_has_many_addresses() {
        let graph = Graph::new("http://127.0.0.1:11999/", "/test").expect("uri");
        assert!(graph.is_at("http://localhost:11999"));
        assert!(graph.is_at("http://127.0.0.1:11999/RPC2"));
        assert!(!graph.is_at("http://127.0.0.1:11998"));
        assert!(!graph.is_at("http://192.0.2.1:11999"));
        assert!(!graph.is_at("not a URI"));
    }
}
