//! Messages that did not become records: counted durably per topic and reason, then reported in a signed gap record.

use rusqlite::{Connection, OptionalExtension as _, Row, params};
use serde::{Deserialize, Serialize};

use super::append::add;
use super::rows::unsigned;
use super::{Ledger, NewRecord, database::whole};
use crate::model::{Address, Digest, LossReason, Timestamp};
use crate::store::StoreError;

/// Messages of one topic and publisher that were lost for one reason.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Loss {
    /// The owner.
    pub owner: Address,
    /// Topic name.
    pub topic: String,
    /// The sending node; untrusted text.
    pub publisher: String,
    /// The reason.
    pub reason: LossReason,
    /// The number.
    pub count: u64,
    /// `header.seq` of the first and the last, if they have one.
    pub numbers: Option<(u32, u32)>,
    /// When the first loss was noticed.
    pub first_at: Timestamp,
    /// When the last loss was noticed.
    pub last_at: Timestamp,
}

/// Losses as stored in the ledger.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct GapRow {
    /// The id of the row.
    pub key: i64,
    /// Topic name.
    pub topic: String,
    /// The sending node; untrusted text: clean it.
    pub publisher: String,
    /// The name of the [`LossReason`].
    pub reason: String,
    /// The number.
    pub count: u64,
    /// `header.seq` of the first and the last.
    pub numbers: Option<(u32, u32)>,
    /// When the first loss was noticed.
    pub first_at: Timestamp,
    /// When the last loss was noticed.
    pub last_at: Timestamp,
    /// The gap record that reports them; none until it is sealed.
    pub report: Option<Digest>,
}

/// The setting with the number of a text of losses.
const COUNTED: &str = "waiting:counted";

const COLUMNS: &str =
    "key, topic, publisher, reason, count, first_number, last_number, first_at, last_at, report FROM gaps";

impl Ledger {
    /// Counts losses durably, all or none; they stay open until a gap record reports them.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like; then none is counted yet.
    pub fn count_losses(&self, losses: Vec<Loss>) -> Result<(), StoreError> {
        self.write(move |session| losses.iter().try_for_each(|loss| count_one(session.connection, loss)))
    }

    /// The same, and notes in the same commit up to which text of [`crate::store::WaitingFile`] its losses are counted.
    ///
    /// # Errors
    /// See [`Self::count_losses`].
    pub fn count_losses_up_to(&self, losses: Vec<Loss>, number: u64) -> Result<(), StoreError> {
        self.write(move |session| {
            losses.iter().try_for_each(|loss| count_one(session.connection, loss))?;
            let values = [COUNTED.to_owned(), number.to_string()];
            session.connection.prepare_cached("REPLACE INTO settings VALUES (?1, ?2)")?.execute(values)?;
            Ok(())
        })
    }

    /// Up to which text its losses are counted; 0 = none.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn losses_counted(&self) -> Result<u64, StoreError> {
        Ok(self.setting(COUNTED)?.and_then(|text| text.parse().ok()).unwrap_or(0))
    }

    /// Losses of an owner that no gap record reports and that began before a given time, oldest first, at most `limit`.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn open_gaps(&self, owner: Address, by: Timestamp, limit: usize) -> Result<Vec<GapRow>, StoreError> {
        self.read(|connection| {
            let sql = format!(
                "SELECT {COLUMNS} INDEXED BY gaps_open WHERE report IS NULL AND owner = ?1 AND first_at <= ?2
                 ORDER BY key LIMIT ?3"
            );
            let (by, limit) = (i64::try_from(by.0).unwrap_or(i64::MAX), i64::try_from(limit).unwrap_or(i64::MAX));
            let mut statement = connection.prepare_cached(&sql)?;
            let rows = statement.query_map(params![owner.0, by, limit], gap_row)?;
            Ok(rows.collect::<Result<_, _>>()?)
        })
    }

    /// Acknowledges a gap record and notes the losses it reports, in one commit. Losses since the row was read stay
    /// open.
    ///
    /// # Errors
    /// See [`Ledger::append`]; [`StoreError::NotReady`] if the row is already reported.
    pub fn close_gap(&self, gap: &GapRow, report: NewRecord) -> Result<(), StoreError> {
        let gap = gap.clone();
        self.write(move |session| {
            let now = whole("time", Timestamp::now().0)?;
            add(session, &report, now)?;
            settle(session.connection, &gap, report.digest)
        })
    }

    /// The losses of an owner, newest first, at most `limit`.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn gaps(&self, owner: Address, limit: usize) -> Result<Vec<GapRow>, StoreError> {
        self.read(|connection| {
            let sql = format!("SELECT {COLUMNS} WHERE owner = ?1 ORDER BY key DESC LIMIT ?2");
            let mut statement = connection.prepare_cached(&sql)?;
            let rows = statement.query_map(params![owner.0, i64::try_from(limit).unwrap_or(i64::MAX)], gap_row)?;
            Ok(rows.collect::<Result<_, _>>()?)
        })
    }
}

