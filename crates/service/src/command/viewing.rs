//! Looking at opened records beyond their fields: as files, and as a path over many.

use serde::{Deserialize, Serialize};

use crate::ros::readable::Exported;

/// The most records of a path.
pub const LONGEST_PATH: usize = 1_000;

/// What is asked about opened records.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "view")]
pub enum Viewing {
    /// One record, checked and opened, with its message as a file.
    File {
        /// Its id.
        id: String,
        /// Which kind; `None` = a picture's own bytes where it is one, else the message's.
        kind: Option<Exported>,
    },
    /// Where the robot was, over the records of a topic that lead to this one.
    Path {
        /// Its id.
        id: String,
        /// So many records at most, this one included; 2 to [`LONGEST_PATH`].
        records: usize,
    },
}
