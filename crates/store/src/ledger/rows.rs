//! A record's row, its states, and the names and places it is found by.

use std::collections::HashMap;
use std::os::unix::fs::MetadataExt as _;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{Ledger, Records};
use crate::crypto::SealedRecord;
use crate::crypto::merkle::Leaf;
use crate::model::RecordState::{
    self, Batched, Confirmed, Dropped, Mined, Quarantined, RightEnded, Stored, Submitted, Tampered, Verified,
};
use crate::model::bytes::hex;
use crate::model::header::TAG_LENGTH;
use crate::model::{
    Address, Digest, FilterId, Hash, Head, RecordKind, RecorderId, Signature, SignerId, Timestamp, TopicId, clean,
};
use crate::notes::LastPlace;
use crate::sql::{self, Connection, Row, Value};
use crate::{StoreError, snapshot};

/// The first hex characters of the digest.
const ID_LENGTH: usize = 16;

/// Of a record captured elsewhere.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Foreign {
    /// Its number belongs to this recorder.
    pub recorder: RecorderId,
    /// The account that anchors it instead of its owner.
    pub keeper: Address,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NewRecord {
    /// SM3 of the stored bytes.
    pub digest: Digest,
    pub owner: Address,
    pub topic_id: TopicId,
    /// Within (owner, signer, recorder, topic), from 1.
    pub seq: u64,
    /// `None` if recorded here and anchored by its owner.
    pub foreign: Option<Foreign>,
    pub epoch: u64,
    pub kind: RecordKind,
    pub signer: SignerId,
    /// r || s.
    pub signature: Signature,
    /// Of type and tags, as in its header.
    pub filters: Vec<FilterId>,
    /// In clear: the ledger never leaves the machine. Empty if only the owner knows it.
    pub topic: String,
    /// `package/Type`, or the hex of its filter id if only the owner knows it.
    pub type_name: String,
    /// Of the plaintext, or of the packed message if only the owner knows more.
    pub bytes: u64,
    pub captured_at: Timestamp,
    /// As far as known here.
    pub simulated: bool,
    /// [`RecordState::Stored`] or [`RecordState::Quarantined`].
    pub state: RecordState,
    /// Written in the commit of the row; `None` if erased before it came here.
    pub blob: Option<Vec<u8>>,
}

impl NewRecord {
    /// A record of this ledger, without the content of its head.
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
            state: RecordState::Stored,
            blob: Some(blob),
        }
    }

    /// A record that another ledger numbered.
    pub fn foreign(sealed: SealedRecord, keeper: Address) -> Self {
        let foreign = Some(Foreign { recorder: sealed.header.recorder, keeper });
        Self { foreign, ..Self::sealed(sealed) }
    }

    /// Adds the content of the opened head.
    pub fn named(self, head: &Head) -> Self {
        let (topic, type_name) = (head.topic.clone(), head.type_name.clone());
        Self { topic, type_name, bytes: head.plain_length, simulated: head.is_simulated(), ..self }
    }
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordRow {
    /// The first 16 hex characters of the digest.
    pub id: String,
    /// SM3 of the stored bytes.
    pub digest: Digest,
    pub owner: Address,
    /// `seq` belongs to it.
    pub recorder: RecorderId,
    pub topic_id: TopicId,
    /// Within (owner, signer, recorder, topic), from 1.
    pub seq: u64,
    pub epoch: u64,
    pub kind: RecordKind,
    pub signer: SignerId,
    /// r || s.
    pub signature: Signature,
    pub topic: String,
    /// `package/Type`.
    #[serde(rename = "type")]
    pub type_name: String,
    /// Of the plaintext, or of the packed message if this site cannot open it.
    pub bytes: u64,
    pub captured_at: Timestamp,
    pub acknowledged_at: Timestamp,
    pub simulated: bool,
    pub state: RecordState,
    /// Sent, or seen in a block.
    pub transaction: Option<Hash>,
    pub block: Option<u64>,
    pub block_hash: Option<Hash>,
    /// Deletion of the ciphertext.
    pub deleted_at: Option<Timestamp>,
}

