//! Whether the ledger's tables agree with each other: checked after an unclean shutdown, and when a home is examined.

use rusqlite::Connection;

use super::Ledger;
use crate::model::{Digest, RecordState};
use crate::store::StoreError;

/// A query that must find nothing, and the meaning if it does.
const RULES: [(&str, &str); 5] = [
    (
        "SELECT count(*) FROM (SELECT stream, state, count(*) AS rows FROM records GROUP BY state, stream) found
         LEFT JOIN counters c ON c.stream = found.stream AND c.state = found.state
         WHERE coalesce(c.records, 0) <> found.rows",
        "counts per state do not match the records",
    ),
    (
        "SELECT count(*) FROM (SELECT stream, sum(records) AS rows FROM counters GROUP BY stream) held
         JOIN intake i ON i.stream = held.stream WHERE i.records <> held.rows",
        "streams have fewer or more records than were stored",
    ),
    (
        "SELECT count(*) FROM records WHERE stream NOT IN (SELECT key FROM streams)
         OR topic NOT IN (SELECT key FROM topics)",
        "records without a topic",
    ),
    (
        "SELECT count(*) FROM leaves WHERE batch NOT IN (SELECT key FROM batches)
         OR record NOT IN (SELECT n FROM records)",
        "batch positions without a batch or record",
    ),
    (
        "SELECT count(*) FROM records WHERE state = 1 AND n NOT IN (SELECT record FROM copies)",
        "sealed records lack their local copies",
    ),
];

impl Ledger {
    /// Whether the previous process closed it. If not, the file's structure was checked on opening.
    pub fn ended_cleanly(&self) -> bool {
        self.shared.clean
    }

    /// Contradictions in its tables, in words; takes about a second per million records.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn contradictions(&self) -> Result<Vec<String>, StoreError> {
        self.read(|connection| {
            let found = RULES.iter().map(|(sql, text)| {
                let count: i64 = connection.query_row(sql, [], |row| row.get(0))?;
                Ok((count > 0).then(|| format!("{count} {text}")))
            });
            found.filter_map(Result::transpose).collect()
        })
    }

    /// The records acknowledged last, at most `limit`, that should be in the vault and were not deleted by retention.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn newest_stored(&self, limit: usize) -> Result<Vec<Digest>, StoreError> {
        self.read(|connection| newest(connection, limit))
    }
}

fn newest(connection: &Connection, limit: usize) -> Result<Vec<Digest>, StoreError> {
    let mut statement = connection.prepare_cached(
        "SELECT digest FROM records NOT INDEXED WHERE (state BETWEEN ?1 AND ?2 OR state = ?4)
         AND NOT EXISTS (SELECT 1 FROM retained WHERE record = n) ORDER BY n DESC LIMIT ?3",
    )?;
    let states = (RecordState::Stored.code(), RecordState::Verified.code());
    let limit = i64::try_from(limit).unwrap_or(i64::MAX);
    let values = (states.0, states.1, limit, RecordState::RightEnded.code());
    let rows = statement.query_map(values, |row| row.get(0).map(Digest))?;
    Ok(rows.collect::<Result<_, _>>()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_only_reads_writes_nothing() {
        let home = tempfile::tempdir().expect("temporary directory");
        let path = home.path().join("ledger.db");
        Ledger::open(&path).and_then(Ledger::close).expect("made");
        let found = || {
            let about = std::fs::metadata(&path).expect("there");
            let others = std::fs::read_dir(home.path()).expect("a folder").count();
            (std::fs::read(&path).expect("read"), about.modified().expect("a time"), others)
        };
        let before = found();
        let ledger = Ledger::open(&path).expect("opens");
        assert_eq!(ledger.contradictions(), Ok(Vec::new()));
        assert_eq!(ledger.confirm(9).expect("nothing to confirm"), Vec::new());
        ledger.close().expect("closed");
        assert!(before == found(), "neither its bytes nor its time");
    }

    #[test]
    fn an_empty_ledger_is_sound_and_an_unclean_end_is_known() {
        let home = tempfile::tempdir().expect("temporary directory");
        let path = home.path().join("ledger.db");
        let ledger = Ledger::open(&path).expect("opens");
        assert_eq!((ledger.ended_cleanly(), ledger.contradictions()), (true, Ok(Vec::new())));
        drop(ledger);
        let ledger = Ledger::open(&path).expect("opens");
        assert!(!ledger.ended_cleanly());
        ledger.close().expect("closed");
        let ledger = Ledger::open(&path).expect("opens");
        assert!(ledger.ended_cleanly());
        ledger.put_setting("a", "b").expect("written");
        drop(ledger);
        let ledger = Ledger::open(&path).expect("opens");
        assert!(!ledger.ended_cleanly(), "the first change marked it as open");
        ledger.close().expect("closed");
        let ledger = Ledger::open(&path).expect("opens");
        assert!(ledger.ended_cleanly());
        let lost = "INSERT INTO intake VALUES (7, 3); INSERT INTO counters VALUES (7, 2, 2, 9);
                    INSERT INTO leaves VALUES (1, 1, 0, x'')";
        ledger.write(|session| Ok(session.connection.execute_batch(lost)?)).expect("written");
        let found = ledger.contradictions().expect("read");
        assert_eq!(found.len(), 2, "{found:?}");
        assert!(found[0].contains("were stored") && found[1].contains("batch positions"), "{found:?}");
    }
}
