//! What a gateway holds for the other gateways of its fleet: anchored records in the order of the anchoring blocks, and
//! which of another gateway's records are lacking here.

use std::collections::HashMap;

use rusqlite::{OptionalExtension as _, Row, params};

use super::batches::{self, BatchPlace};
use super::rows::{self, RecordRow, state, unsigned};
use super::{Ledger, database::whole};
use crate::model::{Address, Digest, Ranges, RecordState, RecorderId, TopicId};
use crate::store::StoreError;

/// A record that is held.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct HoldingRow {
    /// Block, batch and leaf of its anchor.
    pub place: (u64, u64, u64),
    /// The owner.
    pub owner: Address,
    /// The recorder.
    pub recorder: RecorderId,
    /// Pseudonym of its topic.
    pub topic_id: TopicId,
    /// Its number.
    pub seq: u64,
}

/// Records that are held, in the order of the blocks that anchor them.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct HoldingPage {
    /// The records.
    pub rows: Vec<HoldingRow>,
    /// Block, batch and leaf of the last one looked at; `None` = there was none.
    pub last: Option<(u64, u64, u64)>,
    /// Whether there may be more behind it.
    pub more: bool,
}

/// A record of one of several ranges that were asked for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HeldRecord {
    /// Which range, counted from 0.
    pub range: usize,
    /// The record.
    pub row: RecordRow,
    /// Its place in its batch.
    pub place: Option<BatchPlace>,
}

/// Which of another gateway's records are lacking here.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Lacking {
    /// Numbers that are not here, or not anchored as far as this ledger knows.
    pub numbers: Ranges,
    /// Of the records that are here, those on their way to an anchor of their own.
    pub twice: Vec<Digest>,
}

/// Whose records, numbered by whom, of which topic.
type Which = (Address, RecorderId, TopicId);

/// For so many blocks the list ends before a record that is anchored and not verified yet: whoever reads it goes on behind
/// its end, and would miss what is told a little later.
const WAITED_FOR: u64 = 256;

/// A row that was looked at: whether its anchor and bytes are here, its state.
type Looked = (bool, RecordState, HoldingRow);

