//! The monitoring node: captures every message of the watched topics, of any type.
//!
//! A registrar thread keeps the subscriptions alive at the master and finds publishers; each publisher is read by its
//! own thread, so that none can starve another. Captured messages go to a [`MessageSink`]; sealing, storing and
//! bounding the ring happen elsewhere.

mod node;
mod origin;
mod reader;
mod registrar;
mod sequence;
mod topic;

#[cfg(test)]
mod tests;

use std::sync::Arc;
use std::time::{Duration, Instant};

use super::RosError;
use super::address::{Endpoint, own_host};
use super::graph::Unreached;
use super::slave::SlaveServer;
use crate::model::{Timestamp, TopicName, TypeName};
use node::Shared;
pub(crate) use origin::next_number;
pub use origin::{Origin, Rival};
use registrar::Registrar;

/// How long starting may wait for names to be resolved.
const PATIENCE: Duration = Duration::from_secs(2);

/// A message as received from its publisher.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Message {
    /// Topic name.
    pub topic: Arc<str>,
    /// Type, `package/Type`.
    pub type_name: Arc<str>,
    /// The type's md5sum, 32 hex characters, as stated by the publisher.
    pub md5sum: Arc<str>,
    /// The full text of the type's definition, as stated by the publisher.
    pub definition: Arc<str>,
    /// The publisher's node name, as it stated it: clean it before it is shown.
    pub caller_id: Arc<str>,
    /// Its origin, as far as can be seen.
    pub origin: Arc<Origin>,
    /// Whether the publisher keeps its last message for later subscribers.
    pub latching: bool,
    /// When the complete message had arrived.
    pub captured_at: Timestamp,
    /// `header.seq`, if the type begins with a header.
    pub header_seq: Option<u32>,
    /// Further facts about it, sealed beside it as tags; [`crate::recording::tags`] has the names.
    pub tags: Vec<(String, String)>,
    /// The serialised message, without its length; of ROS 2 with its encapsulation header.
    pub body: Vec<u8>,
}

/// The recipient of captured messages. Called from several threads at once, in order per publisher.
pub trait MessageSink: Send + Sync {
    /// Takes a message. It may block; meanwhile that publisher's socket is not read.
    fn accept(&self, message: Message);
    /// Takes the definition of a publisher's messages that arrived after some of them; the message has no body of its own.
    fn define(&self, message: Message) {
        drop(message);
    }
    /// Takes a notice about the capture itself. It must not block.
    fn notice(&self, notice: CaptureNotice);
}

/// A notice about the capture. Texts from peers in it are cleaned.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CaptureNotice {
    /// A publisher is being read.
    PublisherConnected {
        /// Topic name.
        topic: Arc<str>,
        /// The publisher's node name.
        caller_id: String,
        /// Its type.
        type_name: Arc<str>,
        /// Its origin, as far as can be seen.
        origin: Arc<Origin>,
    },
    /// A publisher that was being read is gone.
    PublisherLost {
        /// Topic name.
        topic: Arc<str>,
        /// The publisher's node name.
        caller_id: String,
        /// Its number among those seen.
        number: u64,
        /// The reason.
        reason: String,
    },
    /// Somebody told this node of a publisher that the master does not list; it is not contacted.
    UnconfirmedPublisher {
        /// Topic name.
        topic: Arc<str>,
        /// The URI announced.
        publisher: String,
    },
    /// The master lists a publisher that cannot be read; reported once until it can.
    PublisherUnreachable {
        /// Topic name.
        topic: Arc<str>,
        /// The publisher's URI.
        publisher: String,
        /// The reason.
        reason: String,
    },
    /// A publisher sends another type than requested; it is not captured.
    TypeMismatch {
        /// Topic name.
        topic: Arc<str>,
        /// The publisher's node name.
        caller_id: String,
        /// The type requested.
        wanted: String,
        /// The type it has.
        found: String,
    },
    /// A publisher's description of its messages is inconsistent; they are captured as sent.
    Contradiction {
        /// Topic name.
        topic: Arc<str>,
        /// The publisher's node name.
        caller_id: String,
        /// The inconsistency.
        contradiction: String,
    },
    /// Sequence numbers are missing: this many messages never arrived.
    LostInTransport {
        /// Topic name.
        topic: Arc<str>,
        /// The publisher's node name.
        caller_id: String,
        /// The number.
        count: u64,
        /// The first and the last of the missing numbers.
        numbers: (u32, u32),
    },
    /// A publisher or an answer was refused, for example a message beyond the length cap.
    Refused {
        /// Topic name.
        topic: Arc<str>,
        /// The publisher's URI.
        publisher: String,
        /// The reason.
        reason: String,
    },
    /// The program that reads ROS 2 ended and is restarted; what was missed meanwhile is reported by
    /// [`Self::LostInTransport`] when its publishers are heard again.
    ReadingBroken {
        /// Why.
        reason: String,
    },
    /// A publisher vanished while nothing could be read of it.
    EndUnknown {
        /// Topic name.
        topic: Arc<str>,
        /// The publisher's node name.
        caller_id: String,
        /// At least this many of its messages are missing.
        at_least: u64,
    },
    /// The master stopped answering; publishers that are connected are still read.
    MasterLost {
        /// What happened.
        reason: String,
    },
    /// The master answers (again).
    MasterBack,
    /// Somebody asked this node to shut down; it does not.
    ShutdownAsked {
        /// The caller.
        by: String,
        /// The reason it gave.
        reason: String,
    },
}

