//! Moving from one chain to another: verified records keep a note of their old anchor, the rest are anchored again.
//! Moving only to another contract: what is in a block stays there, and is noted as anchored in the old contract.

use rusqlite::{Connection, OptionalExtension as _, params};
use serde::{Deserialize, Serialize};

use super::append::count;
use super::edges::{By, may};
use super::{Ledger, rows::unsigned};
use crate::model::{Digest, Domain, Hash, RecordState};
use crate::store::StoreError;

/// Where a verified record was anchored on an abandoned chain.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct EarlierAnchor {
    /// The network of that chain.
    pub domain: Domain,
    /// The transaction.
    pub transaction: Option<Hash>,
    /// Its block.
    pub block: u64,
    /// That block's hash.
    pub block_hash: Option<Hash>,
}

/// The effect of leaving a chain.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Left {
    /// Verified records whose anchors stay on the old chain.
    pub kept: u64,
    /// Records to be anchored again.
    pub anew: u64,
}

/// States of records whose anchor, or progress to one, was lost with the chain.
const UNSETTLED: [RecordState; 3] = [RecordState::Submitted, RecordState::Mined, RecordState::Confirmed];

impl Ledger {
    /// Abandons the chain of `domain`, in one commit: verified records stay verified and keep a note of their anchor
    /// there; all others are stored (or batched) again; no transaction is open, no block is known any more. The setting
    /// `key` is written with it, so that both happen or neither does.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like; then nothing changes.
    pub fn leave_chain(&self, domain: Domain, key: &str, value: &str) -> Result<Left, StoreError> {
        let (key, value) = (key.to_owned(), value.to_owned());
        self.write(move |session| {
            let connection = session.connection;
            let kept = keep_anchors(connection, domain)?;
            free_batches(connection)?;
            connection.execute("UPDATE transactions SET state = 3 WHERE state = 0", [])?;
            connection
                .execute("UPDATE transactions SET block = NULL, block_hash = NULL WHERE block IS NOT NULL", [])?;
            let mut anew = 0;
            for state in UNSETTLED {
                anew += store_again(connection, state)?;
            }
            connection.execute(
                "UPDATE records SET tx = NULL, block = NULL, block_hash = NULL WHERE state = ?1",
                [RecordState::Tampered.code()],
            )?;
            connection.execute_batch(
                "DELETE FROM events; DELETE FROM trail; DELETE FROM cursors; DELETE FROM passed_over;",
            )?;
            connection.execute("REPLACE INTO settings VALUES (?1, ?2)", [key, value])?;
            Ok(Left { kept, anew })
        })
    }

    /// Abandons the contract of `domain` for another one on the same chain, in one commit: what is in a block stays
    /// there and is noted as anchored in that contract; what was on its way is anchored again. `key` as for
    /// [`Ledger::leave_chain`].
    ///
    /// # Errors
    /// See [`Ledger::leave_chain`].
    pub fn leave_contract(&self, domain: Domain, key: &str, value: &str) -> Result<Left, StoreError> {
        let (key, value) = (key.to_owned(), value.to_owned());
        self.write(move |session| {
            let connection = session.connection;
            let kept = connection.execute(
                "REPLACE INTO earlier_anchors
                 SELECT n, ?1, tx, block, block_hash FROM records WHERE block IS NOT NULL AND state IN (?2, ?3, ?4, ?5)
                 AND NOT EXISTS (SELECT 1 FROM earlier_anchors AS known WHERE record = n AND known.block = records.block)",
                params![
                    domain.0,
                    RecordState::Mined.code(),
                    RecordState::Confirmed.code(),
                    RecordState::Verified.code(),
                    RecordState::Tampered.code()
                ],
            )?;
            connection.execute("UPDATE batches SET tx = NULL, account = NULL WHERE block IS NULL", [])?;
            connection.execute("UPDATE transactions SET state = 3 WHERE state = 0", [])?;
            let anew = store_again(connection, RecordState::Submitted)?;
            connection.execute("REPLACE INTO settings VALUES (?1, ?2)", [key, value])?;
            Ok(Left { kept: count(kept), anew })
        })
    }

