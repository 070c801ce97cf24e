//! Records in each state, from counters that change in the transaction of the records.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::ops::RangeInclusive;

use serde::{Deserialize, Serialize};

use super::Counts;
use super::rows::{self, Stream, Which, optional, unsigned};
use crate::StoreError;
use crate::database::whole;
use crate::model::{Address, LossReason, RecordKind, RecordState, RecorderId, SignerId, Timestamp, TopicId};
use crate::sql::{Connection, Params, params};

/// `captured = verified + pending + right_ended + quarantined + dropped + tampered`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TopicCounts {
    pub owner: Address,
    pub topic: String,
    /// `None` if all messages were dropped.
    pub topic_id: Option<TopicId>,
    /// The last one; empty if all messages were dropped.
    #[serde(rename = "type")]
    pub type_name: String,
    /// Includes dropped ones; counted independently, not summed.
    pub captured: u64,
    pub verified: u64,
    pub pending: u64,
    /// Waiting for their signer's right.
    pub right_ended: u64,
    pub quarantined: u64,
    pub tampered: u64,
    /// Never acknowledged, or discarded from quarantine.
    pub dropped: u64,
    /// Dropped without acknowledgement.
    pub lost: u64,
    /// Lost on the way ([`LossReason::Transport`]); not in `captured`.
    pub missed: u64,
    /// Of plaintext, over all acknowledged data records.
    pub bytes: u64,
}

#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct StateCounts {
    /// `dropped` includes [`super::Losses::count`].
    pub data: BTreeMap<RecordState, u64>,
    /// Data records; counted independently, not summed.
    pub acknowledged: u64,
    /// Captured but never acknowledged.
    pub lost_in_recorder: u64,
    /// Not part of what was captured.
    pub lost_in_transport: u64,
    /// Of all other kinds.
    pub others: BTreeMap<RecordState, u64>,
    /// Ordered by (topic, owner).
    pub topics: Vec<TopicCounts>,
    /// Pseudonyms of attachments to recordings.
    pub attachments: Vec<TopicId>,
}

/// Messages that an owner sealed in some epochs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SealedQuery {
    pub owner: Address,
    /// `None` = all.
    pub topic: Option<TopicId>,
    pub epochs: RangeInclusive<u64>,
    /// Captured at this time or later.
    pub since: Timestamp,
}

/// By [`SealedQuery::values`].
const SEALED: &str = "FROM epoch_records
    JOIN streams ON streams.key = epoch_records.stream JOIN topics ON topics.key = streams.topic
    WHERE topics.owner = ?1 AND (topics.topic_id = ?2 OR ?2 IS NULL) AND epoch BETWEEN ?3 AND ?4
    AND kind = ?5 AND records > 0 AND last_at >= ?6";

impl SealedQuery {
    fn values(&self) -> Result<impl Params, StoreError> {
        let (first, last) = (whole("epoch", *self.epochs.start())?, whole("epoch", *self.epochs.end())?);
        let topic = self.topic.map(|topic| topic.0);
        Ok((self.owner.0, topic, first, last, RecordKind::Data.code(), whole("time", self.since.0)?))
    }
}

impl TopicCounts {
    pub fn is_conserved(&self) -> bool {
        let settled = self.verified + self.quarantined + self.dropped + self.tampered;
        self.captured == settled + self.pending + self.right_ended
    }
}

impl StateCounts {
    pub fn data_in(&self, state: RecordState) -> u64 {
        self.data.get(&state).copied().unwrap_or(0)
    }

    pub fn captured(&self) -> u64 {
        self.acknowledged + self.lost_in_recorder
    }

    /// In total and for each topic.
    pub fn is_conserved(&self) -> bool {
        self.captured() == self.data.values().sum::<u64>() && self.topics.iter().all(TopicCounts::is_conserved)
    }

    pub fn pending(&self) -> u64 {
        self.data.iter().filter(|(state, _)| state.is_pending()).map(|(_, count)| count).sum()
    }

    pub fn pending_of_any_kind(&self) -> u64 {
        self.pending() + self.others.iter().filter(|(state, _)| state.is_pending()).map(|(_, n)| n).sum::<u64>()
    }
}