impl Ledger {
    /// The verified records behind a place (block, batch, leaf), at most `limit` looked at. Those that retention deleted,
    /// or whose bytes are wrong, are left out.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn holdings(&self, after: (u64, u64, u64), limit: usize) -> Result<HoldingPage, StoreError> {
        // A place beyond what a ledger can have is behind everything.
        let place = |number: u64| i64::try_from(number).unwrap_or(i64::MAX);
        let (block, batch, leaf) = (place(after.0), place(after.1), place(after.2));
        let most = i64::try_from(limit).unwrap_or(i64::MAX);
        self.read(|connection| {
            let mut statement = connection.prepare_cached(
                "SELECT batches.block, batches.key, leaf, topics.owner, recorders.id, topics.topic_id, records.seq,
                     coalesce(records.block = batches.block, 0) AND records.deleted_at IS NULL,
                     records.state
                 FROM batches INDEXED BY batches_anchored
                 CROSS JOIN leaves ON leaves.batch = batches.key
                 CROSS JOIN records ON records.n = leaves.record
                 CROSS JOIN topics ON topics.key = records.topic
                 CROSS JOIN recorders ON recorders.key = topics.recorder
                 WHERE batches.block IS NOT NULL AND batches.block >= ?1
                     AND (batches.block, batches.key, leaf) > (?1, ?2, ?3)
                 ORDER BY batches.block, batches.key, leaf LIMIT ?4",
            )?;
            let looked = |row: &Row<'_>| Ok((row.get(7)?, state(row, 8)?, holding(row)?));
            let found = statement.query_map(params![block, batch, leaf, most], looked)?;
            let found: Vec<Looked> = found.collect::<Result<_, _>>()?;
            let more = found.len() >= limit;
            let last = if more { found.last().map(|(.., row)| row.place) } else { end_of(&found) };
            let told = |(whole, state, _): &Looked| *whole && *state == RecordState::Verified;
            let rows = found.into_iter().filter(told).map(|(.., row)| row).collect();
            Ok(HoldingPage { rows, last, more })
        })
    }

    /// Which of these numbers are lacking here.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn lacking(&self, which: Which, told: &Ranges) -> Result<Lacking, StoreError> {
        self.read(|connection| {
            let Some(topic) = topic_key(connection, which)? else {
                return Ok(Lacking { numbers: told.clone(), twice: Vec::new() });
            };
            let mut statement = connection.prepare_cached(
                "SELECT seq, state, digest FROM records WHERE topic = ?1 AND seq BETWEEN ?2 AND ?3 ORDER BY seq",
            )?;
            let (mut numbers, mut twice) = (Vec::new(), Vec::new());
            for (first, last) in told.iter() {
                let range = params![topic, whole("number", first)?, whole("number", last)?];
                let found = statement.query_map(range, |row| Ok((unsigned(row, 0)?, state(row, 1)?, row.get(2)?)))?;
                let mut next = first;
                for row in found {
                    let (seq, state, digest) = row?;
                    numbers.extend(next..seq);
                    next = seq + 1;
                    match state {
                        RecordState::Stored => numbers.push(seq),
                        RecordState::Batched | RecordState::Submitted => twice.push(Digest(digest)),
                        _ => {}
                    }
                }
                numbers.extend(next..=last);
            }
            Ok(Lacking { numbers: Ranges::of(numbers), twice })
        })
    }

    /// The records that [`Ledger::holdings`] tells, of these ranges, each with its first and last number: in their order, at
    /// most `limit`.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn held_between(&self, ranges: &[(Which, (u64, u64))], limit: usize) -> Result<Vec<HeldRecord>, StoreError> {
        self.read(|connection| {
            let mut statement = connection.prepare_cached(&format!(
                "SELECT {}, n FROM records WHERE topic = ?1 AND seq BETWEEN ?2 AND ?3 AND block IS NOT NULL
                 AND deleted_at IS NULL AND state = ?5 ORDER BY seq LIMIT ?4",
                rows::COLUMNS
            ))?;
            let (mut streams, mut found) = (HashMap::new(), Vec::new());
            for (range, (which, (first, last))) in ranges.iter().enumerate() {
                let (first, last) = (whole("number", *first)?, whole("number", *last)?);
                let most = i64::try_from(limit - found.len()).unwrap_or(i64::MAX);
                let Some(topic) = topic_key(connection, *which)? else { continue };
                let mut rows = statement.query(params![topic, first, last, most, RecordState::Verified.code()])?;
                while let Some(row) = rows.next()? {
                    rows::learn_stream(connection, row, &mut streams)?;
                    let place = batches::place_in(connection, row.get("n")?)?;
                    found.push(HeldRecord { range, row: rows::record(row, &streams)?, place });
                }
                if found.len() >= limit {
                    break;
                }
            }
            Ok(found)
        })
    }
}

fn topic_key(connection: &rusqlite::Connection, (owner, recorder, topic): Which) -> Result<Option<i64>, StoreError> {
    let key = connection
        .prepare_cached(
            "SELECT key FROM topics WHERE owner = ?1 AND topic_id = ?2
             AND recorder = (SELECT key FROM recorders WHERE id = ?3)",
        )?
        .query_row(params![owner.0, topic.0, recorder.0], |row| row.get(0))
        .optional()?;
    Ok(key)
}

/// Where a list ends that has no more rows: before the first record of the newest blocks that is to be verified.
fn end_of(found: &[Looked]) -> Option<(u64, u64, u64)> {
    let block = |(.., row): &Looked| row.place.0;
    let newest = found.last().map_or(0, block);
    let waits = |looked: &&Looked| {
        let (whole, state, _) = looked;
        *whole && matches!(state, RecordState::Mined | RecordState::Confirmed) && block(looked) + WAITED_FOR >= newest
    };
    found.iter().take_while(|looked| !waits(looked)).last().map(|(.., row)| row.place)
}

