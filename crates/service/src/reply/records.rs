//! Answers about records: lists, provenance, checks, openings.

use serde::{Deserialize, Serialize};

use crate::model::{Address, Digest, Hash, RecordKind, Timestamp, Verdict, base64_text};
pub use crate::pipeline::columns::{Caveat, Compared, Refusal, ShownState};
use crate::ros::readable::Readable;

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
