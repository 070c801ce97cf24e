//! Recordings: files that hold messages with their times, as written by `rosbag record` and MCAP writers.
//!
//! What both formats share: channels, messages, chunk compression, and a reader's report of damage. Files are treated
//! as hostile: every length is checked, memory is bounded by [`LARGEST_CHUNK`].

mod compression;
mod damage;
mod described;
mod open;
mod place;
pub mod tags;

use std::collections::BTreeMap;
use std::sync::Arc;

pub use compression::ChunkCompression;
pub(super) use compression::{SPOILT, ZSTD, pack, unpack, unpacked_body, why};
pub use damage::{Damage, Findings, Unusable};
pub use described::{Described, TYPE_HASH, TypeFacts};
pub use open::{Recording, RecordingFormat, RecordingWriter, content_of};
pub(super) use place::{go_to, read_at};

pub use super::mcap::{AttachedFile, BESIDE, Beside, BesideContent};
use super::tcpros::LONGEST_MESSAGE;
use crate::model::Timestamp;

/// The most bytes of a decompressed chunk: a message of the largest size and what was in its chunk before it.
pub const LARGEST_CHUNK: usize = LONGEST_MESSAGE + (64 << 20);

/// A chunk is closed when it holds this many bytes, as in `rosbag record`.
pub(super) const CHUNK_THRESHOLD: usize = 768 * 1024;

/// The most channels of a recording.
pub(super) const MOST_CHANNELS: usize = 16_384;

/// The most bytes of all channels' texts together.
pub(super) const MOST_CHANNEL_BYTES: usize = 64 << 20;

/// Name of the topic that a bag's connection header gives, where that is not the connection's own; empty if it gives none.
pub const BAG_TOPIC: &str = "bag.topic";

/// Why a message is left out that no record can hold.
pub const TOO_LARGE: &str = "it is larger than a record may be (64 MiB)";

/// The longest of a channel's further data, bytes; the most entries; the most bytes of all of them, which go into the head of
/// each record.
const LONGEST_ABOUT: usize = 8 * 1024;
const MOST_ABOUT: usize = 12;
const MOST_ABOUT_BYTES: usize = 32 * 1024;

/// A channel's further data as far as it is kept, and whether that is all.
pub(super) fn kept_about(all: impl IntoIterator<Item = (Arc<str>, Arc<str>)>) -> (BTreeMap<Arc<str>, Arc<str>>, bool) {
    let (mut kept, mut whole, mut bytes) = (BTreeMap::new(), true, 0);
    for (key, value) in all {
        let size = key.len() + value.len();
        if size <= LONGEST_ABOUT && kept.len() < MOST_ABOUT && bytes + size <= MOST_ABOUT_BYTES {
            bytes += size;
            kept.insert(key, value);
        } else {
            whole = false;
        }
    }
    (kept, whole)
}

/// How the message bodies of a channel are serialised.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Encoding {
    /// As in ROS 1.
    Ros1,
    /// CDR, as in ROS 2; with the schema's encoding as named by MCAP (`ros2msg`, `ros2idl`).
    Cdr {
        /// Whether the schema is IDL.
        idl: bool,
    },
    /// No message: MCAP's own bytes of what the recording holds beside its messages.
    Beside(Beside),
}

/// A recording's description of the messages of one publisher on one topic.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Channel {
    /// Topic name, as written.
    pub topic: Arc<str>,
    /// Type, `package/Type`; for ROS 2 `package/msg/Type`.
    pub type_name: Arc<str>,
    /// The type's md5sum, 32 hex characters; `*` if the recording has none.
    pub md5sum: Arc<str>,
    /// The full text of the type's definition.
    pub definition: Arc<str>,
    /// The publisher's node name; empty if the recording has none.
    pub caller_id: Arc<str>,
    /// Whether the last message is kept for later subscribers.
    pub latching: bool,
    /// How bodies are serialised.
    pub encoding: Encoding,
    /// What the recording says of it beyond these fields: MCAP's metadata such as the QoS offered, the other fields of a
    /// bag's connection header; bounded. `latching` is here if it is not `1`, [`BAG_TOPIC`] if a bag's header names
    /// another topic or none.
    pub about: BTreeMap<Arc<str>, Arc<str>>,
}

impl Channel {
    /// Bytes of its texts.
    pub(super) fn size(&self) -> usize {
        let texts = [&self.topic, &self.type_name, &self.md5sum, &self.definition, &self.caller_id];
        let about = self.about.iter().map(|(key, value)| key.len() + value.len());
        texts.iter().map(|text| text.len()).chain(about).sum::<usize>() + 128
    }
}

/// MCAP's data about a message's publishing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sent {
    /// When it was published.
    pub time: Timestamp,
    /// Its sequence number.
    pub sequence: u32,
}

/// One message of a recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RecordedMessage {
    /// Topic, type, publisher.
    pub channel: Arc<Channel>,
    /// When it was recorded.
    pub time: Timestamp,
    /// When and with which number it was published, if the recording says so.
    pub sent: Option<Sent>,
    /// The serialised message.
    pub body: Vec<u8>,
}

#[cfg(test)]
mod altered_tests;
#[cfg(test)]
mod beside_tests;
#[cfg(test)]
mod tests;
