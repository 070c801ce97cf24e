//! The input and output of the ledger, one record at a time.

use std::collections::HashMap;

use rusqlite::types::Value;
use rusqlite::{Connection, Row, params_from_iter};
use serde::{Deserialize, Serialize};

use crate::chain::merkle::Leaf;
use crate::crypto::SealedRecord;
use crate::model::bytes::hex;
use crate::model::header::TAG_LENGTH;
use crate::model::{
    Address, Digest, FilterId, Hash, Head, RecordKind, RecordState, RecorderId, Signature, SignerId, Timestamp, TopicId,
};
use crate::store::StoreError;

/// Characters of a record id: the first 16 hex characters of its digest.
const ID_LENGTH: usize = 16;

/// The origin of a record that was not captured here.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Foreign {
    /// The recorder that its number belongs to.
    pub recorder: RecorderId,
    /// The account that anchors it instead of its owner.
    pub keeper: Address,
}

/// A sealed record to be acknowledged.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NewRecord {
    /// SM3 of the stored bytes.
    pub digest: Digest,
    /// The owner.
    pub owner: Address,
    /// Pseudonym of its topic.
    pub topic_id: TopicId,
    /// Number within (owner, signer, recorder, topic), from 1.
    pub seq: u64,
    /// `None` if this ledger recorded it and its owner anchors it.
    pub foreign: Option<Foreign>,
    /// The epoch it is sealed under.
    pub epoch: u64,
    /// The kind of record.
    pub kind: RecordKind,
    /// The signer.
    pub signer: SignerId,
    /// The raw signature, r || s.
    pub signature: Signature,
    /// Ids of type and tags, as in its header.
    pub filters: Vec<FilterId>,
    /// Topic name, in clear: the ledger never leaves the machine. Empty if only the owner knows it.
    pub topic: String,
    /// Message type, `package/Type`; the hex of its filter id if only the owner knows it.
    pub type_name: String,
    /// Length of the plaintext, bytes; of the packed message if only the owner knows more.
    pub bytes: u64,
    /// When it was captured.
    pub captured_at: Timestamp,
    /// Whether a simulated robot sent it, as far as known here.
    pub simulated: bool,
    /// [`RecordState::Sealed`], [`RecordState::Stored`] or [`RecordState::Quarantined`].
    pub state: RecordState,
    /// The stored bytes, if they are not durable in the vault yet.
    pub local_copy: Option<Vec<u8>>,
}

impl NewRecord {
    /// A record of this ledger as sealed, with its bytes; the content of its head is not known yet.
    pub fn sealed(sealed: SealedRecord) -> Self {
        let SealedRecord { header, blob, digest, signature } = sealed;
        Self {
            digest,
            owner: header.owner,
            topic_id: header.topic_id,
            seq: header.seq,
            foreign: None,
            epoch: header.epoch,
            kind: header.kind,
            signer: header.signer,
            signature,
            topic: String::new(),
            // The first filter id is the type's.
            type_name: header.filters.first().map(|id| hex(&id.0)).unwrap_or_default(),
            filters: header.filters,
            bytes: header.body_length.saturating_sub(TAG_LENGTH as u64),
            captured_at: header.captured_at,
            simulated: false,
            state: RecordState::Sealed,
            local_copy: Some(blob),
        }
    }

    /// Like [`Self::sealed`], for a record that another ledger numbered; `keeper` anchors it.
    pub fn foreign(sealed: SealedRecord, keeper: Address) -> Self {
        let foreign = Some(Foreign { recorder: sealed.header.recorder, keeper });
        Self { foreign, ..Self::sealed(sealed) }
    }

    /// Adds the content of its head, for callers that sealed or opened it.
    pub fn named(self, head: &Head) -> Self {
        let (topic, type_name) = (head.topic.clone(), head.type_name.clone());
        Self { topic, type_name, bytes: head.plain_length, simulated: head.is_simulated(), ..self }
    }
}