impl Counts {
    /// Costs the same whatever the number of records.
    pub fn by_state(&self, owner: Option<Address>) -> Result<StateCounts, StoreError> {
        self.0.read(|connection| {
            let streams = rows::all_streams(connection)?;
            let mut tally = Tally::default();
            tally.add_records(connection, owner, &streams)?;
            tally.add_intake(connection, owner, &streams)?;
            tally.add_drops(connection, owner)?;
            Ok(tally.finish())
        })
    }

    /// How many records a grant of these epochs opens, and the first capture. A clock ahead of this one counts as the
    /// arrival here.
    pub fn opened_by(&self, query: &SealedQuery) -> Result<(u64, Option<Timestamp>), StoreError> {
        let sql = format!("SELECT coalesce(sum(records), 0), min(first_at) {SEALED}");
        self.0.one(&sql, query.values()?, |row| Ok((unsigned(row, 0)?, optional(row, 1)?.map(Timestamp))))
    }

    /// The first of these epochs in which anything was captured since.
    pub fn first_epoch(&self, query: &SealedQuery) -> Result<Option<u64>, StoreError> {
        self.0.one(&format!("SELECT min(epoch) {SEALED}"), query.values()?, |row| optional(row, 0))
    }

    /// Whether anything was sealed under the keys of an epoch; notices to robots have keys of their own.
    pub fn is_epoch_used(&self, owner: Address, epoch: u64) -> Result<bool, StoreError> {
        let sql = "SELECT 1 FROM epoch_records
            JOIN streams ON streams.key = epoch_records.stream JOIN topics ON topics.key = streams.topic
            WHERE topics.owner = ?1 AND epoch = ?2 AND kind <> ?3 LIMIT 1";
        let values = params![owner.0, whole("epoch", epoch)?, RecordKind::Key.code()];
        let found: Vec<i64> = self.0.list(sql, values, |row| row.get(0))?;
        Ok(!found.is_empty())
    }

    pub fn in_each_state(&self) -> Result<BTreeMap<RecordState, u64>, StoreError> {
        let sql = "SELECT state, sum(records) FROM counters GROUP BY state HAVING sum(records) > 0";
        self.0.list(sql, [], |row| Ok((rows::state(row, 0)?, unsigned(row, 1)?)))
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
        let sql = "SELECT stream, state, records, bytes FROM counters ORDER BY stream";
        connection.each(sql, [], |row| {
            let stream = streams.get(&row.get(0)?).ok_or_else(|| rows::out_of_range(0))?;
            let (state, records, bytes) = (rows::state(row, 1)?, unsigned(row, 2)?, unsigned(row, 3)?);
            if records > 0 && owner.is_none_or(|owner| owner == stream.owner) {
                self.add(stream, state, records, bytes);
            }
            Ok(())
        })
    }

