//! Our own publisher: a ROS node that serves topics over TCPROS. The simulated robots are such nodes, and so is the one
//! that plays shared records into a reader's graph.

mod choice;
mod node;
mod outlet;
mod subscriber;

use std::sync::Arc;
use std::time::{Duration, Instant};

use super::RosError;
use super::address::{Endpoint, own_host};

pub use choice::GraphPublisher;
pub(super) use node::PublisherNode;
pub(super) use outlet::Outlet;

/// How long to wait for the master and for names.
const PATIENCE: Duration = Duration::from_secs(2);

/// How long subscribers get for the rest of their queues at an orderly shutdown.
const FAREWELL: Duration = Duration::from_secs(5);

/// A topic as published.
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
    /// Whether the last message of each source is sent to later subscribers.
    pub latching: bool,
}

/// A publishing node. It unregisters and ends on drop; queued messages are sent first, unless it was cut off.
pub struct Publisher {
    node: PublisherNode,
}

impl Publisher {
    /// Starts a node at the master; it publishes nothing yet.
    ///
    /// # Errors
    /// [`RosError::Address`] for a bad URI, [`RosError::Unreachable`] if the master's name does not resolve,
    /// [`RosError::OwnHost`] if this machine's address cannot be listened on.
    pub fn start(master_uri: &str, given_host: Option<&str>, node_name: &str) -> Result<Self, RosError> {
        let master = Endpoint::parse(master_uri).ok_or_else(|| RosError::address(master_uri))?;
        let host = own_host(given_host, &master, Instant::now() + PATIENCE)?;
        Ok(Self { node: PublisherNode::start(master, &host, node_name.to_owned(), Vec::new())? })
    }

    /// Announces a topic; returns how many subscribers the master knows for it. A topic already announced is unchanged.
    ///
    /// # Errors
    /// If the master does not answer or refuses.
    pub fn advertise(&self, topic: &Advertised) -> Result<usize, RosError> {
        self.node.advertise(Arc::new(Outlet::new(topic.clone())))
    }

    /// Registers all topics again, which recovers from a master's restart.
    ///
    /// # Errors
    /// If the master does not answer or refuses.
    pub fn register_again(&self) -> Result<(), RosError> {
        self.node.register_all()
    }

    /// Sends a message to all subscribers of an announced topic, as one of `source`; false if it is not announced.
    pub fn publish(&self, topic: &str, source: u64, body: &[u8]) -> bool {
        let outlet = self.node.outlet_of(topic);
        outlet.as_ref().inspect(|outlet| outlet.publish_of(source, body)).is_some()
    }

    /// The number of connected subscribers of a topic.
    pub fn subscribers(&self, topic: &str) -> usize {
        self.node.outlet_of(topic).map_or(0, |outlet| outlet.subscribers())
    }

    /// Whether a subscriber is so far behind that more messages would soon be dropped.
    pub fn is_crowded(&self) -> bool {
        self.node.outlets().iter().any(|outlet| outlet.is_crowded())
    }

    /// Total messages that a subscriber missed because it read too slowly.
    pub fn overflowed(&self) -> u64 {
        self.node.overflowed()
    }

    /// Stops waiting for the subscribers that are behind now, until they have caught up.
    pub fn outrun(&self) {
        self.node.outlets().iter().for_each(|outlet| outlet.outrun());
    }

    /// Withdraws topics at once: what is queued for their subscribers is no longer sent.
    pub fn cut(&self, topics: &[String]) {
        self.node.withdraw(topics);
    }

    /// No more messages come; queued ones are still sent.
    pub fn leave(&self) {
        self.node.leave();
    }

    /// Whether everything queued has been sent, after [`Self::leave`].
    pub fn is_sent(&self) -> bool {
        self.node.is_sent()
    }

    /// Ends without further waiting. Returns the total messages that a subscriber missed.
    pub fn end(self) -> u64 {
        self.node.close(Duration::ZERO);
        self.node.overflowed()
    }

    /// Drops at once what came from a source, including the topic's queues; other sources go on publishing it.
    pub fn silence(&self, topic: &str, source: u64) {
        if let Some(outlet) = self.node.outlet_of(topic) {
            outlet.silence(source);
        }
    }

    /// Unregisters and ends, after sending what is queued, for at most five seconds. Returns the total messages that a
    /// subscriber missed.
    pub fn finish(self) -> u64 {
        self.node.close(FAREWELL);
        self.node.overflowed()
    }
}

#[cfg(test)]
mod tests;
