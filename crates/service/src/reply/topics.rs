//! Answers about topics: captures, imports, exports, rules, playback.

use serde::{Deserialize, Serialize};

pub use crate::pipeline::columns::{Caveat, Compared, Refusal, ShownState};

use super::{LeftOut, UnreachedView};
use crate::model::{
    Address, Digest, Hash, RecordKind, Sampling, Timestamp, TopicName, TopicRule, TypeName, Verdict, base64_text,
};
use crate::ros::readable::Readable;
use crate::ros::recording::{Damage, RecordingFormat};
use crate::store::CoveragePart;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum HeldUp {
    /// The keys have not been unlocked in this site.
    WaitsForKey,
    /// A console paused capture, or the disk is full.
    Paused,
}

#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct TopicRow {
    pub topic: String,
    /// Cleaned, if known.
    #[serde(rename = "type")]
    pub type_name: Option<String>,
    /// 1 or 2.
    pub ros: u8,
    /// `RIHS01_…`, cleaned, if a ROS 2 publisher gave it.
    pub type_hash: Option<String>,
    /// What all ROS 2 publishers offer, such as `reliable volatile`; `None` in ROS 1.
    pub qos: Option<String>,
    pub publishers: Vec<String>,
    /// Publishers of a captured topic that cannot be read.
    pub unreached: Vec<UnreachedView>,
    pub watched: bool,
    /// The pattern that watches it, if its own name does not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub watched_by: Option<String>,
    /// The only type that is captured, if its watch names one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub watched_type: Option<TypeName>,
    /// How many of its messages are kept: by its watch, or else by the settings.
    #[serde(default, skip_serializing_if = "Sampling::is_all")]
    pub sampling: Sampling,
    /// `None` = it is captured, or not watched.
    pub held_up: Option<HeldUp>,
    pub simulated: bool,
    /// Per second over the last 5 s; `None` = not measured.
    pub hz: Option<f64>,
    /// Per second over the last 5 s; `None` = not measured.
    pub bytes_per_second: Option<f64>,
    pub messages: u64,
    /// header.seq gaps.
    pub lost_in_transport: u64,
    pub lost_in_recorder: u64,
    /// Left out by the topic's rule; not lost.
    pub left_out: u64,
    pub last_message: Option<Timestamp>,
    /// Pinned publishers; 0 = none yet.
    pub pins: u64,
    /// Those of `publishers` that are not pinned, if any is.
    pub unpinned: Vec<String>,
    pub quarantined: u64,
    /// An alarm about a publisher is open.
    pub alarm: bool,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct CoverageView {
    pub topic: TopicName,
    /// Only this robot's records are shown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robot: Option<String>,
    /// Robots that recorded some of it. Their losses are sealed in their reports, so no part counts them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub robots: Vec<String>,
    pub since: Timestamp,
    pub until: Timestamp,
    /// Capture of the first record ever.
    pub first: Option<Timestamp>,
    pub last: Option<Timestamp>,
    /// Oldest first, all of the same length.
    pub parts: Vec<CoveragePart>,
}

impl CoverageView {
    pub fn strip(&self) -> String {
        self.parts.iter().map(CoveragePart::sign).collect()
    }

    pub fn legend(&self) -> String {
        coverage_legend(&self.strip())
    }
}

/// Meaning of the signs that occur in a strip.
pub fn coverage_legend(strip: &str) -> String {
    const MEANINGS: [(char, &str); 5] =
        [('█', "recorded"), ('·', "nothing"), ('L', "messages lost"), ('Q', "quarantined"), ('T', "tampered")];
    let there = MEANINGS.iter().filter(|(sign, _)| strip.contains(*sign));
    there.map(|(sign, text)| format!("{sign} {text}")).collect::<Vec<_>>().join("  ")
}

#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct TopicSummary {
    pub topic: String,
    #[serde(rename = "type")]
    pub type_name: Option<String>,
    pub captured: u64,
    pub verified: u64,
    /// From a publisher that is not pinned.
    pub quarantined: u64,
    /// In transport or in the recorder.
    pub lost: u64,
    pub unreached: Vec<UnreachedView>,
}