fn holding(row: &Row<'_>) -> rusqlite::Result<HoldingRow> {
    let place = (unsigned(row, 0)?, unsigned(row, 1)?, unsigned(row, 2)?);
    let (owner, recorder) = (Address(row.get(3)?), RecorderId(row.get(4)?));
    Ok(HoldingRow { place, owner, recorder, topic_id: TopicId(row.get(5)?), seq: unsigned(row, 6)? })
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::super::tests::numbered as record;
    use super::*;
    use crate::chain::merkle::{Inclusion, Leaf, Tree};
    use crate::model::Hash;
    use crate::store::{Foreign, NewBatch, NewRecord, RootSighting};

    const THERE: RecorderId = RecorderId([7; 16]);
    const WHICH: Which = (Address([1; 20]), THERE, TopicId([2; 16]));

    fn foreign(number: u8) -> NewRecord {
        NewRecord { foreign: Some(Foreign { recorder: THERE, keeper: Address([9; 20]) }), ..record(number) }
    }

    fn ledger(home: &tempfile::TempDir) -> Ledger {
        Ledger::open(&home.path().join("ledger.db")).expect("opens")
    }

    /// Each of these records with its place in one batch that somebody else anchored in a block.
    fn anchors(numbers: &[u8], block: u64) -> Vec<(Digest, Inclusion, RootSighting)> {
        let leaf = |number: &u8| {
            let ((owner, recorder, topic_id), seq) = (WHICH, u64::from(*number));
            Leaf { owner, recorder, topic_id, seq, digest: Digest([*number; 32]) }
        };
        let leaves: Vec<Leaf> = numbers.iter().map(leaf).collect();
        let tree = Tree::new(Leaf::hashes(&leaves)).expect("leaves");
        let (root, count) = (tree.root(), leaves.len() as u64);
        let (transaction, block_hash) = (Hash([50; 32]), Hash([60; 32]));
        let anchor = RootSighting { account: Address([8; 20]), root, count, transaction, block, block_hash };
        let place = |index: usize| Inclusion { index: index as u64, count, path: tree.path(index), root };
        leaves.iter().enumerate().map(|(index, leaf)| (leaf.digest, place(index), anchor)).collect()
    }

    fn append(
        ledger: &Ledger,
        records: Vec<NewRecord>,
        anchors: Vec<(Digest, Inclusion, RootSighting)>,
    ) -> Result<u64, StoreError> {
        ledger.append_anchored(records, anchors, BTreeMap::new())
    }

    fn mine(ledger: &Ledger, numbers: &[u8], block: u64) -> u64 {
        ledger.walk_to("watcher", (block, Hash([60; 32])), Vec::new()).expect("walked");
        let records = numbers.iter().map(|number| foreign(*number)).collect();
        append(ledger, records, anchors(numbers, block)).expect("taken")
    }

    fn verify(ledger: &Ledger, numbers: &[u8], block: u64) {
        ledger.confirm(block).expect("confirmed");
        let digests: Vec<Digest> = numbers.iter().map(|number| Digest([*number; 32])).collect();
        ledger.advance(&digests, RecordState::Confirmed, RecordState::Verified).expect("verified");
    }

    fn take(ledger: &Ledger, numbers: &[u8], block: u64) -> u64 {
        let taken = mine(ledger, numbers, block);
        verify(ledger, numbers, block);
        taken
    }

    fn told(page: &HoldingPage) -> Vec<u64> {
        page.rows.iter().map(|row| row.seq).collect()
    }

    #[test]
    fn what_another_gateway_anchored_is_acknowledged_with_its_anchor_and_told_in_the_order_of_blocks() {
        let home = tempfile::tempdir().expect("folder");
        let ledger = ledger(&home);
        assert_eq!(ledger.holdings((0, 0, 0), 9), Ok(HoldingPage::default()));
        assert_eq!((take(&ledger, &[4, 5], 20), take(&ledger, &[1, 2, 3], 10)), (2, 3));
        assert_eq!(mine(&ledger, &[4, 5], 20), 0, "twice is once");
        let row = ledger.record(Digest([4; 32])).expect("reads").expect("is there");
        assert_eq!((row.state, row.block, row.transaction), (RecordState::Verified, Some(20), Some(Hash([50; 32]))));
        assert_eq!(ledger.stored_leaves(Address([9; 20]), 9).expect("reads"), [], "nobody here anchors it again");
        let first = ledger.holdings((0, 0, 0), 2).expect("reads");
        assert!(first.more && told(&first).len() == 2, "{first:?}");
        let rest = ledger.holdings(first.last.expect("a place"), 9).expect("reads");
        let mut all = [told(&first), told(&rest)].concat();
        assert!(!rest.more && rest.last.is_some_and(|(block, ..)| block == 20), "{rest:?}");
        all[..3].sort_unstable();
        all[3..].sort_unstable();
        assert_eq!(all, [1, 2, 3, 4, 5], "block 10 before block 20");
        assert_eq!(told(&ledger.holdings((20, 0, 0), 9).expect("reads")).len(), 2);
        assert_eq!(ledger.holdings((u64::MAX, 0, 0), 9), Ok(HoldingPage::default()));
        let held = ledger.held_between(&[(WHICH, (2, 4))], 9).expect("reads");
        assert_eq!(held.iter().map(|held| held.row.seq).collect::<Vec<_>>(), [2, 3, 4]);
        let digests: Vec<Digest> = held.iter().map(|held| held.row.digest).collect();
        let places: Vec<_> = held.iter().map(|held| held.place.clone()).collect();
        assert_eq!(places, ledger.batch_places(&digests).expect("reads"));
        let rows: Vec<_> = held.into_iter().map(|held| Some(held.row)).collect();
        assert_eq!(rows, ledger.records(&digests).expect("reads"));
        let nobodys = (Address([3; 20]), THERE, WHICH.2);
        assert_eq!(ledger.held_between(&[(nobodys, (1, 9))], 9), Ok(Vec::new()));
    }

    #[test]
    fn of_several_ranges_the_first_ones_are_handed_over_as_far_as_is_asked() {
        let home = tempfile::tempdir().expect("folder");
        let ledger = ledger(&home);
        take(&ledger, &[1, 2, 3, 4, 5], 10);
        let nobodys = (Address([3; 20]), THERE, WHICH.2);
        let ranges = [(WHICH, (4, 9)), (nobodys, (1, 9)), (WHICH, (1, 1)), (WHICH, (2, 3))];
        let numbers = |limit| {
            let held = ledger.held_between(&ranges, limit).expect("reads");
            held.iter().map(|held| (held.range, held.row.seq)).collect::<Vec<_>>()
        };
        let all = [(0, 4), (0, 5), (2, 1), (3, 2), (3, 3)];
        for limit in 0..7 {
            assert_eq!(numbers(limit), all[..limit.min(5)], "{limit}");
        }
    }

    #[test]
    fn what_is_to_be_verified_is_not_told_yet_and_not_passed_either() {
        let home = tempfile::tempdir().expect("folder");
        let ledger = ledger(&home);
        take(&ledger, &[1, 2], 10);
        mine(&ledger, &[3], 11);
        let held = || {
            ledger
                .held_between(&[(WHICH, (1, 9))], 9)
                .expect("reads")
                .iter()
                .map(|held| held.row.seq)
                .collect::<Vec<_>>()
        };
        let page = ledger.holdings((0, 0, 0), 9).expect("reads");
        assert_eq!((told(&page), page.last.map(|(block, ..)| block), page.more), (vec![1, 2], Some(10), false));
        assert_eq!(held(), [1, 2], "nor is it handed over");
        let behind = ledger.holdings(page.last.expect("a place"), 9).expect("reads");
        assert_eq!((told(&behind), behind.last), (Vec::new(), None), "nobody goes past it");
        ledger.confirm(11).expect("confirmed");
        assert_eq!(held(), [1, 2], "its signer's right was not judged yet");
        take(&ledger, &[4], 12);
        let page = ledger.holdings((0, 0, 0), 9).expect("reads");
        assert_eq!((told(&page), page.last.map(|(block, ..)| block)), (vec![1, 2, 4], Some(10)), "others do not wait");
        // One that is never verified is not waited for without end.
        take(&ledger, &[5], 11 + WAITED_FOR + 1);
        let page = ledger.holdings((0, 0, 0), 9).expect("reads");
        assert_eq!(page.last.map(|(block, ..)| block), Some(11 + WAITED_FOR + 1));
        verify(&ledger, &[3], 11);
        assert_eq!(told(&ledger.holdings((0, 0, 0), 9).expect("reads")), [1, 2, 3, 4, 5]);
        assert_eq!(held(), [1, 2, 3, 4, 5]);
    }

    #[test]
    fn an_anchor_in_a_block_that_was_replaced_is_not_taken_from_anybody() {
        let home = tempfile::tempdir().expect("folder");
        let ledger = ledger(&home);
        let walk = |block, hash| ledger.walk_to("watcher", (block, Hash([hash; 32])), Vec::new()).expect("walked");
        let of_batch = |index: usize, block, hash| {
            let (digest, inclusion, anchor) = anchors(&[1, 2], block).remove(index);
            vec![(digest, inclusion, RootSighting { block_hash: Hash([hash; 32]), ..anchor })]
        };
        let found = |number| ledger.record(Digest([number; 32])).expect("reads").map(|row| (row.state, row.block));
        walk(10, 60);
        append(&ledger, vec![foreign(1)], of_batch(0, 10, 60)).expect("taken");
        assert_eq!(found(1), Some((RecordState::Mined, Some(10))));
        ledger.unmine(10).expect("the block is gone");
        let replaced = Err(StoreError::Replaced { digest: Digest([2; 32]), block: 10 });
        assert_eq!(append(&ledger, vec![foreign(2)], of_batch(1, 10, 60)), replaced, "before it is read again");
        walk(10, 61);
        assert_eq!(append(&ledger, vec![foreign(2)], of_batch(1, 10, 60)), replaced, "nor afterwards");
        assert_eq!((found(1), found(2)), (Some((RecordState::Batched, None)), None));
        walk(11, 62);
        append(&ledger, vec![foreign(2)], of_batch(1, 11, 62)).expect("taken");
        let there = Some((RecordState::Mined, Some(11)));
        assert_eq!((found(1), found(2)), (there, there), "where it is now");
        walk(2000, 63);
        let old = vec![anchors(&[3], 5).remove(0)];
        assert_eq!(append(&ledger, vec![foreign(3)], old), Ok(1), "of old blocks not each is kept");
    }

    #[test]
    fn lacking_is_what_is_absent_or_without_an_anchor() {
        let home = tempfile::tempdir().expect("folder");
        let ledger = ledger(&home);
        let all = Ranges::of((1..=9).collect());
        assert_eq!(ledger.lacking(WHICH, &all).expect("reads").numbers, all, "a topic that nobody knows here");
        take(&ledger, &[2, 3], 10);
        ledger.append(vec![foreign(5), foreign(6)]).expect("stored");
        let leaf = (Digest([6; 32]), Vec::new());
        ledger
            .close_batch(NewBatch { owner: Address([9; 20]), root: Hash([77; 32]), leaves: vec![leaf] })
            .expect("closed");
        let found = ledger.lacking(WHICH, &all).expect("reads");
        assert_eq!(found.numbers.iter().collect::<Vec<_>>(), [(1, 1), (4, 5), (7, 9)]);
        assert_eq!(found.twice, [Digest([6; 32])], "its own anchor is on the way");
        assert_eq!(take(&ledger, &[5], 11), 1, "what was here without an anchor gets it");
        assert_eq!(ledger.lacking(WHICH, &Ranges::of(vec![5])).expect("reads"), Lacking::default());
    }

    #[test]
    fn a_record_that_contradicts_another_is_taken_with_none_of_those_beside_it() {
        let home = tempfile::tempdir().expect("folder");
        let ledger = ledger(&home);
        take(&ledger, &[2], 10);
        ledger.walk_to("watcher", (11, Hash([60; 32])), Vec::new()).expect("walked");
        let other = NewRecord { seq: 2, ..foreign(8) };
        let records = vec![foreign(3), other];
        let refused = append(&ledger, records, anchors(&[3], 11));
        assert!(matches!(refused, Err(StoreError::Conflict { .. })), "{refused:?}");
        assert_eq!(ledger.record(Digest([3; 32])).expect("reads"), None);
    }
}
