//! The verdict on a bundle: for each record, level by level, what is proven and what is not. There is no single tick.

use std::collections::BTreeMap;

use authros_crypto::record::Revealed;
use authros_model::{Address, Birth, Digest, Heads, RecorderId, SignerId, Timestamp, TopicId};
use serde::Serialize;
use strum::{IntoStaticStr, VariantArray};

use crate::completeness::TOPIC;

/// The result of a level.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, IntoStaticStr, VariantArray)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "lowercase")]
pub enum Standing {
    /// It follows from the bytes and from what was pinned.
    Proven,
    /// It is true by the word of the exporter's own chain: it proves nothing against the exporter.
    #[strum(to_string = "self-sealed chain")]
    OwnChain,
    /// Nothing contradicts it, but something that would prove it is missing.
    #[strum(to_string = "not proven")]
    Unproven,
    /// Nobody claims it.
    Absent,
    /// It is contradicted.
    #[strum(to_string = "REFUSED")]
    Refused,
}

impl Standing {
    /// In words for people.
    pub fn word(self) -> &'static str {
        self.into()
    }
}

/// Why a level is not proven, or refused. `sentences.json` has its words.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, IntoStaticStr, VariantArray)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
#[allow(missing_docs, reason = "each has its sentence")]
pub enum Reason {
    NotAsFiled,
    NotARecord,
    OtherChain,
    SignerMissing,
    BadSignature,
    RegistrationMissing,
    RegistrationBroken,
    NoKeys,
    KeysReplaced,
    IdentityMissing,
    OtherKey,
    Suspended,
    SuspensionUnknown,
    NoRight,
    DeviceUnknown,
    NotAnchored,
    WrongPath,
    HeaderMissing,
    StateMissing,
    StateBroken,
    OtherCode,
    AnchorMissing,
    OtherAnchor,
    FirstBlockOnly,
    NoTrust,
    NoSigners,
    FewSigners,
    OtherSigner,
    BrokenSeals,
    NoSeal,
    StampPath,
    BadStamp,
    UnknownAuthority,
    BadDisclosure,
    ForeignDisclosure,
    UnprovenDisclosure,
    TooMuchDisclosed,
    TwoHistories,
    FalseHeads,
}

impl Reason {
    /// Its name in `sentences.json`.
    pub fn name(self) -> &'static str {
        self.into()
    }
}

/// One level of one record.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Level {
    /// Its result.
    pub standing: Standing,
    /// The cause if it is not proven or refused, unless that follows from another level.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<Reason>,
    /// In words, with all details.
    pub text: String,
}

impl Level {
    /// A level whose cause is elsewhere, if it needs one.
    pub fn new(standing: Standing, text: impl Into<String>) -> Self {
        Self { standing, reason: None, text: text.into() }
    }

    pub(crate) fn proven(text: impl Into<String>) -> Self {
        Self::new(Standing::Proven, text)
    }

    pub(crate) fn unproven(reason: Reason, text: impl Into<String>) -> Self {
        Self { reason: Some(reason), ..Self::new(Standing::Unproven, text) }
    }

    /// Not proven because another level is not.
    pub(crate) fn follows(text: impl Into<String>) -> Self {
        Self::new(Standing::Unproven, text)
    }

    pub(crate) fn refused(reason: Reason, text: impl Into<String>) -> Self {
        Self { reason: Some(reason), ..Self::new(Standing::Refused, text) }
    }
}

/// The findings about one record.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct RecordReport {
    /// SM3 of it.
    pub digest: Digest,
    /// Its owner, as its header says.
    pub owner: Option<Address>,
    /// The owner's pinned name, if the key is shown to be the owner's.
    pub person: Option<String>,
    /// SM3 of the key that signed it.
    pub signer: Option<SignerId>,
    /// SM3 of the key that its owner had registered, if a trusted state shows it.
    pub owner_key: Option<SignerId>,
    /// The ledger that numbered it.
    pub recorder: Option<RecorderId>,
    /// Its topic's pseudonym.
    pub topic_id: Option<TopicId>,
    /// Its number.
    pub seq: Option<u64>,
    /// When it was captured, by its owner's word alone.
    pub captured_at: Option<Timestamp>,
    /// The anchoring block's time, by its sealer's clock.
    pub anchored_at: Option<Timestamp>,
    /// The anchoring block.
    pub block: Option<u64>,
    /// Seconds from the claimed capture to the anchor; negative if the claim is later.
    pub seconds_to_anchor: Option<i64>,
    /// It existed before this time, according to a pinned authority.
    pub existed_before: Option<Timestamp>,
    /// Which authority.
    pub authority: Option<String>,
    /// (a) The bytes are intact and signed.
    pub bytes: Level,
    /// (b) The owner was entitled to sign with the key.
    pub key: Level,
    /// (c) It is anchored.
    pub anchor: Level,
    /// (d) An outside authority's time.
    pub time: Level,
    /// (e) It is opened by its owner's disclosure.
    pub opened: Level,
    /// The disclosed content.
    pub disclosed: Option<Disclosed>,
}

