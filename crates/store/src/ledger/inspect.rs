//! An audit's pages, one snapshot each, so that memory stays constant. An unreadable row is reported, and the walk goes
//! on.

use std::collections::HashMap;

use super::Inspection;
use super::branches::Branches;
use super::rows::{self, RecordRow, Stream, optional, unsigned};
use super::{batches, branches};
use crate::StoreError;
use crate::crypto::merkle::Inclusion;
use crate::database::{self, capped, count, whole};
use crate::model::{Address, Digest, FilterId, Hash, RecordState, RecorderId, SignerId, Timestamp, TopicId, clean};
use crate::sql::{self, Row, params};

/// Of [`rows::record`].
const RECORD_COLUMNS: usize = 14;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AuditedPlace {
    /// `None` if the batch is gone.
    pub inclusion: Option<Inclusion>,
    pub transaction: Option<Hash>,
    pub block: Option<u64>,
    pub block_hash: Option<Hash>,
    /// A verified record depends on this block, but the ledger knows another one from elsewhere.
    pub is_contradicted: bool,
}

#[allow(clippy::struct_excessive_bools, reason = "each says another thing of the row")]
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AuditedRecord {
    pub number: u64,
    pub row: RecordRow,
    pub place: Option<AuditedPlace>,
    pub is_stored: bool,
    /// Row and stream name the same topic.
    pub in_its_topic: bool,
    /// Row and retention agree on the deletion's time.
    pub as_retained: bool,
}

