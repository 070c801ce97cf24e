//! Records: lists, provenance, checks, openings.

use serde::{Deserialize, Serialize};

use crate::model::{Address, Digest, Hash, RecordKind, Timestamp, Verdict, base64_text};
pub use crate::pipeline::columns::{Caveat, Compared, Refusal, ShownState};
use crate::ros::readable::Readable;

/// One record in a list.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordView {
    /// Short stable id (beginning of the digest).
    pub id: String,
    /// Its owner (shared lists).
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub owner: Option<Address>,
    /// The owner's name in the address book.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub owner_name: Option<String>,
    /// Per recorder and topic, from 1.
    pub seq: u64,
    pub topic: String,
    #[serde(rename = "type")]
    pub type_name: String,
    pub kind: RecordKind,
    /// State; `unread` for a verified one whose bytes are not here for comparison, `verified, names unchecked` if only
    /// the ledger vouches for the sealed names, for want of a key; `false name` if its signer wrote a name into it that
    /// belongs to another pseudonym: then topic and type are what the ledger knows of its pseudonyms.
    pub state: ShownState,
    /// SM3 of the stored bytes.
    pub digest: Digest,
    /// Length of the message, bytes.
    pub bytes: u64,
    /// When it was captured.
    pub captured_at: Timestamp,
    /// The epoch that seals it.
    pub epoch: u64,
    /// Sent by a simulated robot.
    pub simulated: bool,
    pub transaction: Option<Hash>,
    pub block: Option<u64>,
    /// The result of comparing the ledger's row with the record.
    pub compared: Compared,
    /// The field in which they differ: the record's own value is then shown, and it is `tampered`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub differs: Option<String>,
    /// Who had it erased, when and why, in words; none for what a rule deleted.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub erased: Option<String>,
}

/// A page of records.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordPage {
    pub records: Vec<RecordView>,
    /// Cursor of the next page.
    pub next: Option<String>,
    /// Why this is not all that there is to see: more is arriving from the gateway.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub arriving: Option<String>,
}

/// One record with its provenance and its state.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Provenance {
    #[serde(flatten)]
    pub record: RecordView,
    /// Steps from message to verified, each with a word and its evidence.
    pub steps: Vec<(String, String)>,
}

/// A file to be written by the caller.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ExportedFile {
    /// Its name, no path.
    pub name: String,
    /// Its bytes.
    pub bytes: Vec<u8>,
}

/// A bundle of evidence that was written.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct EvidenceView {
    pub file: String,
    pub bytes: u64,
    pub records: u64,
    /// How many of them are disclosed.
    pub revealed: u64,
    /// What could not be included, in words.
    pub notes: Vec<String>,
}

/// The result of asking time stamp authorities.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct StampView {
    /// Batches newly covered by a stamp.
    pub roots: u64,
    pub tokens: Vec<StampedView>,
    /// Stamps that no authority has given yet.
    pub waiting: u64,
    pub problem: Option<String>,
}

/// One stamp from an authority.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct StampedView {
    /// The authority's name in the settings.
    pub authority: String,
    /// All of it existed before this time.
    pub before: Timestamp,
    /// The number of batches it covers.
    pub roots: u64,
}

/// The result of opening a record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OpenedView {
    #[serde(flatten)]
    pub record: RecordView,
    /// The result of the checks; nothing below is filled unless it is `verified`, `not_checked` or `unanchored`.
    pub verdict: Verdict,
    /// Why the chain was not asked, if it was not.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub reason: Option<String>,
    /// The publisher's node name, cleaned.
    pub caller_id: String,
    pub tags: Vec<(String, String)>,
    /// How it was compressed before it was sealed: `none`, `lz4`, `matrix`.
    pub compression: String,
    /// Length of its sealed body, bytes.
    pub stored: u64,
    /// Why no fields are shown, or what casts doubt on them.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub note: Option<String>,
    /// Field paths and values in order, cleaned, for screens.
    pub fields: Vec<(String, String)>,
    /// The message as JSON; long arrays summarised.
    pub message: serde_json::Value,
    /// Well-known types in readable form.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub readable: Option<Readable>,
    /// The first bytes of the message.
    #[serde(with = "base64_text", skip_serializing_if = "Vec::is_empty", default)]
    pub beginning: Vec<u8>,
    /// The message's bytes as captured, unless it is long.
    #[serde(with = "base64_text::option", skip_serializing_if = "Option::is_none", default)]
    pub body: Option<Vec<u8>>,
    /// A picture's own bytes (JPEG, PNG) if the message is one, unless it is long.
    #[serde(with = "base64_text::option", skip_serializing_if = "Option::is_none", default)]
    pub picture: Option<Vec<u8>>,
    #[serde(with = "base64_text::option", skip_serializing_if = "Option::is_none", default)]
    pub file: Option<Vec<u8>>,
}

/// The result of a check of one record.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct CheckView {
    pub id: String,
    pub verdict: Verdict,
    /// Why the chain was not asked, if it was not.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub reason: Option<String>,
    /// SM3 of the stored bytes.
    pub digest: Digest,
    pub transaction: Option<Hash>,
    pub block: Option<u64>,
    /// What the contract answers about the right to read it; `None` if the token of its epoch is not on the chain.
    pub contract: Option<ContractAnswer>,
}

/// The contract's answer to the paper's `dataQuery`: whether an account may read what another one sealed in an epoch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct ContractAnswer {
    /// Whose right was asked about.
    pub reader: Address,
    pub owner: Address,
    /// Whether the reader may read them.
    pub authorised: bool,
    /// The epoch of the record.
    pub epoch: u64,
    /// How many digests the owner put on the chain one by one; 0 if the reader is not authorised.
    pub count: u64,
    /// The last of them.
    pub last: Option<Digest>,
}

impl ContractAnswer {
    /// In words for people.
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
