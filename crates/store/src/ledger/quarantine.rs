//! Records held back, pinned publishers and their alarms, and gaps.

use serde::{Deserialize, Serialize};

use super::append::add;
use super::rows::{self, By, RecordRow, check, time, unsigned};
use super::{Losses, NewRecord, Pins, Quarantine, Session};
use crate::StoreError;
use crate::database::{capped, whole};
use crate::model::{Address, Digest, LossReason, Publisher, RecordKind, RecordState, Timestamp, TopicId};
use crate::notes::{self, LossesCounted};
use crate::sql::{self, Connection, Row, params};

const MINUTE: i64 = 60_000_000_000;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Hold {
    /// Acknowledged in the same commit.
    pub digest: Digest,
    /// The doubt's name.
    pub reason: &'static str,
    /// As written in pins.
    pub publisher: String,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct HeldRow {
    pub record: RecordRow,
    /// The doubt's name.
    pub reason: String,
    /// As written in pins; untrusted text: clean it.
    pub publisher: String,
    /// The quarantine record that counts it.
    pub report: Option<Digest>,
    /// `released` or `discarded`.
    pub decision: Option<String>,
}

/// Not counted by a quarantine record.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HeldMinute {
    pub topic_id: TopicId,
    pub topic: String,
    /// Minutes since 1970 UTC.
    pub minute: u64,
    /// In order of acknowledgement.
    pub records: Vec<(u64, Digest)>,
}

#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct HeldQuery {
    /// A name, or a pattern for several.
    pub topic: Option<String>,
    /// Includes decided ones.
    pub decided: bool,
    /// Excludes definitions.
    pub messages: bool,
    /// Otherwise oldest first.
    pub newest_first: bool,
    pub limit: usize,
}

impl Quarantine {
    /// Like [`Records::append`], durable with the reasons or not at all. [`StoreError::NotReady`] if a record with a
    /// reason is not quarantined.
    pub fn append_held(&self, records: Vec<NewRecord>, holds: Vec<Hold>) -> Result<(), StoreError> {
        self.0.write_many(records.len(), move |session| {
            let now = whole("time", Timestamp::now().0)?;
            records.iter().try_for_each(|record| add(session, record, now))?;
            holds.iter().try_for_each(|one| hold(session.connection, one))
        })
    }

    pub fn held(&self, owner: Address, query: &HeldQuery) -> Result<Vec<HeldRow>, StoreError> {
        self.0.read(|connection| {
            let streams = rows::all_streams(connection)?;
            let (index, which) =
                if query.decided { ("", "") } else { ("INDEXED BY held_undecided", "decision IS NULL AND") };
            let order = if query.newest_first { "DESC" } else { "ASC" };
            let sql = format!(
                "SELECT {}, reason, publisher, report, decision FROM held {index} CROSS JOIN records ON n = record
                    JOIN topics ON key = topic WHERE {which} owner = ?1 AND (coalesce(?2, '') = '' OR topic_matches(?2, name))
                    AND (NOT ?4 OR stream IN (SELECT key FROM streams WHERE kind = ?5)) ORDER BY record {order} LIMIT ?3",
                rows::COLUMNS
            );
            let values = params![owner.0, query.topic, capped(query.limit), query.messages, RecordKind::Data.code()];
            Ok(connection.list(&sql, values, |row| {
                let (record, report) = (rows::record(row, &streams)?, row.get::<Option<_>>(16)?.map(Digest));
                let (reason, publisher, decision) = (row.get(14)?, row.get(15)?, row.get(17)?);
                Ok(HeldRow { record, reason, publisher, report, decision })
            })?)
        })
    }

    /// For the next quarantine record: the oldest topic and minute before `before` with uncounted records, and all of
    /// those.
    pub fn unreported(&self, owner: Address, before: u64) -> Result<Option<HeldMinute>, StoreError> {
        self.0.read(|connection| {
            let sql = "SELECT topics.key, topic_id, name, minute FROM held INDEXED BY held_unreported
                CROSS JOIN records ON n = record JOIN topics ON key = topic
                WHERE report IS NULL AND minute < ?1 AND owner = ?2 ORDER BY record LIMIT 1";
            let first = connection.find(sql, params![capped(before), owner.0], |row| {
                Ok((row.get::<i64>(0)?, TopicId(row.get(1)?), row.get::<String>(2)?, unsigned(row, 3)?))
            })?;
            let Some((key, topic_id, topic, minute)) = first else { return Ok(None) };
            let sql = "SELECT seq, digest FROM held INDEXED BY held_unreported CROSS JOIN records ON n = record
                    WHERE report IS NULL AND minute = ?1 AND topic = ?2 ORDER BY record";
            let values = params![minute.cast_signed(), key];
            let records = connection.list(sql, values, |row| Ok((unsigned(row, 0)?, Digest(row.get(1)?))))?;
            Ok(Some(HeldMinute { topic_id, topic, minute, records }))
        })
    }

