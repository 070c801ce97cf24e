//! Stamps of time stamp authorities over roots of batches: what is to be stamped, what waits, what there is.

use rusqlite::{OptionalExtension as _, params};

use super::rows::unsigned;
use super::{Ledger, database::whole};
use crate::model::{Hash, Timestamp};
use crate::store::StoreError;

/// Stamps for which an authority added later is still asked.
const NEWEST: i64 = 48;

/// Roots under one stamp.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeptStamp {
    /// Its number in this ledger.
    pub key: u64,
    /// The roots in their order.
    pub roots: Vec<Hash>,
    /// Tokens over them, DER, by their authorities' certificates.
    pub tokens: Vec<Vec<u8>>,
}

/// The state of a ledger's stamps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct StampCounts {
    /// Stamps that at least one authority gave a token for.
    pub stamped: u64,
    /// Stamps without any.
    pub waiting: u64,
    /// When the newest was begun.
    pub newest: Option<Timestamp>,
    /// The end of the newest time in a token.
    pub before: Option<Timestamp>,
}

impl Ledger {
    /// Puts the batches closed since the last time under a new stamp made `at`, the oldest `most` of them; returns how
    /// many.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like: then nothing is begun.
    pub fn begin_stamp(&self, most: usize, at: Timestamp) -> Result<u64, StoreError> {
        let (most, at) = (i64::try_from(most).unwrap_or(i64::MAX), whole("time", at.0)?);
        self.write(move |session| {
            let connection = session.connection;
            let sql = "SELECT key, root FROM batches WHERE key > coalesce((SELECT max(upto) FROM stamps), 0)
                       ORDER BY key LIMIT ?1";
            let found: Vec<(i64, [u8; 32])> = connection
                .prepare_cached(sql)?
                .query_map([most], |row| Ok((row.get(0)?, row.get(1)?)))?
                .collect::<Result<_, _>>()?;
            let Some((upto, _)) = found.last() else { return Ok(0) };
            let roots: Vec<u8> = found.iter().flat_map(|(_, root)| *root).collect();
            connection
                .prepare_cached("INSERT INTO stamps (made_at, upto, roots) VALUES (?1, ?2, ?3)")?
                .execute(params![at, upto, roots])?;
            let key = connection.last_insert_rowid();
            let mut add = connection.prepare_cached("INSERT OR IGNORE INTO stamped_roots VALUES (?1, ?2)")?;
            for (_, root) in &found {
                add.execute(params![root, key])?;
            }
            Ok(u64::try_from(found.len()).unwrap_or(u64::MAX))
        })
    }

    /// The oldest stamps to request from this authority: those that nobody stamped, and of the newest ones those that
    /// others did.
    ///
    /// # Errors
    /// [`StoreError::Database`] and its kin.
    pub fn waiting_stamps(&self, authority: Hash, limit: usize) -> Result<Vec<KeptStamp>, StoreError> {
        let limit = i64::try_from(limit).unwrap_or(i64::MAX);
        self.read(|connection| {
            let sql = "SELECT key, roots FROM stamps
                       WHERE NOT EXISTS (SELECT 1 FROM stamp_tokens WHERE stamp = key AND authority = ?1)
                       AND (key > (SELECT max(key) FROM stamps) - ?2
                            OR NOT EXISTS (SELECT 1 FROM stamp_tokens WHERE stamp = key))
                       ORDER BY key LIMIT ?3";
            let mut statement = connection.prepare_cached(sql)?;
            let rows = statement.query_map(params![authority.0, NEWEST, limit], |row| {
                Ok(KeptStamp { key: unsigned(row, 0)?, roots: hashes(&row.get::<_, Vec<u8>>(1)?), tokens: Vec::new() })
            })?;
            Ok(rows.collect::<Result<_, _>>()?)
        })
    }

    /// Stores an authority's token over a stamp's roots; an existing one stays.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like: then it is requested again.
    pub fn keep_token(&self, stamp: u64, authority: Hash, before: Timestamp, token: Vec<u8>) -> Result<(), StoreError> {
        let (stamp, before) = (whole("stamp", stamp)?, whole("time", before.0)?);
        self.write(move |session| {
            session
                .connection
                .prepare_cached("INSERT OR IGNORE INTO stamp_tokens VALUES (?1, ?2, ?3, ?4)")?
                .execute(params![stamp, authority.0, before, token])?;
            Ok(())
        })
    }

    /// The number of the stamp that a root is under.
    ///
    /// # Errors
    /// [`StoreError::Database`] and its kin.
    pub fn stamp_of(&self, root: Hash) -> Result<Option<u64>, StoreError> {
        self.read(|connection| {
            let mut statement = connection.prepare_cached("SELECT stamp FROM stamped_roots WHERE root = ?1")?;
            Ok(statement.query_row([root.0], |row| unsigned(row, 0)).optional()?)
        })
    }

