//! Answers about imports, exports and rules for topics.

use serde::{Deserialize, Serialize};

use super::{Answer, LeftOut, Reply};
use crate::model::{Digest, TopicRule};
use crate::ros::recording::{Damage, RecordingFormat};

/// Figures of one topic of an import.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct ImportedTopic {
    /// Topic, cleaned.
    pub topic: String,
    /// Messages sealed now.
    pub imported: u64,
    /// Of these, verified.
    pub verified: u64,
    /// Messages imported earlier.
    pub already: u64,
}

/// The result of an import.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct ImportView {
    /// The file, or the other home, cleaned.
    pub file: String,
    /// SM3 of the file, unpacked if it is compressed as a whole; of a folder that of its files' names, lengths and digests.
    pub digest: Option<Digest>,
    /// Messages, attachments and metadata records that the file or home holds, wanted or not.
    pub found: u64,
    /// Messages sealed now.
    pub imported: u64,
    /// Of these, verified: re-read from the store, digest equal to the chain, signature valid.
    pub verified: u64,
    /// Messages that an earlier import of the same file or home sealed, or a follower; they are not sealed twice.
    pub already: u64,
    /// Attachments and metadata records of the file sealed now or earlier; [`Self::topics`] has them under a name of their own.
    pub attachments: u64,
    /// Messages given up because their profile has no keys in force.
    pub lost: u64,
    /// Unusable messages: left out, of an undescribed channel, or damaged.
    pub skipped: u64,
    /// Messages left out by topic, with the reason.
    pub left_out: Vec<LeftOut>,
    /// Messages without a checksum in the file: it cannot show whether they were altered.
    pub unguarded: u64,
    /// Whether the recorder was killed before it wrote the file's index, so that the end may be missing.
    pub unfinished: bool,
    /// What could not be read, and why.
    pub damages: Vec<Damage>,
    /// Further places of damage.
    pub more_damages: u64,
    /// Whether it ended before the end of the file.
    pub ended_early: bool,
    /// Per topic.
    pub topics: Vec<ImportedTopic>,
}

/// One file of a followed folder.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct FollowedFile {
    /// Its name in the folder, cleaned.
    pub file: String,
    /// Bytes read of it.
    pub bytes: u64,
    /// Messages, attachments and metadata records found in it, wanted or not.
    pub found: u64,
    /// Of these, sealed in this run.
    pub sealed: u64,
    /// Of these, sealed in an earlier run.
    pub already: u64,
    /// Given up because their profile has no keys in force.
    pub lost: u64,
    /// Unusable messages.
    pub skipped: u64,
    /// These by topic, with the reason.
    pub left_out: Vec<LeftOut>,
    /// What could not be read, and why.
    pub damages: Vec<Damage>,
    /// Further places of damage.
    pub more_damages: u64,
    /// Chunks of it; a file may have none.
    pub chunks: u64,
    /// SM3 of the whole file, once it has ended.
    pub digest: Option<Digest>,
    /// Whether its recorder closed it.
    pub is_closed: bool,
    /// Whether it is no longer what was sealed of it: shorter, or altered.
    pub is_altered: bool,
    /// The record that states its digests, by id, once it is verified.
    pub record: Option<String>,
    /// The bundle beside it, once it is written.
    pub proof: Option<String>,
    /// The copy of it with its proof attached.
    pub attached: Option<String>,
    /// What went wrong or is still missing, in words.
    pub notes: Vec<String>,
}

/// The result of following a folder.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct FollowView {
    /// The folder, cleaned.
    pub folder: String,
    /// Whether the folder was gone at the end.
    pub is_gone: bool,
    /// Whether it was ended before the recording was closed.
    pub ended_early: bool,
    /// Its files, in the order of recording.
    pub files: Vec<FollowedFile>,
}

/// Figures of one topic of an export.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct ExportedTopic {
    /// Topic, cleaned.
    pub topic: String,
    /// Type, cleaned.
    #[serde(rename = "type")]
    pub type_name: String,
    /// Messages written.
    pub messages: u64,
}

/// Records that were not written, by reason.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Refused {
    /// They differ from what was anchored, or their signature is not valid.
    pub tampered: u64,
    /// Their ciphertext is missing in the store.
    pub missing: u64,
    /// Not confirmed on the chain.
    pub unanchored: u64,
    /// Their signers wrote names into them that belong to other pseudonyms.
    pub false_names: u64,
    /// No key of this profile opens them.
    pub no_key: u64,
    /// Own records in quarantine, or given up.
    pub held: u64,
    /// No readable record holds the definition of their type.
    pub no_definition: u64,
    /// The format cannot hold them (messages of ROS 2 in a bag).
    pub unsuitable: u64,
    /// Attachments and metadata records, which a bag has no room for, or which are not as MCAP has them.
    pub attachments: u64,
}

