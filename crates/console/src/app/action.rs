//! The input of `update` and its output.

use std::path::PathBuf;

use zeroize::Zeroizing;

use super::feed::Feed;
use super::incidents::Deed;
use super::key::Key;
use super::paths::{Found, Sought};
use super::screen::Screen;
use super::verb::Verb;
use crate::model::{Address, IncidentName, Party, ProfileName, Timestamp};
use crate::service::reply::ExportedFile;
use crate::service::{Command, Event, Failure, KeyKind, Reply};

/// Everything that can happen to the console.
#[derive(Debug)]
pub enum Action {
    /// The operator wants this done (palette, keymap, tests).
    Do(Verb),
    /// A key was pressed.
    Key(Key),
    /// Text was pasted.
    Paste(Zeroizing<String>),
    /// The terminal has a new size, in cells.
    Resize {
        /// Columns.
        columns: u16,
        /// Rows.
        rows: u16,
    },
    /// The current time.
    Tick(Timestamp),
    /// The site answered.
    Answered {
        /// Which question.
        tag: Tag,
        /// Its answer.
        result: Box<Result<Reply, Failure>>,
    },
    /// The site sent an event.
    Told(Event),
    /// Events were missed; everything is requested again.
    Missed,
    /// Files were written (where), or why not.
    FilesWritten(Result<String, String>),
    /// The paths that begin as was typed, or why they cannot be read.
    PathsFound(Sought, Result<Found, String>),
    /// A file was read as text, or why it cannot be.
    TextRead(PathBuf, Result<String, String>),
    /// The theme is now this one.
    ThemeIs(String),
    /// The wheel was turned: up or down.
    Wheel {
        /// Away from the operator.
        up: bool,
    },
    /// The left button was pressed on a cell, from 0.
    Click {
        /// Column.
        column: u16,
        /// Row.
        row: u16,
    },
    /// The process was suspended and is running again.
    Resumed,
    /// A background task of this process failed.
    Fault(String),
}

/// What the caller of `update` must do next. None of it may block `update`.
#[derive(Debug)]
#[allow(clippy::large_enum_variant, reason = "a handful at a time, and gone at once")]
pub enum Effect {
    /// Send a command; its answer comes back under the tag.
    Send(Command, Tag),
    /// Leave the console.
    Quit,
    /// Leave the console, and a site running in its place.
    LeaveSite,
    /// Leave the console because the site refuses it.
    Leave(Failure),
    /// Stop the process as Ctrl-Z does.
    Suspend,
    /// Redraw everything.
    Redraw,
    /// Show the theme with this name.
    ShowTheme(String),
    /// Toggle between ASCII characters only and all.
    ToggleAscii,
    /// Take the mouse, or leave it to the terminal.
    Mouse(bool),
    /// Give a text to the terminal's clipboard (OSC 52).
    CopyText(String),
    /// Speak for this profile from now on.
    SpeakFor(ProfileName),
    /// Read which paths begin as typed.
    FindPaths(Sought),
    /// Read a file as text, no further than a robot's policy may be long.
    ReadText(PathBuf),
    /// Write files into a new place below `base`, 0600, never overwriting others.
    WriteFiles {
        /// An existing folder; `None` = the working directory.
        base: Option<PathBuf>,
        /// Directory to create, if any.
        directory: Option<String>,
        /// The files.
        files: Vec<Contents>,
    },
}

/// One file to write.
pub struct Contents {
    /// Its name, no path.
    pub name: String,
    /// Its bytes.
    pub bytes: Zeroizing<Vec<u8>>,
}

impl std::fmt::Debug for Contents {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "Contents({}, {} bytes)", self.name, self.bytes.len())
    }
}

impl From<ExportedFile> for Contents {
    fn from(file: ExportedFile) -> Self {
        Self { name: file.name, bytes: Zeroizing::new(file.bytes) }
    }
}

/// A command to send, with the tag for its answer.
#[derive(Debug, Clone)]
pub struct Errand {
    /// The command.
    pub command: Command,
    /// The tag of its answer.
    pub tag: Tag,
}