#[derive(Debug, Default)]
pub struct AuditPage {
    /// An unreadable row as its number and the reason.
    pub records: Vec<Result<AuditedRecord, (u64, String)>>,
    /// `None` at the end.
    pub next: Option<u64>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AuditedBatch {
    pub key: u64,
    pub root: Hash,
    /// At closing.
    pub count: u64,
    /// With records in the ledger.
    pub held: u64,
    /// Else perhaps not all its records ever came here.
    pub closed_here: bool,
    /// That anchored it, or will.
    pub account: Option<Address>,
    pub transaction: Option<Hash>,
    pub block: Option<u64>,
    pub block_hash: Option<Hash>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sequence {
    pub key: i64,
    pub owner: Address,
    /// Or its pseudonym.
    pub name: String,
    /// Anchors it instead of the owner.
    pub keeper: Option<Address>,
    pub signer: SignerId,
    pub recorder: RecorderId,
    pub count: u64,
    pub first: u64,
    pub last: u64,
}

impl Inspection {
    /// After row `after`, captured at `since` or later.
    pub fn audit_page(&self, after: u64, since: Timestamp, limit: usize) -> Result<AuditPage, StoreError> {
        let (after, since) = (whole("row", after)?, whole("time", since.0)?);
        let limit = capped(limit);
        self.0.read(|connection| {
            let streams = rows::all_streams(connection)?;
            let sql = format!(
                "SELECT {}, n, leaves.batch, leaf, branches.path, root, batches.count, batches.tx, batches.block,
                    batches.block_hash, EXISTS (SELECT 1 FROM ciphertext WHERE record = n),
                    records.topic = (SELECT topic FROM streams WHERE streams.key = stream),
                    records.deleted_at IS NOT DISTINCT FROM (SELECT retained.deleted_at FROM retained WHERE record = n), {}
                    FROM records LEFT JOIN leaves ON record = n LEFT JOIN batches ON key = leaves.batch
                    {}
                    WHERE n > ?1 AND (captured_at >= ?2 OR captured_at < 0) ORDER BY n LIMIT ?3",
                rows::COLUMNS,
                batches::CONTRADICTED,
                branches::JOINED
            );
            let (mut page, mut last, mut branches) = (AuditPage::default(), 0, Branches::default());
            connection.each(&sql, params![after, since, limit], |row| {
                last = unsigned(row, RECORD_COLUMNS)?;
                let record = audited(row, &streams, &mut branches);
                page.records.push(record.map_err(|error| (last, clean(&error.to_string(), 160))));
                Ok(())
            })?;
            page.next = (capped(page.records.len()) >= limit).then_some(last);
            Ok(page)
        })
    }

    /// How many of these ids find a record in the indexes of tags and of their streams.
    pub fn indexed(&self, number: u64, filters: &[FilterId]) -> Result<u64, StoreError> {
        let number = whole("row", number)?;
        self.0.read(|connection| {
            let sql = "SELECT 1 FROM filter_ids JOIN filters ON filters.filter = key
                WHERE id = ?1 AND record = ?2 AND EXISTS (SELECT 1 FROM filter_streams
                    WHERE filter_streams.filter = key AND stream = (SELECT stream FROM records WHERE n = ?2))";
            let found = connection.among(sql, filters, |filter: FilterId| Ok((filter.0, number)), true)?;
            Ok(count(found.len()))
        })
    }

    pub fn size_of_index(&self, last: u64) -> Result<u64, StoreError> {
        let last = whole("row", last)?;
        self.0.one("SELECT count(*) FROM filters WHERE record <= ?1", [last], |row| unsigned(row, 0))
    }

    pub fn audit_batches(&self, after: u64, limit: usize) -> Result<Vec<AuditedBatch>, StoreError> {
        let after = whole("batch", after)?;
        let sql = "SELECT key, root, count, (SELECT count(*) FROM leaves JOIN records ON n = record WHERE batch = key)
            + (SELECT count(*) FROM left_places JOIN records ON n = record WHERE batch = key),
            account, tx, block, block_hash, closed_here FROM batches WHERE key > ?1 ORDER BY key LIMIT ?2";
        self.0.list(sql, params![after, capped(limit)], batch)
    }

    /// By this machine's clock.
    pub fn newest_acknowledgement(&self) -> Result<Option<Timestamp>, StoreError> {
        let sql = "SELECT acknowledged_at FROM records ORDER BY n DESC LIMIT 1";
        let newest: Option<i64> = self.0.find(sql, [], |row| row.get(0))?;
        Ok(newest.and_then(|newest| u64::try_from(newest).ok()).map(Timestamp))
    }

    pub fn unknown_roots(&self, roots: &[Hash]) -> Result<Vec<Hash>, StoreError> {
        let sql = "SELECT 1 FROM batches WHERE root = ?1";
        self.0.read(|connection| connection.among(sql, roots, |root| Ok([root.0]), false))
    }

    pub fn unknown_digests(&self, digests: &[Digest]) -> Result<Vec<Digest>, StoreError> {
        let sql = "SELECT 1 FROM records WHERE digest = ?1";
        self.0.read(|connection| connection.among(sql, digests, |digest| Ok([digest.0]), false))
    }

    pub fn size(&self) -> Result<u64, StoreError> {
        self.0.one("SELECT coalesce(sum(records), 0) FROM counters", [], |row| unsigned(row, 0))
    }

    pub fn signing_accounts(&self) -> Result<Vec<Address>, StoreError> {
        self.0.list("SELECT DISTINCT account FROM transactions", [], |row| row.get(0).map(Address))
    }

    pub fn signs_for(&self, account: Address) -> Result<bool, StoreError> {
        let sql = "SELECT EXISTS (SELECT 1 FROM transactions WHERE account = ?1)";
        self.0.one(sql, [account.0], |row| row.get(0))
    }

    /// Topics with records stamped more than five seconds before their predecessor, and how many.
    pub fn backwards(&self) -> Result<Vec<(String, u64)>, StoreError> {
        let sql = "SELECT coalesce(nullif(name, ''), lower(hex(topic_id))), held FROM
            (SELECT topic, count(*) AS held FROM
             (SELECT topic, captured_at, lag(captured_at) OVER (PARTITION BY topic ORDER BY seq) AS before
              FROM records) AS steps WHERE captured_at + 5000000000 < before GROUP BY topic) AS back
            JOIN topics ON topics.key = topic ORDER BY topics.key";
        self.0.list(sql, [], |row| Ok((row.get(0)?, unsigned(row, 1)?)))
    }

    pub fn holder(
        &self,
        owner: Address,
        (signer, recorder): (SignerId, RecorderId),
        topic: TopicId,
        number: u64,
    ) -> Result<Option<Digest>, StoreError> {
        let number = whole("sequence number", number)?;
        let sql = "SELECT digest FROM records JOIN topics ON topics.key = records.topic
            JOIN recorders ON recorders.key = topics.recorder
            WHERE topics.owner = ?1 AND recorders.id = ?2 AND topics.topic_id = ?3 AND seq = ?4
            AND recorders.signer = ?5";
        let values = params![owner.0, recorder.0, topic.0, number, signer.0];
        self.0.find(sql, values, |row| row.get(0).map(Digest))
    }

    pub fn sequences(&self) -> Result<Vec<Sequence>, StoreError> {
        let sql = "SELECT topics.key, owner, coalesce(nullif(name, ''), lower(hex(topic_id))), keeper, held, low, high, id, signer
            FROM (SELECT topic, count(*) AS held, min(seq) AS low, max(seq) AS high FROM records GROUP BY topic) AS numbers
            JOIN topics ON topics.key = topic JOIN recorders ON recorders.key = topics.recorder
            ORDER BY topics.key";
        self.0.list(sql, [], |row| {
            let (owner, keeper) = (Address(row.get(1)?), row.get::<Option<_>>(3)?.map(Address));
            let (count, first, last) = (unsigned(row, 4)?, unsigned(row, 5)?, unsigned(row, 6)?);
            let (recorder, signer) = (RecorderId(row.get(7)?), SignerId(row.get(8)?));
            let (key, name) = (row.get(0)?, row.get(2)?);
            Ok(Sequence { key, owner, name, keeper, signer, recorder, count, first, last })
        })
    }

    /// First and last missing numbers.
    pub fn holes(&self, sequence: &Sequence, limit: usize) -> Result<Vec<(u64, u64)>, StoreError> {
        let before = (sequence.first > 1).then(|| (1, sequence.first - 1));
        let sql = "SELECT seq + 1, next - 1 FROM
            (SELECT seq, lead(seq) OVER (ORDER BY seq) AS next FROM records WHERE topic = ?1) AS steps
            WHERE next > seq + 1 LIMIT ?2";
        let values = params![sequence.key, capped(limit)];
        let holes: Vec<_> = self.0.list(sql, values, |row| Ok((unsigned(row, 0)?, unsigned(row, 1)?)))?;
        Ok(before.into_iter().chain(holes).collect())
    }
}

fn audited(row: &Row<'_>, streams: &HashMap<i64, Stream>, branches: &mut Branches) -> sql::Result<AuditedRecord> {
    Ok(AuditedRecord {
        number: unsigned(row, RECORD_COLUMNS)?,
        row: rows::record(row, streams)?,
        place: place(row, branches)?,
        is_stored: row.get(RECORD_COLUMNS + 9)?,
        in_its_topic: row.get::<Option<bool>>(RECORD_COLUMNS + 10)?.unwrap_or(false),
        as_retained: row.get(RECORD_COLUMNS + 11)?,
    })
}

fn place(row: &Row<'_>, branches: &mut Branches) -> sql::Result<Option<AuditedPlace>> {
    let column = |number: usize| RECORD_COLUMNS + number;
    if row.get::<Option<i64>>(column(1))?.is_none() {
        return Ok(None);
    }
    let within = |root| {
        let (index, count) = (unsigned(row, column(2))?, unsigned(row, column(5))?);
        let path = branches.path_of(row, column(3), root, (index, count))?;
        Ok::<_, sql::Error>(Inclusion { index, count, path, root })
    };
    let inclusion = row.get::<Option<_>>(column(4))?.map(Hash).map(within).transpose()?;
    let (transaction, block) = (row.get::<Option<_>>(column(6))?.map(Hash), optional(row, column(7))?);
    let (block_hash, is_contradicted) = (row.get::<Option<_>>(column(8))?.map(Hash), row.get(column(12))?);
    Ok(Some(AuditedPlace { inclusion, transaction, block, block_hash, is_contradicted }))
}

fn batch(row: &Row<'_>) -> sql::Result<AuditedBatch> {
    let (key, count, held) = (unsigned(row, 0)?, unsigned(row, 2)?, unsigned(row, 3)?);
    let (account, transaction) = (row.get::<Option<_>>(4)?.map(Address), row.get::<Option<_>>(5)?.map(Hash));
    let (block, block_hash) = (optional(row, 6)?, row.get::<Option<_>>(7)?.map(Hash));
    let (root, closed_here) = (Hash(row.get(1)?), row.get(8)?);
    Ok(AuditedBatch { key, root, count, held, closed_here, account, transaction, block, block_hash })
}

// Whether the tables agree: checked after an unclean shutdown, and when a home is examined.

/// Counts the rows that `found` or `held` has and the other has not.
macro_rules! differing {
    (found: $found:literal, held: $held:literal) => {
        concat!(
            "WITH found AS (",
            $found,
            "), held AS (",
            $held,
            ")
            SELECT count(*) FROM (SELECT * FROM (SELECT * FROM found EXCEPT SELECT * FROM held) lacking
            UNION ALL SELECT * FROM (SELECT * FROM held EXCEPT SELECT * FROM found) excess) differing"
        )
    };
}

/// Queries that must count zero, with the meaning of any other count.
const RULES: [(&str, &str); 5] = [
    (
        differing!(
            found: "SELECT stream, state, count(*) AS records, sum(bytes) AS bytes FROM records GROUP BY state, stream",
            held: "SELECT * FROM counters WHERE records <> 0 OR bytes <> 0"
        ),
        "counts per state do not match the records",
    ),
    (
        differing!(
            found: "SELECT stream, epoch, sum(CASE WHEN state NOT IN (7, 8) AND deleted_at IS NULL THEN 1 ELSE 0 END),
                min(min(captured_at, acknowledged_at)), max(min(captured_at, acknowledged_at))
                FROM records GROUP BY stream, epoch",
            held: "SELECT * FROM epoch_records"
        ),
        "counts per epoch do not match the records",
    ),
    (
        "SELECT count(*) FROM (SELECT stream, sum(records) AS rows FROM counters GROUP BY stream) held
            LEFT JOIN intake i ON i.stream = held.stream WHERE i.records IS DISTINCT FROM held.rows",
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
];

impl Inspection {
    /// If not, opening checked the file's structure.
    pub fn ended_cleanly(&self) -> bool {
        self.0.shared.clean
    }

    /// Reads every row: a few seconds per million records.
    pub fn contradictions(&self) -> Result<Vec<String>, StoreError> {
        self.0.read(|connection| {
            let found = RULES.iter().map(|(sql, text)| {
                let count: i64 = connection.one(sql, [], |row| row.get(0))?;
                Ok::<_, StoreError>((count > 0).then(|| format!("{count} {text}")))
            });
            found.filter_map(Result::transpose).collect()
        })
    }

    /// Reads everything but ciphertext, and compares indices with their tables.
    pub fn check_file(&self) -> Result<(), StoreError> {
        self.0.read(|connection| match connection.file() {
            Some(file) => database::check_all_but("integrity_check", file, "ciphertext", self.0.path()),
            None => Ok(()),
        })
    }

    /// Those acknowledged last whose ciphertext should be there.
    pub fn newest_stored(&self, limit: usize) -> Result<Vec<Digest>, StoreError> {
        let states = (RecordState::Stored.code(), RecordState::Verified.code());
        let values = (states.0, states.1, capped(limit), RecordState::RightEnded.code());
        let sql = "SELECT digest FROM records NOT INDEXED WHERE (state BETWEEN ?1 AND ?2 OR state = ?4)
        AND NOT EXISTS (SELECT 1 FROM retained WHERE record = n) ORDER BY n DESC LIMIT ?3";
        self.0.list(sql, values, |row| row.get(0).map(Digest))
    }
}

#[cfg(test)]
mod integrity_tests {
    use crate::Ledger;
    use crate::notes::CopiedAt;

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
        assert_eq!(ledger.inspection.contradictions(), Ok(Vec::new()));
        assert_eq!(ledger.batches.confirm(9).expect("nothing to confirm"), Vec::new());
        ledger.close().expect("closed");
        assert!(before == found(), "neither its bytes nor its time");
    }

    #[test]
    fn an_empty_ledger_is_sound_and_an_unclean_end_is_known() {
        let home = tempfile::tempdir().expect("temporary directory");
        let path = home.path().join("ledger.db");
        let ledger = Ledger::open(&path).expect("opens");
        assert_eq!((ledger.inspection.ended_cleanly(), ledger.inspection.contradictions()), (true, Ok(Vec::new())));
        drop(ledger);
        let ledger = Ledger::open(&path).expect("opens");
        assert!(!ledger.inspection.ended_cleanly());
        ledger.close().expect("closed");
        let ledger = Ledger::open(&path).expect("opens");
        assert!(ledger.inspection.ended_cleanly());
        ledger.notes.write(&CopiedAt {}, &7).expect("written");
        drop(ledger);
        let ledger = Ledger::open(&path).expect("opens");
        assert!(!ledger.inspection.ended_cleanly(), "the first change marked it as open");
        ledger.close().expect("closed");
        let ledger = Ledger::open(&path).expect("opens");
        assert!(ledger.inspection.ended_cleanly());
        let lost = "INSERT INTO intake VALUES (7, 3); INSERT INTO counters VALUES (7, 2, 2, 9);
                    INSERT INTO leaves VALUES (1, 1, 0)";
        ledger.database.write(|session| Ok(session.connection.script(lost)?)).expect("written");
        let found = ledger.inspection.contradictions().expect("read");
        let meanings = ["counts per state", "were stored", "batch positions"];
        assert!(
            found.len() == 3 && found.iter().zip(meanings).all(|(found, meaning)| found.contains(meaning)),
            "{found:?}"
        );
    }
}
