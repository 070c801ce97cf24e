//! A ledger whose rows are written into its file by SQL: ten million in about two minutes. They have what lists read,
//! the counts and batches among it, and neither ciphertext nor a place in the feed.

use std::path::Path;

use rusqlite::{Connection, params};

use crate::pipeline::before::{APART, OWNER, TOPICS, record};
use authros_model::{Digest, RecordState};
use authros_service::Failure;
use authros_service::reply::internal;
use authros_store::Ledger;

/// One record in this many is in quarantine: a prime, so that every topic has some.
pub const HELD: u64 = 997;
/// Rows in one statement.
const BULK: u64 = 100_000;
/// Records of a batch.
const BATCH: u64 = 5_000;

/// The file is thrown away if this fails, so nothing protects it while it is written.
const UNPROTECTED: &str = "PRAGMA journal_mode = DELETE; PRAGMA synchronous = OFF; PRAGMA journal_mode = OFF;
    PRAGMA cache_size = -400000;";
/// The first record of each topic is the store's own work; the others are copies with other numbers.
const FIRST: &str = "UPDATE records SET state = ?1";
const TEMPLATE: &str = "CREATE TEMP TABLE first AS SELECT * FROM records";
/// From ?1 to before ?2.
const NUMBERS: &str =
    "WITH RECURSIVE next (number) AS (SELECT ?1 UNION ALL SELECT number + 1 FROM next WHERE number + 1 < ?2)";
const COPIES: &str = "SELECT CAST(printf('%032d', number) AS BLOB), topic, stream, number / ?3 + 1, epoch, signature,
        bytes, captured_at + (number - number % ?3) * ?4, acknowledged_at, simulated,
        CASE number % ?5 WHEN 0 THEN ?6 ELSE ?7 END
    FROM next JOIN first ON first.n = number % ?3 + 1";
const PLACES: &str = "INSERT INTO leaves SELECT n, (n - 1) / ?1 + 1, (n - 1) % ?1 FROM records";
const BATCHES: &str =
    "INSERT INTO batches (root, owner, count, closed_at, account, tx, block, block_hash, proof, closed_here)
    SELECT CAST(printf('%032d', batch) AS BLOB), ?1, count(*), 0, ?1, CAST(printf('%032d', batch) AS BLOB), batch,
        CAST(printf('%032d', batch) AS BLOB), 1, 1
    FROM leaves GROUP BY batch ORDER BY batch";

/// A ledger of that many records, at least one of each topic.
///
/// # Errors
/// Errors of the store, such as a full disk.
pub fn ledger(path: &Path, records: u64, mut done: impl FnMut(u64)) -> Result<Ledger, Failure> {
    let ledger = Ledger::open(path)?;
    let first = (0..TOPICS).map(|number| record(number, digest(number), None));
    ledger.records.append(first.collect())?;
    ledger.close()?;
    write(path, records, &mut done).map_err(|error| internal(format!("rows for a list: {error}")))?;
    Ok(Ledger::open(path)?)
}

/// Like those of [`COPIES`].
fn digest(number: u64) -> Digest {
    let mut bytes = [0; Digest::LENGTH];
    bytes.copy_from_slice(format!("{number:032}").as_bytes());
    Digest(bytes)
}

fn write(path: &Path, records: u64, done: &mut impl FnMut(u64)) -> rusqlite::Result<()> {
    let connection = Connection::open(path)?;
    connection.execute_batch(UNPROTECTED)?;
    let (verified, held) = (RecordState::Verified.code(), RecordState::Quarantined.code());
    connection.execute(FIRST, [verified])?;
    connection.execute_batch(TEMPLATE)?;
    let sql = format!(
        "INSERT INTO records (digest, topic, stream, seq, epoch, signature, bytes, captured_at, acknowledged_at, simulated,
             state) {NUMBERS} {COPIES}"
    );
    let mut statement = connection.prepare(&sql)?;
    let mut there = TOPICS;
    while there < records {
        let end = records.min(there + BULK);
        let [from, to, topics, apart, every] = [there, end, TOPICS, APART, HELD].map(u64::cast_signed);
        statement.execute(params![from, to, topics, apart, every, held, verified])?;
        there = end;
        done(there);
    }
    connection.execute(PLACES, [BATCH.cast_signed()])?;
    connection.execute(BATCHES, [OWNER.0])?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::before::captured_at;
    use authros_store::RecordQuery;

    #[test]
    fn what_is_written_is_counted_listed_and_placed_like_any_other_record() {
        let directory = tempfile::tempdir().expect("a directory");
        let ledger = ledger(&directory.path().join("ledger.db"), 3_000, |_| ()).expect("written");
        let counts = ledger.counts.by_state(Some(OWNER)).expect("counted");
        // 997, 1994 and 2991; number 0 is a first record.
        assert_eq!((counts.data_in(RecordState::Verified), counts.data_in(RecordState::Quarantined)), (2_997, 3));
        assert!(counts.is_conserved() && counts.captured() == 3_000, "{counts:?}");
        let rows = ledger.records.all(RecordQuery { limit: 1_000, ..RecordQuery::default() });
        let rows: Vec<_> = rows.collect::<Result<_, _>>().expect("listed");
        assert_eq!(rows.len(), 3_000);
        for (number, row) in (0u64..).zip(&rows) {
            assert_eq!((row.digest, row.captured_at), (digest(number), captured_at(number)));
            assert_eq!((row.seq, row.block), (number / TOPICS + 1, Some(1)));
        }
    }
}
