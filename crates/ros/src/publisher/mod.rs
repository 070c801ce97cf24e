//! Our own publisher: a ROS node that gives topics out over TCPROS. The simulated robots are such nodes, and so is
//! what plays shared records into a reader's graph.

mod node;
mod outlet;
mod subscriber;

use std::sync::Arc;
use std::time::{Duration, Instant};

use super::RosError;
use super::address::{Endpoint, own_host};

pub(super) use node::PublisherNode;
pub(super) use outlet::Outlet;

/// How long master and names get for an answer.
const PATIENCE: Duration = Duration::from_secs(2);

/// How long subscribers get for the rest of their queues at an orderly end.
const FAREWELL: Duration = Duration::from_secs(5);

/// A topic as its messages are given out.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Advertised {
    /// Its name.
    pub topic: String,
    /// Type, `package/Type`.
    pub type_name: String,
    /// The type's md5sum, 32 hex characters.
    pub md5sum: String,
    /// The full text of the type's definition.
    pub definition: String,
    /// Whether the last message of each source goes to whoever subscribes later.
    pub latching: bool,
}

/// A publishing node. It unregisters and ends when dropped; what is queued is sent first, unless it was cut.
pub struct Publisher {
    node: PublisherNode,
}

impl Publisher {
    /// Starts a node at the master; it publishes nothing yet.
    ///
    /// # Errors
    /// [`RosError::Address`] for a bad URI, [`RosError::Unreachable`] where the master's name does not resolve,
    /// [`RosError::OwnHost`] where this machine's address cannot be listened on.
    pub fn start(master_uri: &str, given_host: Option<&str>, node_name: &str) -> Result<Self, RosError> {
        let master = Endpoint::parse(master_uri).ok_or_else(|| RosError::address(master_uri))?;
        let host = own_host(given_host, &master, Instant::now() + PATIENCE)?;
        Ok(Self { node: PublisherNode::start(master, &host, node_name.to_owned(), Vec::new())? })
    }

    /// Announces a topic; how many subscribers the master knows for it. One that is announced already stays as it is.
    ///
    /// # Errors
    /// Where the master does not answer or refuses.
    pub fn advertise(&self, topic: &Advertised) -> Result<usize, RosError> {
        self.node.advertise(Arc::new(Outlet::new(topic.clone())))
    }

    /// Registers all topics once more, which heals a master's restart.
    ///
    /// # Errors
    /// Where the master does not answer or refuses.
    pub fn register_again(&self) -> Result<(), RosError> {
        self.node.register_all()
    }

    /// Gives a message to all subscribers of an announced topic, as one of `source`; false where it is not announced.
    pub fn publish(&self, topic: &str, source: u64, body: &[u8]) -> bool {
        let outlet = self.node.outlet_of(topic);
        outlet.as_ref().inspect(|outlet| outlet.publish_of(source, body)).is_some()
    }

    /// Subscribers of a topic that are connected.
    pub fn subscribers(&self, topic: &str) -> usize {
        self.node.outlet_of(topic).map_or(0, |outlet| outlet.subscribers())
    }

    /// Whether a subscriber has so much to read still that more would soon be dropped.
    pub fn is_crowded(&self) -> bool {
        self.node.outlets().iter().any(|outlet| outlet.is_crowded())
    }

    /// Messages that a subscriber did not get because it read too slowly, in all.
    pub fn overflowed(&self) -> u64 {
        self.node.overflowed()
    }

    /// Waits no more for the subscribers that are behind now, until they have caught up.
    pub fn outrun(&self) {
        self.node.outlets().iter().for_each(|outlet| outlet.outrun());
    }

    /// Takes topics back at once: what is queued for their subscribers is not sent any more.
    pub fn cut(&self, topics: &[String]) {
        self.node.withdraw(topics);
    }

    /// No more messages come; what is queued is still sent.
    pub fn leave(&self) {
        self.node.leave();
    }

    /// Whether all that was queued is sent, after [`Self::leave`].
    pub fn is_sent(&self) -> bool {
        self.node.is_sent()
    }

    /// Ends without further patience. Messages that a subscriber did not get, in all.
    pub fn end(self) -> u64 {
        self.node.close(Duration::ZERO);
        self.node.overflowed()
    }

    /// Forgets at once what came from a source, queues of the topic included; others go on publishing it.
    pub fn silence(&self, topic: &str, source: u64) {
        if let Some(outlet) = self.node.outlet_of(topic) {
            outlet.silence(source);
        }
    }

    /// Unregisters and ends, after what is queued was sent, for five seconds at most. Messages that a subscriber did
    /// not get, in all.
    pub fn finish(self) -> u64 {
        self.node.close(FAREWELL);
        self.node.overflowed()
    }
}

#[cfg(test)]
mod tests;
