//! The verdict on a bundle: for each record, level by level, what is proven and what is not. There is no single tick.

use std::collections::BTreeMap;

use authros_crypto::record::Revealed;
use authros_model::{Address, Birth, Digest, Heads, RecorderId, SignerId, Timestamp, TopicId};
use serde::Serialize;

use crate::heights::TOPIC;

/// How far a level goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Standing {
    /// It follows from the bytes and from what was pinned.
    Proven,
    /// It holds by the word of the exporter's own chain: it proves nothing against him.
    OwnChain,
    /// Nothing contradicts it, and something that would prove it is missing.
    Unproven,
    /// Nobody claims it.
    Absent,
    /// It is contradicted.
    Refused,
}

impl Standing {
    /// As told to people.
    pub fn word(self) -> &'static str {
        match self {
            Self::Proven => "proven",
            Self::OwnChain => "own chain",
            Self::Unproven => "not proven",
            Self::Absent => "absent",
            Self::Refused => "REFUSED",
        }
    }
}

/// One level of one record.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Level {
    /// How far it goes.
    pub standing: Standing,
    /// Why, in words.
    pub text: String,
}

impl Level {
    /// A level.
    pub fn new(standing: Standing, text: impl Into<String>) -> Self {
        Self { standing, text: text.into() }
    }
}

/// What is said of one record.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct RecordReport {
    /// SM3 of it.
    pub digest: Digest,
    /// Its owner, as its header says.
    pub owner: Option<Address>,
    /// Who that is, as it was pinned, where the key is shown to be his.
    pub person: Option<String>,
    /// SM3 of the key that signed it.
    pub signer: Option<SignerId>,
    /// SM3 of the key that its owner had registered, where a state that is believed shows it.
    pub owner_key: Option<SignerId>,
    /// The ledger that numbered it.
    pub recorder: Option<RecorderId>,
    /// Its topic's pseudonym.
    pub topic_id: Option<TopicId>,
    /// Its number.
    pub seq: Option<u64>,
    /// When it was captured, by its owner's word alone.
    pub captured_at: Option<Timestamp>,
    /// The anchoring block's time, by the clock of whoever sealed it.
    pub anchored_at: Option<Timestamp>,
    /// The anchoring block.
    pub block: Option<u64>,
    /// Seconds from the claimed capture to the anchor; less than zero where the claim is later.
    pub seconds_to_anchor: Option<i64>,
    /// Before when it existed, by an authority that was pinned.
    pub existed_before: Option<Timestamp>,
    /// (a) The bytes are intact and signed.
    pub bytes: Level,
    /// (b) The key was the owner's to sign with.
    pub key: Level,
    /// (c) It is anchored.
    pub anchor: Level,
    /// (d) An outside authority's time.
    pub time: Level,
    /// (e) It is opened by its owner's disclosure.
    pub opened: Level,
    /// What was disclosed.
    pub disclosed: Option<Disclosed>,
}

impl RecordReport {
    /// Whether the key that signed it is shown to be its owner's, by pinned signers or by the exporter's own chain.
    pub fn is_believed(&self) -> bool {
        matches!(self.key.standing, Standing::Proven | Standing::OwnChain)
    }

    /// Whether it opened as what a recorder states of itself for completeness; bundles add these to what was chosen.
    pub fn is_statement(&self) -> bool {
        let types = [Birth::TYPE, Heads::TYPE];
        self.disclosed.as_ref().is_some_and(|facts| facts.topic == TOPIC && types.contains(&facts.type_name.as_str()))
    }

    /// The standings that a bundle needs of it.
    fn needed(&self) -> [Standing; 3] {
        [&self.bytes, &self.key, &self.anchor].map(|level| level.standing)
    }

    /// Whether it is a statement of which something is merely not proven: it says nothing then, and denies nothing.
    pub(crate) fn is_mute(&self) -> bool {
        let needed = self.needed();
        self.is_statement() && needed.contains(&Standing::Unproven) && !needed.contains(&Standing::Refused)
    }

    /// Its levels by their letters.
    pub fn levels(&self) -> [(char, &Level); 5] {
        [('a', &self.bytes), ('b', &self.key), ('c', &self.anchor), ('d', &self.time), ('e', &self.opened)]
    }
}

/// What a disclosed record says of itself.
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

/// (f) The records of one topic by one recorder.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Stretch {
    /// Whose.
    pub owner: Address,
    /// The ledger.
    pub recorder: RecorderId,
    /// The topic.
    pub topic_id: TopicId,
    /// How far it goes: no further than the signers of its records are shown.
    pub standing: Standing,
    /// The first number in the bundle; `None` if no record's signer is proven.
    pub first: Option<u64>,
    /// The last.
    pub last: Option<u64>,
    /// Numbers between them that are not there, from and to.
    pub gaps: Vec<(u64, u64)>,
    /// How many numbers are missing.
    pub missing: u64,
    /// Records that are not counted, because nothing proves whose key signed them.
    pub uncounted: u64,
    /// Numbers that two different records have: their signer told two histories.
    pub twice: Vec<u64>,
    /// What the newest believed head of its recorder says of it.
    pub heads: Option<HeadsClaim>,
    /// When the recorder's birth was anchored, where that is in the bundle.
    pub born_at: Option<Timestamp>,
    /// The recorder that it follows, after a restore, as its birth says.
    pub predecessor: Option<RecorderId>,
    /// In words.
    pub text: String,
}

/// What a recorder said of a topic at a time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct HeadsClaim {
    /// The record of the head.
    pub record: Digest,
    /// The highest number of the topic.
    pub number: u64,
    /// When the head was anchored, by the clock of whoever sealed the block.
    pub at: Option<Timestamp>,
}

/// What it all comes to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// Levels (a) to (c) are proven for every record, by what was pinned.
    Holds,
    /// Something is not proven, or holds by the exporter's own chain alone.
    Incomplete,
    /// Something is contradicted.
    Refused,
}

/// The verdict.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Report {
    /// What it all comes to.
    pub outcome: Outcome,
    /// Whether a trust file was given.
    pub pinned: bool,
    /// Who made the bundle.
    pub exporter: Level,
    /// What has to be known beside the levels.
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
    /// The standings of (a) to (c) of all records; a statement that says nothing counts only where nothing else is there.
    pub(crate) fn needed(&self) -> impl Iterator<Item = Standing> {
        let nothing_else = self.records.iter().all(RecordReport::is_mute);
        let counted = self.records.iter().filter(move |record| nothing_else || !record.is_mute());
        counted.flat_map(RecordReport::needed)
    }

    /// The last line for people.
    pub fn last_line(&self) -> &'static str {
        let by_own_chain = || self.needed().all(|one| matches!(one, Standing::Proven | Standing::OwnChain));
        match self.outcome {
            Outcome::Holds => "levels (a) to (c) hold for every record, by what you pinned; read the notes",
            Outcome::Incomplete if !self.records.is_empty() && by_own_chain() => {
                "holds by the exporter's own chain alone, which proves nothing against him"
            }
            Outcome::Incomplete => "NOT ALL IS PROVEN: the levels say what is not",
            Outcome::Refused => "REFUSED: something is contradicted; the levels say what",
        }
    }
}
