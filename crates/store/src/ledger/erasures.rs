//! What owners state of records that they had erased: noted with each erasure, told in a fixed order to the gateway that a home
//! joins, and taken there. A copy goes only where the owner's account has signed, too.

use std::fmt;
use std::sync::atomic::Ordering;

use rusqlite::{Connection, params};
use serde::{Deserialize, Serialize};

use super::append::add;
use super::batches::take_in;
use super::retention::{is_held, name};
use super::rows::{LEARNED_NAME, state, unsigned};
use super::{Erasures, NewRecord, RootSighting};
use crate::StoreError;
use crate::crypto::ErasedStatement;
use crate::crypto::merkle::Inclusion;
use crate::database::{Statements as _, capped, whole};
use crate::model::{Address, Digest, PublicKey, RecordState, Timestamp, clean};
use crate::notes::{self, Erased};

/// What an owner of this home states of an erased record.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StatedErasure {
    pub digest: Digest,
    /// What is stated, signed by d_C.
    pub statement: Vec<u8>,
    /// The signature of the owner's account; `None` = not signed by it.
    pub account: Option<Vec<u8>>,
}

/// A statement as it is kept.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeptErasure {
    /// What is stated, signed by d_C.
    pub statement: Vec<u8>,
    /// The signature of the owner's account.
    pub account: Option<Vec<u8>>,
    /// Whether it came from elsewhere.
    pub taken: bool,
}

/// An erased record of an owner of this home about which the owner states nothing that holds today.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Unstated {
    pub digest: Digest,
    /// The retention record that names it.
    pub report: Digest,
    pub header: Vec<u8>,
    /// Who had it erased, when and why.
    pub erasure: Erasure,
}

/// A part of what was erased here.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ErasurePage {
    /// Records with statement and account's signature.
    pub erasures: Vec<(Digest, Vec<u8>, Vec<u8>)>,
    /// The number of the last one, if there is any.
    pub last: Option<u64>,
    /// Whether more may follow.
    pub more: bool,
}

/// What became of a record that its owner told was erased.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ToldErased {
    /// It was never here: it is listed without bytes from now on.
    Listed,
    /// Its bytes are here, and named to be overwritten.
    Named,
    /// It was gone already; the statement is the newer one now.
    Restated,
    /// Nothing changed: this home decided about it itself, or it is in a state in which nobody may.
    Unchanged,
}

impl Erasures {
    /// Notes what owners of this home state of records that they had erased; what was noted before is replaced.
    pub fn keep(&self, stated: Vec<StatedErasure>) -> Result<(), StoreError> {
        let sql = "REPLACE INTO erasures (record, statement, account, taken)
            SELECT n, ?2, ?3, coalesce((SELECT taken FROM erasures WHERE record = records.n), 0)
            FROM records WHERE digest = ?1";
        self.0
            .run_each(sql, stated.into_iter().map(|one| (one.digest.0, one.statement, one.account)).collect())
            .map(drop)
    }

    /// What is stated of an erased record.
    pub fn kept(&self, digest: Digest) -> Result<Option<KeptErasure>, StoreError> {
        self.0.read(|connection| kept(connection, digest))
    }

    /// What was erased here and may be told to the gateway after a number, in order: what its owner's account has signed for, and
    /// whose bytes are gone.
    pub fn list(&self, after: u64, limit: usize) -> Result<ErasurePage, StoreError> {
        self.0.read(|connection| {
            let sql = "SELECT erasures.n, digest, statement, account FROM erasures JOIN records one ON one.n = record
                WHERE erasures.n > ?1 AND account IS NOT NULL AND deleted_at IS NOT NULL ORDER BY erasures.n LIMIT ?2";
            let rows: Vec<_> = connection.list(sql, params![capped(after), capped(limit)], |row| {
                Ok((unsigned(row, 0)?, (Digest(row.get(1)?), row.get(2)?, row.get(3)?)))
            })?;
            let (last, more) = (rows.last().map(|(number, _)| *number), rows.len() >= limit);
            Ok(ErasurePage { erasures: rows.into_iter().map(|(_, erasure)| erasure).collect(), last, more })
        })
    }

