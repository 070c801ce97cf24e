//! Acknowledging records with their ciphertext, and changing their state.

use std::collections::hash_map::Entry;
use std::collections::{HashMap, HashSet};

use super::rows::{By, check, optional};
use super::{Foreign, NewRecord, Records, Session, own_prefix};
use crate::StoreError;
use crate::database::whole;
use crate::model::header::LARGEST_SEQ;
use crate::model::{Address, Digest, FilterId, RecordKind, RecordState, SignerId, Timestamp, TopicId};
use crate::sql::{Connection, params};

type StreamKey = (i64, u8, String);
type TopicKey = (Address, SignerId, TopicId, Option<Foreign>);

/// More than a gateway of a hundred robots has.
const MOST_NAMES: usize = 65_536;

/// A cache of the tables.
#[derive(Default)]
pub(crate) struct KnownNames {
    topics: HashMap<TopicKey, (i64, String)>,
    streams: HashMap<StreamKey, i64>,
    filters: HashMap<FilterId, i64>,
    filter_streams: HashSet<(i64, i64)>,
}

impl KnownNames {
    /// Every new value of a tag is one more name, for as long as the file is open.
    pub fn bound(&mut self) {
        if self.topics.len() + self.streams.len() + self.filters.len() + self.filter_streams.len() > MOST_NAMES {
            *self = Self::default();
        }
    }
}

impl Records {
    /// The signer's highest number for a topic in this ledger, plus 1; records from elsewhere do not count.
    pub fn next_seq(&self, owner: Address, signer: SignerId, topic: TopicId) -> Result<u64, StoreError> {
        let recorder = self.0.shared.recorder.of_signer(&signer);
        self.0.read(|connection| {
            let sql = "SELECT max(seq) FROM records WHERE topic =
                (SELECT key FROM topics WHERE owner = ?1 AND topic_id = ?2 AND keeper IS NULL
                 AND recorder = (SELECT key FROM recorders WHERE id = ?3 AND signer = ?4))";
            let values = params![owner.0, topic.0, recorder.0, signer.0];
            Ok(connection.one(sql, values, |row| optional(row, 0))?.map_or(1, |seq| seq + 1))
        })
    }

    /// All records are durable on return, or none. Known records do not change.
    pub fn append(&self, records: Vec<NewRecord>) -> Result<(), StoreError> {
        self.0.takes_records()?;
        self.0.write_many(records.len(), move |session| {
            let now = whole("time", Timestamp::now().0)?;
            records.iter().try_for_each(|record| add(session, record, now))
        })
    }

    /// Moves only records in state `from`; returns how many.
    pub fn advance(&self, digests: &[Digest], from: RecordState, to: RecordState) -> Result<u64, StoreError> {
        check(By::Worker, from, to)?;
        let sql = "UPDATE records SET state = ?3 WHERE digest = ?1 AND state = ?2";
        self.0.held().run_each(sql, digests.iter().map(|digest| (digest.0, from.code(), to.code())).collect())
    }
}

/// `false` for a record of this ledger's own that came back; else own recorders are only for records made here.
fn check_number(connection: &Connection, record: &NewRecord) -> Result<bool, StoreError> {
    let refused = |detail: String| Err(StoreError::Conflict { digest: record.digest, detail });
    if !(1..=LARGEST_SEQ).contains(&record.seq) {
        return refused(format!("its number {} is not one of 1 to 2^40", record.seq));
    }
    let Some(foreign) = record.foreign else { return Ok(true) };
    if !own_prefix(connection)?.has(&foreign.recorder) {
        return Ok(true);
    }
    if connection.has("SELECT 1 FROM records WHERE digest = ?1", [record.digest.0])? {
        return Ok(false);
    }
    refused("it came from elsewhere and carries a recorder id of this ledger".to_owned())
}

pub(super) fn add(session: &mut Session<'_>, record: &NewRecord, now: i64) -> Result<(), StoreError> {
    if !matches!(record.state, RecordState::Stored | RecordState::Quarantined) {
        return Err(StoreError::IllegalEdge { from: RecordState::Captured, to: record.state });
    }
    if !check_number(session.connection, record)? {
        return Ok(());
    }
    let topic = topic_key(session, record)?;
    let seq = whole("sequence number", record.seq)?;
    if is_known(session.connection, record, topic, seq)? {
        return store_again(session.connection, record);
    }
    let stream = stream_key(session, record, topic)?;
    let sql = "INSERT INTO records (digest, topic, stream, seq, epoch, signature, bytes, captured_at,
        acknowledged_at, simulated, state) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11)";
    let (epoch, bytes) = (whole("epoch", record.epoch)?, whole("length", record.bytes)?);
    let (digest, captured_at) = (record.digest.0, whole("capture time", record.captured_at.0)?);
    let (signature, simulated, state) = (record.signature.0, record.simulated, record.state.code());
    let values = params![digest, topic, stream, seq, epoch, signature, bytes, captured_at, now, simulated, state];
    let row = session.connection.inserted(sql, "n", values)?;
    if record.kind == RecordKind::Key {
        super::feed::note(session.connection, row, topic)?;
    }
    keep_filters(session, record, row, stream)?;
    match &record.blob {
        Some(blob) => session.connection.run("INSERT INTO ciphertext VALUES (?1, ?2)", params![row, blob]),
        None => Ok(()),
    }
}