impl RecordReport {
    /// Whether the key that signed it is shown to be its owner's, by pinned signers or by the exporter's own chain.
    pub fn is_believed(&self) -> bool {
        matches!(self.key.standing, Standing::Proven | Standing::OwnChain)
    }

    /// Whether it opened as a recorder's statement about completeness; bundles add these to what was chosen.
    pub fn is_statement(&self) -> bool {
        let types = [Birth::TYPE, Heads::TYPE];
        self.disclosed.as_ref().is_some_and(|facts| facts.topic == TOPIC && types.contains(&facts.type_name.as_str()))
    }

    fn needed(&self) -> [Standing; 3] {
        [&self.bytes, &self.key, &self.anchor].map(|level| level.standing)
    }

    /// Such a statement says nothing, and denies nothing.
    pub(crate) fn is_mute(&self) -> bool {
        let needed = self.needed();
        self.is_statement() && needed.contains(&Standing::Unproven) && !needed.contains(&Standing::Refused)
    }

    /// Its levels by their letters.
    pub fn levels(&self) -> [(char, &Level); 5] {
        [('a', &self.bytes), ('b', &self.key), ('c', &self.anchor), ('d', &self.time), ('e', &self.opened)]
    }
}

/// The content of a disclosed record.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Disclosed {
    /// Its topic.
    pub topic: String,
    /// Its type.
    #[serde(rename = "type")]
    pub type_name: String,
    /// The publisher's node.
    pub publisher: String,
    /// Length of the message.
    pub length: u64,
    /// SM3 of the message.
    pub message_sm3: Digest,
    /// Its tags.
    pub tags: BTreeMap<String, String>,
}

/// (f) The records of one topic by one key in one recorder.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Stretch {
    /// Their owner.
    pub owner: Address,
    /// SM3 of the key that signed them.
    pub signer: SignerId,
    /// The ledger.
    pub recorder: RecorderId,
    /// The topic.
    pub topic_id: TopicId,
    /// Its result: no better than what is proven about the signers of its records.
    pub standing: Standing,
    /// Why it is refused.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<Reason>,
    /// Whether these are the recorder's own statements, of which nobody claims that they are all.
    pub own_statements: bool,
    /// The first number in the bundle; `None` if no record's signer is proven.
    pub first: Option<u64>,
    /// The last.
    pub last: Option<u64>,
    /// Numbers missing between them, from and to.
    pub gaps: Vec<(u64, u64)>,
    /// How many numbers are missing.
    pub missing: u64,
    /// Records not counted, because nothing proves whose key signed them.
    pub uncounted: u64,
    /// Numbers that two different records have: their signer told two histories.
    pub twice: Vec<u64>,
    /// The statement of its recorder's newest trusted head.
    pub heads: Option<HeadsClaim>,
    /// When the recorder's birth was anchored, if that is in the bundle.
    pub born_at: Option<Timestamp>,
    /// The recorder that it follows, after a restore or a change of keys, according to its birth.
    pub predecessor: Option<RecorderId>,
    /// In words.
    pub text: String,
}

/// A recorder's statement about a topic at a time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct HeadsClaim {
    /// The record of the head.
    pub record: Digest,
    /// The highest number of the topic.
    pub number: u64,
    /// When the head was anchored, by the block sealer's clock.
    pub at: Option<Timestamp>,
}

/// The overall result.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// Levels (a) to (c) are proven for every record, and who put the bundle together, using what was pinned.
    Holds,
    /// Something is not proven, or true only by the word of the exporter's own chain.
    Incomplete,
    /// Something is contradicted.
    Refused,
}

/// The verdict.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Report {
    /// The overall result.
    pub outcome: Outcome,
    /// In sentences, the outcome first.
    pub verdict: Vec<String>,
    /// Whether a trust file was given.
    pub pinned: bool,
    /// The exporter.
    pub exporter: Level,
    /// What has to be known besides the levels.
    pub warnings: Vec<String>,
    /// Each record.
    pub records: Vec<RecordReport>,
    /// (f) each topic of each recorder.
    pub complete: Vec<Stretch>,
    /// The messages that were disclosed.
    #[serde(skip)]
    pub messages: BTreeMap<Digest, Revealed>,
}

impl Report {
    /// The results of (a) to (c) of all records; a statement that says nothing counts only if there is nothing else.
    pub(crate) fn needed(&self) -> impl Iterator<Item = Standing> {
        let nothing_else = self.records.iter().all(RecordReport::is_mute);
        let counted = self.records.iter().filter(move |record| nothing_else || !record.is_mute());
        counted.flat_map(RecordReport::needed)
    }

    pub(crate) fn is_proven(&self) -> bool {
        !self.records.is_empty() && self.needed().all(|standing| standing == Standing::Proven)
    }

    /// Whether all that counts is proven at least by the exporter's own chain, and something by that alone.
    pub(crate) fn is_self_sealed(&self) -> bool {
        let is_by_own_chain = |one| matches!(one, Standing::Proven | Standing::OwnChain);
        !self.records.is_empty() && !self.is_proven() && self.needed().all(is_by_own_chain)
    }
}