    /// Records that an owner of this home had erased and does not state with this key and the account, at most `limit`. Looks
    /// at all that is deleted: not to be asked often.
    pub fn unstated(&self, owner: Address, key: &PublicKey, limit: usize) -> Result<Vec<Unstated>, StoreError> {
        self.0.read(|connection| {
            // P_C is behind the retention record (32) and the time (8) of a statement.
            let sql = "SELECT one.digest, report, header FROM retained JOIN records one ON one.n = retained.record
                JOIN topics t ON t.key = one.topic
                JOIN notes ON notes.kind = 'erased' AND about = lower(hex(report))
                LEFT JOIN erasures ON erasures.record = retained.record
                WHERE t.owner = ?1 AND retained.deleted_at IS NOT NULL
                AND (account IS NULL OR substr(statement, 41, 64) <> ?2) LIMIT ?3";
            let rows: Vec<_> = connection.list(sql, params![owner.0, key.0, capped(limit)], |row| {
                Ok((Digest(row.get(0)?), Digest(row.get(1)?), row.get(2)?))
            })?;
            let mut found = Vec::new();
            for (digest, report, header) in rows {
                let erasure = notes::read_in(connection, &Erased { report })?;
                found.extend(erasure.map(|erasure| Unstated { digest, report, header, erasure }));
            }
            Ok(found)
        })
    }

    /// Takes what an owner told of an erased record, after everything about it was checked: its row with its anchor if it
    /// was never here, otherwise its bytes are named to be overwritten; the statement with it, in one commit.
    pub fn take_told(
        &self,
        record: NewRecord,
        (taken, account): (TakenErased, Vec<u8>),
        (inclusion, anchor): (Inclusion, RootSighting),
    ) -> Result<ToldErased, StoreError> {
        self.0.takes_records()?;
        let told = self.0.write(move |session| {
            let (digest, now) = (record.digest, whole("time", Timestamp::now().0)?);
            let before = found(session.connection, digest)?;
            add(session, &record, now)?;
            let connection = session.connection;
            let told = match before {
                None => list(connection, digest, &taken)?,
                Some((_, true)) => restate(connection, digest, &taken)?,
                Some((state, false)) if may_go(state) => give_up(connection, digest, &taken)?,
                Some(_) => ToldErased::Unchanged,
            };
            if told == ToldErased::Unchanged {
                return Ok(told);
            }
            let sql = "REPLACE INTO erasures (record, statement, account, taken)
                SELECT n, ?2, ?3, 1 FROM records WHERE digest = ?1";
            connection.run(sql, params![digest.0, taken.statement, account])?;
            take_in(connection, digest, &inclusion, &anchor)?;
            Ok(told)
        })?;
        self.0.shared.told.fetch_add(u64::from(told == ToldErased::Named), Ordering::AcqRel);
        Ok(told)
    }

    /// How often a record was named at the word of an owner elsewhere since this file was opened: what overwrites such records
    /// sees that there is something to do.
    pub fn named_elsewhere(&self) -> u64 {
        self.0.shared.told.load(Ordering::Acquire)
    }

    /// Records whose owners told that they were erased, whose bytes are still here, and that no incident holds. What is not
    /// verified yet is left until it is: its bytes are what is verified.
    pub fn told_to_delete(&self, limit: usize) -> Result<Vec<Digest>, StoreError> {
        let (verified, tampered) = (RecordState::Verified.code(), RecordState::Tampered.code());
        let values = params![verified, tampered, capped(limit)];
        let sql = format!(
            "SELECT one.digest FROM {} AND one.state IN (?1, ?2) AND NOT {} ORDER BY retained.record LIMIT ?3",
            told(),
            is_held()
        );
        self.0.list(&sql, values, |row| row.get(0).map(Digest))
    }

    /// How many records whose owners told that they were erased stay here, because an incident of their owner holds them.
    pub fn held_although_erased(&self) -> Result<u64, StoreError> {
        let sql = format!("SELECT count(*) FROM {} AND {}", told(), is_held());
        self.0.one(&sql, [], |row| unsigned(row, 0))
    }
}