/// The result of an export.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ExportView {
    /// The file, cleaned; `None` if there was nothing to write.
    pub file: Option<String>,
    /// Its format.
    pub format: RecordingFormat,
    /// Messages written.
    pub messages: u64,
    /// Attachments and metadata records written.
    pub attachments: u64,
    /// Bytes of their bodies.
    pub bytes: u64,
    /// Records not written.
    pub refused: Refused,
    /// Ids of those tampered with, missing, or with false names; the first 100.
    pub suspicious: Vec<String>,
    /// Topics whose definitions their publishing nodes of ROS 2 gave: a type hash proves names and types of fields, not
    /// comments, constants or default values. Cleaned.
    pub given: Vec<String>,
    /// Per topic.
    pub topics: Vec<ExportedTopic>,
}

/// Progress of long work: an import, a folder followed, an export, an audit, a back-up.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ProgressView {
    /// What it does now: `hashing`, `importing`, `following`, `verifying`, `exporting`, `auditing`, `writing`.
    pub step: String,
    /// The file, or what it is about, cleaned.
    pub file: String,
    /// Bytes (import, back-up) or records (export, audit) done.
    pub done: u64,
    /// Their total; 0 if unknown.
    pub of: u64,
    /// Messages sealed or written, or so many of another unit.
    pub messages: u64,
    /// What is counted there: `messages`, `records`, `files`.
    pub unit: String,
}

/// Answers about recordings.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RecordingReply {
    /// To `Import` and `ImportHome`.
    Imported(ImportView),
    /// To `Follow`.
    Followed(FollowView),
    /// To `Export`.
    Exported(ExportView),
    /// To `Progress`.
    Progress(Vec<ProgressView>),
}

impl RecordingReply {
    fn of(reply: Reply) -> Option<Self> {
        if let Reply::Recording(reply) = reply { Some(reply) } else { None }
    }
}

impl Answer for ImportView {
    fn into_reply(self) -> Reply {
        Reply::Recording(RecordingReply::Imported(self))
    }

    fn from_reply(reply: Reply) -> Option<Self> {
        if let RecordingReply::Imported(view) = RecordingReply::of(reply)? { Some(view) } else { None }
    }
}

impl Answer for FollowView {
    fn into_reply(self) -> Reply {
        Reply::Recording(RecordingReply::Followed(self))
    }

    fn from_reply(reply: Reply) -> Option<Self> {
        if let RecordingReply::Followed(view) = RecordingReply::of(reply)? { Some(view) } else { None }
    }
}

impl Answer for ExportView {
    fn into_reply(self) -> Reply {
        Reply::Recording(RecordingReply::Exported(self))
    }

    fn from_reply(reply: Reply) -> Option<Self> {
        if let RecordingReply::Exported(view) = RecordingReply::of(reply)? { Some(view) } else { None }
    }
}

impl Answer for Vec<ProgressView> {
    fn into_reply(self) -> Reply {
        Reply::Recording(RecordingReply::Progress(self))
    }

    fn from_reply(reply: Reply) -> Option<Self> {
        if let RecordingReply::Progress(runs) = RecordingReply::of(reply)? { Some(runs) } else { None }
    }
}

/// The rule of one topic, and the topic's rates.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PolicyRow {
    /// Topic, cleaned.
    pub topic: String,
    /// Its type, cleaned, if known.
    #[serde(rename = "type")]
    pub type_name: Option<String>,
    /// Whether this profile watches it.
    pub watched: bool,
    /// The rule in force.
    pub rule: Option<TopicRule>,
    /// Messages left out by it since the site started.
    pub left_out: u64,
    /// Messages a second.
    pub hz: Option<f64>,
    /// Bytes a second.
    pub bytes_per_second: Option<f64>,
    /// Bytes of the largest message seen.
    pub largest: Option<u64>,
}

/// The rules for topics.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PolicyView {
    /// Every topic of the graph and those watched.
    pub topics: Vec<PolicyRow>,
    /// Rules that no topic uses now.
    pub idle: Vec<TopicRule>,
    /// Whether the topics' rates were measured.
    pub learned: bool,
}