/// The request that an answer belongs to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Tag {
    /// A feed's pull, with its generation.
    Feed(Feed, u64),
    /// The claim of the profile for this console.
    OpenConsole,
    /// Creation of an identity.
    CreateIdentity,
    /// Opening of the keyring.
    Unlock,
    /// Registration on the chain.
    Register,
    /// Watching of a topic.
    Watch(String),
    /// End of the watching of a topic.
    Unwatch(String),
    /// A grant.
    Grant(Party),
    /// Extension of a grant.
    Extend(Address),
    /// A revoke.
    Revoke(Address),
    /// Loading of a key.
    LoadKey(KeyKind),
    /// Export of a key.
    ExportKey(KeyKind),
    /// A new epoch.
    Rotate,
    /// Pausing the capture before leaving, or resuming it.
    HoldCapture,
    /// Wiping the keys from memory.
    Lock,
    /// A copy of the keyring.
    BackUp,
    /// An administrator's act, in a word.
    Administer(&'static str),
    /// Deployment of the contract.
    Deploy,
    /// Accepting of a topic's publishers.
    Pin(String),
    /// A publisher of a topic is no longer accepted.
    Unpin(String),
    /// Release of a topic's quarantined messages.
    Release(String),
    /// Deletion of a topic's quarantined messages.
    Discard(String),
    /// Publishers of a topic.
    Publishers(String),
    /// Provenance of a record.
    Show(String),
    /// Details of a record in the pane beside a list.
    Beside(Screen, String),
    /// Opening of a record.
    Open(String),
    /// The path over a record's topic.
    Path(String),
    /// Check of a record.
    Check(String),
    /// Export of a record.
    Export(String),
    /// A contact added, confirmed or removed.
    Contact(String),
    /// Something done to an incident.
    Incident(Deed, IncidentName),
    /// A robot in full.
    Robot(String),
    /// The policy of a robot, from this file; `None` = cleared.
    SetPolicy(String, Option<PathBuf>),
    /// Playing of a topic into ROS, under this name.
    Play(String),
    /// End of a playback.
    StopPlay,
}

impl Tag {
    /// Whether the command changes something, so that quitting should wait or ask.
    pub fn is_work(&self) -> bool {
        let looks = matches!(
            self,
            Self::Show(_) | Self::Beside(..) | Self::Open(_) | Self::Path(_) | Self::Check(_) | Self::Publishers(_)
        );
        !looks && !matches!(self, Self::Feed(..) | Self::OpenConsole | Self::Robot(_))
    }

    /// The running command, in words.
    pub fn words(&self) -> String {
        match self {
            Self::Feed(..) => "asking the site".to_owned(),
            Self::OpenConsole => "claiming the profile".to_owned(),
            Self::CreateIdentity => "creating the identity".to_owned(),
            Self::Unlock => "unlocking the keyring".to_owned(),
            Self::Register => "registering on the chain".to_owned(),
            Self::Watch(topic) => format!("watching {topic}"),
            Self::Unwatch(topic) => format!("unwatching {topic}"),
            Self::Grant(grantee) => format!("granting to {}", grantee.short()),
            Self::Extend(grantee) => format!("extending the grant to {}", grantee.short()),
            Self::Revoke(grantee) => format!("revoking {}", grantee.short()),
            Self::LoadKey(kind) => format!("loading the {} key", kind_word(*kind)),
            Self::ExportKey(kind) => format!("exporting the {} key", kind_word(*kind)),
            Self::Rotate => "rotating the keys".to_owned(),
            Self::HoldCapture => "stopping capture".to_owned(),
            Self::Lock => "locking the keyring".to_owned(),
            Self::BackUp => "backing up the keyring".to_owned(),
            Self::Administer(act) => format!("administrator: {act}"),
            Self::Deploy => "deploying the contract".to_owned(),
            Self::Pin(topic) => format!("pinning publishers of {topic}"),
            Self::Unpin(topic) => format!("unpinning a publisher of {topic}"),
            Self::Release(topic) => format!("releasing quarantined messages of {topic}"),
            Self::Discard(topic) => format!("discarding quarantined messages of {topic}"),
            Self::Publishers(topic) => format!("looking up publishers of {topic}"),
            Self::Show(id) => format!("looking up {id}"),
            Self::Beside(_, id) => format!("reading {id}"),
            Self::Open(id) => format!("opening {id}"),
            Self::Path(id) => format!("reading the path to {id}"),
            Self::Check(id) => format!("checking {id}"),
            Self::Export(id) => format!("exporting {id}"),
            Self::Incident(deed, name) => deed.words(name),
            Self::Contact(name) => format!("changing contact {name}"),
            Self::Robot(name) => format!("looking up robot {name}"),
            Self::SetPolicy(robot, Some(_)) => format!("setting the policy of {robot}"),
            Self::SetPolicy(robot, None) => format!("clearing the policy of {robot}"),
            Self::Play(topic) => format!("playing {topic} into ROS, live (4, then p: stop)"),
            Self::StopPlay => "stopping playback".to_owned(),
        }
    }
}

/// A kind of key as shown on screen.
pub fn kind_word(kind: KeyKind) -> &'static str {
    match kind {
        KeyKind::Sm4 => "SM4",
        KeyKind::Sm2 => "SM2",
        KeyKind::Eoa => "EOA",
    }
}