    /// Where a verified record was anchored before its chain was abandoned.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn earlier_anchor(&self, digest: Digest) -> Result<Option<EarlierAnchor>, StoreError> {
        self.read(|connection| {
            let sql = "SELECT domain, earlier_anchors.tx, earlier_anchors.block, earlier_anchors.block_hash
                       FROM earlier_anchors JOIN records ON record = n WHERE digest = ?1";
            let mut statement = connection.prepare_cached(sql)?;
            let anchor = statement.query_row([digest.0], |row| {
                Ok(EarlierAnchor {
                    domain: Domain(row.get(0)?),
                    transaction: row.get::<_, Option<_>>(1)?.map(Hash),
                    block: unsigned(row, 2)?,
                    block_hash: row.get::<_, Option<_>>(3)?.map(Hash),
                })
            });
            Ok(anchor.optional()?)
        })
    }
}

fn keep_anchors(connection: &Connection, domain: Domain) -> Result<u64, StoreError> {
    let verified = RecordState::Verified.code();
    connection.execute(
        "REPLACE INTO earlier_anchors
         SELECT n, ?1, tx, block, block_hash FROM records WHERE state = ?2 AND block IS NOT NULL",
        params![domain.0, verified],
    )?;
    let kept = connection.execute(
        "UPDATE records SET block = NULL, block_hash = NULL WHERE state = ?1 AND block IS NOT NULL",
        [verified],
    )?;
    Ok(count(kept))
}

/// Batches with only verified records keep their transaction, so that they do not wait; the others wait.
fn free_batches(connection: &Connection) -> Result<(), StoreError> {
    connection.execute(
        "UPDATE batches SET tx = NULL, account = NULL WHERE key IN
         (SELECT batch FROM leaves JOIN records ON n = record WHERE state IN (?1, ?2, ?3))",
        UNSETTLED.map(RecordState::code),
    )?;
    connection.execute("UPDATE batches SET block = NULL, block_hash = NULL WHERE block IS NOT NULL", [])?;
    Ok(())
}

fn store_again(connection: &Connection, from: RecordState) -> Result<u64, StoreError> {
    let (stored, batched) = (RecordState::Stored, RecordState::Batched);
    let legal = |to| may(By::Reorg, from, to) || may(By::Close, from, to);
    if let Some(to) = [stored, batched].into_iter().find(|to| !legal(*to)) {
        return Err(StoreError::IllegalEdge { from, to });
    }
    let moved = connection.execute(
        "UPDATE records INDEXED BY records_by_state SET tx = NULL, block = NULL, block_hash = NULL,
         state = CASE WHEN EXISTS (SELECT 1 FROM leaves WHERE record = n) THEN ?3 ELSE ?2 END
         WHERE state = ?1",
        [from, stored, batched].map(RecordState::code),
    )?;
    Ok(count(moved))
}

#[cfg(test)]
mod tests {
    use super::super::tests::numbered as record;
    use super::*;
    use crate::model::Address;
    use crate::store::{Anchors, NewBatch, NewTransaction, Sighting};

    fn sighting(number: u8, block: u64) -> Sighting {
        let (transaction, block_hash) = (Hash([number; 32]), Hash([9; 32]));
        Sighting { owner: Address([1; 20]), digest: Digest([number; 32]), transaction, block, block_hash }
    }

