//! Records passed on to a gateway: accepted by its signed receipt, verified or lost by its statement.

use std::collections::BTreeSet;

use rusqlite::{OptionalExtension as _, params};

use super::append::count;
use super::edges::{By, may};
use super::rows::{self, RecordRow};
use super::{Ledger, Session};
use crate::model::{Digest, RecordState, Signature, Timestamp};
use crate::store::StoreError;
use crate::store::database::whole;

/// A gateway's signed receipt for records.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeptReceipt {
    /// Its time.
    pub time: Timestamp,
    /// All digests it covers, in order.
    pub digests: Vec<Digest>,
    /// Signature by the gateway's identity key.
    pub signature: Signature,
}

/// A page of the records that a gateway signed for and that are not decided yet.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ForwardedPage {
    /// The records, in the order of this ledger.
    pub rows: Vec<RecordRow>,
    /// Where the next page begins; none if this is the last.
    pub next: Option<i64>,
}

/// Records of no transaction and no block of this ledger.
const MOVE: &str = "UPDATE records SET state = ?3 WHERE digest = ?1 AND state = ?2 AND tx IS NULL AND block IS NULL";

impl Ledger {
    /// The gateway took records over: its receipt is stored, and those in state stored become submitted. Returns how many
    /// changed.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like; then nothing changes, and they are passed on again.
    pub fn accept(&self, receipt: KeptReceipt) -> Result<u64, StoreError> {
        self.write(move |session| {
            let digests: Vec<u8> = receipt.digests.iter().flat_map(|digest| digest.0).collect();
            session
                .connection
                .prepare_cached("INSERT INTO receipts (at, digests, signature) VALUES (?1, ?2, ?3)")?
                .execute(params![whole("time", receipt.time.0)?, digests, receipt.signature.0])?;
            let key = session.connection.last_insert_rowid();
            let moved = shift(session, &receipt.digests, RecordState::Stored, RecordState::Submitted)?;
            let before = held(session, &receipt.digests)?;
            let mut bind = session.connection.prepare_cached(
                "INSERT INTO receipted SELECT n, ?2 FROM records WHERE digest = ?1
                 ON CONFLICT DO UPDATE SET receipt = excluded.receipt",
            )?;
            for digest in &receipt.digests {
                bind.execute(params![digest.0, key])?;
            }
            sweep(session, before)?;
            Ok(moved)
        })
    }

    /// The submitted records that the gateway signed for, after a page whose `next` was this.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn forwarded(&self, after: Option<i64>, limit: usize) -> Result<ForwardedPage, StoreError> {
        let limit = limit.max(1);
        self.read(|connection| {
            let sql = format!(
                "SELECT {}, n FROM receipted JOIN records ON n = record WHERE record > ?1 AND state = ?2
                 ORDER BY record LIMIT ?3",
                rows::COLUMNS
            );
            let most = i64::try_from(limit).unwrap_or(i64::MAX);
            let values = params![after.unwrap_or(0), RecordState::Submitted.code(), most];
            let mut statement = connection.prepare_cached(&sql)?;
            let streams: Vec<i64> =
                statement.query_map(values, |row| row.get(0))?.collect::<Result<_, rusqlite::Error>>()?;
            let streams = rows::keyed_streams(connection, streams)?;
            let found =
                statement.query_map(values, |row| Ok((rows::record(row, &streams)?, row.get::<_, i64>(14)?)))?;
            let found: Vec<(RecordRow, i64)> = found.collect::<Result<_, _>>()?;
            let next = found.last().map(|(_, key)| *key).filter(|_| found.len() >= limit);
            Ok(ForwardedPage { rows: found.into_iter().map(|(row, _)| row).collect(), next })
        })
    }

    /// A gateway's standings of records it took over: verified, tampered, or, if it no longer knows them, stored again.
    /// Receipts whose records are all verified are deleted. Returns how many records changed.
    ///
    /// # Errors
    /// [`StoreError::IllegalEdge`] if no gateway may cause this transition, [`StoreError::DiskFull`] and the like.
    pub fn settle_forwarded(&self, digests: &[Digest], to: RecordState) -> Result<u64, StoreError> {
        let from = RecordState::Submitted;
        if !may(By::Gateway, from, to) {
            return Err(StoreError::IllegalEdge { from, to });
        }
        let digests = digests.to_vec();
        self.write_many(digests.len(), move |session| {
            let moved = shift(session, &digests, from, to)?;
            if to == RecordState::Verified {
                let before = held(session, &digests)?;
                let mut release = session
                    .connection
                    .prepare_cached("DELETE FROM receipted WHERE record = (SELECT n FROM records WHERE digest = ?1)")?;
                for digest in &digests {
                    release.execute(params![digest.0])?;
                }
                sweep(session, before)?;
            }
            Ok(moved)
        })
    }

    /// The newest receipt that covers a record not yet verified.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn receipt_of(&self, digest: Digest) -> Result<Option<KeptReceipt>, StoreError> {
        self.read(|connection| {
            let row: Option<(i64, Vec<u8>, [u8; 64])> = connection
                .prepare_cached(
                    "SELECT at, digests, signature FROM receipts WHERE key = (SELECT receipt FROM receipted
                     WHERE record = (SELECT n FROM records WHERE digest = ?1))",
                )?
                .query_row(params![digest.0], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?)))
                .optional()?;
            Ok(row.map(|(at, digests, signature)| KeptReceipt {
                time: Timestamp(at.cast_unsigned()),
                digests: digests.chunks(Digest::LENGTH).filter_map(Digest::from_slice).collect(),
                signature: Signature(signature),
            }))
        })
    }
}

