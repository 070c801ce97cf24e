//! Recordings of rosbag2: a folder with `metadata.yaml` and one or more `.mcap` or `.db3` files. Everything in it is untrusted.

mod db3;
mod folder;
mod metadata;
mod temporary;
mod yaml;

pub use db3::{Db3Reader, has_journal};
pub use folder::{ATTACHED, FolderReader, files_of};
pub use metadata::{METADATA, Tally};
pub(super) use temporary::unpacked;

/// The start of every SQLite file.
pub(super) const SQLITE: &[u8] = b"SQLite format 3\0";
