//! A robot's evidence for records that its gateway reports as verified: the signed statement, and proofs that were
//! checked.

use rusqlite::params;

use super::Ledger;
use crate::model::{Digest, Signature, Timestamp};
use crate::store::StoreError;
use crate::store::database::whole;

/// A gateway's signed statement of standings.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeptStanding {
    /// Its time.
    pub time: Timestamp,
    /// The signed bytes, without label and domain.
    pub statement: Vec<u8>,
    /// Signature by the gateway's identity key.
    pub signature: Signature,
    /// Records it reports as verified, each with the proof of its anchor.
    pub proofs: Vec<(Digest, Vec<u8>)>,
}

impl Ledger {
    /// Stores a statement with the proofs of its records; records that already have one keep it.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like; then nothing is stored.
    pub fn keep_proven(&self, kept: KeptStanding) -> Result<(), StoreError> {
        self.write(move |session| {
            let (connection, time) = (session.connection, whole("time", kept.time.0)?);
            connection
                .prepare_cached("INSERT INTO standings (at, statement, signature) VALUES (?1, ?2, ?3)")?
                .execute(params![time, kept.statement, kept.signature.0])?;
            let (key, now) = (connection.last_insert_rowid(), whole("time", Timestamp::now().0)?);
            let mut insert = connection.prepare_cached(
                "INSERT INTO proven SELECT n, ?2, ?3, ?4, 0 FROM records WHERE digest = ?1 ON CONFLICT DO NOTHING",
            )?;
            for (digest, proof) in &kept.proofs {
                insert.execute(params![digest.0, key, proof, now])?;
            }
            Ok(())
        })
    }

    /// Verified records that were proven before a given time and whose ciphertext is still here, oldest first.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn proven_before(&self, moment: Timestamp, limit: usize) -> Result<Vec<Digest>, StoreError> {
        let (moment, limit) = (whole("time", moment.0)?, i64::try_from(limit).unwrap_or(i64::MAX));
        self.read(|connection| {
            let mut statement = connection.prepare_cached(
                "SELECT digest FROM proven JOIN records ON n = record
                 WHERE gone = 0 AND at < ?1 AND state = ?3 ORDER BY at LIMIT ?2",
            )?;
            let verified = crate::model::RecordState::Verified.code();
            let found = statement.query_map(params![moment, limit, verified], |row| row.get(0).map(Digest))?;
            Ok(found.collect::<Result<_, _>>()?)
        })
    }

    /// Notes that the ciphertext of these was deleted; statement and proof stay.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like.
    pub fn proven_gone(&self, digests: &[Digest]) -> Result<(), StoreError> {
        let digests = digests.to_vec();
        self.write_many(digests.len(), move |session| {
            let mut mark = session.connection.prepare_cached(
                "UPDATE proven SET gone = 1 WHERE record = (SELECT n FROM records WHERE digest = ?1)",
            )?;
            for digest in &digests {
                mark.execute(params![digest.0])?;
            }
            Ok(())
        })
    }

    /// The statement that reports a record as verified, with only the proof of its anchor.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn proven(&self, digest: Digest) -> Result<Option<KeptStanding>, StoreError> {
        use rusqlite::OptionalExtension as _;
        self.read(|connection| {
            let sql = "SELECT s.at, statement, signature, proof FROM proven p JOIN standings s ON s.key = p.standing
                       WHERE record = (SELECT n FROM records WHERE digest = ?1)";
            let found = connection.prepare_cached(sql)?.query_row(params![digest.0], |row| {
                Ok(KeptStanding {
                    time: Timestamp(row.get::<_, i64>(0)?.cast_unsigned()),
                    statement: row.get(1)?,
                    signature: Signature(row.get(2)?),
                    proofs: vec![(digest, row.get(3)?)],
                })
            });
            Ok(found.optional()?)
        })
    }
}