/// Shared by its records.
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

/// No ROS name begins like this.
const UNNAMED: &str = "id:";

/// Name, learned name (needs [`LEARNED_NAME`]) or pseudonym of topic `t`.
pub(super) const TOPIC_NAME: &str = "coalesce(nullif(t.name, ''), topic_name.name, 'id:' || lower(hex(t.topic_id)))";
/// Joins the learned name of a topic `t` that arrived without one.
pub(super) const LEARNED_NAME: &str =
    "LEFT JOIN names topic_name ON topic_name.owner = t.owner AND topic_name.id = lower(hex(t.topic_id))";

pub(super) enum Which {
    /// As many as combinations of topic, type and signer.
    All,
    Of(Address),
    Key(i64),
}

pub(super) fn streams(connection: &Connection, which: &Which) -> Result<Vec<Stream>, StoreError> {
    let (condition, value): (&str, Option<Value>) = match which {
        Which::All => ("", None),
        Which::Of(owner) => (" WHERE t.owner = ?1", Some(Value::Blob(&owner.0))),
        Which::Key(key) => (" WHERE s.key = ?1", Some(Value::Integer(*key))),
    };
    let sql = format!(
        "SELECT s.key, t.owner, r.id, t.topic_id, {TOPIC_NAME}, s.kind, coalesce(type_name.name, s.type_name), r.signer
            FROM streams s JOIN topics t ON t.key = s.topic JOIN recorders r ON r.key = t.recorder {LEARNED_NAME}
            LEFT JOIN names type_name ON type_name.owner = t.owner AND type_name.id = s.type_name{condition}"
    );
    Ok(connection.list(&sql, value, |row| {
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
    })?)
}

pub(super) fn all_streams(connection: &Connection) -> Result<HashMap<i64, Stream>, StoreError> {
    Ok(by_key(streams(connection, &Which::All)?))
}

pub(super) fn by_key(streams: Vec<Stream>) -> HashMap<i64, Stream> {
    streams.into_iter().map(|stream| (stream.key, stream)).collect()
}

/// Costs the same however many streams there are.
pub(super) fn keyed_streams(
    connection: &Connection,
    keys: impl IntoIterator<Item = i64>,
) -> Result<HashMap<i64, Stream>, StoreError> {
    let mut found = HashMap::new();
    for key in keys {
        if !found.contains_key(&key) {
            found.extend(by_key(streams(connection, &Which::Key(key))?));
        }
    }
    Ok(found)
}

impl RecordRow {
    pub fn is_named(&self) -> bool {
        !self.topic.starts_with(UNNAMED)
    }

    pub fn unnamed(topic: TopicId) -> String {
        format!("{UNNAMED}{topic}")
    }

    pub fn leaf(&self) -> Leaf {
        let Self { owner, signer, recorder, topic_id, seq, digest, .. } = *self;
        Leaf { owner, signer, recorder, topic_id, seq, digest }
    }
}

/// A column of the record's batch; NULL without one.
macro_rules! of_its_batch {
    ($column:literal) => {
        concat!(
            "(SELECT batches.",
            $column,
            " FROM leaves JOIN batches ON batches.key = leaves.batch WHERE leaves.record = records.n)"
        )
    };
}

/// A column of the record's own transaction, or else of its batch's.
macro_rules! anchored {
    ($column:literal) => {
        concat!("CASE WHEN records.tx IS NULL THEN ", of_its_batch!($column), " ELSE records.", $column, " END")
    };
}
pub(super) use {anchored, of_its_batch};

/// Of [`record`].
pub(super) const COLUMNS: &str = concat!(
    "records.stream, records.digest, records.seq, records.epoch, records.signature, records.bytes,
     records.captured_at, records.acknowledged_at, records.simulated, records.state, ",
    anchored!("tx"),
    ", ",
    anchored!("block"),
    ", ",
    anchored!("block_hash"),
    ", records.deleted_at"
);

