//! The blocks that the watcher has seen, so that after a reorg it finds where the old and the new chain diverge.

use rusqlite::{OptionalExtension as _, params};

use super::{Ledger, database::whole, rows::unsigned};
use crate::model::Hash;
use crate::store::StoreError;

/// Below the newest block, how many blocks have every entry kept.
pub(super) const DENSE: u64 = 1024;
/// Below those, one entry is kept for this many blocks.
const SPARSE: u64 = 256;

impl Ledger {
    /// Moves the walker `name` to a block, and stores this and other blocks met on the way, in one commit.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like; then nothing moves.
    pub fn walk_to(&self, name: &str, to: (u64, Hash), met: Vec<(u64, Hash)>) -> Result<(), StoreError> {
        let name = name.to_owned();
        let block = whole("block", to.0)?;
        self.write(move |session| {
            let connection = session.connection;
            let mut keep = connection.prepare_cached("REPLACE INTO trail VALUES (?1, ?2)")?;
            for (number, hash) in met.iter().chain([&to]) {
                keep.execute(params![whole("block", *number)?, hash.0])?;
            }
            connection
                .prepare_cached("REPLACE INTO cursors VALUES (?1, ?2, ?3)")?
                .execute(params![name, block, to.1.0])?;
            let old = block.saturating_sub(whole("block", DENSE)?);
            if to.0.is_multiple_of(SPARSE) {
                connection
                    .prepare_cached(
                        "DELETE FROM trail WHERE block < ?1 AND block NOT IN
                         (SELECT max(block) FROM trail WHERE block < ?1 GROUP BY block / ?2)",
                    )?
                    .execute(params![old, whole("block", SPARSE)?])?;
            }
            Ok(())
        })
    }

    /// The blocks kept, oldest first.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn trail(&self) -> Result<Vec<(u64, Hash)>, StoreError> {
        self.read(|connection| {
            let mut statement = connection.prepare_cached("SELECT block, hash FROM trail ORDER BY block")?;
            let rows = statement.query_map([], |row| Ok((unsigned(row, 0)?, Hash(row.get(1)?))))?;
            Ok(rows.collect::<Result<_, _>>()?)
        })
    }

    /// The newest block kept.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn trail_end(&self) -> Result<Option<(u64, Hash)>, StoreError> {
        self.read(|connection| {
            let sql = "SELECT block, hash FROM trail ORDER BY block DESC LIMIT 1";
            let mut statement = connection.prepare_cached(sql)?;
            Ok(statement.query_row([], |row| Ok((unsigned(row, 0)?, Hash(row.get(1)?)))).optional()?)
        })
    }

    /// Moves the walker `name` back to `to` if it is further, and deletes the blocks after `to`, in one commit.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like; then nothing moves.
    pub fn walk_back(&self, name: &str, to: (u64, Hash)) -> Result<(), StoreError> {
        let name = name.to_owned();
        let block = whole("block", to.0)?;
        self.write(move |session| {
            let connection = session.connection;
            connection.prepare_cached("DELETE FROM trail WHERE block > ?1")?.execute([block])?;
            connection
                .prepare_cached("UPDATE cursors SET block = ?2, hash = ?3 WHERE name = ?1 AND block > ?2")?
                .execute(params![name, block, to.1.0])?;
            Ok(())
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hash(number: u64) -> Hash {
        let mut bytes = [0; 32];
        bytes[..8].copy_from_slice(&number.to_be_bytes());
        Hash(bytes)
    }

    #[test]
    fn old_blocks_thin_out_and_a_way_back_is_left() {
        let home = tempfile::tempdir().expect("folder");
        let ledger = Ledger::open(&home.path().join("ledger.db")).expect("opens");
        for number in 1..=4096 {
            let met = if number % 3 == 0 { vec![(number - 1, hash(number - 1))] } else { Vec::new() };
            ledger.walk_to("w", (number, hash(number)), met).expect("walks");
        }
        let trail = ledger.trail().expect("read");
        assert!(trail.len() < 1300 && trail.is_sorted(), "{}", trail.len());
        assert!((3072..=4096).all(|number| trail.contains(&(number, hash(number)))), "the newest are all there");
        for bucket in 0..12 {
            assert!(trail.iter().any(|(number, _)| number / SPARSE == bucket), "{bucket}");
        }
        assert_eq!(ledger.trail_end(), Ok(Some((4096, hash(4096)))));
        ledger.walk_back("w", (4000, hash(4000))).expect("walks back");
        assert_eq!(
            (ledger.cursor("w"), ledger.trail_end()),
            (Ok(Some((4000, hash(4000)))), Ok(Some((4000, hash(4000)))))
        );
        ledger.set_cursor("w", 7, hash(7)).expect("set");
        ledger.walk_back("w", (3999, hash(3999))).expect("walks back");
        assert_eq!(ledger.cursor("w"), Ok(Some((7, hash(7)))), "a walker that is behind stays there");
    }
}