    fn add_intake(
        &mut self,
        connection: &Connection,
        owner: Option<Address>,
        streams: &HashMap<i64, Stream>,
    ) -> Result<(), StoreError> {
        connection.each("SELECT stream, records FROM intake", [], |row| {
            let stream = streams.get(&row.get(0)?).ok_or_else(|| rows::out_of_range(0))?;
            if stream.kind == RecordKind::Data && owner.is_none_or(|owner| owner == stream.owner) {
                let records = unsigned(row, 1)?;
                self.counts.acknowledged += records;
                self.topic(stream.owner, &stream.topic).captured += records;
            }
            Ok(())
        })
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
        let sql = "SELECT owner, topic, reason, count FROM drops WHERE owner = ?1 OR ?1 IS NULL";
        connection.each(sql, [owner.map(|owner| owner.0)], |row| {
            let (topic, reason, count) = (row.get::<String>(1)?, row.get::<String>(2)?, unsigned(row, 3)?);
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
            Ok(())
        })
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

// Coverage looks each part up in the index of states: the cost depends on the parts, not on the records.

pub const MOST_PARTS: usize = 1_000;
/// Only the newest losses count.
const MOST_LOSSES: i64 = 10_000;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CoverageQuery {
    pub owner: Address,
    pub topics: Vec<String>,
    /// Only these keys' records and no losses, which this site's own capture counts; `None` = all recorders.
    pub signers: Option<BTreeSet<SignerId>>,
    /// `None` = from the first record of any.
    pub since: Option<Timestamp>,
    pub until: Timestamp,
    /// 1 to [`MOST_PARTS`].
    pub parts: usize,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct CoveragePart {
    pub at: Timestamp,
    /// Neither quarantined nor altered.
    pub data: bool,
    /// Also discarded from quarantine.
    pub quarantined: bool,
    pub tampered: bool,
    /// A count that covers several parts is in each.
    pub lost: u64,
}

impl CoveragePart {
    /// The worst finding.
    pub fn sign(&self) -> char {
        match self {
            Self { tampered: true, .. } => 'T',
            Self { quarantined: true, .. } => 'Q',
            Self { lost: 1.., .. } => 'L',
            Self { data: true, .. } => '█',
            _ => '·',
        }
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Coverage {
    pub since: Timestamp,
    pub until: Timestamp,
    pub first: Option<Timestamp>,
    pub last: Option<Timestamp>,
    /// All signers of the topic.
    pub signers: BTreeSet<SignerId>,
    /// Oldest first, all of the same length.
    pub parts: Vec<CoveragePart>,
}

impl Counts {
    /// Of each topic, all over the same span. One lookup for each part, stream and state.
    pub fn coverage(&self, query: &CoverageQuery) -> Result<Vec<Coverage>, StoreError> {
        self.0.read(|connection| {
            let streams = rows::streams(connection, &Which::Of(query.owner))?;
            let tracks = query.topics.iter().map(|topic| Track::of(connection, &streams, topic, query));
            let tracks = tracks.collect::<Result<Vec<_>, _>>()?;
            let first = tracks.iter().filter_map(|track| track.first).min();
            let since = query.since.or(first).unwrap_or(query.until).min(query.until);
            tracks.into_iter().map(|track| track.covered(connection, since, query)).collect()
        })
    }
}

/// The records of one topic.
struct Track<'a> {
    topic: &'a str,
    signers: BTreeSet<SignerId>,
    lanes: Vec<Lane>,
    first: Option<Timestamp>,
    last: Option<Timestamp>,
}

impl<'a> Track<'a> {
    fn of(
        connection: &Connection,
        streams: &[Stream],
        topic: &'a str,
        query: &CoverageQuery,
    ) -> Result<Self, StoreError> {
        let mut lanes = lanes(connection, streams, topic)?;
        let signers = lanes.iter().map(|lane| lane.signer).collect();
        if let Some(wanted) = &query.signers {
            lanes.retain(|lane| wanted.contains(&lane.signer));
        }
        let (first, last) = ends(connection, &lanes)?;
        Ok(Self { topic, signers, lanes, first, last })
    }

    fn covered(self, connection: &Connection, since: Timestamp, query: &CoverageQuery) -> Result<Coverage, StoreError> {
        let mut parts = empty(since, query);
        for lane in &self.lanes {
            lane.walk(connection, query.until, &mut parts)?;
        }
        if query.signers.is_none() {
            add_losses(connection, self.topic, query, &mut parts)?;
        }
        let Self { signers, first, last, .. } = self;
        Ok(Coverage { since, until: query.until, first, last, signers, parts })
    }
}

struct Lane {
    stream: i64,
    signer: SignerId,
    state: RecordState,
}

fn lanes(connection: &Connection, streams: &[Stream], topic: &str) -> Result<Vec<Lane>, StoreError> {
    let sql = "SELECT state FROM counters WHERE stream = ?1 AND records > 0";
    let mut lanes = Vec::new();
    for stream in streams.iter().filter(|stream| stream.topic == topic && stream.kind == RecordKind::Data) {
        let states: Vec<_> = connection.list(sql, [stream.key], |row| rows::state(row, 0))?;
        lanes.extend(states.into_iter().map(|state| Lane { stream: stream.key, signer: stream.signer, state }));
    }
    Ok(lanes)
}

fn ends(connection: &Connection, lanes: &[Lane]) -> Result<(Option<Timestamp>, Option<Timestamp>), StoreError> {
    let end = |which: &str| -> Result<Vec<Timestamp>, StoreError> {
        let sql = format!(
            "SELECT {which}(captured_at) FROM records INDEXED BY records_by_state WHERE state = ?1 AND stream = ?2"
        );
        let mut found = Vec::new();
        for lane in lanes {
            let values = [i64::from(lane.state.code()), lane.stream];
            found.extend(connection.one(&sql, values, |row| optional(row, 0))?.map(Timestamp));
        }
        Ok(found)
    };
    Ok((end("min")?.into_iter().min(), end("max")?.into_iter().max()))
}

fn empty(since: Timestamp, query: &CoverageQuery) -> Vec<CoveragePart> {
    let count = query.parts.clamp(1, MOST_PARTS) as u64;
    let length = (query.until.0 - since.0).div_ceil(count).max(1);
    let at = |place: u64| Timestamp(since.0.saturating_add(place * length));
    let part = |place| CoveragePart { at: at(place), ..CoveragePart::default() };
    (0..count).map(part).take_while(|part| part.at < query.until || part.at == since).collect()
}

impl Lane {
    /// Jumps to the next part with records.
    fn walk(&self, connection: &Connection, until: Timestamp, parts: &mut [CoveragePart]) -> Result<(), StoreError> {
        let sql = "SELECT captured_at FROM records INDEXED BY records_by_state
                WHERE state = ?1 AND stream = ?2 AND captured_at >= ?3 AND captured_at < ?4 ORDER BY captured_at LIMIT 1";
        let (state, until) = (i64::from(self.state.code()), whole("time", until.0)?);
        let mut from = parts.first().map(|part| part.at);
        while let Some(at) = from {
            let values = [state, self.stream, whole("time", at.0)?, until];
            let Some(found) = connection.find(sql, values, |row| unsigned(row, 0))? else { return Ok(()) };
            let behind = parts.partition_point(|part| part.at.0 <= found);
            if let Some(part) = behind.checked_sub(1).and_then(|place| parts.get_mut(place)) {
                self.note(part);
            }
            from = parts.get(behind).map(|part| part.at);
        }
        Ok(())
    }

    fn note(&self, part: &mut CoveragePart) {
        match self.state {
            RecordState::Quarantined | RecordState::Dropped => part.quarantined = true,
            RecordState::Tampered => part.tampered = true,
            _ => part.data = true,
        }
    }
}

fn add_losses(
    connection: &Connection,
    topic: &str,
    query: &CoverageQuery,
    parts: &mut [CoveragePart],
) -> Result<(), StoreError> {
    let Some(since) = parts.first().map(|part| part.at) else { return Ok(()) };
    let sql =
        "SELECT count, first_at, last_at FROM gaps WHERE owner = ?1 AND topic = ?2 AND last_at >= ?3 AND first_at < ?4
            ORDER BY key DESC LIMIT ?5";
    let (since, until) = (whole("time", since.0)?, whole("time", query.until.0)?);
    connection.each(sql, params![query.owner.0, topic, since, until, MOST_LOSSES], |row| {
        let (count, first, last) = (unsigned(row, 0)?, unsigned(row, 1)?, unsigned(row, 2)?);
        let from = parts.partition_point(|part| part.at.0 <= first).saturating_sub(1);
        let to = parts.partition_point(|part| part.at.0 <= last);
        for part in parts.iter_mut().take(to).skip(from) {
            part.lost = part.lost.saturating_add(count);
        }
        Ok(())
    })
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct OwnerUsage {
    /// Of plaintext, also where the ciphertext was deleted.
    pub bytes: u64,
    /// Combinations of recorder, topic, kind, type and signer.
    pub streams: u64,
}

impl Counts {
    /// Costs as much as there are streams.
    pub fn usage(&self, owner: Address) -> Result<OwnerUsage, StoreError> {
        let sql = "SELECT count(DISTINCT s.key), coalesce(sum(c.bytes), 0)
            FROM topics t JOIN streams s ON s.topic = t.key LEFT JOIN counters c ON c.stream = s.key
            WHERE t.owner = ?1";
        self.0.one(sql, [owner.0], |row| Ok(OwnerUsage { streams: unsigned(row, 0)?, bytes: unsigned(row, 1)? }))
    }

    pub fn has_stream(
        &self,
        owner: Address,
        (recorder, topic): (RecorderId, TopicId),
        (kind, type_name, signer): (RecordKind, &str, SignerId),
    ) -> Result<bool, StoreError> {
        let sql = "SELECT EXISTS (SELECT 1 FROM topics t JOIN streams s ON s.topic = t.key
            WHERE t.owner = ?1 AND t.topic_id = ?2
            AND t.recorder = (SELECT key FROM recorders WHERE id = ?3 AND signer = ?6)
            AND s.kind = ?4 AND s.type_name = ?5)";
        self.0.one(sql, params![owner.0, topic.0, recorder.0, kind.code(), type_name, signer.0], |row| row.get(0))
    }
}
