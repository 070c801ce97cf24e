//! Pinned publishers of topics, and the alarms raised about others.

use rusqlite::{Connection, Row, params};
use serde::{Deserialize, Serialize};

use super::append::count;
use super::{Ledger, database::whole, rows::unsigned};
use crate::model::{Address, Publisher, Timestamp};
use crate::store::StoreError;

/// A pinned publisher.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PinRow {
    /// The topic.
    pub topic: String,
    /// The publisher.
    pub publisher: Publisher,
    /// `first` (first seen), or `operator`.
    pub source: String,
    /// When it was pinned.
    pub at: Timestamp,
}

/// An alarm about a publisher.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct AlarmRow {
    /// The topic.
    pub topic: String,
    /// Its publisher, written as in pins, or a URI. Untrusted text: clean it.
    pub publisher: String,
    /// The name of the doubt.
    pub reason: String,
    /// When it was raised.
    pub at: Timestamp,
    /// Whether the operator has yet to decide.
    pub open: bool,
}

impl Ledger {
    /// Pins publishers of a topic; those already pinned are unchanged. Alarms about them are deleted.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like; then none is pinned.
    pub fn pin(
        &self,
        owner: Address,
        topic: &str,
        publishers: &[Publisher],
        source: &'static str,
    ) -> Result<(), StoreError> {
        let (topic, publishers) = (topic.to_owned(), publishers.to_vec());
        self.write(move |session| {
            let connection = session.connection;
            connection.execute("INSERT OR IGNORE INTO pinned_topics VALUES (?1, ?2)", params![owner.0, topic])?;
            let now = whole("time", Timestamp::now().0)?;
            publishers.iter().try_for_each(|publisher| pin(connection, owner, &topic, publisher, (source, now)))
        })
    }

    /// Removes every pin of a caller id on a topic; returns how many there were.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like; then none is removed.
    pub fn unpin(&self, owner: Address, topic: &str, caller_id: &str) -> Result<u64, StoreError> {
        let (topic, caller_id) = (topic.to_owned(), caller_id.to_owned());
        self.write(move |session| {
            let sql = "DELETE FROM pins WHERE owner = ?1 AND topic = ?2 AND caller_id = ?3";
            Ok(count(session.connection.execute(sql, params![owner.0, topic, caller_id])?))
        })
    }