/// A record as the ledger knows it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordRow {
    /// Short name: the first 16 hex characters of the digest.
    pub id: String,
    /// SM3 of the stored bytes.
    pub digest: Digest,
    /// The owner.
    pub owner: Address,
    /// The recorder that `seq` belongs to.
    pub recorder: RecorderId,
    /// Pseudonym of its topic.
    pub topic_id: TopicId,
    /// Number within (owner, signer, recorder, topic), from 1.
    pub seq: u64,
    /// The epoch it is sealed under.
    pub epoch: u64,
    /// The kind of record.
    pub kind: RecordKind,
    /// The signer.
    pub signer: SignerId,
    /// The raw signature, r || s.
    pub signature: Signature,
    /// Topic name.
    pub topic: String,
    /// Message type, `package/Type`.
    #[serde(rename = "type")]
    pub type_name: String,
    /// Length of the plaintext, bytes; of the packed message if this site cannot open it.
    pub bytes: u64,
    /// When it was captured.
    pub captured_at: Timestamp,
    /// When it was written to disk here.
    pub acknowledged_at: Timestamp,
    /// Whether a simulated robot sent it.
    pub simulated: bool,
    /// Its state.
    pub state: RecordState,
    /// The transaction that anchors it: sent, or seen in a block.
    pub transaction: Option<Hash>,
    /// The block it was seen in.
    pub block: Option<u64>,
    /// That block's hash.
    pub block_hash: Option<Hash>,
    /// When retention deleted its ciphertext.
    pub deleted_at: Option<Timestamp>,
}

/// What all records of one stream share: owner, topic, kind, type, signer.
#[derive(Debug, Clone)]
pub(super) struct Stream {
    pub key: i64,
    pub owner: Address,
    pub recorder: RecorderId,
    pub topic_id: TopicId,
    pub topic: String,
    pub kind: RecordKind,
    pub type_name: String,
    pub signer: SignerId,
}

/// Prefix of the pseudonym of a topic whose name is not known here; no ROS name begins like this.
const UNNAMED: &str = "id:";

/// A topic `t` by its name, by the one that was learned (with [`LEARNED_NAME`] joined), or by its pseudonym.
pub(super) const TOPIC_NAME: &str = "coalesce(nullif(t.name, ''), topic_name.name, 'id:' || lower(hex(t.topic_id)))";
/// What was learned of a topic `t` that arrived without its name, as those that only robots recorded.
pub(super) const LEARNED_NAME: &str =
    "LEFT JOIN names topic_name ON topic_name.owner = t.owner AND topic_name.id = lower(hex(t.topic_id))";

/// A selection of streams.
pub(super) enum Which {
    /// All; as many as there are combinations of topic, type and signer, not records.
    All,
    /// One owner's.
    Of(Address),
    /// The one with this key.
    Key(i64),
}

/// The selected streams.
pub(super) fn streams(connection: &Connection, which: &Which) -> Result<Vec<Stream>, StoreError> {
    let (condition, value): (&str, Option<Value>) = match which {
        Which::All => ("", None),
        Which::Of(owner) => (" WHERE t.owner = ?1", Some(Value::from(owner.0.to_vec()))),
        Which::Key(key) => (" WHERE s.key = ?1", Some(Value::from(*key))),
    };
    let mut statement = connection.prepare_cached(&format!(
        "SELECT s.key, t.owner, r.id, t.topic_id, {TOPIC_NAME}, s.kind, coalesce(type_name.name, s.type_name), r.signer
         FROM streams s JOIN topics t ON t.key = s.topic JOIN recorders r ON r.key = t.recorder {LEARNED_NAME}
         LEFT JOIN names type_name ON type_name.owner = t.owner AND type_name.id = s.type_name{condition}"
    ))?;
    let rows = statement.query_map(params_from_iter(value), |row| {
        Ok(Stream {
            key: row.get(0)?,
            owner: Address(row.get(1)?),
            recorder: RecorderId(row.get(2)?),
            topic_id: TopicId(row.get(3)?),
            topic: row.get(4)?,
            kind: RecordKind::from_code(row.get(5)?).ok_or_else(|| out_of_range(5))?,
            type_name: row.get(6)?,
            signer: SignerId(row.get(7)?),
        })
    })?;
    Ok(rows.collect::<Result<_, _>>()?)
}

