//! Looking at opened records beyond their fields: as files, and as a path over many.

use serde::{Deserialize, Serialize};

use super::{Ask, Command};
use crate::ros::readable::Exported;
use crate::service::reply::{OpenedView, PathView};

/// The most records of a path.
pub const LONGEST_PATH: usize = 1_000;

requests! {
    /// What is asked about opened records.
    #[serde(rename_all = "snake_case", tag = "view")]
    enum Viewing by Command::View;
    /// One record, checked and opened, with its message as a file.
    #[serde(rename = "file")]
    ViewFile {
        /// Its id.
        id: String,
        /// Which kind; `None` = a picture's own bytes where it is one, else the message's.
        kind: Option<Exported>,
    } => Box<OpenedView>;
    /// Where the robot was, over the records of a topic that lead to this one.
    #[serde(rename = "path")]
    ViewPath {
        /// Its id.
        id: String,
        /// So many records at most, this one included; 2 to [`LONGEST_PATH`].
        records: usize,
    } => PathView;
}