/// What owners told was erased, and is still here: the record `one`, of the topic `t`.
fn told() -> String {
    format!(
        "retained INDEXED BY retained_due CROSS JOIN records one ON one.n = retained.record
         JOIN erasures ON erasures.record = one.n JOIN topics t ON t.key = one.topic {LEARNED_NAME}
         WHERE retained.deleted_at IS NULL AND erasures.taken = 1"
    )
}

fn kept(connection: &Connection, digest: Digest) -> Result<Option<KeptErasure>, StoreError> {
    let sql = "SELECT statement, account, taken FROM erasures WHERE record = (SELECT n FROM records WHERE digest = ?1)";
    let found = connection.find(sql, [digest.0], |row| {
        Ok(KeptErasure { statement: row.get(0)?, account: row.get(1)?, taken: row.get(2)? })
    })?;
    Ok(found)
}

/// A record's state, and whether its bytes are gone.
fn found(connection: &Connection, digest: Digest) -> Result<Option<(RecordState, bool)>, StoreError> {
    Ok(connection.find("SELECT state, deleted_at IS NOT NULL FROM records WHERE digest = ?1", [digest.0], |row| {
        Ok((state(row, 0)?, row.get(1)?))
    })?)
}

/// Whether bytes of a record in this state may be given up: not while an operator decides.
fn may_go(state: RecordState) -> bool {
    use RecordState::{Batched, Confirmed, Mined, Stored, Submitted, Tampered, Verified};
    matches!(state, Stored | Batched | Submitted | Mined | Confirmed | Verified | Tampered)
}

/// Notes a record that was never here as deleted.
fn list(connection: &Connection, digest: Digest, taken: &TakenErased) -> Result<ToldErased, StoreError> {
    let at = whole("time", taken.at.0)?;
    let sql =
        "INSERT INTO retained (record, report, header, deleted_at) SELECT n, ?2, ?3, ?4 FROM records WHERE digest = ?1";
    connection.run(sql, params![digest.0, taken.report.0, taken.header, at])?;
    connection.run("UPDATE records SET deleted_at = ?2 WHERE digest = ?1", params![digest.0, at])?;
    count_given_up(connection, digest)?;
    Ok(ToldErased::Listed)
}

/// Bytes accounted for before are accounted for by the newer statement.
fn restate(connection: &Connection, digest: Digest, taken: &TakenErased) -> Result<ToldErased, StoreError> {
    if !kept(connection, digest)?.is_some_and(|kept| kept.taken) {
        return Ok(ToldErased::Unchanged);
    }
    let sql = "UPDATE retained SET report = ?2 WHERE record = (SELECT n FROM records WHERE digest = ?1)";
    connection.run(sql, params![digest.0, taken.report.0])?;
    Ok(ToldErased::Restated)
}

/// Names a record whose bytes are here. What a rule has named is the owner's erasure from then on; what a person of this home
/// has named stays theirs.
fn give_up(connection: &Connection, digest: Digest, taken: &TakenErased) -> Result<ToldErased, StoreError> {
    let is_named = "SELECT 1 FROM retained WHERE record = (SELECT n FROM records WHERE digest = ?1)";
    let is_named = connection.has(is_named, [digest.0])?;
    let sql = "INSERT INTO retained (record, report, header) SELECT n, ?2, ?3 FROM records WHERE digest = ?1
        ON CONFLICT DO UPDATE SET report = excluded.report, header = excluded.header
        WHERE NOT EXISTS (SELECT 1 FROM notes WHERE kind = 'erased' AND about = lower(hex(retained.report)))";
    let named = connection.run(sql, params![digest.0, taken.report.0, taken.header])?;
    if named == 0 {
        return Ok(ToldErased::Unchanged);
    }
    if !is_named {
        count_given_up(connection, digest)?;
    }
    Ok(ToldErased::Named)
}

// Records that somebody had erased: named like those of retention, with who and why, and overwritten, not only freed.

/// Who had records erased, when and why.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Erasure {
    pub at: Timestamp,
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
    /// As a reader is told: by whom and why is in the owner's retention record.
    pub(super) fn stated(statement: &[u8]) -> Option<Self> {
        let at = ErasedStatement::parse(statement).ok()?.at;
        Some(Self { at, by: "its owner".to_owned(), reason: "its proof remains".to_owned() })
    }
}

