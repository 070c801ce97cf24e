//! Owners' statements about erased records: noted with each erasure, sent in a fixed order to the joined gateway, and
//! received there. A copy needs the signature of the owner's account.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::append::add;
use super::batches::take_in;
use super::retention::{is_held, name};
use super::rows::{LEARNED_NAME, state, unsigned};
use super::{Erasures, NewRecord, RootSighting, Session};
use crate::StoreError;
use crate::crypto::ErasedStatement;
use crate::crypto::merkle::Inclusion;
use crate::database::{capped, whole};
use crate::model::{Address, Digest, PublicKey, RecordState, Timestamp, clean};
use crate::notes::{self, Erased};
use crate::sql::{Connection, params};

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StatedErasure {
    pub digest: Digest,
    /// Signed by d_C.
    pub statement: Vec<u8>,
    /// The owner account's signature, if any.
    pub account: Option<Vec<u8>>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeptErasure {
    /// Signed by d_C.
    pub statement: Vec<u8>,
    /// The owner account's signature.
    pub account: Option<Vec<u8>>,
    /// From elsewhere.
    pub taken: bool,
}

/// An erased record whose owner states nothing that holds today.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Unstated {
    pub digest: Digest,
    /// The retention record that names it.
    pub report: Digest,
    pub header: Vec<u8>,
    pub erasure: Erasure,
}

#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ErasurePage {
    /// With statement and account's signature.
    pub erasures: Vec<(Digest, Vec<u8>, Vec<u8>)>,
    pub last: Option<u64>,
    pub more: bool,
}

/// The effect of an owner's statement from elsewhere.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ToldErased {
    /// It was never here: it is listed without bytes.
    Listed,
    /// Its bytes are here, and named for overwriting.
    Named,
    /// It was gone already; the statement replaces the older.
    Restated,
    /// This home decided itself, or its state forbids it.
    Unchanged,
}

impl Erasures {
    /// Replaces earlier statements.
    pub fn keep(&self, stated: Vec<StatedErasure>) -> Result<(), StoreError> {
        self.0.write_many(stated.len(), move |Session { connection, .. }| {
            stated.iter().try_for_each(|one| {
                let taken = kept(connection, one.digest)?.is_some_and(|before| before.taken);
                put(
                    connection,
                    one.digest,
                    &KeptErasure { statement: one.statement.clone(), account: one.account.clone(), taken },
                )
            })
        })
    }

    pub fn kept(&self, digest: Digest) -> Result<Option<KeptErasure>, StoreError> {
        self.0.read(|connection| kept(connection, digest))
    }

    /// Erasures for the gateway after a number, in order: signed by the owner's account, bytes gone.
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

