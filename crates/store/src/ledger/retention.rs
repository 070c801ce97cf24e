//! Deletion of ciphertext: a retention record names it first, and must be anchored. Digest, signature, place and header
//! stay.

use std::path::PathBuf;

use super::append::add;
use super::erasures::{kept, put};
use super::rows::{LEARNED_NAME, TOPIC_NAME, optional, time, unsigned};
use super::{Erasure, NewRecord, Retention};
use crate::StoreError;
use crate::database::{capped, whole};
use crate::model::{Address, Digest, RecordKind, RecordState, Timestamp, TopicId};
use crate::notes::{self, Erased};
use crate::sql::{Connection, params};

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeptTopic {
    pub key: i64,
    pub topic_id: TopicId,
    pub name: String,
    /// Of messages with ciphertext.
    pub bytes: u64,
}

impl KeptTopic {
    pub fn is_named(&self) -> bool {
        self.name != super::RecordRow::unnamed(self.topic_id)
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OldRecord {
    /// SM3 of its stored bytes.
    pub digest: Digest,
    pub seq: u64,
    pub bytes: u64,
    pub captured_at: Timestamp,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Retained {
    /// The retention record that names it.
    pub report: Digest,
    /// Confirmed on the chain; if not, missing ciphertext is an alarm.
    pub anchored: bool,
    /// Of its stored bytes.
    pub header: Vec<u8>,
    /// When the ciphertext was deleted.
    pub deleted_at: Option<Timestamp>,
    /// Set unless a rule deleted it.
    pub erased: Option<Erasure>,
    /// An unchecked statement of its owner, if it was erased before it came here.
    pub stated: Option<Vec<u8>>,
}

impl Retention {
    /// Of the owner and of robots that bring records here. No rule matches the pseudonym of an unnamed topic.
    pub fn topics(&self, owner: Address) -> Result<Vec<KeptTopic>, StoreError> {
        let values = params![owner.0, RecordKind::Data.code(), RecordState::Dropped.code()];
        let sql = format!(
            "SELECT t.key, t.topic_id, {TOPIC_NAME}, max(0, CAST(coalesce(sum(c.bytes), 0) AS BIGINT) - coalesce(
                    (SELECT r.bytes FROM retained_topics r WHERE r.topic = t.key), 0))
                FROM topics t JOIN streams s ON s.topic = t.key JOIN counters c ON c.stream = s.key {LEARNED_NAME}
                WHERE t.owner = ?1 AND s.kind = ?2 AND c.state <> ?3 GROUP BY t.key, t.topic_id, {TOPIC_NAME}"
        );
        self.0.list(&sql, values, |row| {
            let (topic_id, bytes) = (TopicId(row.get(1)?), unsigned(row, 3)?);
            Ok(KeptTopic { key: row.get(0)?, topic_id, name: row.get(2)?, bytes })
        })
    }

    /// The oldest verified messages of a topic that retention has not deleted, from `since` to before `until`.
    pub fn oldest(
        &self,
        topic: &KeptTopic,
        (since, until): (Timestamp, Timestamp),
        limit: usize,
    ) -> Result<Vec<OldRecord>, StoreError> {
        let (verified, data) = (RecordState::Verified.code(), RecordKind::Data.code());
        let values = params![verified, topic.key, data, capped(since.0), capped(until.0), capped(limit)];
        let sql = "SELECT digest, seq, bytes, captured_at FROM records
            WHERE state = ?1 AND stream IN (SELECT key FROM streams WHERE topic = ?2 AND kind = ?3)
            AND captured_at >= ?4 AND captured_at < ?5
            AND NOT EXISTS (SELECT 1 FROM retained WHERE record = n) ORDER BY captured_at, n LIMIT ?6";
        self.0.list(sql, values, |row| {
            let (digest, captured_at) = (Digest(row.get(0)?), time(row, 3)?);
            Ok(OldRecord { digest, seq: unsigned(row, 1)?, bytes: unsigned(row, 2)?, captured_at })
        })
    }

    /// Acknowledges the retention record and notes what it names in one commit. [`StoreError::NotReady`] for a record
    /// not verified, or already named.
    pub fn give_up(
        &self,
        topic: &KeptTopic,
        report: NewRecord,
        records: Vec<(OldRecord, Vec<u8>)>,
    ) -> Result<(), StoreError> {
        let key = topic.key;
        self.0.write_many(records.len(), move |session| {
            let (connection, now) = (session.connection, whole("time", Timestamp::now().0)?);
            add(session, &report, now)?;
            let mut bytes = 0;
            for (record, header) in &records {
                name(connection, record.digest, report.digest, header)?;
                bytes += record.bytes;
            }
            let sql = "INSERT INTO retained_topics VALUES (?1, ?2, ?3)
                ON CONFLICT (topic) DO UPDATE SET records = retained_topics.records + excluded.records,
                bytes = retained_topics.bytes + excluded.bytes";
            connection.run(sql, params![key, whole("count", records.len() as u64)?, whole("bytes", bytes)?])
        })
    }

    /// Records with a confirmed retention record, ciphertext and no incident.
    pub fn to_delete(&self, owner: Address, limit: usize) -> Result<Vec<Digest>, StoreError> {
        let (confirmed, verified) = (RecordState::Confirmed.code(), RecordState::Verified.code());
        let values = params![owner.0, confirmed, verified, capped(limit)];
        let sql = format!(
            "SELECT one.digest FROM retained INDEXED BY retained_due CROSS JOIN records one ON one.n = record
                JOIN topics t ON t.key = one.topic JOIN records told ON told.digest = report {LEARNED_NAME}
                WHERE retained.deleted_at IS NULL AND t.owner = ?1 AND told.state IN (?2, ?3) AND NOT {}
                ORDER BY record LIMIT ?4",
            is_held()
        );
        self.0.list(&sql, values, |row| row.get(0).map(Digest))
    }

    /// Notes the deletion of ciphertext.
    pub fn deleted(&self, digests: &[Digest]) -> Result<(), StoreError> {
        let digests = digests.to_vec();
        self.0.write_many(digests.len(), move |session| {
            let now = whole("time", Timestamp::now().0)?;
            for digest in &digests {
                for sql in [
                    "UPDATE retained SET deleted_at = coalesce(deleted_at, ?2)
                        WHERE record = (SELECT n FROM records WHERE digest = ?1)",
                    "UPDATE records SET deleted_at = coalesce(deleted_at, ?2) WHERE digest = ?1",
                ] {
                    session.connection.run(sql, params![digest.0, now])?;
                }
                if let Some(stated) = kept(session.connection, *digest)? {
                    put(session.connection, *digest, &stated)?;
                }
            }
            Ok(())
        })
    }

    /// `None` unless retention names the record.
    pub fn find(&self, digest: Digest) -> Result<Option<Retained>, StoreError> {
        self.0.read(|connection| {
            let sql = "SELECT report, coalesce(told.state IN (?2, ?3), FALSE), header, retained.deleted_at,
                told.n IS NOT NULL,
                (SELECT statement FROM erasures WHERE erasures.record = one.n AND taken = 1) FROM records one
                JOIN retained ON record = one.n LEFT JOIN records told ON told.digest = report WHERE one.digest = ?1";
            let values = params![digest.0, RecordState::Confirmed.code(), RecordState::Verified.code()];
            let found = connection.find(sql, values, |row| {
                let (report, deleted_at) = (Digest(row.get(0)?), optional(row, 3)?.map(Timestamp));
                let (anchored, header, stated) = (row.get(1)?, row.get(2)?, row.get(5)?);
                let retained = Retained { report, anchored, header, deleted_at, erased: None, stated };
                Ok((retained, row.get::<bool>(4)?))
            })?;
            let Some((mut retained, told)) = found else { return Ok(None) };
            retained.erased = notes::read_in(connection, &Erased { report: retained.report })?;
            // A ledger needs no statement for its own erasures.
            retained.stated = retained.stated.filter(|_| retained.erased.is_none());
            let Some(stated) = &retained.stated else { return Ok(told.then_some(retained)) };
            let erased = Erasure::stated(stated).ok_or_else(|| {
                let detail = format!("what its owner states of the erased record {digest} cannot be read");
                StoreError::Corrupt { file: PathBuf::new(), detail }
            })?;
            (retained.anchored, retained.erased) = (false, Some(erased));
            Ok(Some(retained))
        })
    }

    /// Counts messages deleted by retention.
    pub fn given_up(&self, owner: Address) -> Result<u64, StoreError> {
        let sql = "SELECT coalesce(sum(records), 0) FROM retained_topics JOIN topics ON key = topic WHERE owner = ?1";
        self.0.one(sql, [owner.0], |row| unsigned(row, 0))
    }
}

/// Whether an incident holds record `one` of topic `t`; needs [`LEARNED_NAME`].
pub(super) fn is_held() -> String {
    format!(
        "EXISTS (SELECT 1 FROM incidents i WHERE i.owner = t.owner
             AND one.captured_at >= i.since AND one.captured_at < coalesce(i.until, 9223372036854775807)
             AND (EXISTS (SELECT 1 FROM incident_topics
                     WHERE incident = i.key AND topic_matches(incident_topics.topic, {TOPIC_NAME}))
                 OR NOT EXISTS (SELECT 1 FROM incident_topics WHERE incident = i.key)))"
    )
}

pub(super) fn name(connection: &Connection, digest: Digest, report: Digest, header: &[u8]) -> Result<(), StoreError> {
    let sql = "INSERT INTO retained (record, report, header) SELECT n, ?2, ?3 FROM records
        WHERE digest = ?1 AND state = ?4 ON CONFLICT DO NOTHING";
    match connection.changed(sql, params![digest.0, report.0, header, RecordState::Verified.code()])? {
        1 => Ok(()),
        _ => Err(StoreError::NotReady { digest, found: "not verified, or already discarded" }),
    }
}
