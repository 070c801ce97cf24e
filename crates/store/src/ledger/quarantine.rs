//! Quarantined records: acknowledged like others, counted in quarantine records, released or discarded.

use rusqlite::{Connection, OptionalExtension as _, params};
use serde::{Deserialize, Serialize};

use super::append::{add, count};
use super::edges::{By, may};
use super::rows::{self, RecordRow, unsigned};
use super::{Ledger, NewRecord, database::whole};
use crate::model::{Address, Digest, RecordKind, RecordState, Timestamp, TopicId};
use crate::store::StoreError;

/// Nanoseconds in a minute.
const MINUTE: i64 = 60_000_000_000;

/// Why a record is quarantined.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Hold {
    /// The record, acknowledged in the same commit.
    pub digest: Digest,
    /// The name of the doubt.
    pub reason: &'static str,
    /// Its sender, written as in pins.
    pub publisher: String,
}

/// A record that is or was quarantined.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct HeldRow {
    /// The record.
    pub record: RecordRow,
    /// The name of the doubt.
    pub reason: String,
    /// Its sender, written as in pins; untrusted text: clean it.
    pub publisher: String,
    /// The quarantine record that counts it.
    pub report: Option<Digest>,
    /// `released` or `discarded`.
    pub decision: Option<String>,
}

/// Records of one topic and minute that no quarantine record counts yet.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HeldMinute {
    /// Pseudonym of the topic.
    pub topic_id: TopicId,
    /// Its name.
    pub topic: String,
    /// Minutes since 1970 UTC.
    pub minute: u64,
    /// Sequence numbers and digests in the order of acknowledgement.
    pub records: Vec<(u64, Digest)>,
}

/// Which quarantined records to list.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct HeldQuery {
    /// Only of this topic.
    pub topic: Option<String>,
    /// Including those already decided.
    pub decided: bool,
    /// Only captured messages, no definitions.
    pub messages: bool,
    /// At most this many.
    pub limit: usize,
}

impl Ledger {
    /// Like [`Ledger::append`], with the reasons why some of the records are quarantined; all of it is durable when
    /// this returns, or nothing is.
    ///
    /// # Errors
    /// See [`Ledger::append`]; [`StoreError::NotReady`] if a record given a reason is not in state quarantined.
    pub fn append_held(&self, records: Vec<NewRecord>, holds: Vec<Hold>) -> Result<(), StoreError> {
        self.write_many(records.len(), move |session| {
            let now = whole("time", Timestamp::now().0)?;
            records.iter().try_for_each(|record| add(session, record, now))?;
            holds.iter().try_for_each(|one| hold(session.connection, one))
        })
    }

