//! Records that somebody had erased: named like those of retention, with who and why, and overwritten, not only freed.

use std::fmt;

use rusqlite::{Connection, OptionalExtension as _, params};

use super::append::add;
use super::retention::name;
use super::{Ledger, NewRecord, database, database::whole};
use crate::crypto::ErasedStatement;
use crate::model::{Digest, Timestamp, clean};
use crate::store::StoreError;

/// Who had records erased, when and why.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Erasure {
    /// When.
    pub at: Timestamp,
    /// The profile.
    pub by: String,
    /// Why, in its words.
    pub reason: String,
}

/// What came here in place of a record that its owner had erased.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TakenErased {
    /// The public header of its stored bytes.
    pub header: Vec<u8>,
    /// The retention record that names it, which need not be here.
    pub report: Digest,
    /// When it was decided.
    pub at: Timestamp,
    /// What the owner states, signed.
    pub statement: Vec<u8>,
}

impl fmt::Display for Erasure {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "erased {} by {}, {}", self.at, clean(&self.by, 80), clean(&self.reason, 500))
    }
}

impl Erasure {
    /// As the ledger notes it: nanoseconds, profile and reason, a line each.
    fn noted(&self) -> String {
        format!("{}\n{}\n{}", self.at.0, self.by, self.reason)
    }

    /// As a reader is told: by whom and why is in the owner's retention record.
    pub(super) fn stated(statement: &[u8]) -> Option<Self> {
        let at = ErasedStatement::parse(statement).ok()?.at;
        Some(Self { at, by: "its owner".to_owned(), reason: "its proof remains".to_owned() })
    }

    /// From a note.
    pub(super) fn read(text: &str) -> Option<Self> {
        let mut lines = text.splitn(3, '\n');
        let at = Timestamp(lines.next()?.parse().ok()?);
        Some(Self { at, by: lines.next()?.to_owned(), reason: lines.next()?.to_owned() })
    }
}

/// The setting that says whose erasure a retention record is.
pub(super) fn place(report: &Digest) -> String {
    format!("erased:{report}")
}

/// Makes a record that a rule has named, and whose bytes are still here, this erasure's; `false` if it is not such a one.
fn take_from_rule(connection: &Connection, digest: Digest, report: Digest) -> Result<bool, StoreError> {
    let taken = connection
        .prepare_cached(
            "UPDATE retained SET report = ?2 WHERE record = (SELECT n FROM records WHERE digest = ?1)
             AND deleted_at IS NULL
             AND NOT EXISTS (SELECT 1 FROM settings WHERE key = 'erased:' || lower(hex(report)))",
        )?
        .execute(params![digest.0, report.0])?;
    Ok(taken > 0)
}

/// Counts a record among those of its topic whose ciphertext is given up.
pub(super) fn count_given_up(connection: &Connection, digest: Digest) -> Result<(), StoreError> {
    connection
        .prepare_cached(
            "INSERT INTO retained_topics SELECT topic, 1, bytes FROM records WHERE digest = ?1
             ON CONFLICT DO UPDATE SET records = records + excluded.records, bytes = bytes + excluded.bytes",
        )?
        .execute([digest.0])?;
    Ok(())
}

impl Ledger {
    /// Acknowledges the retention record of an erasure, notes who and why, and names the records with their public
    /// headers, in one commit. What a rule has named and is not deleted yet is the erasure's from then on.
    ///
    /// # Errors
    /// See [`Ledger::append`]; [`StoreError::NotReady`] if one of them is not verified, already deleted, or another
    /// erasure's.
    pub fn erase(
        &self,
        report: NewRecord,
        erasure: &Erasure,
        records: Vec<(Digest, Vec<u8>)>,
    ) -> Result<(), StoreError> {
        let (place, text) = (place(&report.digest), erasure.noted());
        self.write_many(records.len(), move |session| {
            let (connection, now) = (session.connection, whole("time", Timestamp::now().0)?);
            add(session, &report, now)?;
            connection.prepare_cached("REPLACE INTO settings VALUES (?1, ?2)")?.execute([&place, &text])?;
            for (digest, header) in &records {
                if take_from_rule(connection, *digest, report.digest)? {
                    continue;
                }
                name(connection, *digest, report.digest, header)?;
                count_given_up(connection, *digest)?;
            }
            Ok(())
        })
    }

