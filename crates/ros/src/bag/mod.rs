//! rosbag 2.0: read as far as a bag is readable, written so that the real `rosbag` accepts it.
//!
//! The index is optional: chunks are read in file order, and a damaged one is skipped and reported. Where there is an index, it
//! must agree with the messages. Format:
//! <http://wiki.ros.org/Bags/Format/2.0>. The content of a bag is untrusted.

mod index;
mod reader;
mod record;
mod search;
mod writer;

pub use reader::BagReader;
pub use writer::BagWriter;

/// The start of every bag.
pub(super) const MAGIC: &[u8] = b"#ROSBAG V2.0\n";
