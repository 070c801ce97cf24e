//! What is kept in a record's tags beside its message: how it is serialised, and what MCAP would say of it.

/// Tag of messages that are no ROS 1 messages: how they are serialised.
pub const ENCODING: &str = "encoding";
/// What MCAP says beside the message: tags that begin so, and are never searched for.
pub const MCAP: &str = "mcap.";
/// Tag of when a message was published, nanoseconds, where that is not when it was recorded.
pub const PUBLISHED: &str = "mcap.publish_time";
/// Tag of a message's number: in its recording, or that of its ROS 2 publisher.
pub const SEQUENCE: &str = "mcap.sequence";
/// Tags of what is said of the channel.
pub const CHANNEL: &str = "mcap.channel.";