    #[test]
    fn the_verified_stay_and_the_rest_begins_anew() {
        let home = tempfile::tempdir().expect("folder");
        let ledger = Ledger::open(&home.path().join("ledger.db")).expect("opens");
        ledger.append((1..=6).map(record).collect()).expect("acknowledged");
        let leaves = [3, 4].map(|number| (Digest([number; 32]), vec![Hash([number; 32])])).to_vec();
        let root = Hash([77; 32]);
        ledger.close_batch(NewBatch { owner: Address([1; 20]), root, leaves }).expect("closed");
        let transaction = |hash, nonce, anchors| NewTransaction {
            hash: Hash([hash; 32]),
            account: Address([1; 20]),
            nonce,
            raw: vec![1],
            purpose: "x".to_owned(),
            anchors,
        };
        ledger.submit(transaction(50, 1, Anchors::Batch(root))).expect("kept");
        ledger.submit(transaction(51, 2, Anchors::Digests(vec![Digest([5; 32])]))).expect("kept");
        ledger.mined(&[sighting(1, 5), sighting(2, 6)]).expect("seen");
        ledger.confirm(6).expect("confirmed");
        ledger.advance(&[Digest([1; 32])], RecordState::Confirmed, RecordState::Verified).expect("verified");
        ledger.walk_to("watcher", (6, Hash([9; 32])), Vec::new()).expect("walked");

        let left = ledger.leave_chain(Domain([8; 32]), "adoptions", "[1]");
        assert_eq!(left, Ok(Left { kept: 1, anew: 4 }));
        let states: Vec<_> =
            (1..=6).map(|n| ledger.record(Digest([n; 32])).expect("read").expect("kept").state).collect();
        let [verified, stored, batched] = [RecordState::Verified, RecordState::Stored, RecordState::Batched];
        assert_eq!(states, [verified, stored, batched, batched, stored, stored]);
        let anchor = ledger.earlier_anchor(Digest([1; 32])).expect("read").expect("kept");
        assert_eq!((anchor.domain, anchor.block, anchor.transaction), (Domain([8; 32]), 5, Some(Hash([1; 32]))));
        assert_eq!(ledger.earlier_anchor(Digest([2; 32])), Ok(None));
        assert_eq!(ledger.lane_count(Address([1; 20])).map(|lane| lane.open), Ok(0));
        assert_eq!(ledger.waiting_batches(Address([1; 20]), 9).map(|batches| batches.len()), Ok(1));
        assert_eq!((ledger.cursor("watcher"), ledger.trail_end()), (Ok(None), Ok(None)));
        assert_eq!(ledger.setting("adoptions"), Ok(Some("[1]".to_owned())));
        let again = ledger.leave_contract(Domain([6; 32]), "adoptions", "[2]");
        assert_eq!(again, Ok(Left { kept: 0, anew: 0 }), "no block of that chain holds any");
        // A reorg on the new chain does not affect them.
        assert_eq!((ledger.unverify(0), ledger.unmine(0)), (Ok(0), Ok(0)));
    }

    #[test]
    fn what_is_in_a_block_stays_when_only_the_contract_is_left() {
        let home = tempfile::tempdir().expect("folder");
        let ledger = Ledger::open(&home.path().join("ledger.db")).expect("opens");
        ledger.append((1..=3).map(record).collect()).expect("acknowledged");
        let (hash, account) = (Hash([51; 32]), Address([1; 20]));
        let anchors = Anchors::Digests(vec![Digest([3; 32])]);
        let on_its_way = NewTransaction { hash, account, nonce: 2, raw: vec![1], purpose: "x".to_owned(), anchors };
        ledger.submit(on_its_way).expect("kept");
        ledger.mined(&[sighting(1, 5), sighting(2, 6)]).expect("seen");
        ledger.confirm(5).expect("confirmed");
        ledger.advance(&[Digest([1; 32])], RecordState::Confirmed, RecordState::Verified).expect("verified");

        let left = ledger.leave_contract(Domain([8; 32]), "adoptions", "[1]");
        assert_eq!(left, Ok(Left { kept: 2, anew: 1 }));
        let rows: Vec<_> = (1..=3).map(|n| ledger.record(Digest([n; 32])).expect("read").expect("kept")).collect();
        let found: Vec<_> = rows.iter().map(|row| (row.state, row.block)).collect();
        let expected = [(RecordState::Verified, Some(5)), (RecordState::Mined, Some(6)), (RecordState::Stored, None)];
        assert_eq!(found, expected);
        let anchor =
            |n| ledger.earlier_anchor(Digest([n; 32])).expect("read").map(|anchor| (anchor.domain, anchor.block));
        assert_eq!([anchor(1), anchor(2), anchor(3)], [Some((Domain([8; 32]), 5)), Some((Domain([8; 32]), 6)), None]);
        assert_eq!(ledger.confirm(6).map(|times| times.len()), Ok(1), "it goes on");
        // With the next contract, records in the first one are still known to be there.
        assert_eq!(ledger.leave_contract(Domain([9; 32]), "adoptions", "[2]").map(|left| left.kept), Ok(0));
        assert_eq!(anchor(1), Some((Domain([8; 32]), 5)));
    }
}