    /// A stamp with its tokens.
    ///
    /// # Errors
    /// [`StoreError::Database`] and its kin.
    pub fn stamp(&self, key: u64) -> Result<Option<KeptStamp>, StoreError> {
        let number = whole("stamp", key)?;
        self.read(|connection| {
            let mut statement = connection.prepare_cached("SELECT roots FROM stamps WHERE key = ?1")?;
            let roots = statement.query_row([number], |row| row.get::<_, Vec<u8>>(0)).optional()?;
            let Some(roots) = roots else { return Ok(None) };
            let mut statement =
                connection.prepare_cached("SELECT token FROM stamp_tokens WHERE stamp = ?1 ORDER BY authority")?;
            let tokens = statement.query_map([number], |row| row.get(0))?.collect::<Result<_, _>>()?;
            Ok(Some(KeptStamp { key, roots: hashes(&roots), tokens }))
        })
    }

    /// The state of the stamps.
    ///
    /// # Errors
    /// [`StoreError::Database`] and its kin.
    pub fn stamp_counts(&self) -> Result<StampCounts, StoreError> {
        self.read(|connection| {
            let sql = "SELECT (SELECT count(*) FROM stamps), (SELECT count(DISTINCT stamp) FROM stamp_tokens),
                       (SELECT max(made_at) FROM stamps), (SELECT max(before) FROM stamp_tokens)";
            let mut statement = connection.prepare_cached(sql)?;
            Ok(statement.query_row([], |row| {
                let time = |at| {
                    Ok::<_, rusqlite::Error>(row.get::<_, Option<i64>>(at)?.map(|at| Timestamp(at.cast_unsigned())))
                };
                let (all, stamped) = (unsigned(row, 0)?, unsigned(row, 1)?);
                Ok(StampCounts { stamped, waiting: all.saturating_sub(stamped), newest: time(2)?, before: time(3)? })
            })?)
        })
    }
}

fn hashes(bytes: &[u8]) -> Vec<Hash> {
    bytes.chunks_exact(Hash::LENGTH).filter_map(Hash::from_slice).collect()
}

#[cfg(test)]
mod tests {
    use super::super::tests::numbered as record;
    use super::*;
    use crate::model::{Address, Digest};
    use crate::store::NewBatch;

    fn close(ledger: &Ledger, number: u8) {
        ledger.append(vec![record(number)]).expect("acknowledged");
        let leaves = vec![(Digest([number; 32]), Vec::new())];
        ledger.close_batch(NewBatch { owner: Address([1; 20]), root: Hash([number; 32]), leaves }).expect("closed");
    }

    #[test]
    fn each_batch_is_put_under_one_stamp_and_waits_there_for_tokens() {
        let home = tempfile::tempdir().expect("folder");
        let path = home.path().join("ledger.db");
        let ledger = Ledger::open(&path).expect("opens");
        let begin = |most| ledger.begin_stamp(most, Timestamp(40));
        assert_eq!((begin(9), ledger.stamp_counts()), (Ok(0), Ok(StampCounts::default())));
        (1..=3).for_each(|number| close(&ledger, number));
        assert_eq!([begin(2), begin(2), begin(2)], [Ok(2), Ok(1), Ok(0)]);
        let (one, other) = (Hash([0xa; 32]), Hash([0xb; 32]));
        let waiting = |authority| -> Vec<Vec<u8>> {
            let stamps = ledger.waiting_stamps(authority, 9).expect("read");
            stamps.iter().map(|stamp| stamp.roots.iter().map(|root| root.0[0]).collect()).collect()
        };
        assert_eq!(waiting(one), [vec![1, 2], vec![3]]);
        let key = ledger.stamp_of(Hash([2; 32])).expect("read").expect("stamped");
        ledger.keep_token(key, one, Timestamp(50), vec![7]).expect("kept");
        ledger.keep_token(key, one, Timestamp(60), vec![8]).expect("the first stays");
        assert_eq!((waiting(one), waiting(other)), (vec![vec![3]], vec![vec![1, 2], vec![3]]));
        let counts = ledger.stamp_counts().expect("read");
        assert_eq!((counts.stamped, counts.waiting, counts.before), (1, 1, Some(Timestamp(50))));
        // Another process, later.
        ledger.close().expect("closed");
        let ledger = Ledger::open(&path).expect("opens");
        let stamp = ledger.stamp(key).expect("read").expect("kept");
        assert_eq!((stamp.roots, stamp.tokens), (vec![Hash([1; 32]), Hash([2; 32])], vec![vec![7]]));
        assert_eq!((ledger.stamp_of(Hash([9; 32])), ledger.stamp(99)), (Ok(None), Ok(None)));
        close(&ledger, 4);
        assert_eq!(ledger.begin_stamp(9, Timestamp(70)), Ok(1));
        assert_eq!(ledger.stamp_counts().expect("read").newest, Some(Timestamp(70)));
    }
}