fn count_one(connection: &Connection, loss: &Loss) -> Result<(), StoreError> {
    let (count, word) = (whole("count", loss.count)?, loss.reason.word());
    connection
        .prepare_cached(
            "INSERT INTO drops VALUES (?1, ?2, ?3, ?4) ON CONFLICT DO UPDATE SET count = count + excluded.count",
        )?
        .execute(params![loss.owner.0, loss.topic, word, count])?;
    connection
        .prepare_cached(
            "INSERT INTO gaps (owner, topic, publisher, reason, count, first_number, last_number, first_at, last_at)
             VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9)
             ON CONFLICT (owner, topic, publisher, reason) WHERE report IS NULL DO UPDATE SET
             count = count + excluded.count, last_number = excluded.last_number, last_at = excluded.last_at,
             first_number = coalesce(first_number, excluded.first_number)",
        )?
        .execute(params![
            loss.owner.0,
            loss.topic,
            loss.publisher,
            word,
            count,
            loss.numbers.map(|(first, _)| first),
            loss.numbers.map(|(_, last)| last),
            whole("time", loss.first_at.0)?,
            whole("time", loss.last_at.0)?,
        ])?;
    Ok(())
}

fn settle(connection: &Connection, gap: &GapRow, report: Digest) -> Result<(), StoreError> {
    let not_open = || StoreError::NotReady { digest: report, found: "already reported" };
    let told = whole("count", gap.count)?;
    let (count, last_number, last_at): (i64, Option<u32>, i64) = connection
        .prepare_cached("SELECT count, last_number, last_at FROM gaps WHERE key = ?1 AND report IS NULL")?
        .query_row([gap.key], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?)))
        .optional()?
        .filter(|(count, _, _)| *count >= told)
        .ok_or_else(not_open)?;
    connection
        .prepare_cached("UPDATE gaps SET report = ?2, count = ?3, last_number = ?4, last_at = ?5 WHERE key = ?1")?
        .execute(params![gap.key, report.0, told, gap.numbers.map(|(_, last)| last), whole("time", gap.last_at.0)?])?;
    if count > told {
        connection
            .prepare_cached(
                "INSERT INTO gaps (owner, topic, publisher, reason, count, first_number, last_number, first_at, last_at)
                 SELECT owner, topic, publisher, reason, ?2, last_number, ?3, last_at, ?4 FROM gaps WHERE key = ?1",
            )?
            .execute(params![gap.key, count - told, last_number, last_at])?;
    }
    Ok(())
}

fn gap_row(row: &Row<'_>) -> rusqlite::Result<GapRow> {
    let numbers = row.get::<_, Option<u32>>(5)?.zip(row.get::<_, Option<u32>>(6)?);
    Ok(GapRow {
        key: row.get(0)?,
        topic: row.get(1)?,
        publisher: row.get(2)?,
        reason: row.get(3)?,
        count: unsigned(row, 4)?,
        numbers,
        first_at: Timestamp(unsigned(row, 7)?),
        last_at: Timestamp(unsigned(row, 8)?),
        report: row.get::<_, Option<_>>(9)?.map(Digest),
    })
}