    /// Erased records that the owner does not state with this key and the account. Scans all deletions: call rarely.
    pub fn unstated(&self, owner: Address, key: &PublicKey, limit: usize) -> Result<Vec<Unstated>, StoreError> {
        self.0.read(|connection| {
            // P_C follows the retention record (32) and the time (8) of a statement.
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

    /// Takes an owner's checked statement: lists an unknown record with its anchor, or names its bytes for overwriting,
    /// in one commit with the statement.
    pub fn take_told(
        &self,
        record: NewRecord,
        (taken, account): (TakenErased, Vec<u8>),
        (inclusion, anchor): (Inclusion, RootSighting),
    ) -> Result<ToldErased, StoreError> {
        self.0.takes_records()?;
        self.0.write(move |session| {
            let (digest, now) = (record.digest, whole("time", Timestamp::now().0)?);
            let before = found(session.connection, digest)?;
            add(session, &record, now)?;
            let connection = session.connection;
            // Locked: a transaction that takes the block back waits, and then finds what rests on it.
            connection.run("UPDATE trail SET hash = hash WHERE block = ?1", [whole("block", anchor.block)?])?;
            let told = match before {
                None => list(connection, digest, &taken)?,
                Some((_, true)) => restate(connection, digest, &taken)?,
                Some((state, false)) if may_go(state) => give_up(connection, digest, &taken)?,
                Some(_) => ToldErased::Unchanged,
            };
            if told == ToldErased::Unchanged {
                return Ok(told);
            }
            let stated =
                KeptErasure { statement: taken.statement.clone(), account: Some(account.clone()), taken: true };
            put(connection, digest, &stated)?;
            take_in(connection, digest, &inclusion, &anchor)?;
            Ok(told)
        })
    }

    /// Records to delete by their owners' statements, except those an incident holds. Unverified ones wait:
    /// verification needs their bytes.
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

    /// Records that an incident keeps despite their owners' statements.
    pub fn held_although_erased(&self) -> Result<u64, StoreError> {
        let sql = format!("SELECT count(*) FROM {} AND {}", told(), is_held());
        self.0.one(&sql, [], |row| unsigned(row, 0))
    }
}

/// Records `one` of topics `t` that owners elsewhere erased and that are still here.
fn told() -> String {
    format!(
        "retained INDEXED BY retained_due CROSS JOIN records one ON one.n = retained.record
         JOIN erasures ON erasures.record = one.n JOIN topics t ON t.key = one.topic {LEARNED_NAME}
         WHERE retained.deleted_at IS NULL AND erasures.taken = 1"
    )
}

pub(super) fn kept(connection: &Connection, digest: Digest) -> Result<Option<KeptErasure>, StoreError> {
    let sql = "SELECT statement, account, taken FROM erasures WHERE record = (SELECT n FROM records WHERE digest = ?1)";
    Ok(connection.find(sql, [digest.0], |row| {
        Ok(KeptErasure { statement: row.get(0)?, account: row.get(1)?, taken: row.get(2)? })
    })?)
}

/// In the place of an earlier one, under a new number: followers may have read past the earlier.
pub(super) fn put(connection: &Connection, digest: Digest, stated: &KeptErasure) -> Result<(), StoreError> {
    connection.run("DELETE FROM erasures WHERE record = (SELECT n FROM records WHERE digest = ?1)", [digest.0])?;
    let sql =
        "INSERT INTO erasures (record, statement, account, taken) SELECT n, ?2, ?3, ?4 FROM records WHERE digest = ?1";
    connection.run(sql, params![digest.0, stated.statement, stated.account, stated.taken])
}

/// State, and whether the bytes are gone.
fn found(connection: &Connection, digest: Digest) -> Result<Option<(RecordState, bool)>, StoreError> {
    let sql = "SELECT state, deleted_at IS NOT NULL FROM records WHERE digest = ?1";
    Ok(connection.find(sql, [digest.0], |row| Ok((state(row, 0)?, row.get(1)?)))?)
}

/// Not while an operator decides.
fn may_go(state: RecordState) -> bool {
    use RecordState::{Batched, Confirmed, Mined, Stored, Submitted, Tampered, Verified};
    matches!(state, Stored | Batched | Submitted | Mined | Confirmed | Verified | Tampered)
}

/// Notes an unknown record as deleted.
fn list(connection: &Connection, digest: Digest, taken: &TakenErased) -> Result<ToldErased, StoreError> {
    let at = whole("time", taken.at.0)?;
    let sql =
        "INSERT INTO retained (record, report, header, deleted_at) SELECT n, ?2, ?3, ?4 FROM records WHERE digest = ?1";
    connection.run(sql, params![digest.0, taken.report.0, taken.header, at])?;
    connection.run("UPDATE records SET deleted_at = ?2 WHERE digest = ?1", params![digest.0, at])?;
    count_given_up(connection, digest)?;
    Ok(ToldErased::Listed)
}

/// The newer statement accounts for bytes that another did.
fn restate(connection: &Connection, digest: Digest, taken: &TakenErased) -> Result<ToldErased, StoreError> {
    if !kept(connection, digest)?.is_some_and(|kept| kept.taken) {
        return Ok(ToldErased::Unchanged);
    }
    let sql = "UPDATE retained SET report = ?2 WHERE record = (SELECT n FROM records WHERE digest = ?1)";
    connection.run(sql, params![digest.0, taken.report.0])?;
    Ok(ToldErased::Restated)
}

/// Names a record with bytes. Replaces a rule's naming, but not that of a person of this home.
fn give_up(connection: &Connection, digest: Digest, taken: &TakenErased) -> Result<ToldErased, StoreError> {
    let is_named = "SELECT 1 FROM retained WHERE record = (SELECT n FROM records WHERE digest = ?1)";
    let is_named = connection.has(is_named, [digest.0])?;
    let sql = "INSERT INTO retained (record, report, header) SELECT n, ?2, ?3 FROM records WHERE digest = ?1
        ON CONFLICT (record) DO UPDATE SET report = excluded.report, header = excluded.header
        WHERE NOT EXISTS (SELECT 1 FROM notes WHERE kind = 'erased' AND about = lower(hex(retained.report)))";
    if connection.changed(sql, params![digest.0, taken.report.0, taken.header])? == 0 {
        return Ok(ToldErased::Unchanged);
    }
    if !is_named {
        count_given_up(connection, digest)?;
    }
    Ok(ToldErased::Named)
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Erasure {
    pub at: Timestamp,
    pub by: String,
    /// Free text.
    pub reason: String,
}

/// Received in place of a record that its owner had erased.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TakenErased {
    /// Of its stored bytes.
    pub header: Vec<u8>,
    /// The retention record that names it, perhaps unknown here.
    pub report: Digest,
    /// The decision's time.
    pub at: Timestamp,
    /// The owner's, signed.
    pub statement: Vec<u8>,
}

impl fmt::Display for Erasure {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "erased {} by {}, {}", self.at, clean(&self.by, 80), clean(&self.reason, 500))
    }
}

impl Erasure {
    /// Who and why is in the owner's retention record.
    pub(super) fn stated(statement: &[u8]) -> Option<Self> {
        let at = ErasedStatement::parse(statement).ok()?.at;
        Some(Self { at, by: "its owner".to_owned(), reason: "its proof remains".to_owned() })
    }
}

/// Takes over a record that a rule named and whose bytes are here; `false` for any other.
fn take_from_rule(connection: &Connection, digest: Digest, report: Digest) -> Result<bool, StoreError> {
    let sql = "UPDATE retained SET report = ?2 WHERE record = (SELECT n FROM records WHERE digest = ?1)
        AND deleted_at IS NULL
        AND NOT EXISTS (SELECT 1 FROM notes WHERE kind = 'erased' AND about = lower(hex(report)))";
    Ok(connection.changed(sql, params![digest.0, report.0])? > 0)
}

pub(super) fn count_given_up(connection: &Connection, digest: Digest) -> Result<(), StoreError> {
    let sql = "INSERT INTO retained_topics SELECT topic, 1, bytes FROM records WHERE digest = ?1
        ON CONFLICT (topic) DO UPDATE SET records = retained_topics.records + excluded.records,
        bytes = retained_topics.bytes + excluded.bytes";
    connection.run(sql, [digest.0])
}

impl Erasures {
    /// Acknowledges the retention record, notes who and why, and names the records, in one commit. Takes over what a
    /// rule named. [`StoreError::NotReady`] for a record not verified, deleted, or erased by another.
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

    /// Notes a record erased before it came here, with the owner's statement, in one commit. `false`, without a change,
    /// if its bytes are here.
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
            if connection.changed(sql, params![digest, taken.report.0, taken.header, at])? > 0 {
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

    /// Erased here or elsewhere.
    pub fn erased_among(&self, digests: &[Digest]) -> Result<Vec<Digest>, StoreError> {
        self.0.read(|connection| {
            let sql = "SELECT 1 FROM retained JOIN records ON records.n = retained.record WHERE digest = ?1
                AND (EXISTS (SELECT 1 FROM notes WHERE kind = 'erased' AND about = lower(hex(report)))
                    OR EXISTS (SELECT 1 FROM erasures WHERE erasures.record = records.n AND taken = 1))";
            connection.among(sql, digests, |digest| Ok([digest.0]), true)
        })
    }

    /// Of any owner.
    pub fn has_named(&self) -> Result<bool, StoreError> {
        self.0.has("SELECT record FROM retained WHERE deleted_at IS NULL LIMIT 1", [])
    }
}
