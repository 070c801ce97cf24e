//! How many records are in each state, read from counters that change in the same transaction as the records.

use std::collections::{BTreeMap, HashMap};

use rusqlite::{Connection, params};
use serde::{Deserialize, Serialize};

use super::Ledger;
use super::rows::{self, Stream};
use crate::model::{Address, LossReason, RecordKind, RecordState, Timestamp, TopicId};
use crate::store::StoreError;
use crate::store::database::whole;

/// Bytes that header, head and tags add to a message.
const AROUND: i64 = 600;

/// The counts of one topic's records by state. `captured = verified + pending + right_ended + quarantined + dropped +
/// tampered`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TopicCounts {
    /// The topic's owner.
    pub owner: Address,
    /// Its name.
    pub topic: String,
    /// Its pseudonym; none if all messages were dropped.
    pub topic_id: Option<TopicId>,
    /// The message type last seen; empty if all messages were dropped.
    #[serde(rename = "type")]
    pub type_name: String,
    /// Messages captured, including dropped ones; counted independently, not summed.
    pub captured: u64,
    /// Verified records.
    pub verified: u64,
    /// Records on their way to verified.
    pub pending: u64,
    /// Records waiting for their signer's right.
    pub right_ended: u64,
    /// Quarantined records.
    pub quarantined: u64,
    /// Records whose stored bytes are wrong.
    pub tampered: u64,
    /// Messages captured but never acknowledged, or discarded from quarantine.
    pub dropped: u64,
    /// Of these, never acknowledged.
    pub lost: u64,
    /// Messages that never arrived ([`LossReason::Transport`]); not part of `captured`.
    pub missed: u64,
    /// Plaintext bytes of all acknowledged data records.
    pub bytes: u64,
}

/// The counts of an owner's records, or of all, by state.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct StateCounts {
    /// Data records per state; `dropped` includes the messages counted by [`Ledger::count_losses`].
    pub data: BTreeMap<RecordState, u64>,
    /// All data records ever acknowledged; counted independently, not summed.
    pub acknowledged: u64,
    /// Messages captured but never acknowledged.
    pub lost_in_recorder: u64,
    /// Messages that never arrived; not part of what was captured.
    pub lost_in_transport: u64,
    /// Records of all other kinds, per state.
    pub others: BTreeMap<RecordState, u64>,
    /// Data records per topic, ordered by (topic, owner).
    pub topics: Vec<TopicCounts>,
    /// Pseudonyms under which attachments to recordings are filed.
    pub attachments: Vec<TopicId>,
}

impl TopicCounts {
    /// Whether captured = verified + pending + right ended + quarantined + dropped + tampered.
    pub fn is_conserved(&self) -> bool {
        let settled = self.verified + self.quarantined + self.dropped + self.tampered;
        self.captured == settled + self.pending + self.right_ended
    }
}

impl StateCounts {
    /// Data records in a state.
    pub fn data_in(&self, state: RecordState) -> u64 {
        self.data.get(&state).copied().unwrap_or(0)
    }

    /// Messages captured, including dropped ones.
    pub fn captured(&self) -> u64 {
        self.acknowledged + self.lost_in_recorder
    }

    /// Whether captured = verified + pending + right ended + quarantined + dropped + tampered, in total and for each
    /// topic.
    pub fn is_conserved(&self) -> bool {
        self.captured() == self.data.values().sum::<u64>() && self.topics.iter().all(TopicCounts::is_conserved)
    }

    /// Data records on their way to verified.
    pub fn pending(&self) -> u64 {
        self.data.iter().filter(|(state, _)| state.is_pending()).map(|(_, count)| count).sum()
    }

    /// Records of any kind on their way to verified.
    pub fn pending_of_any_kind(&self) -> u64 {
        self.pending() + self.others.iter().filter(|(state, _)| state.is_pending()).map(|(_, n)| n).sum::<u64>()
    }
}

impl Ledger {
    /// Counts per state and topic; costs the same whatever the number of records.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn counts(&self, owner: Option<Address>) -> Result<StateCounts, StoreError> {
        self.read(|connection| {
            let streams =
                rows::streams(connection, &rows::Which::All)?.into_iter().map(|stream| (stream.key, stream)).collect();
            let mut tally = Tally::default();
            tally.add_records(connection, owner, &streams)?;
            tally.add_intake(connection, owner, &streams)?;
            tally.add_drops(connection, owner)?;
            Ok(tally.finish())
        })
    }

    /// Messages of an owner that are sealed in an epoch, of these topics or of all: how many, and when the first of them
    /// was captured.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn sealed_in_epoch(
        &self,
        owner: Address,
        epoch: u64,
        topics: Option<&[TopicId]>,
    ) -> Result<(u64, Option<Timestamp>), StoreError> {
        let epoch = whole("epoch", epoch)?;
        self.read(|connection| {
            let mut statement = connection.prepare_cached(
                "SELECT topics.topic_id, epoch_records.records, first_at FROM epoch_records
                 JOIN streams ON streams.key = epoch_records.stream JOIN topics ON topics.key = streams.topic
                 WHERE topics.owner = ?1 AND epoch = ?2 AND kind = ?3",
            )?;
            let values = params![owner.0, epoch, RecordKind::Data.code()];
            let found = statement.query_map(values, |row| {
                Ok((TopicId(row.get(0)?), rows::unsigned(row, 1)?, Timestamp(rows::unsigned(row, 2)?)))
            })?;
            let (mut records, mut first) = (0, None::<Timestamp>);
            for row in found {
                let (topic, count, at) = row?;
                if topics.is_none_or(|topics| topics.contains(&topic)) {
                    records += count;
                    first = Some(first.map_or(at, |first| first.min(at)));
                }
            }
            Ok((records, first))
        })
    }

    /// Records of all owners and kinds in each state.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn in_each_state(&self) -> Result<BTreeMap<RecordState, u64>, StoreError> {
        self.read(|connection| {
            let sql = "SELECT state, sum(records) FROM counters GROUP BY state HAVING sum(records) > 0";
            let mut statement = connection.prepare_cached(sql)?;
            let found = statement.query_map([], |row| Ok((rows::state(row, 0)?, rows::unsigned(row, 1)?)))?;
            Ok(found.collect::<Result<_, _>>()?)
        })
    }

    /// Sealed records waiting here for the vault.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn sealed(&self) -> Result<u64, StoreError> {
        self.read(|connection| {
            let sql = "SELECT coalesce(sum(records), 0) FROM counters WHERE state = ?1";
            let state = [i64::from(RecordState::Sealed.code())];
            Ok(connection.prepare_cached(sql)?.query_row(state, |row| rows::unsigned(row, 0))?)
        })
    }

    /// Bytes of sealed records waiting here for the vault, including each record's overhead over its message.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn backlog(&self) -> Result<u64, StoreError> {
        self.read(|connection| {
            let sql = "SELECT coalesce(sum(bytes + records * ?2), 0) FROM counters WHERE state = ?1";
            let values = [i64::from(RecordState::Sealed.code()), AROUND];
            Ok(connection.prepare_cached(sql)?.query_row(values, |row| rows::unsigned(row, 0))?)
        })
    }
}