pub(super) fn record(row: &Row<'_>, streams: &HashMap<i64, Stream>) -> sql::Result<RecordRow> {
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
        captured_at: time(row, 6)?,
        acknowledged_at: time(row, 7)?,
        simulated: row.get(8)?,
        state: state(row, 9)?,
        transaction: row.get::<Option<_>>(10)?.map(Hash),
        block: optional(row, 11)?,
        block_hash: row.get::<Option<_>>(12)?.map(Hash),
        deleted_at: optional(row, 13)?.map(Timestamp),
    })
}

/// From 0 to 2^63 - 1.
pub(crate) fn unsigned(row: &Row<'_>, column: usize) -> sql::Result<u64> {
    row.get(column).map(i64::cast_unsigned)
}

pub(crate) fn time(row: &Row<'_>, column: usize) -> sql::Result<Timestamp> {
    unsigned(row, column).map(Timestamp)
}

/// `None` for NULL.
pub(super) fn optional(row: &Row<'_>, column: usize) -> sql::Result<Option<u64>> {
    row.get::<Option<i64>>(column).map(|value| value.map(i64::cast_unsigned))
}

pub(super) fn state(row: &Row<'_>, column: usize) -> sql::Result<RecordState> {
    RecordState::from_code(row.get(column)?).ok_or_else(|| out_of_range(column))
}

