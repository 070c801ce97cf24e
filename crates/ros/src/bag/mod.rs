//! rosbag 2.0: read as far as a bag is readable, written as real `rosbag` accepts it.
//!
//! The index is optional: chunks are read in the order of the file, and a damaged one is skipped and named.
//! Format: <http://wiki.ros.org/Bags/Format/2.0>. Whatever a bag says is untrusted.

mod reader;
mod record;
mod search;
mod writer;

pub use reader::BagReader;
pub use writer::BagWriter;

/// What a bag begins with.
pub(super) const MAGIC: &[u8] = b"#ROSBAG V2.0\n";