#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct CaptureSummary {
    pub captured: u64,
    /// Re-read from the store, digest equal to the chain, signature valid.
    pub verified: u64,
    pub quarantined: u64,
    pub lost: u64,
    /// Left out on purpose (bag import).
    pub skipped: u64,
    pub topics: Vec<TopicSummary>,
}

#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct ImportedTopic {
    pub topic: String,
    pub imported: u64,
    pub verified: u64,
    pub already: u64,
}

#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct ImportView {
    /// File or other home; cleaned.
    pub file: String,
    /// SM3 of the unpacked file; for a folder, of its files' names, lengths and digests.
    pub digest: Option<Digest>,
    /// Messages, attachments and metadata records, wanted or not.
    pub found: u64,
    pub imported: u64,
    pub verified: u64,
    /// Sealed by an earlier import or follower; not sealed twice.
    pub already: u64,
    /// Attachments and metadata records sealed now or earlier; [`Self::topics`] lists them under their own name.
    pub attachments: u64,
    /// Given up: the profile has no keys in force.
    pub lost: u64,
    /// Unusable: left out, of an undescribed channel, or damaged.
    pub skipped: u64,
    pub left_out: Vec<LeftOut>,
    /// Without a checksum in the file: alterations cannot show.
    pub unguarded: u64,
    /// The recorder died before it wrote the index, so the end may be missing.
    pub unfinished: bool,
    /// What could not be read, and why.
    pub damages: Vec<Damage>,
    pub more_damages: u64,
    /// Stopped before the end of the file.
    pub ended_early: bool,
    pub topics: Vec<ImportedTopic>,
}

#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct FollowedFile {
    pub file: String,
    pub bytes: u64,
    /// Messages, attachments and metadata records, wanted or not.
    pub found: u64,
    /// Sealed in this run.
    pub sealed: u64,
    pub already: u64,
    pub lost: u64,
    pub skipped: u64,
    pub left_out: Vec<LeftOut>,
    pub damages: Vec<Damage>,
    pub more_damages: u64,
    /// May be 0.
    pub chunks: u64,
    /// SM3 of the whole file, once it has ended.
    pub digest: Option<Digest>,
    pub is_closed: bool,
    /// Shorter or otherwise different from what was sealed.
    pub is_altered: bool,
    /// Id of the record that states its digests, once verified.
    pub record: Option<String>,
    /// The bundle beside it, once written.
    pub proof: Option<String>,
    /// What went wrong or is still missing.
    pub notes: Vec<String>,
}

#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct FollowView {
    pub folder: String,
    pub is_gone: bool,
    /// Stopped before the recording was closed.
    pub ended_early: bool,
    pub files: Vec<FollowedFile>,
}

#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct ExportedTopic {
    pub topic: String,
    #[serde(rename = "type")]
    pub type_name: String,
    pub messages: u64,
}