/// Makes a record that a rule has named, and whose bytes are still here, this erasure's; `false` if it is not such a one.
fn take_from_rule(connection: &Connection, digest: Digest, report: Digest) -> Result<bool, StoreError> {
    let sql = "UPDATE retained SET report = ?2 WHERE record = (SELECT n FROM records WHERE digest = ?1)
        AND deleted_at IS NULL
        AND NOT EXISTS (SELECT 1 FROM notes WHERE kind = 'erased' AND about = lower(hex(report)))";
    let taken = connection.run(sql, params![digest.0, report.0])?;
    Ok(taken > 0)
}

/// Counts a record among those of its topic whose ciphertext is given up.
pub(super) fn count_given_up(connection: &Connection, digest: Digest) -> Result<(), StoreError> {
    let sql = "INSERT INTO retained_topics SELECT topic, 1, bytes FROM records WHERE digest = ?1
        ON CONFLICT DO UPDATE SET records = records + excluded.records, bytes = bytes + excluded.bytes";
    connection.run(sql, [digest.0])?;
    Ok(())
}

impl Erasures {
    /// Acknowledges the retention record of an erasure, notes who and why, and names the records with their public
    /// headers, in one commit. What a rule has named and is not deleted yet is the erasure's from then on.
    ///
    /// # Errors
    /// See [`Records::append`]; [`StoreError::NotReady`] if one of them is not verified, already deleted, or another
    /// erasure's.
    pub fn erase(
        &self,
        report: NewRecord,
        erasure: &Erasure,
        records: Vec<(Digest, Vec<u8>)>,
    ) -> Result<(), StoreError> {
        let erasure = erasure.clone();
        self.0.write_many(records.len(), move |session| {
            let (connection, now) = (session.connection, whole("time", Timestamp::now().0)?);
            add(session, &report, now)?;
            notes::write_in(connection, &Erased { report: report.digest }, &erasure)?;
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

    /// Notes a record that its owner had erased before it came here: its row, its public header, and the owner's
    /// statement, in one commit. `false` if it is here with its bytes: then nothing changes.
    pub fn take(&self, record: NewRecord, taken: TakenErased) -> Result<bool, StoreError> {
        self.0.takes_records()?;
        self.0.write(move |session| {
            let digest = record.digest.0;
            let here = "SELECT 1 FROM records WHERE digest = ?1 AND deleted_at IS NULL";
            if session.connection.has(here, [digest])? {
                return Ok(false);
            }
            add(session, &record, whole("time", Timestamp::now().0)?)?;
            let (connection, at) = (session.connection, whole("time", taken.at.0)?);
            let sql = "INSERT INTO retained (record, report, header, deleted_at) SELECT n, ?2, ?3, ?4 FROM records
                WHERE digest = ?1 ON CONFLICT DO NOTHING";
            let named = connection.run(sql, params![digest, taken.report.0, taken.header, at])?;
            if named > 0 {
                count_given_up(connection, record.digest)?;
            }
            let sql = "UPDATE records SET deleted_at = ?2 WHERE digest = ?1 AND deleted_at IS NULL";
            connection.run(sql, params![digest, at])?;
            let sql = "INSERT INTO erasures (record, statement, taken) SELECT n, ?2, 1 FROM records WHERE digest = ?1
                ON CONFLICT DO NOTHING";
            connection.run(sql, params![digest, taken.statement])?;
            Ok(true)
        })
    }

    /// Those of these records that somebody had erased, here or elsewhere.
    pub fn erased_among(&self, digests: &[Digest]) -> Result<Vec<Digest>, StoreError> {
        self.0.read(|connection| {
            let sql = "SELECT 1 FROM retained JOIN records ON records.n = retained.record WHERE digest = ?1
                AND (EXISTS (SELECT 1 FROM notes WHERE kind = 'erased' AND about = lower(hex(report)))
                    OR EXISTS (SELECT 1 FROM erasures WHERE erasures.record = records.n AND taken = 1))";
            connection.among(sql, digests, |digest| Ok([digest.0]), true)
        })
    }

    /// Whether ciphertext of any owner is named and not deleted yet.
    pub fn has_named(&self) -> Result<bool, StoreError> {
        self.0.has("SELECT record FROM retained WHERE deleted_at IS NULL LIMIT 1", [])
    }
}
