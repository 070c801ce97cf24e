//! MCAP: read as far as a file is readable, written with chunks, indexes and checksums (<https://mcap.dev/spec>).
//!
//! The profile `ros1` is read and written whole; messages of ROS 2 are taken as raw CDR with their schema.
//! Whatever a file says is untrusted.

mod reader;
mod record;
mod writer;

pub use reader::McapReader;
pub use writer::McapWriter;

/// What a file begins and ends with.
pub(super) const MAGIC: &[u8] = b"\x89MCAP0\r\n";