    /// Quarantined records of an owner, oldest first.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn held(&self, owner: Address, query: &HeldQuery) -> Result<Vec<HeldRow>, StoreError> {
        self.read(|connection| {
            let streams =
                rows::streams(connection, &rows::Which::All)?.into_iter().map(|stream| (stream.key, stream)).collect();
            let sql = format!(
                "SELECT {}, reason, publisher, report, decision FROM held CROSS JOIN records ON n = record
                 JOIN topics ON key = topic
                 WHERE (?1 OR decision IS NULL) AND owner = ?2 AND (?3 IS NULL OR name = ?3)
                 AND (NOT ?5 OR stream IN (SELECT key FROM streams WHERE kind = ?6)) ORDER BY record LIMIT ?4",
                rows::COLUMNS
            );
            let limit = i64::try_from(query.limit).unwrap_or(i64::MAX);
            let mut statement = connection.prepare_cached(&sql)?;
            let data = RecordKind::Data.code();
            let values = params![query.decided, owner.0, query.topic, limit, query.messages, data];
            let found = statement.query_map(values, |row| {
                Ok(HeldRow {
                    record: rows::record(row, &streams)?,
                    reason: row.get(14)?,
                    publisher: row.get(15)?,
                    report: row.get::<_, Option<_>>(16)?.map(Digest),
                    decision: row.get(17)?,
                })
            })?;
            Ok(found.collect::<Result<_, _>>()?)
        })
    }

    /// What the next quarantine record has to count: the oldest (topic, minute) of an owner before minute `before` with
    /// uncounted records, and all of those.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn unreported(&self, owner: Address, before: u64) -> Result<Option<HeldMinute>, StoreError> {
        let before = i64::try_from(before).unwrap_or(i64::MAX);
        self.read(|connection| {
            let first = connection
                .prepare_cached(
                    "SELECT topics.key, topic_id, name, minute FROM held INDEXED BY held_unreported
                     CROSS JOIN records ON n = record JOIN topics ON key = topic
                     WHERE report IS NULL AND minute < ?1 AND owner = ?2 ORDER BY record LIMIT 1",
                )?
                .query_row(params![before, owner.0], |row| {
                    Ok((row.get::<_, i64>(0)?, TopicId(row.get(1)?), row.get::<_, String>(2)?, unsigned(row, 3)?))
                })
                .optional()?;
            let Some((key, topic_id, topic, minute)) = first else { return Ok(None) };
            let mut statement = connection.prepare_cached(
                "SELECT seq, digest FROM held INDEXED BY held_unreported CROSS JOIN records ON n = record
                 WHERE report IS NULL AND minute = ?1 AND topic = ?2 ORDER BY record",
            )?;
            let records = statement
                .query_map(params![minute.cast_signed(), key], |row| Ok((unsigned(row, 0)?, Digest(row.get(1)?))))?;
            Ok(Some(HeldMinute { topic_id, topic, minute, records: records.collect::<Result<_, _>>()? }))
        })
    }

    /// Acknowledges a quarantine record and notes the records it counts, in one commit.
    ///
    /// # Errors
    /// See [`Ledger::append`]; [`StoreError::NotReady`] if one of the records is already counted.
    pub fn report(&self, report: NewRecord, counted: Vec<Digest>) -> Result<(), StoreError> {
        self.write_many(counted.len(), move |session| {
            let now = whole("time", Timestamp::now().0)?;
            add(session, &report, now)?;
            let mut statement = session.connection.prepare_cached(
                "UPDATE held SET report = ?2
                 WHERE report IS NULL AND record = (SELECT n FROM records WHERE digest = ?1)",
            )?;
            counted.iter().try_for_each(|digest| match statement.execute(params![digest.0, report.digest.0])? {
                1 => Ok(()),
                _ => Err(StoreError::NotReady { digest: *digest, found: "not quarantined, or already counted" }),
            })
        })
    }

    /// Releases quarantined records: to stored, or to sealed if their bytes are not in the vault yet. Returns how many.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like; then none is released.
    pub fn release(&self, digests: &[Digest]) -> Result<u64, StoreError> {
        const COPY: &str = "EXISTS (SELECT 1 FROM copies WHERE record = n)";
        let (copied, stored) = (COPY.to_owned(), format!("NOT {COPY}"));
        self.decide(digests, "released", vec![(RecordState::Sealed, copied), (RecordState::Stored, stored)])
    }

    /// Discards quarantined records: they are dropped and their local copies deleted; digests, signatures and reasons
    /// stay. The caller must delete the vault's bytes. Returns how many were discarded.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like; then none is discarded.
    pub fn discard(&self, digests: &[Digest]) -> Result<u64, StoreError> {
        self.decide(digests, "discarded", vec![(RecordState::Dropped, "1".to_owned())])
    }

    fn decide(
        &self,
        digests: &[Digest],
        decision: &'static str,
        ways: Vec<(RecordState, String)>,
    ) -> Result<u64, StoreError> {
        let from = RecordState::Quarantined;
        if let Some((to, _)) = ways.iter().find(|(to, _)| !may(By::Operator, from, *to)) {
            return Err(StoreError::IllegalEdge { from, to: *to });
        }
        let digests = digests.to_vec();
        self.write_many(digests.len(), move |session| {
            let (connection, now) = (session.connection, whole("time", Timestamp::now().0)?);
            let mut decided = 0;
            for digest in &digests {
                let mut moved = 0;
                for (to, condition) in &ways {
                    let sql = format!("UPDATE records SET state = ?3 WHERE digest = ?1 AND state = ?2 AND {condition}");
                    moved +=
                        count(connection.prepare_cached(&sql)?.execute(params![digest.0, from.code(), to.code()])?);
                }
                if moved > 0 {
                    note(connection, *digest, decision, now)?;
                }
                decided += moved;
            }
            Ok(decided)
        })
    }
}

fn hold(connection: &Connection, hold: &Hold) -> Result<(), StoreError> {
    let held = connection
        .prepare_cached(
            "INSERT INTO held (record, minute, reason, publisher)
             SELECT n, captured_at / ?5, ?3, ?4 FROM records WHERE digest = ?1 AND state = ?2 ON CONFLICT DO NOTHING",
        )?
        .execute(params![hold.digest.0, RecordState::Quarantined.code(), hold.reason, hold.publisher, MINUTE])?;
    let known = || {
        let sql = "SELECT 1 FROM held JOIN records ON n = record WHERE digest = ?1";
        connection.prepare_cached(sql)?.exists([hold.digest.0])
    };
    if held == 0 && !known()? {
        return Err(StoreError::NotReady { digest: hold.digest, found: "not quarantined" });
    }
    Ok(())
}

fn note(connection: &Connection, digest: Digest, decision: &str, now: i64) -> Result<(), StoreError> {
    connection
        .prepare_cached(
            "UPDATE held SET decision = ?2, decided_at = ?3 WHERE record = (SELECT n FROM records WHERE digest = ?1)",
        )?
        .execute(params![digest.0, decision, now])?;
    if decision == "discarded" {
        let sql = "DELETE FROM copies WHERE record = (SELECT n FROM records WHERE digest = ?1)";
        connection.prepare_cached(sql)?.execute([digest.0])?;
    }
    Ok(())
}

impl HeldRow {
    /// Whether it is a captured message rather than a definition.
    pub fn is_message(&self) -> bool {
        self.record.kind == RecordKind::Data
    }
}