/// The parameters of a capture.
#[derive(Debug, Clone)]
pub struct CaptureOptions {
    /// The master, `http://HOST:PORT`.
    pub master_uri: String,
    /// The host at which other nodes reach this one (`ROS_HOSTNAME` or `ROS_IP`); chosen automatically if not set.
    pub own_host: Option<String>,
    /// This node's name, which must be unique: a master shuts down the older of two nodes with the same name.
    pub node_name: String,
}

/// The status of one topic's capture.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TopicCapture {
    /// Topic name.
    pub topic: TopicName,
    /// The type requested, otherwise the one last seen.
    pub type_name: Option<String>,
    /// Publishers being read now.
    pub publishers: usize,
    /// Those that the master lists and that cannot be read.
    pub unreached: Vec<Unreached>,
    /// Messages captured.
    pub messages: u64,
    /// Bytes of their bodies.
    pub bytes: u64,
    /// Messages missing according to their sequence numbers.
    pub lost_in_transport: u64,
    /// When the last message had arrived.
    pub last_message: Option<Timestamp>,
}

/// A running capture. It unregisters and ends its threads on drop.
pub struct Capture {
    shared: Arc<Shared>,
    registrar: Registrar,
    slave: SlaveServer,
}

impl Capture {
    /// Starts the monitoring node; it watches nothing yet. The master need not be running.
    ///
    /// # Errors
    /// [`RosError::Address`] for a bad URI, [`RosError::Unreachable`] if the master's name does not resolve,
    /// [`RosError::OwnHost`] if this machine's address cannot be listened on.
    pub fn start(options: CaptureOptions, sink: Arc<dyn MessageSink>) -> Result<Self, RosError> {
        let master = Endpoint::parse(&options.master_uri).ok_or_else(|| RosError::address(&options.master_uri))?;
        let host = own_host(options.own_host.as_deref(), &master, Instant::now() + PATIENCE)?;
        let shared = Arc::new(Shared::new(master, options.node_name, sink));
        let slave = SlaveServer::start(&host, Arc::clone(&shared) as _)?;
        let registrar = Registrar::start(Arc::clone(&shared), slave.uri.clone())?;
        Ok(Self { shared, registrar, slave })
    }

    /// Watches a topic; with `type_name` only publishers of that type are read. Watching it again changes nothing. A
    /// topic without publishers is waited for.
    pub fn watch(&self, topic: TopicName, type_name: Option<TypeName>) {
        self.shared.watch(topic, type_name);
    }

    /// Stops watching a topic. A message being handed to the sink is still handed over.
    pub fn unwatch(&self, topic: &TopicName) {
        self.shared.unwatch(topic);
    }

    /// The URI of this node's own slave API.
    pub fn uri(&self) -> &str {
        &self.slave.uri
    }

    /// The watched topics, by name, with the types requested.
    pub fn watched(&self) -> Vec<(TopicName, Option<TypeName>)> {
        self.shared.topics().iter().map(|topic| (topic.name.clone(), topic.wanted.clone())).collect()
    }

    /// The status of each watched topic, by name.
    pub fn status(&self) -> Vec<TopicCapture> {
        self.shared.topics().iter().map(|topic| topic.status()).collect()
    }
}

impl Drop for Capture {
    fn drop(&mut self) {
        let deadline = Instant::now() + PATIENCE;
        self.shared.stop();
        self.registrar.stop(deadline);
        self.shared.threads.wait_until_none(deadline);
    }
}