    /// Notes the counted records in the same commit.
    pub fn report(&self, report: NewRecord, counted: Vec<Digest>) -> Result<(), StoreError> {
        self.0.write_many(counted.len(), move |session| {
            let now = whole("time", Timestamp::now().0)?;
            add(session, &report, now)?;
            let sql = "UPDATE held SET report = ?2
                    WHERE report IS NULL AND record = (SELECT n FROM records WHERE digest = ?1)";
            let mark = |digest: &Digest| session.connection.changed(sql, params![digest.0, report.digest.0]);
            counted.iter().try_for_each(|digest| match mark(digest)? {
                1 => Ok(()),
                _ => Err(StoreError::NotReady { digest: *digest, found: "not quarantined, or already counted" }),
            })
        })
    }

    /// Moves records to stored; returns how many.
    pub fn release(&self, digests: &[Digest]) -> Result<u64, StoreError> {
        self.decide(digests, "released", RecordState::Stored)
    }

    /// Keeps digests, signatures and reasons; the caller discards ciphertext first. Returns how many.
    pub fn discard(&self, digests: &[Digest]) -> Result<u64, StoreError> {
        self.decide(digests, "discarded", RecordState::Dropped)
    }

    fn decide(&self, digests: &[Digest], decision: &'static str, to: RecordState) -> Result<u64, StoreError> {
        let from = RecordState::Quarantined;
        check(By::Operator, from, to)?;
        let digests = digests.to_vec();
        self.0.write_many(digests.len(), move |session| {
            let (connection, now) = (session.connection, whole("time", Timestamp::now().0)?);
            let mut decided = 0;
            for digest in &digests {
                let sql = "UPDATE records SET state = ?3 WHERE digest = ?1 AND state = ?2";
                let moved = connection.changed(sql, params![digest.0, from.code(), to.code()])?;
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
    let sql = "INSERT INTO held (record, minute, reason, publisher)
        SELECT n, captured_at / ?5, ?3, ?4 FROM records WHERE digest = ?1 AND state = ?2 ON CONFLICT DO NOTHING";
    let values = params![hold.digest.0, RecordState::Quarantined.code(), hold.reason, hold.publisher, MINUTE];
    let held = connection.changed(sql, values)?;
    let known = "SELECT 1 FROM held JOIN records ON n = record WHERE digest = ?1";
    if held == 0 && !connection.has(known, [hold.digest.0])? {
        return Err(StoreError::NotReady { digest: hold.digest, found: "not quarantined" });
    }
    Ok(())
}

fn note(connection: &Connection, digest: Digest, decision: &str, now: i64) -> Result<(), StoreError> {
    let sql = "UPDATE held SET decision = ?2, decided_at = ?3 WHERE record = (SELECT n FROM records WHERE digest = ?1)";
    connection.run(sql, params![digest.0, decision, now])
}

impl HeldRow {
    /// Not a definition.
    pub fn is_message(&self) -> bool {
        self.record.kind == RecordKind::Data
    }
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PinRow {
    pub topic: String,
    pub publisher: Publisher,
    /// `first` (first seen), or `operator`.
    pub source: String,
    pub at: Timestamp,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct AlarmRow {
    pub topic: String,
    /// As written in pins, or a URI. Untrusted text: clean it.
    pub publisher: String,
    /// The doubt's name.
    pub reason: String,
    pub at: Timestamp,
    /// Without a decision.
    pub open: bool,
}

impl Pins {
    /// Deletes alarms about them; existing pins stay.
    pub fn pin(
        &self,
        owner: Address,
        topic: &str,
        publishers: &[Publisher],
        source: &'static str,
    ) -> Result<(), StoreError> {
        let (topic, publishers) = (topic.to_owned(), publishers.to_vec());
        self.0.write(move |Session { connection, .. }| {
            connection.run("INSERT OR IGNORE INTO pinned_topics VALUES (?1, ?2)", params![owner.0, topic])?;
            let now = whole("time", Timestamp::now().0)?;
            publishers.iter().try_for_each(|publisher| pin(connection, owner, &topic, publisher, (source, now)))
        })
    }

    /// Returns how many there were.
    pub fn unpin(&self, owner: Address, topic: &str, caller_id: &str) -> Result<u64, StoreError> {
        let (topic, caller_id) = (topic.to_owned(), caller_id.to_owned());
        let sql = "DELETE FROM pins WHERE owner = ?1 AND topic = ?2 AND caller_id = ?3";
        self.0.changed(sql, (owner.0, topic, caller_id))
    }

    /// Of one topic or all.
    pub fn list(&self, owner: Address, topic: Option<&str>) -> Result<Vec<PinRow>, StoreError> {
        let sql = "SELECT topic, caller_id, host, type_name, md5sum, source, at FROM pins
            WHERE owner = ?1 AND (topic = ?2 OR ?2 IS NULL) ORDER BY topic, at, caller_id";
        self.0.list(sql, params![owner.0, topic], pin_row)
    }

    pub fn was_pinned(&self, owner: Address, topic: &str) -> Result<bool, StoreError> {
        self.0.has("SELECT 1 FROM pinned_topics WHERE owner = ?1 AND topic = ?2", params![owner.0, topic])
    }

    /// `false` if the publisher has an open alarm on this topic.
    pub fn raise_alarm(
        &self,
        owner: Address,
        topic: &str,
        publisher: &str,
        reason: &'static str,
    ) -> Result<bool, StoreError> {
        let (topic, publisher) = (topic.to_owned(), publisher.to_owned());
        let now = whole("time", Timestamp::now().0)?;
        let sql =
            "INSERT INTO alarms VALUES (?1, ?2, ?3, ?4, ?5, 1) ON CONFLICT DO UPDATE SET open = 1, at = excluded.at
                WHERE open = 0";
        Ok(self.0.changed(sql, (owner.0, topic, publisher, reason, now))? > 0)
    }

    /// Keeps the alarms, closed; returns how many were open.
    pub fn close_alarms(&self, owner: Address, topic: &str) -> Result<u64, StoreError> {
        let topic = topic.to_owned();
        let sql = "UPDATE alarms SET open = 0 WHERE owner = ?1 AND topic = ?2 AND open = 1";
        self.0.changed(sql, (owner.0, topic))
    }

    /// Includes closed ones; of one topic or all.
    pub fn alarms(&self, owner: Address, topic: Option<&str>) -> Result<Vec<AlarmRow>, StoreError> {
        let sql = "SELECT topic, publisher, reason, at, open FROM alarms
            WHERE owner = ?1 AND (topic = ?2 OR ?2 IS NULL) ORDER BY topic, at";
        self.0.list(sql, params![owner.0, topic], |row| {
            let (at, open) = (time(row, 3)?, row.get(4)?);
            Ok(AlarmRow { topic: row.get(0)?, publisher: row.get(1)?, reason: row.get(2)?, at, open })
        })
    }
}

fn pin(
    connection: &Connection,
    owner: Address,
    topic: &str,
    publisher: &Publisher,
    (source, now): (&str, i64),
) -> Result<(), StoreError> {
    let Publisher { caller_id, host, type_name, md5sum } = publisher;
    let sql = "INSERT OR IGNORE INTO pins VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8)";
    connection.run(sql, params![owner.0, topic, caller_id, host, type_name, md5sum, source, now])?;
    let sql = "DELETE FROM alarms WHERE owner = ?1 AND topic = ?2 AND publisher = ?3";
    connection.run(sql, params![owner.0, topic, publisher.to_string()])
}

fn pin_row(row: &Row<'_>) -> sql::Result<PinRow> {
    let (caller_id, host, type_name, md5sum) = (row.get(1)?, row.get(2)?, row.get(3)?, row.get(4)?);
    let publisher = Publisher { caller_id, host, type_name, md5sum };
    Ok(PinRow { topic: row.get(0)?, publisher, source: row.get(5)?, at: time(row, 6)? })
}

// Messages that did not become records: counted durably, then reported in a signed gap record.

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Loss {
    pub owner: Address,
    pub topic: String,
    /// Untrusted text.
    pub publisher: String,
    pub reason: LossReason,
    pub count: u64,
    /// First and last `header.seq`, if any.
    pub numbers: Option<(u32, u32)>,
    pub first_at: Timestamp,
    pub last_at: Timestamp,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct GapRow {
    pub key: i64,
    pub topic: String,
    /// Untrusted text: clean it.
    pub publisher: String,
    /// A [`LossReason`]'s name.
    pub reason: String,
    pub count: u64,
    /// First and last `header.seq`.
    pub numbers: Option<(u32, u32)>,
    pub first_at: Timestamp,
    pub last_at: Timestamp,
    /// The gap record that reports them.
    pub report: Option<Digest>,
}

const COLUMNS: &str =
    "key, topic, publisher, reason, count, first_number, last_number, first_at, last_at, report FROM gaps";

impl Losses {
    /// Counts all or none; gap records report them later.
    pub fn count(&self, losses: Vec<Loss>) -> Result<(), StoreError> {
        self.0.write(move |session| losses.iter().try_for_each(|loss| count_one(session.connection, loss)))
    }

    /// Notes the last text of [`crate::WaitingFile`] with counted losses in the same commit.
    pub fn count_up_to(&self, losses: Vec<Loss>, number: u64) -> Result<(), StoreError> {
        self.0.write(move |session| {
            losses.iter().try_for_each(|loss| count_one(session.connection, loss))?;
            notes::write_in(session.connection, &LossesCounted {}, &number)
        })
    }

    /// Unreported losses that began by `by`, oldest first.
    pub fn open_gaps(&self, owner: Address, by: Timestamp, limit: usize) -> Result<Vec<GapRow>, StoreError> {
        let sql = format!(
            "SELECT {COLUMNS} INDEXED BY gaps_open WHERE report IS NULL AND owner = ?1 AND first_at <= ?2
                ORDER BY key LIMIT ?3"
        );
        let (by, limit) = (capped(by.0), capped(limit));
        self.0.list(&sql, params![owner.0, by, limit], gap_row)
    }

    /// Notes the reported losses with the gap record in one commit. Later losses stay open.
    pub fn close_gap(&self, gap: &GapRow, report: NewRecord) -> Result<(), StoreError> {
        let gap = gap.clone();
        self.0.write(move |session| {
            add(session, &report, whole("time", Timestamp::now().0)?)?;
            settle(session.connection, &gap, report.digest)
        })
    }

    /// Newest first.
    pub fn gaps(&self, owner: Address, limit: usize) -> Result<Vec<GapRow>, StoreError> {
        let sql = format!("SELECT {COLUMNS} WHERE owner = ?1 ORDER BY key DESC LIMIT ?2");
        self.0.list(&sql, params![owner.0, capped(limit)], gap_row)
    }
}

fn count_one(connection: &Connection, loss: &Loss) -> Result<(), StoreError> {
    let (count, word) = (whole("count", loss.count)?, loss.reason.word());
    let sql = "INSERT INTO drops VALUES (?1, ?2, ?3, ?4) ON CONFLICT DO UPDATE SET count = count + excluded.count";
    connection.run(sql, params![loss.owner.0, loss.topic, word, count])?;
    let sql = "INSERT INTO gaps (owner, topic, publisher, reason, count, first_number, last_number, first_at, last_at)
        VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9)
        ON CONFLICT (owner, topic, publisher, reason) WHERE report IS NULL DO UPDATE SET
        count = count + excluded.count, last_number = excluded.last_number, last_at = excluded.last_at,
        first_number = coalesce(first_number, excluded.first_number)";
    let Loss { owner, topic, publisher, numbers, .. } = loss;
    let (first, last) = (numbers.map(|(first, _)| first), numbers.map(|(_, last)| last));
    let (first_at, last_at) = (whole("time", loss.first_at.0)?, whole("time", loss.last_at.0)?);
    connection.run(sql, params![owner.0, topic, publisher, word, count, first, last, first_at, last_at])
}

fn settle(connection: &Connection, gap: &GapRow, report: Digest) -> Result<(), StoreError> {
    let not_open = || StoreError::NotReady { digest: report, found: "already reported" };
    let told = whole("count", gap.count)?;
    let sql = "SELECT count, last_number, last_at FROM gaps WHERE key = ?1 AND report IS NULL";
    let found = connection.find(sql, [gap.key], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?)))?;
    let (count, last_number, last_at): (i64, Option<u32>, i64) =
        found.filter(|(count, ..)| *count >= told).ok_or_else(not_open)?;
    let sql = "UPDATE gaps SET report = ?2, count = ?3, last_number = ?4, last_at = ?5 WHERE key = ?1";
    let (number, at) = (gap.numbers.map(|(_, last)| last), whole("time", gap.last_at.0)?);
    connection.run(sql, params![gap.key, report.0, told, number, at])?;
    if count > told {
        let sql =
            "INSERT INTO gaps (owner, topic, publisher, reason, count, first_number, last_number, first_at, last_at)
                SELECT owner, topic, publisher, reason, ?2, last_number, ?3, last_at, ?4 FROM gaps WHERE key = ?1";
        connection.run(sql, params![gap.key, count - told, last_number, last_at])?;
    }
    Ok(())
}

fn gap_row(row: &Row<'_>) -> sql::Result<GapRow> {
    let (key, topic, publisher, reason) = (row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?);
    let numbers = row.get::<Option<u32>>(5)?.zip(row.get::<Option<u32>>(6)?);
    let (count, first_at, last_at) = (unsigned(row, 4)?, time(row, 7)?, time(row, 8)?);
    let report = row.get::<Option<_>>(9)?.map(Digest);
    Ok(GapRow { key, topic, publisher, reason, count, numbers, first_at, last_at, report })
}

#[cfg(test)]
mod pins_tests {
    use super::*;
    use crate::Ledger;

    const OWNER: Address = Address([1; 20]);

    fn publisher(name: &str) -> Publisher {
        format!("/{name}@h:a/B:{}", "0".repeat(32)).parse().expect("good")
    }

    #[test]
    fn pins_outlive_the_process_and_there_is_one_first_use() {
        let home = tempfile::tempdir().expect("folder");
        let path = home.path().join("ledger.db");
        let ledger = Ledger::open(&path).expect("opens");
        assert_eq!((ledger.pins.was_pinned(OWNER, "/t"), ledger.pins.list(OWNER, None)), (Ok(false), Ok(Vec::new())));
        ledger.pins.pin(OWNER, "/t", &[publisher("a")], "first").expect("pinned");
        ledger.pins.pin(OWNER, "/t", &[publisher("a"), publisher("b")], "operator").expect("pinned");
        ledger.close().expect("closed");
        let ledger = Ledger::open(&path).expect("opens");
        let pins = ledger.pins.list(OWNER, Some("/t")).expect("read");
        let told: Vec<_> = pins.iter().map(|pin| (pin.publisher.caller_id.as_str(), pin.source.as_str())).collect();
        assert_eq!(told, [("/a", "first"), ("/b", "operator")]);
        assert_eq!((ledger.pins.unpin(OWNER, "/t", "/a"), ledger.pins.unpin(OWNER, "/t", "/a")), (Ok(1), Ok(0)));
        assert_eq!(ledger.pins.unpin(OWNER, "/t", "/b"), Ok(1));
        assert_eq!((ledger.pins.was_pinned(OWNER, "/t"), ledger.pins.was_pinned(OWNER, "/u")), (Ok(true), Ok(false)));
        assert_eq!(ledger.pins.list(Address([2; 20]), None), Ok(Vec::new()));
    }

    #[test]
    fn an_alarm_is_raised_once_until_it_is_decided() {
        let home = tempfile::tempdir().expect("folder");
        let ledger = Ledger::open(&home.path().join("ledger.db")).expect("opens");
        let name = publisher("evil").to_string();
        let raise = || ledger.pins.raise_alarm(OWNER, "/t", &name, "new").expect("written");
        assert!(raise() && !raise());
        assert!(ledger.pins.raise_alarm(OWNER, "/u", &name, "new").expect("written"));
        assert_eq!((ledger.pins.close_alarms(OWNER, "/t"), ledger.pins.close_alarms(OWNER, "/t")), (Ok(1), Ok(0)));
        let open =
            |topic| ledger.pins.alarms(OWNER, Some(topic)).expect("read").iter().filter(|alarm| alarm.open).count();
        assert_eq!((open("/t"), open("/u"), ledger.pins.alarms(OWNER, None).expect("read").len()), (0, 1, 2));
        assert!(raise());
        ledger.pins.pin(OWNER, "/t", &[publisher("evil")], "operator").expect("pinned");
        assert_eq!(ledger.pins.alarms(OWNER, Some("/t")), Ok(Vec::new()));
    }
}
