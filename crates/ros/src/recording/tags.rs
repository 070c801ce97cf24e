//! The data in a record's tags beside its message: its serialisation, and what MCAP would say about it.

/// Tag of messages other than ROS 1's: their serialisation.
pub const ENCODING: &str = "encoding";
/// MCAP's data beside the message: tags with this prefix, never searched for.
pub const MCAP: &str = "mcap.";
/// Tag of the time a message was published, nanoseconds, if that is not when it was recorded.
pub const PUBLISHED: &str = "mcap.publish_time";
/// Tag of a message's number: in its recording, or that of its ROS 2 publisher.
pub const SEQUENCE: &str = "mcap.sequence";
/// What a message was before it was sealed anew: tags with this prefix, never searched for.
pub const FORMER: &str = "former.";
/// Tag of the digest that its record had in the home it was brought from.
pub const FORMER_RECORD: &str = "former.record";
/// Tag of the device that signed that record, if its owner did not.
pub const FORMER_SIGNER: &str = "former.signer";
/// Tags of the channel's data.
pub const CHANNEL: &str = "mcap.channel.";