#[derive(Default)]
struct Tally {
    counts: StateCounts,
    topics: BTreeMap<(String, Address), TopicCounts>,
}

impl Tally {
    fn add_records(
        &mut self,
        connection: &Connection,
        owner: Option<Address>,
        streams: &HashMap<i64, Stream>,
    ) -> Result<(), StoreError> {
        let mut statement =
            connection.prepare_cached("SELECT stream, state, records, bytes FROM counters ORDER BY stream")?;
        let mut rows = statement.query([])?;
        while let Some(row) = rows.next()? {
            let stream = streams.get(&row.get(0)?).ok_or_else(|| rows::out_of_range(0))?;
            let (state, records, bytes) = (rows::state(row, 1)?, rows::unsigned(row, 2)?, rows::unsigned(row, 3)?);
            if records > 0 && owner.is_none_or(|owner| owner == stream.owner) {
                self.add(stream, state, records, bytes);
            }
        }
        Ok(())
    }

    fn add_intake(
        &mut self,
        connection: &Connection,
        owner: Option<Address>,
        streams: &HashMap<i64, Stream>,
    ) -> Result<(), StoreError> {
        let mut statement = connection.prepare_cached("SELECT stream, records FROM intake")?;
        let mut rows = statement.query([])?;
        while let Some(row) = rows.next()? {
            let stream = streams.get(&row.get(0)?).ok_or_else(|| rows::out_of_range(0))?;
            if stream.kind == RecordKind::Data && owner.is_none_or(|owner| owner == stream.owner) {
                let records = rows::unsigned(row, 1)?;
                self.counts.acknowledged += records;
                self.topic(stream.owner, &stream.topic).captured += records;
            }
        }
        Ok(())
    }

    fn add(&mut self, stream: &Stream, state: RecordState, records: u64, bytes: u64) {
        if stream.kind == RecordKind::Attachment && !self.counts.attachments.contains(&stream.topic_id) {
            self.counts.attachments.push(stream.topic_id);
        }
        if stream.kind != RecordKind::Data {
            *self.counts.others.entry(state).or_default() += records;
            return;
        }
        *self.counts.data.entry(state).or_default() += records;
        let topic = self.topic(stream.owner, &stream.topic);
        topic.topic_id = Some(stream.topic_id);
        topic.type_name.clone_from(&stream.type_name);
        topic.bytes += bytes;
        *match state {
            RecordState::Verified => &mut topic.verified,
            RecordState::Quarantined => &mut topic.quarantined,
            RecordState::RightEnded => &mut topic.right_ended,
            RecordState::Tampered => &mut topic.tampered,
            RecordState::Dropped => &mut topic.dropped,
            _ => &mut topic.pending,
        } += records;
    }

    fn add_drops(&mut self, connection: &Connection, owner: Option<Address>) -> Result<(), StoreError> {
        let mut statement = connection
            .prepare_cached("SELECT owner, topic, reason, count FROM drops WHERE ?1 IS NULL OR owner = ?1")?;
        let mut rows = statement.query([owner.map(|owner| owner.0)])?;
        while let Some(row) = rows.next()? {
            let (topic, reason, count) = (row.get::<_, String>(1)?, row.get::<_, String>(2)?, rows::unsigned(row, 3)?);
            let topic = self.topic(Address(row.get(0)?), &topic);
            if reason == LossReason::Transport.word() {
                topic.missed += count;
                self.counts.lost_in_transport += count;
            } else {
                topic.dropped += count;
                topic.lost += count;
                topic.captured += count;
                self.counts.lost_in_recorder += count;
                *self.counts.data.entry(RecordState::Dropped).or_default() += count;
            }
        }
        Ok(())
    }

    fn topic(&mut self, owner: Address, topic: &str) -> &mut TopicCounts {
        self.topics.entry((topic.to_owned(), owner)).or_insert_with(|| TopicCounts {
            owner,
            topic: topic.to_owned(),
            topic_id: None,
            type_name: String::new(),
            captured: 0,
            verified: 0,
            pending: 0,
            right_ended: 0,
            quarantined: 0,
            tampered: 0,
            dropped: 0,
            lost: 0,
            missed: 0,
            bytes: 0,
        })
    }

    fn finish(mut self) -> StateCounts {
        self.counts.topics = self.topics.into_values().collect();
        self.counts
    }
}
