//! The input and the output of `update`.

use std::path::PathBuf;
use zeroize::Zeroizing;

use crate::app::{completion::Found, completion::Sought, key::Key, verb::Tag, verb::Verb};
use crate::model::{ProfileName, Timestamp};
use crate::service::{Command, Event, Failure, Reply};

#[derive(Debug)]
pub enum Action {
    Do(Verb),
    Key(Key),
    Paste(Zeroizing<String>),
    /// In cells.
    Resize {
        columns: u16,
        rows: u16,
    },
    Tick(Timestamp),
    Answered {
        tag: Tag,
        result: Box<Result<Reply, Failure>>,
    },
    Told(Event),
    /// Events were lost; everything is requested again.
    Missed,
    /// Where, or why not.
    FilesWritten(Result<String, String>),
    PathsFound(Sought, Result<Found, String>),
    TextRead(PathBuf, Result<String, String>),
    ThemeIs(String),
    Wheel {
        up: bool,
    },
    /// Left button on a cell, from 0.
    Click {
        column: u16,
        row: u16,
    },
    Resumed,
    Fault(String),
}

/// Work for the caller; nothing of it may block `update`.
#[derive(Debug)]
#[allow(clippy::large_enum_variant, reason = "a handful at a time, and gone at once")]
pub enum Effect {
    Send(Command, Tag),
    Quit,
    /// A site continues after the console.
    LeaveSite,
    /// The site refuses this console.
    Leave(Failure),
    /// Stops the process as Ctrl-Z does.
    Suspend,
    Redraw,
    ShowTheme(String),
    ToggleAscii,
    Mouse(bool),
    /// OSC 52.
    CopyText(String),
    SpeakFor(ProfileName),
    FindPaths(Sought),
    /// Reads no further than a robot's policy may be long.
    ReadText(PathBuf),
    /// Into a new place below `base`, 0600, never overwriting.
    WriteFiles {
        /// An existing folder; `None` = the working directory.
        base: Option<PathBuf>,
        /// Created, if named.
        directory: Option<String>,
        files: Vec<Contents>,
    },
}

pub struct Contents {
    /// No path.
    pub name: String,
    pub bytes: Zeroizing<Vec<u8>>,
}

impl std::fmt::Debug for Contents {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "Contents({}, {} bytes)", self.name, self.bytes.len())
    }
}
