//! Requests about recordings and about the rules for topics.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::{Ask, Command};
use crate::model::{Party, Timestamp, TopicPattern};
use crate::ros::recording::{ChunkCompression, RecordingFormat};
use crate::service::reply::{ExportView, FollowView, ImportView, ProgressView};

/// A recording to import.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ImportWishes {
    /// The file or folder, absolute; read by the site, which runs as the same user.
    pub path: PathBuf,
    /// Only topics that match any of these patterns; empty = all.
    pub topics: Vec<TopicPattern>,
    /// Tags for the sealed heads.
    pub tags: Vec<(String, String)>,
    /// Import again what was imported before.
    pub again: bool,
}

/// A folder whose recordings are sealed while a recorder writes them.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FollowWishes {
    /// The folder, absolute; it need not be there yet. Read by the site, which runs as the same user.
    pub folder: PathBuf,
    /// Only topics that match any of these patterns; empty = all.
    pub topics: Vec<TopicPattern>,
    /// Tags for the sealed heads.
    pub tags: Vec<(String, String)>,
    /// End when the recording is closed and its proofs are written.
    pub until_closed: bool,
    /// Also write a copy of each file with its proof as an attachment.
    pub attach: bool,
}

/// Another home whose messages are sealed anew in this one.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct HomeWishes {
    /// Its folder, absolute; read by the site, which runs as the same user.
    pub home: PathBuf,
}

/// A recording to write from records.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ExportWishes {
    /// The file, absolute, which must not exist; written by the site, which runs as the same user.
    pub path: PathBuf,
    /// The format.
    pub format: RecordingFormat,
    /// The compression of chunks.
    pub compression: ChunkCompression,
    /// Only records of this owner.
    pub owner: Option<Party>,
    /// Only topics that match any of these patterns; empty = all.
    pub topics: Vec<TopicPattern>,
    /// Captured at or after.
    pub since: Option<Timestamp>,
    /// Captured before.
    pub until: Option<Timestamp>,
    /// Also records that are not confirmed on the chain.
    pub unanchored: bool,
}

/// Commands about recordings.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RecordingCommand {
    /// Seal the messages of a recording as records; answered when all are verified.
    Import(ImportWishes),
    /// Seal what is recorded into a folder, until it is closed or this is ended.
    Follow(FollowWishes),
    /// Seal every message of another home of the same owner; answered when all are verified.
    ImportHome(HomeWishes),
    /// Write records that this profile may read as a recording.
    Export(ExportWishes),
    /// How far what the profile asked for is, where that takes long; needs no keyring.
    Progress,
}

/// How far the profile's imports, exports, audits and back-ups are.
#[derive(Debug, Clone, Copy)]
pub struct RecordingProgress;

impl From<ImportWishes> for Command {
    fn from(wishes: ImportWishes) -> Self {
        Self::Recording { with: RecordingCommand::Import(wishes) }
    }
}

impl Ask for ImportWishes {
    type Answer = ImportView;
}

impl From<FollowWishes> for Command {
    fn from(wishes: FollowWishes) -> Self {
        Self::Recording { with: RecordingCommand::Follow(wishes) }
    }
}

impl Ask for FollowWishes {
    type Answer = FollowView;
}

impl From<HomeWishes> for Command {
    fn from(wishes: HomeWishes) -> Self {
        Self::Recording { with: RecordingCommand::ImportHome(wishes) }
    }
}

impl Ask for HomeWishes {
    type Answer = ImportView;
}

impl From<ExportWishes> for Command {
    fn from(wishes: ExportWishes) -> Self {
        Self::Recording { with: RecordingCommand::Export(wishes) }
    }
}

impl Ask for ExportWishes {
    type Answer = ExportView;
}

impl From<RecordingProgress> for Command {
    fn from(_: RecordingProgress) -> Self {
        Self::Recording { with: RecordingCommand::Progress }
    }
}

impl Ask for RecordingProgress {
    type Answer = Vec<ProgressView>;
}

/// Commands about the rules for topics.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PolicyCommand {
    /// The rule of each topic.
    Show,
    /// What each topic of the graph does over this many milliseconds.
    Learn {
        /// How long to look, milliseconds.
        milliseconds: u64,
    },
}
