//! Answers about topics and what becomes of them: captures, imports, exports, rules, playback.

use serde::{Deserialize, Serialize};

use super::{LeftOut, UnreachedView};
use crate::model::{Digest, Timestamp, TopicName, TopicRule};
use crate::ros::recording::{Damage, RecordingFormat};
use crate::store::CoveragePart;

/// Why a watched topic is not captured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum HeldUp {
    /// The profile's keys have not been unlocked in this site.
    WaitsForKey,
    /// A console has paused capture, or the disk is full.
    Paused,
}

/// One topic of the graph.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct TopicRow {
    pub topic: String,
    /// Its type, cleaned, if known.
    #[serde(rename = "type")]
    pub type_name: Option<String>,
    /// Its version of ROS: 1 or 2.
    pub ros: u8,
    /// The type's hash (`RIHS01_…`), cleaned, if a ROS 2 publisher gave it.
    pub type_hash: Option<String>,
    /// What all ROS 2 publishers offer, such as `reliable volatile`; `None` in ROS 1.
    pub qos: Option<String>,
    pub publishers: Vec<String>,
    /// Of the publishers of a captured topic, those that cannot be read.
    pub unreached: Vec<UnreachedView>,
    /// Whether this profile watches it.
    pub watched: bool,
    /// Why it is watched but not captured; `None` = it is captured, or not watched.
    pub held_up: Option<HeldUp>,
    /// Whether a simulated robot of this site publishes it.
    pub simulated: bool,
    /// Messages a second over the last 5 s; `None` = not measured.
    pub hz: Option<f64>,
    /// Bytes a second over the last 5 s; `None` = not measured.
    pub bytes_per_second: Option<f64>,
    /// Messages of it that this profile has captured.
    pub messages: u64,
    /// Lost before capture (header.seq gaps).
    pub lost_in_transport: u64,
    /// Dropped by the recorder.
    pub lost_in_recorder: u64,
    /// Left out by the rate or sampling of the topic's rule; these are not lost.
    pub left_out: u64,
    /// Arrival of the last message.
    pub last_message: Option<Timestamp>,
    /// Publishers pinned to it; 0 = none yet.
    pub pins: u64,
    /// Of `publishers`, those that are not pinned, if any is.
    pub unpinned: Vec<String>,
    /// Messages of it that this profile holds in quarantine.
    pub quarantined: u64,
    /// Whether an alarm about a publisher of it is open.
    pub alarm: bool,
}

/// When there are records of a topic.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct CoverageView {
    pub topic: TopicName,
    /// The robot whose records alone are shown, if one was asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robot: Option<String>,
    /// Robots that recorded something of the topic, by name. What they lost is sealed in their reports, so it is in no
    /// part.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub robots: Vec<String>,
    /// Beginning of the span.
    pub since: Timestamp,
    pub until: Timestamp,
    /// Capture of the first record ever.
    pub first: Option<Timestamp>,
    /// Capture of the last.
    pub last: Option<Timestamp>,
    /// The parts of the span, oldest first, all of the same length.
    pub parts: Vec<CoveragePart>,
}

impl CoverageView {
    /// A sign for each part.
    pub fn strip(&self) -> String {
        self.parts.iter().map(CoveragePart::sign).collect()
    }

    /// The meaning of the signs that occur.
    pub fn legend(&self) -> String {
        const MEANINGS: [(char, &str); 5] =
            [('█', "recorded"), ('·', "nothing"), ('L', "messages lost"), ('Q', "quarantined"), ('T', "tampered")];
        let strip = self.strip();
        let there = MEANINGS.iter().filter(|(sign, _)| strip.contains(*sign));
        there.map(|(sign, text)| format!("{sign} {text}")).collect::<Vec<_>>().join("  ")
    }
}

/// Figures of one topic in a capture's summary.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct TopicSummary {
    pub topic: String,
    /// Type, if a message was seen.
    #[serde(rename = "type")]
    pub type_name: Option<String>,
    pub captured: u64,
    pub verified: u64,
    /// Of these, quarantined: their publisher is not a pinned one.
    pub quarantined: u64,
    /// Lost in transport or in the recorder.
    pub lost: u64,
    /// Publishers that were listed at its end and could not be read.
    pub unreached: Vec<UnreachedView>,
}

/// The result of a capture.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct CaptureSummary {
    pub captured: u64,
    /// Of these, verified: re-read from the store, digest equal to the chain, signature valid.
    pub verified: u64,
    /// Of these, quarantined: their publisher is not a pinned one.
    pub quarantined: u64,
    /// Lost in transport or in the recorder.
    pub lost: u64,
    /// Left out on purpose (bag import).
    pub skipped: u64,
    pub topics: Vec<TopicSummary>,
}

/// Figures of one topic of an import.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct ImportedTopic {
    pub topic: String,
    pub imported: u64,
    pub verified: u64,
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
    pub topic: String,
    #[serde(rename = "type")]
    pub type_name: String,
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
    pub format: RecordingFormat,
    pub messages: u64,
    /// Attachments and metadata records written.
    pub attachments: u64,
    /// Bytes of their bodies.
    pub bytes: u64,
    pub refused: Refused,
    /// Ids of those tampered with, missing, or with false names; the first 100.
    pub suspicious: Vec<String>,
    /// Topics whose definitions their publishing nodes of ROS 2 gave: a type hash proves names and types of fields, not
    /// comments, constants or default values. Cleaned.
    pub given: Vec<String>,
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

/// The rule of one topic, and the topic's rates.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PolicyRow {
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

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, strum::IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
#[serde(rename_all = "snake_case")]
pub enum PlayEnd {
    /// Everything there was has been played.
    Whole,
    /// Somebody ended it, or the connection that requested it is gone.
    Asked,
    /// No grant is left: the last was revoked.
    Revoked,
    /// No grant is left: the last has expired, or the reader is suspended.
    Expired,
    /// The keyring was locked.
    Locked,
    Site,
}

impl PlayEnd {
    /// Its word in answers.
    pub fn word(self) -> &'static str {
        self.into()
    }

    /// What ended it, if nobody asked for that and not everything was played.
    pub fn cut_short(self) -> Option<&'static str> {
        match self {
            Self::Whole | Self::Asked => None,
            Self::Revoked => Some("the grant was revoked"),
            Self::Expired => Some("the grant has expired"),
            Self::Locked => Some("the keyring was locked"),
            Self::Site => Some("the site stopped"),
        }
    }

    /// Whether it ended for want of a right to read.
    pub fn is_by_right(self) -> bool {
        matches!(self, Self::Revoked | Self::Expired | Self::Locked)
    }
}

/// The result of playing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlayedView {
    /// Messages published, each checked first. In ROS 2 every subscriber that acknowledges has acknowledged them.
    pub published: u64,
    /// Records refused by a check, or that the graph or domain cannot take; none of them was published.
    pub refused: u64,
    /// Records whose bytes are missing in the store.
    pub missing: u64,
    /// Messages that a subscriber missed because it read too slowly; in ROS 2 also those that it never acknowledged.
    pub dropped: u64,
    /// Published messages of which nobody knows whether all subscribers got them: best-effort ones do not acknowledge.
    pub unconfirmed: u64,
    /// The time it took.
    pub seconds: f64,
    pub ended_by: PlayEnd,
    /// The reasons for refusing records, with counts; the first 20.
    pub reasons: Vec<(String, u64)>,
    /// The topics as played, with their messages.
    pub topics: Vec<(String, u64)>,
}