/// For a code that no version of this program wrote.
pub(super) fn out_of_range(column: usize) -> sql::Error {
    sql::Error::altered(column, "has a value that no version of this program writes")
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum By {
    Worker,
    Batch,
    Submit,
    /// The transaction failed or was replaced.
    Close,
    /// The watcher found the anchor.
    Sight,
    Confirm,
    Reorg,
    /// A gateway accepted the record or decided about it.
    Gateway,
    /// Decides about quarantine.
    Operator,
    /// A right ended, returned, or was missing at the anchor.
    Right,
}

/// From any of the first states to any of the second.
const EDGES: [(&[RecordState], &[RecordState], By); 15] = [
    (&[Stored], &[Quarantined], By::Worker),
    (&[Confirmed], &[Verified], By::Worker),
    (&[Stored, Batched, Submitted, Mined, Confirmed, Verified, Quarantined, RightEnded], &[Tampered], By::Worker),
    (&[Stored], &[Batched], By::Batch),
    (&[Quarantined], &[Stored, Dropped], By::Operator),
    (&[Stored, Batched], &[Submitted], By::Submit),
    (&[Submitted], &[Stored, Batched], By::Close),
    (&[Stored, Batched, Submitted, RightEnded], &[Mined], By::Sight),
    (&[Mined], &[Confirmed], By::Confirm),
    (&[Mined], &[Submitted, Batched, Stored], By::Reorg),
    (&[Confirmed, Verified], &[Mined, Submitted, Batched, Stored], By::Reorg),
    (&[Stored], &[Submitted], By::Gateway),
    (&[Submitted], &[Stored, Verified, Tampered], By::Gateway),
    (&[Stored], &[RightEnded], By::Right),
    (&[Batched, Confirmed, RightEnded], &[Stored], By::Right),
];

/// By anyone, in one step.
pub fn is_legal(from: RecordState, to: RecordState) -> bool {
    EDGES.iter().any(|(before, after, _)| before.contains(&from) && after.contains(&to))
}

/// Refuses a transition that `by` may not make.
pub(super) fn check(by: By, from: RecordState, to: RecordState) -> Result<(), StoreError> {
    if may(by, from, to) { Ok(()) } else { Err(StoreError::IllegalEdge { from, to }) }
}

pub(super) fn may(by: By, from: RecordState, to: RecordState) -> bool {
    EDGES.iter().any(|(before, after, who)| *who == by && before.contains(&from) && after.contains(&to))
}

impl Records {
    pub fn find(&self, digest: Digest) -> Result<Option<RecordRow>, StoreError> {
        Ok(self.find_all(&[digest])?.pop().flatten())
    }

    /// In order, as of one moment.
    pub fn find_all(&self, digests: &[Digest]) -> Result<Vec<Option<RecordRow>>, StoreError> {
        self.0.read(|connection| rows_of(connection, digests))
    }

    /// `id`: 4 to 64 hex characters.
    pub fn by_id(&self, id: &str) -> Result<Option<RecordRow>, StoreError> {
        let (low, high) = bounds(id).ok_or_else(|| StoreError::Id(clean(id, 70)))?;
        self.0.read(|connection| {
            let sql = format!("SELECT {COLUMNS} FROM records WHERE digest BETWEEN ?1 AND ?2 LIMIT 2");
            let found: Vec<i64> = connection.list(&sql, [low.0, high.0], |row| row.get(0))?;
            let by_key = keyed_streams(connection, found)?;
            let mut found: Vec<RecordRow> = connection.list(&sql, [low.0, high.0], |row| record(row, &by_key))?;
            if found.len() > 1 { Err(StoreError::Ambiguous(id.to_owned())) } else { Ok(found.pop()) }
        })
    }
}

/// In order.
pub(super) fn rows_of(connection: &Connection, digests: &[Digest]) -> Result<Vec<Option<RecordRow>>, StoreError> {
    let mut find = connection.prepared(&format!("SELECT {COLUMNS} FROM records WHERE digest = ?1"))?;
    let mut by_key = HashMap::new();
    let one = |digest: &Digest| {
        let mut found = None;
        find.each_while([digest.0], |row| {
            let key = row.get(0)?;
            if !by_key.contains_key(&key) {
                by_key.extend(keyed_streams(connection, [key])?);
            }
            found = Some(record(row, &by_key)?);
            Ok::<_, StoreError>(false)
        })?;
        Ok(found)
    };
    digests.iter().map(one).collect()
}

const SHORTEST_ID: usize = 4;

fn bounds(id: &str) -> Option<(Digest, Digest)> {
    let whole = Digest::LENGTH * 2;
    let valid = (SHORTEST_ID..=whole).contains(&id.len()) && id.bytes().all(|b| b.is_ascii_hexdigit());
    let fill = |digit: &str| format!("{id}{}", digit.repeat(whole - id.len())).parse().ok();
    if valid { fill("0").zip(fill("f")) } else { None }
}

// A copy opened elsewhere becomes a ledger of its own, like a restored one, so that no number is used twice.

/// See machine-id(5).
const MACHINE: &str = "/etc/machine-id";

impl Ledger {
    /// Says whether the file is a copy: another inode or machine than when last opened. A copy gets a new recorder and
    /// notes how far the chain was known.
    pub fn open_in_place(path: &Path) -> Result<(Self, bool), StoreError> {
        let ledger = Self::open(path)?;
        let here = place(path)?;
        let copied = match ledger.notes.read(&LastPlace {})? {
            Some(there) if there == here => return Ok((ledger, false)),
            there => there.is_some(),
        };
        if !copied {
            ledger.notes.write(&LastPlace {}, &here)?;
            return Ok((ledger, false));
        }
        ledger.close()?;
        snapshot::renew_ledger(path)?;
        let ledger = Self::open(path)?;
        ledger.notes.write(&LastPlace {}, &here)?;
        Ok((ledger, true))
    }
}

/// Machine and inode, which differ for a copy.
fn place(path: &Path) -> Result<String, StoreError> {
    let about = std::fs::metadata(path).map_err(|error| StoreError::home(path, &error))?;
    let machine = std::fs::read_to_string(MACHINE).unwrap_or_default();
    Ok(format!("{} {}", clean(machine.trim(), 64), about.ino()))
}

#[cfg(test)]
mod edges_tests {
    use super::*;

    #[test]
    fn edges_are_distinct_and_leave_no_state_stuck() {
        let edges: Vec<_> = EDGES
            .iter()
            .flat_map(|(before, after, by)| {
                before.iter().flat_map(move |from| after.iter().map(move |to| (from, to, by)))
            })
            .collect();
        for (index, edge) in edges.iter().enumerate() {
            assert!(!edges[..index].contains(edge), "{edge:?}");
            assert_ne!(edge.0, edge.1);
        }
        assert_eq!(edges.len(), 41);
        for state in [Stored, Batched, Submitted, Mined, Confirmed] {
            assert!(edges.iter().any(|(from, to, _)| **from == state && **to > state && **to <= Verified), "{state:?}");
        }
    }

    #[test]
    fn nobody_verifies_by_leaping() {
        for &state in RecordState::ALL {
            assert_eq!(is_legal(state, Verified), matches!(state, Confirmed | Submitted));
            assert_eq!(may(By::Gateway, state, Verified), state == Submitted);
            assert_eq!(may(By::Worker, state, Verified), state == Confirmed);
        }
        assert!(!may(By::Worker, Quarantined, Stored) && !is_legal(Quarantined, Batched) && !is_legal(Dropped, Stored));
        assert!(!is_legal(RightEnded, Batched) && !is_legal(RightEnded, Submitted), "nobody here anchors it");
        assert!(!may(By::Worker, Stored, Submitted) && !may(By::Worker, Submitted, Mined));
    }
}

#[cfg(test)]
mod place_tests {
    use super::*;
    use crate::NewRecord;
    use crate::ledger::tests::record;
    use crate::model::{Address, Digest, SignerId, TopicId};

    #[test]
    fn a_copy_that_is_opened_elsewhere_numbers_under_a_recorder_of_its_own() {
        let home = tempfile::tempdir().expect("a folder");
        let (path, copy) = (home.path().join("ledger.db"), home.path().join("copy.db"));
        let (ledger, copied) = Ledger::open_in_place(&path).expect("made");
        let recorder = ledger.records.recorder();
        assert!(!copied);
        let (owner, signer) = (Address([1; 20]), SignerId([1; 32]));
        ledger.records.append(vec![record(1, 1, 1)]).expect("recorded");
        ledger.close().expect("closed");
        std::fs::copy(&path, &copy).expect("copied");
        let (ledger, copied) = Ledger::open_in_place(&path).expect("opened again");
        assert!(!copied && ledger.records.recorder() == recorder, "the first is as it was");
        assert_eq!(ledger.counts.predecessor(owner, signer).expect("read"), None);
        let (other, copied) = Ledger::open_in_place(&copy).expect("the copy is opened");
        assert!(copied && other.records.recorder() != recorder);
        let before = recorder.of_signer(&signer);
        assert_eq!(other.counts.predecessor(owner, signer).expect("read"), Some(before), "it says whose copy it is");
        assert_eq!(other.records.next_seq(owner, signer, TopicId([1; 16])), Ok(1), "and numbers anew");
        other.records.append(vec![NewRecord { digest: Digest([9; 32]), ..record(1, 1, 1) }]).expect("recorded");
        assert_eq!(other.counts.predecessor(owner, signer).expect("read"), Some(before));
        let renewed = other.records.recorder();
        other.close().expect("closed");
        let (other, copied) = Ledger::open_in_place(&copy).expect("the copy is opened again");
        assert!(!copied && other.records.recorder() == renewed, "once is enough");
    }

    #[test]
    fn one_of_before_that_names_no_place_stays_what_it_is() {
        let home = tempfile::tempdir().expect("a folder");
        let path = home.path().join("ledger.db");
        let ledger = Ledger::open(&path).expect("made as before");
        let recorder = ledger.records.recorder();
        ledger.close().expect("closed");
        let (ledger, copied) = Ledger::open_in_place(&path).expect("opened");
        assert!(!copied && ledger.records.recorder() == recorder);
    }

    #[test]
    fn a_moved_file_is_no_copy() {
        let home = tempfile::tempdir().expect("a folder");
        let (path, moved) = (home.path().join("ledger.db"), home.path().join("moved.db"));
        let (ledger, _) = Ledger::open_in_place(&path).expect("made");
        let recorder = ledger.records.recorder();
        ledger.close().expect("closed");
        std::fs::rename(&path, &moved).expect("moved");
        let (ledger, copied) = Ledger::open_in_place(&moved).expect("opened");
        assert!(!copied && ledger.records.recorder() == recorder);
    }
}