/// Records not written, by reason.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Refused {
    pub tampered: u64,
    pub missing: u64,
    pub unanchored: u64,
    /// Their signers wrote names of other pseudonyms into them.
    pub false_names: u64,
    pub no_key: u64,
    /// Own records in quarantine, or given up.
    pub held: u64,
    /// No readable record holds their type's definition.
    pub no_definition: u64,
    /// The format cannot hold them (messages of ROS 2 in a bag).
    pub unsuitable: u64,
    /// Attachments and metadata records that do not fit a bag or are not as MCAP has them.
    pub attachments: u64,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ExportView {
    /// Cleaned; `None` if there was nothing to write.
    pub file: Option<String>,
    pub format: RecordingFormat,
    pub messages: u64,
    pub attachments: u64,
    pub bytes: u64,
    pub refused: Refused,
    /// Ids of those tampered with, missing, or with false names; the first 100.
    pub suspicious: Vec<String>,
    /// Topics whose definitions ROS 2 nodes gave; cleaned. A type hash does not prove comments, constants or default
    /// values.
    pub given: Vec<String>,
    pub topics: Vec<ExportedTopic>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ProgressView {
    /// `hashing`, `importing`, `following`, `verifying`, `exporting`, `auditing` or `writing`.
    pub step: String,
    /// Subject; cleaned.
    pub file: String,
    /// Bytes (import, back-up) or records (export, audit).
    pub done: u64,
    /// Total; 0 if unknown.
    pub of: u64,
    /// Units sealed or written.
    pub messages: u64,
    /// `messages`, `records` or `files`.
    pub unit: String,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PolicyRow {
    pub topic: String,
    #[serde(rename = "type")]
    pub type_name: Option<String>,
    pub watched: bool,
    /// By its watch, or else by the rule.
    pub sampling: Sampling,
    pub rule: Option<TopicRule>,
    /// Since the site started.
    pub left_out: u64,
    pub hz: Option<f64>,
    pub bytes_per_second: Option<f64>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PolicyView {
    /// Every topic of the graph, and those watched.
    pub topics: Vec<PolicyRow>,
    /// Rules that no topic uses now.
    pub idle: Vec<TopicRule>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, strum::IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
#[serde(rename_all = "snake_case")]
pub enum PlayEnd {
    Whole,
    /// Stopped, or the connection that requested it is gone.
    Asked,
    /// The last grant was revoked.
    Revoked,
    /// The last grant has expired, or the reader is suspended.
    Expired,
    Locked,
    Site,
}

crate::model::words!(PlayEnd);

impl PlayEnd {
    /// Why it ended, unless everything was played or somebody stopped it.
    pub fn cut_short(self) -> Option<&'static str> {
        match self {
            Self::Whole | Self::Asked => None,
            Self::Revoked => Some("the grant was revoked"),
            Self::Expired => Some("the grant has expired"),
            Self::Locked => Some("the keyring was locked"),
            Self::Site => Some("the site stopped"),
        }
    }

    /// Ended for want of a right to read.
    pub fn is_by_right(self) -> bool {
        matches!(self, Self::Revoked | Self::Expired | Self::Locked)
    }
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlayedView {
    /// Each checked first. In ROS 2, acknowledged by every subscriber that acknowledges.
    pub published: u64,
    /// Refused by a check, or unsuitable for the graph or domain; none was published.
    pub refused: u64,
    /// Their bytes are missing in the store.
    pub missing: u64,
    /// Missed by a slow subscriber; in ROS 2 also never acknowledged.
    pub dropped: u64,
    /// Possibly not received: best-effort subscribers do not acknowledge.
    pub unconfirmed: u64,
    pub seconds: f64,
    pub ended_by: PlayEnd,
    /// Reasons for refusing records, with counts; the first 20.
    pub reasons: Vec<(String, u64)>,
    pub topics: Vec<(String, u64)>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordView {
    /// Beginning of the digest.
    pub id: String,
    /// In shared lists.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub owner: Option<Address>,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub owner_name: Option<String>,
    /// Per recorder and topic, from 1.
    pub seq: u64,
    pub topic: String,
    #[serde(rename = "type")]
    pub type_name: String,
    pub kind: RecordKind,
    /// `unread`: verified, but its bytes are not here. `verified, names unchecked`: only the ledger vouches for the
    /// sealed names, for want of a key. `false name`: the signer wrote a name of another pseudonym; topic and type are
    /// then the ledger's.
    pub state: ShownState,
    /// SM3 of the stored bytes.
    pub digest: Digest,
    /// Of the message.
    pub bytes: u64,
    pub captured_at: Timestamp,
    pub epoch: u64,
    /// Sent by a simulated robot.
    pub simulated: bool,
    pub transaction: Option<Hash>,
    pub block: Option<u64>,
    /// Result of comparing the ledger's row with the record.
    pub compared: Compared,
    /// The field in which they differ: the record's value is shown, and it is `tampered`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub differs: Option<String>,
    /// Who had it erased, when and why; none if a rule deleted it.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub erased: Option<String>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordPage {
    pub records: Vec<RecordView>,
    pub next: Option<String>,
    /// Why the list may be incomplete: more is arriving from the gateway.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub arriving: Option<String>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Provenance {
    #[serde(flatten)]
    pub record: RecordView,
    /// From message to verified, each with a word and its evidence.
    pub steps: Vec<(String, String)>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ExportedFile {
    pub name: String,
    pub bytes: Vec<u8>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct EvidenceView {
    pub file: String,
    pub bytes: u64,
    /// Chosen, with the recorder's own statements once it is written.
    pub records: u64,
    pub revealed: u64,
    /// What of each topic is disclosed, the largest first; cleaned.
    pub topics: Vec<DisclosedTopic>,
    /// Not merely shown.
    pub written: bool,
    /// What could not be included.
    pub notes: Vec<String>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DisclosedTopic {
    pub topic: String,
    pub records: u64,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct StampView {
    /// Batches newly covered by a stamp.
    pub roots: u64,
    pub tokens: Vec<StampedView>,
    /// Stamps still missing.
    pub waiting: u64,
    pub problem: Option<String>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct StampedView {
    pub authority: String,
    /// All of it existed before this time.
    pub before: Timestamp,
    pub roots: u64,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OpenedView {
    #[serde(flatten)]
    pub record: RecordView,
    /// Nothing below is filled unless it is `verified`, `not_checked` or `unanchored`.
    pub verdict: Verdict,
    /// Why the chain was not consulted.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub reason: Option<String>,
    /// Cleaned.
    pub caller_id: String,
    pub tags: Vec<(String, String)>,
    /// `none`, `lz4` or `matrix`.
    pub compression: String,
    /// Length of its sealed body, bytes.
    pub stored: u64,
    /// Why no fields are shown, or what casts doubt on them.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub note: Option<String>,
    /// Paths and values in order, cleaned.
    pub fields: Vec<(String, String)>,
    /// As JSON; long arrays summarised.
    pub message: serde_json::Value,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub readable: Option<Readable>,
    /// First bytes of the message.
    #[serde(with = "base64_text", skip_serializing_if = "Vec::is_empty", default)]
    pub beginning: Vec<u8>,
    /// As captured, unless it is long.
    #[serde(with = "base64_text::option", skip_serializing_if = "Option::is_none", default)]
    pub body: Option<Vec<u8>>,
    /// JPEG or PNG bytes if the message is a picture, unless it is long.
    #[serde(with = "base64_text::option", skip_serializing_if = "Option::is_none", default)]
    pub picture: Option<Vec<u8>>,
    #[serde(with = "base64_text::option", skip_serializing_if = "Option::is_none", default)]
    pub file: Option<Vec<u8>>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct CheckView {
    pub id: String,
    pub verdict: Verdict,
    /// Why the chain was not consulted.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub reason: Option<String>,
    pub digest: Digest,
    pub transaction: Option<Hash>,
    pub block: Option<u64>,
    /// The contract's answer about the right to read it; `None` if the chain lacks the token of its epoch.
    pub contract: Option<ContractAnswer>,
}

/// The contract's answer to the paper's `dataQuery`: may `reader` read what `owner` sealed in an epoch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct ContractAnswer {
    pub reader: Address,
    pub owner: Address,
    pub authorised: bool,
    pub epoch: u64,
    /// Digests that the owner anchored one by one; 0 if not authorised.
    pub count: u64,
    pub last: Option<Digest>,
}

impl ContractAnswer {
    pub fn text(&self) -> String {
        let Self { reader, owner, authorised, epoch, count, last } = self;
        if !authorised {
            return format!(
                "the contract itself does not let {reader} read epoch {epoch} of {owner}: its key came in the envelope of a \
                 later epoch"
            );
        }
        let last = last.map_or_else(String::new, |digest| format!(", the last {digest}"));
        format!("the contract lets {reader} read epoch {epoch} of {owner}; digests anchored one by one: {count}{last}")
    }
}