    /// The pins of an owner, of one topic or of all.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn pins(&self, owner: Address, topic: Option<&str>) -> Result<Vec<PinRow>, StoreError> {
        self.read(|connection| {
            let mut statement = connection.prepare_cached(
                "SELECT topic, caller_id, host, type_name, md5sum, source, at FROM pins
                 WHERE owner = ?1 AND (?2 IS NULL OR topic = ?2) ORDER BY topic, at, caller_id",
            )?;
            let rows = statement.query_map(params![owner.0, topic], pin_row)?;
            Ok(rows.collect::<Result<_, _>>()?)
        })
    }

    /// Whether a topic ever had pins.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn was_pinned(&self, owner: Address, topic: &str) -> Result<bool, StoreError> {
        self.read(|connection| {
            let mut statement =
                connection.prepare_cached("SELECT 1 FROM pinned_topics WHERE owner = ?1 AND topic = ?2")?;
            Ok(statement.exists(params![owner.0, topic])?)
        })
    }

    /// Raises an alarm; `false` if the same publisher already has an open alarm on this topic.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like.
    pub fn raise_alarm(
        &self,
        owner: Address,
        topic: &str,
        publisher: &str,
        reason: &'static str,
    ) -> Result<bool, StoreError> {
        let (topic, publisher) = (topic.to_owned(), publisher.to_owned());
        self.write(move |session| {
            let now = whole("time", Timestamp::now().0)?;
            let raised = session.connection.execute(
                "INSERT INTO alarms VALUES (?1, ?2, ?3, ?4, ?5, 1) ON CONFLICT DO UPDATE SET open = 1, at = excluded.at
                 WHERE open = 0",
                params![owner.0, topic, publisher, reason, now],
            )?;
            Ok(raised > 0)
        })
    }

    /// The operator has decided about a topic: its alarms are closed but kept. Returns how many were open.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like.
    pub fn close_alarms(&self, owner: Address, topic: &str) -> Result<u64, StoreError> {
        let topic = topic.to_owned();
        self.write(move |session| {
            let sql = "UPDATE alarms SET open = 0 WHERE owner = ?1 AND topic = ?2 AND open = 1";
            Ok(count(session.connection.execute(sql, params![owner.0, topic])?))
        })
    }

    /// The alarms of an owner, including closed ones, of one topic or of all.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn alarms(&self, owner: Address, topic: Option<&str>) -> Result<Vec<AlarmRow>, StoreError> {
        self.read(|connection| {
            let mut statement = connection.prepare_cached(
                "SELECT topic, publisher, reason, at, open FROM alarms
                 WHERE owner = ?1 AND (?2 IS NULL OR topic = ?2) ORDER BY topic, at",
            )?;
            let rows = statement.query_map(params![owner.0, topic], |row| {
                Ok(AlarmRow {
                    topic: row.get(0)?,
                    publisher: row.get(1)?,
                    reason: row.get(2)?,
                    at: Timestamp(unsigned(row, 3)?),
                    open: row.get(4)?,
                })
            })?;
            Ok(rows.collect::<Result<_, _>>()?)
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
    connection.execute(
        "INSERT OR IGNORE INTO pins VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8)",
        params![owner.0, topic, caller_id, host, type_name, md5sum, source, now],
    )?;
    connection.execute(
        "DELETE FROM alarms WHERE owner = ?1 AND topic = ?2 AND publisher = ?3",
        params![owner.0, topic, publisher.to_string()],
    )?;
    Ok(())
}

fn pin_row(row: &Row<'_>) -> rusqlite::Result<PinRow> {
    Ok(PinRow {
        topic: row.get(0)?,
        publisher: Publisher { caller_id: row.get(1)?, host: row.get(2)?, type_name: row.get(3)?, md5sum: row.get(4)? },
        source: row.get(5)?,
        at: Timestamp(unsigned(row, 6)?),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const OWNER: Address = Address([1; 20]);

    fn publisher(name: &str) -> Publisher {
        format!("/{name}@h:a/B:{}", "0".repeat(32)).parse().expect("good")
    }

    #[test]
    fn pins_outlive_the_process_and_there_is_one_first_use() {
        let home = tempfile::tempdir().expect("folder");
        let path = home.path().join("ledger.db");
        let ledger = Ledger::open(&path).expect("opens");
        assert_eq!((ledger.was_pinned(OWNER, "/t"), ledger.pins(OWNER, None)), (Ok(false), Ok(Vec::new())));
        ledger.pin(OWNER, "/t", &[publisher("a")], "first").expect("pinned");
        ledger.pin(OWNER, "/t", &[publisher("a"), publisher("b")], "operator").expect("pinned");
        ledger.close().expect("closed");
        let ledger = Ledger::open(&path).expect("opens");
        let pins = ledger.pins(OWNER, Some("/t")).expect("read");
        let told: Vec<_> = pins.iter().map(|pin| (pin.publisher.caller_id.as_str(), pin.source.as_str())).collect();
        assert_eq!(told, [("/a", "first"), ("/b", "operator")]);
        assert_eq!((ledger.unpin(OWNER, "/t", "/a"), ledger.unpin(OWNER, "/t", "/a")), (Ok(1), Ok(0)));
        assert_eq!(ledger.unpin(OWNER, "/t", "/b"), Ok(1));
        assert_eq!((ledger.was_pinned(OWNER, "/t"), ledger.was_pinned(OWNER, "/u")), (Ok(true), Ok(false)));
        assert_eq!(ledger.pins(Address([2; 20]), None), Ok(Vec::new()));
    }

    #[test]
    fn an_alarm_is_raised_once_until_it_is_decided() {
        let home = tempfile::tempdir().expect("folder");
        let ledger = Ledger::open(&home.path().join("ledger.db")).expect("opens");
        let name = publisher("evil").to_string();
        let raise = || ledger.raise_alarm(OWNER, "/t", &name, "new").expect("written");
        assert!(raise() && !raise());
        assert!(ledger.raise_alarm(OWNER, "/u", &name, "new").expect("written"));
        assert_eq!((ledger.close_alarms(OWNER, "/t"), ledger.close_alarms(OWNER, "/t")), (Ok(1), Ok(0)));
        let open = |topic| ledger.alarms(OWNER, Some(topic)).expect("read").iter().filter(|alarm| alarm.open).count();
        assert_eq!((open("/t"), open("/u"), ledger.alarms(OWNER, None).expect("read").len()), (0, 1, 2));
        assert!(raise());
        ledger.pin(OWNER, "/t", &[publisher("evil")], "operator").expect("pinned");
        assert_eq!(ledger.alarms(OWNER, Some("/t")), Ok(Vec::new()));
    }
}
