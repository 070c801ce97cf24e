//! Names of a record's tags beside its message.

/// Serialisation of messages other than ROS 1's.
pub const ENCODING: &str = "encoding";
/// Prefix of MCAP's data beside the message; never searched for.
pub const MCAP: &str = "mcap.";
/// Publishing time, nanoseconds, if it differs from the recording time.
pub const PUBLISHED: &str = "mcap.publish_time";
/// A message's number in its recording, or by its ROS 2 publisher.
pub const SEQUENCE: &str = "mcap.sequence";
/// Prefix for a message's state before it was sealed again; never searched for.
pub const FORMER: &str = "former.";
/// Digest of the record in the home it was brought from.
pub const FORMER_RECORD: &str = "former.record";
/// The device that signed that record, if its owner did not.
pub const FORMER_SIGNER: &str = "former.signer";
/// Prefix of the channel's data.
pub const CHANNEL: &str = "mcap.channel.";