fn keep_filters(session: &mut Session<'_>, record: &NewRecord, row: i64, stream: i64) -> Result<(), StoreError> {
    let connection = session.connection;
    for filter in &record.filters {
        let filter = match session.names.filters.entry(*filter) {
            Entry::Occupied(found) => *found.get(),
            Entry::Vacant(place) => *place.insert(filter_key(connection, *filter)?),
        };
        connection.run("INSERT INTO filters VALUES (?1, ?2) ON CONFLICT DO NOTHING", [filter, row])?;
        if session.names.filter_streams.insert((filter, stream)) {
            connection.run("INSERT INTO filter_streams VALUES (?1, ?2) ON CONFLICT DO NOTHING", [filter, stream])?;
        }
    }
    Ok(())
}

fn filter_key(connection: &Connection, filter: FilterId) -> Result<i64, StoreError> {
    connection.run("INSERT INTO filter_ids (id) VALUES (?1) ON CONFLICT DO NOTHING", [filter.0])?;
    Ok(connection.one("SELECT key FROM filter_ids WHERE id = ?1", [filter.0], |row| row.get(0))?)
}

/// Repairs altered or lost bytes of a known record, but not of a deleted one or one named for deletion.
fn store_again(connection: &Connection, record: &NewRecord) -> Result<(), StoreError> {
    let Some(blob) = &record.blob else { return Ok(()) };
    let sql = "INSERT INTO ciphertext SELECT n, ?2 FROM records WHERE digest = ?1 AND deleted_at IS NULL
        AND NOT EXISTS (SELECT 1 FROM retained WHERE record = n)
        ON CONFLICT (record) DO UPDATE SET bytes = excluded.bytes WHERE ciphertext.bytes <> excluded.bytes";
    connection.run(sql, params![record.digest.0, blob.as_slice()])
}

fn is_known(connection: &Connection, record: &NewRecord, topic: i64, seq: i64) -> Result<bool, StoreError> {
    let sql = "SELECT digest = ?1, topic = ?2 AND seq = ?3 FROM records WHERE digest = ?1 OR (topic = ?2 AND seq = ?3)";
    let found: Vec<(bool, bool)> =
        connection.list(sql, params![record.digest.0, topic, seq], |row| Ok((row.get(0)?, row.get(1)?)))?;
    match found.as_slice() {
        [] => Ok(false),
        [(true, true)] => Ok(true),
        _ => Err(StoreError::Conflict {
            digest: record.digest,
            detail: format!("number {seq} of its topic or its digest belongs to another record"),
        }),
    }
}

fn topic_key(session: &mut Session<'_>, record: &NewRecord) -> Result<i64, StoreError> {
    let known = (record.owner, record.signer, record.topic_id, record.foreign);
    let found = match session.names.topics.entry(known) {
        Entry::Occupied(found) => found.into_mut(),
        Entry::Vacant(place) => place.insert(find_topic(session.connection, record)?),
    };
    // The name has become known.
    if found.1.is_empty() && !record.topic.is_empty() {
        *found = find_topic(session.connection, record)?;
    }
    if record.topic.is_empty() || record.topic == found.1 {
        return Ok(found.0);
    }
    let detail = format!("topic id {} is already used for another topic", record.topic_id);
    Err(StoreError::Conflict { digest: record.digest, detail })
}

fn find_topic(connection: &Connection, record: &NewRecord) -> Result<(i64, String), StoreError> {
    let recorder = recorder_key(connection, record)?;
    let keeper = record.foreign.map(|foreign| foreign.keeper.0);
    let sql = "INSERT INTO topics (owner, recorder, topic_id, name, keeper) VALUES (?1, ?2, ?3, ?4, ?5)
        ON CONFLICT (owner, topic_id, recorder)
        DO UPDATE SET name = CASE topics.name WHEN '' THEN excluded.name ELSE topics.name END";
    connection.run(sql, params![record.owner.0, recorder, record.topic_id.0, record.topic, keeper])?;
    let sql = "SELECT key, name FROM topics WHERE owner = ?1 AND topic_id = ?2 AND recorder = ?3";
    let values = params![record.owner.0, record.topic_id.0, recorder];
    Ok(connection.one(sql, values, |row| Ok((row.get(0)?, row.get(1)?)))?)
}

fn recorder_key(connection: &Connection, record: &NewRecord) -> Result<i64, StoreError> {
    let recorder = match record.foreign {
        Some(foreign) => foreign.recorder,
        None => own_prefix(connection)?.of_signer(&record.signer),
    };
    let values = params![recorder.0, record.signer.0];
    connection.run("INSERT INTO recorders (id, signer) VALUES (?1, ?2) ON CONFLICT DO NOTHING", values)?;
    Ok(connection.one("SELECT key FROM recorders WHERE id = ?1 AND signer = ?2", values, |row| row.get(0))?)
}

fn stream_key(session: &mut Session<'_>, record: &NewRecord, topic: i64) -> Result<i64, StoreError> {
    let known: StreamKey = (topic, record.kind.code(), record.type_name.clone());
    if let Some(key) = session.names.streams.get(&known) {
        return Ok(*key);
    }
    let values = params![topic, known.1, known.2];
    let sql = "INSERT INTO streams (topic, kind, type_name) VALUES (?1, ?2, ?3) ON CONFLICT DO NOTHING";
    session.connection.run(sql, values)?;
    let sql = "SELECT key FROM streams WHERE topic = ?1 AND kind = ?2 AND type_name = ?3";
    let key = session.connection.one(sql, values, |row| row.get(0))?;
    session.names.streams.insert(known, key);
    Ok(key)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_forgotten_once_there_are_too_many() {
        let mut names = KnownNames::default();
        names.filter_streams.extend((0..).map(|filter: i64| (filter, 1)).take(MOST_NAMES));
        names.bound();
        assert_eq!(names.filter_streams.len(), MOST_NAMES);
        names.filter_streams.insert((-1, 1));
        names.bound();
        assert!(names.filter_streams.is_empty());
    }
}