/// The streams with these keys, by key: looking up a few records costs the same however many streams there are.
pub(super) fn keyed_streams(
    connection: &Connection,
    keys: impl IntoIterator<Item = i64>,
) -> Result<HashMap<i64, Stream>, StoreError> {
    let mut found = HashMap::new();
    for key in keys {
        if !found.contains_key(&key) {
            found.extend(streams(connection, &Which::Key(key))?.into_iter().map(|stream| (stream.key, stream)));
        }
    }
    Ok(found)
}

/// Makes the stream of a row with [`COLUMNS`] known, unless it is.
pub(super) fn learn_stream(
    connection: &Connection,
    row: &Row<'_>,
    streams: &mut HashMap<i64, Stream>,
) -> Result<(), StoreError> {
    let key: i64 = row.get(0)?;
    if !streams.contains_key(&key) {
        streams.extend(keyed_streams(connection, [key])?);
    }
    Ok(())
}

impl RecordRow {
    /// Whether its topic's name is known here; otherwise the pseudonym takes its place.
    pub fn is_named(&self) -> bool {
        !self.topic.starts_with(UNNAMED)
    }

    /// The placeholder for a topic's name that is not known.
    pub fn unnamed(topic: TopicId) -> String {
        format!("{UNNAMED}{topic}")
    }

    /// The fields that its batch binds.
    pub fn leaf(&self) -> Leaf {
        let Self { owner, signer, recorder, topic_id, seq, digest, .. } = *self;
        Leaf { owner, signer, recorder, topic_id, seq, digest }
    }
}

/// Columns of [`record`], in order.
pub(super) const COLUMNS: &str = "stream, digest, seq, epoch, signature, bytes, captured_at, acknowledged_at,
    simulated, state, tx, block, block_hash, deleted_at";

/// The record of a row with [`COLUMNS`].
pub(super) fn record(row: &Row<'_>, streams: &HashMap<i64, Stream>) -> rusqlite::Result<RecordRow> {
    let stream = streams.get(&row.get(0)?).ok_or_else(|| out_of_range(0))?;
    let digest = Digest(row.get(1)?);
    Ok(RecordRow {
        id: digest.to_hex().chars().take(ID_LENGTH).collect(),
        digest,
        owner: stream.owner,
        recorder: stream.recorder,
        topic_id: stream.topic_id,
        seq: unsigned(row, 2)?,
        epoch: unsigned(row, 3)?,
        kind: stream.kind,
        signer: stream.signer,
        signature: Signature(row.get(4)?),
        topic: stream.topic.clone(),
        type_name: stream.type_name.clone(),
        bytes: unsigned(row, 5)?,
        captured_at: Timestamp(unsigned(row, 6)?),
        acknowledged_at: Timestamp(unsigned(row, 7)?),
        simulated: row.get(8)?,
        state: state(row, 9)?,
        transaction: row.get::<_, Option<_>>(10)?.map(Hash),
        block: row.get::<_, Option<i64>>(11)?.map(i64::cast_unsigned),
        block_hash: row.get::<_, Option<_>>(12)?.map(Hash),
        deleted_at: row.get::<_, Option<i64>>(13)?.map(|at| Timestamp(at.cast_unsigned())),
    })
}

/// A column that holds a number from 0 to 2^63 - 1.
pub(super) fn unsigned(row: &Row<'_>, column: usize) -> rusqlite::Result<u64> {
    row.get(column).map(i64::cast_unsigned)
}

/// A column that holds a state's code.
pub(super) fn state(row: &Row<'_>, column: usize) -> rusqlite::Result<RecordState> {
    RecordState::from_code(row.get(column)?).ok_or_else(|| out_of_range(column))
}

/// The error for a code that no version of this program wrote.
pub(super) fn out_of_range(column: usize) -> rusqlite::Error {
    rusqlite::Error::IntegralValueOutOfRange(column, -1)
}
