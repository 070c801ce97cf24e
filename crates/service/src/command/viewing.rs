//! Views of opened records beyond their fields: as files, and as a path over many.

use serde::{Deserialize, Serialize};

use super::{Ask, Command};
use crate::ros::readable::Exported;
use crate::service::reply::{OpenedView, PathView};

/// The most records of a path.
pub const LONGEST_PATH: usize = 1_000;

requests! {
    /// Requests about opened records.
    #[serde(rename_all = "snake_case", tag = "view")]
    enum Viewing by Command::View;
    /// One record, checked and opened, with its message as a file.
    #[serde(rename = "file")]
    ViewFile {
        /// Its id.
        id: String,
        /// The format; `None` = a picture's own bytes if it is one, else the message's.
        kind: Option<Exported>,
    } => Box<OpenedView>;
    /// The robot's positions, from the records of a topic up to this one.
    #[serde(rename = "path")]
    ViewPath {
        /// Its id.
        id: String,
        /// At most this many records, including this one; 2 to [`LONGEST_PATH`].
        records: usize,
    } => PathView;
}