    /// Whose erasure a retention record is; `None` for one of a rule.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn erasure(&self, report: Digest) -> Result<Option<Erasure>, StoreError> {
        Ok(self.setting(&place(&report))?.and_then(|text| Erasure::read(&text)))
    }

    /// Notes a record that its owner had erased before it came here: its row, its public header, and the owner's
    /// statement, in one commit. `false` if it is here with its bytes: then nothing changes.
    ///
    /// # Errors
    /// See [`Ledger::append`].
    pub fn take_erased(&self, record: NewRecord, taken: TakenErased) -> Result<bool, StoreError> {
        self.takes_records()?;
        self.write(move |session| {
            let digest = record.digest.0;
            let here = "SELECT 1 FROM records WHERE digest = ?1 AND deleted_at IS NULL";
            if session.connection.prepare_cached(here)?.exists([digest])? {
                return Ok(false);
            }
            add(session, &record, whole("time", Timestamp::now().0)?)?;
            let (connection, at) = (session.connection, whole("time", taken.at.0)?);
            let named = connection
                .prepare_cached(
                    "INSERT INTO retained (record, report, header, deleted_at) SELECT n, ?2, ?3, ?4 FROM records
                     WHERE digest = ?1 ON CONFLICT DO NOTHING",
                )?
                .execute(params![digest, taken.report.0, taken.header, at])?;
            if named > 0 {
                count_given_up(connection, record.digest)?;
            }
            connection
                .prepare_cached("UPDATE records SET deleted_at = ?2 WHERE digest = ?1 AND deleted_at IS NULL")?
                .execute(params![digest, at])?;
            connection
                .prepare_cached(
                    "INSERT INTO erasures (record, statement, taken) SELECT n, ?2, 1 FROM records WHERE digest = ?1
                     ON CONFLICT DO NOTHING",
                )?
                .execute(params![digest, taken.statement])?;
            Ok(true)
        })
    }

    /// Those of these records that somebody had erased, here or elsewhere.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn erased_among(&self, digests: &[Digest]) -> Result<Vec<Digest>, StoreError> {
        self.read(|connection| {
            let mut statement = connection.prepare_cached(
                "SELECT 1 FROM retained JOIN records ON records.n = retained.record WHERE digest = ?1
                 AND (EXISTS (SELECT 1 FROM settings WHERE key = 'erased:' || lower(hex(report)))
                     OR EXISTS (SELECT 1 FROM erasures WHERE erasures.record = records.n AND taken = 1))",
            )?;
            let mut erased = Vec::new();
            for digest in digests {
                if statement.exists(params![digest.0])? {
                    erased.push(*digest);
                }
            }
            Ok(erased)
        })
    }

    /// Whether ciphertext of any owner is named and not deleted yet.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn has_named(&self) -> Result<bool, StoreError> {
        self.read(|connection| {
            let sql = "SELECT record FROM retained WHERE deleted_at IS NULL LIMIT 1";
            Ok(connection.prepare_cached(sql)?.query_row([], |_| Ok(())).optional()?.is_some())
        })
    }

    /// Overwrites the local copies of these records, in the file and in its log.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like; [`StoreError::Database`] while somebody reads an earlier state.
    pub fn scour_local_copies(&self, digests: &[Digest]) -> Result<(), StoreError> {
        if digests.is_empty() {
            return Ok(());
        }
        let digests = digests.to_vec();
        self.write_many(digests.len(), move |session| {
            database::overwriting(session.connection, |connection| {
                let sql = "DELETE FROM copies WHERE record = (SELECT n FROM records WHERE digest = ?1)";
                let mut statement = connection.prepare_cached(sql)?;
                digests.iter().try_for_each(|digest| Ok(statement.execute([digest.0]).map(drop)?))
            })
        })?;
        // Also when nothing was left to delete: an earlier attempt may have failed at the log.
        database::empty_log(self.path())
    }
}
