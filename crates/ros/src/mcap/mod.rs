//! MCAP: read as far as a file is readable, written with chunks, indexes and checksums (<https://mcap.dev/spec>).
//!
//! The profile `ros1` is fully read and written; ROS 2 messages are taken as raw CDR with their schema. The content of
//! a file is untrusted.

mod attach;
mod beside;
mod reader;
mod record;
mod writer;

pub use attach::attach;
pub use beside::{AttachedFile, Beside, BesideContent, TOPIC as BESIDE};
pub(super) use beside::{attachment_record, metadata_record};
pub use reader::McapReader;
pub use writer::McapWriter;

/// The start and end of every file.
pub const MAGIC: &[u8] = b"\x89MCAP0\r\n";