fn shift(session: &Session<'_>, digests: &[Digest], from: RecordState, to: RecordState) -> Result<u64, StoreError> {
    let mut statement = session.connection.prepare_cached(MOVE)?;
    digests
        .iter()
        .try_fold(0, |moved, digest| Ok(moved + count(statement.execute(params![digest.0, from.code(), to.code()])?)))
}

/// The receipts that cover these records.
fn held(session: &Session<'_>, digests: &[Digest]) -> Result<BTreeSet<i64>, StoreError> {
    let mut find = session
        .connection
        .prepare_cached("SELECT receipt FROM receipted WHERE record = (SELECT n FROM records WHERE digest = ?1)")?;
    let found = digests.iter().map(|digest| find.query_row(params![digest.0], |row| row.get(0)).optional());
    Ok(found.filter_map(Result::transpose).collect::<Result<_, _>>()?)
}

/// Deletes receipts that no longer cover any record.
fn sweep(session: &Session<'_>, receipts: BTreeSet<i64>) -> Result<(), StoreError> {
    let mut forget = session.connection.prepare_cached(
        "DELETE FROM receipts WHERE key = ?1 AND NOT EXISTS (SELECT 1 FROM receipted WHERE receipt = ?1)",
    )?;
    for receipt in receipts {
        forget.execute([receipt])?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::tests::numbered as record;
    use super::*;

    fn receipt(numbers: &[u8]) -> KeptReceipt {
        let digests = numbers.iter().map(|number| Digest([*number; 32])).collect();
        KeptReceipt { time: Timestamp(7), digests, signature: Signature([number_of(numbers); 64]) }
    }

    fn number_of(numbers: &[u8]) -> u8 {
        numbers.iter().sum()
    }

    #[test]
    fn a_receipt_moves_its_records_and_is_kept_until_all_are_verified() {
        let home = tempfile::tempdir().expect("folder");
        let ledger = Ledger::open(&home.path().join("ledger.db")).expect("opens");
        ledger.append((1..=4).map(record).collect()).expect("acknowledged");
        assert_eq!(ledger.accept(receipt(&[1, 2, 9])), Ok(2), "one is not of this ledger");
        assert_eq!(ledger.accept(receipt(&[2, 3])), Ok(1), "acknowledged again");
        let state = |number: u8| ledger.record(Digest([number; 32])).expect("reads").map(|row| row.state);
        assert_eq!(
            [1, 2, 3, 4].map(state),
            [RecordState::Submitted, RecordState::Submitted, RecordState::Submitted, RecordState::Stored].map(Some)
        );
        assert_eq!(ledger.receipt_of(Digest([2; 32])), Ok(Some(receipt(&[2, 3]))), "the newest");
        assert_eq!(ledger.settle_forwarded(&[Digest([1; 32]), Digest([4; 32])], RecordState::Verified), Ok(1));
        assert_eq!(ledger.receipt_of(Digest([1; 32])), Ok(None));
        assert_eq!(ledger.settle_forwarded(&[Digest([2; 32])], RecordState::Stored), Ok(1));
        assert_eq!(ledger.receipt_of(Digest([2; 32])), Ok(Some(receipt(&[2, 3]))), "evidence");
        assert!(ledger.settle_forwarded(&[Digest([2; 32])], RecordState::Mined).is_err());
        assert_eq!(ledger.accept(receipt(&[2])), Ok(1));
        assert_eq!(ledger.settle_forwarded(&[Digest([2; 32]), Digest([3; 32])], RecordState::Verified), Ok(2));
        let left: i64 = ledger
            .read(|connection| Ok(connection.query_row("SELECT count(*) FROM receipts", [], |row| row.get(0))?))
            .expect("reads");
        assert_eq!(left, 0);
    }

    #[test]
    fn what_is_signed_for_and_not_decided_is_listed_page_by_page() {
        let home = tempfile::tempdir().expect("folder");
        let ledger = Ledger::open(&home.path().join("ledger.db")).expect("opens");
        ledger.append((1..=5).map(record).collect()).expect("acknowledged");
        assert_eq!(ledger.forwarded(None, 9), Ok(ForwardedPage::default()));
        ledger.accept(receipt(&[1, 2, 3, 4])).expect("accepted");
        let numbers = |page: &ForwardedPage| page.rows.iter().map(|row| row.digest.0[0]).collect::<Vec<_>>();
        let first = ledger.forwarded(None, 3).expect("reads");
        let second = ledger.forwarded(first.next, 3).expect("reads");
        assert_eq!((numbers(&first), numbers(&second), second.next), (vec![1, 2, 3], vec![4], None));
        ledger.settle_forwarded(&[Digest([2; 32])], RecordState::Verified).expect("settles");
        ledger.settle_forwarded(&[Digest([3; 32])], RecordState::Stored).expect("sent again");
        // Damaged here: nobody is asked about it any more.
        ledger.advance(&[Digest([4; 32])], RecordState::Submitted, RecordState::Tampered).expect("moves");
        assert_eq!(numbers(&ledger.forwarded(None, 9).expect("reads")), [1]);
    }
}
