//! What a batch's transaction and a record rest on when they were met in several blocks, and some of these are gone.

use super::*;
use RecordState::{Batched, Mined};

const OWNER: Address = Address([1; 20]);
const SINGLE: Hash = Hash([1; 32]);
const NOTHING: Hash = Hash([2; 32]);
const BATCH: Hash = Hash([3; 32]);
const STRANGER: Hash = Hash([9; 32]);

/// A ledger with one record.
fn with_one() -> (tempfile::TempDir, Ledger, NewRecord) {
    let (home, ledger) = open();
    let one = record(1, 1, 1);
    ledger.records.append(vec![one.clone()]).expect("acknowledged");
    (home, ledger, one)
}

/// Closes a batch over all that is stored.
fn close_batch(ledger: &Ledger) -> Hash {
    let leaves = ledger.batches.stored_leaves(OWNER, 100).expect("leaves");
    let tree = Tree::new(Leaf::hashes(&leaves)).expect("a tree");
    let leaves = leaves.iter().enumerate().map(|(at, leaf)| (leaf.digest, tree.path(at))).collect();
    ledger.batches.close(NewBatch { owner: OWNER, root: tree.root(), leaves }).expect("closed");
    tree.root()
}

fn send_batch(ledger: &Ledger, root: Hash) {
    ledger.lanes.submit(NewTransaction { anchors: Anchors::Batch(root), ..transaction(3, &[]) }).expect("kept");
}

fn root_seen(ledger: &Ledger, root: Hash, transaction: Hash, block: u64) -> u64 {
    let block_hash = Hash([u8::try_from(block).expect("small"); 32]);
    let seen = RootSighting { account: OWNER, root, count: 1, transaction, block, block_hash };
    ledger.batches.anchored(&[seen]).expect("seen")
}

/// The sender's word: its transaction is in this block.
fn sender_saw(ledger: &Ledger, block: u64) {
    let block_hash = Hash([u8::try_from(block).expect("small"); 32]);
    let mined = TransactionOutcome::Mined { block, block_hash, gas_used: Some(1) };
    ledger.lanes.close_transactions(vec![(BATCH, mined)]).expect("closed");
}

fn fail(ledger: &Ledger, transaction: Hash) {
    let reverted = TransactionOutcome::Reverted { reason: "no".to_owned() };
    ledger.lanes.close_transactions(vec![(transaction, reverted)]).expect("closed");
}

/// State, and the block with its hash's first byte.
fn stands(ledger: &Ledger) -> (u8, Option<(i64, u8)>) {
    let sql = "SELECT state, block, block_hash FROM transactions WHERE hash = ?1";
    let read = |row: &Row<'_>| Ok((row.get(0)?, row.get::<Option<i64>>(1)?, row.get::<Option<[u8; 32]>>(2)?));
    let (state, block, hash) = ledger.database.one(sql, [BATCH.0], read).expect("a transaction");
    (state, block.zip(hash.map(|hash| hash[0])))
}

/// State, transaction and block of a record.
type Place = (RecordState, Option<Hash>, Option<u64>);

fn place(ledger: &Ledger, one: &NewRecord) -> Place {
    let row = ledger.records.find(one.digest).expect("read").expect("there");
    (row.state, row.transaction, row.block)
}

#[test]
fn a_batchs_transaction_stands_in_the_block_in_which_the_root_was_seen() {
    let (open, mined) = (TransactionState::Open as u8, TransactionState::Mined as u8);
    for sender_is_first in [true, false] {
        let (_home, ledger, one) = with_one();
        let root = close_batch(&ledger);
        send_batch(&ledger, root);
        if sender_is_first {
            sender_saw(&ledger, 9);
            assert_eq!(stands(&ledger), (mined, Some((9, 9))), "nobody else has seen it");
        }
        assert_eq!(root_seen(&ledger, root, BATCH, 7), 1);
        if !sender_is_first {
            sender_saw(&ledger, 9);
        }
        assert_eq!(stands(&ledger), (mined, Some((7, 7))), "the sender was first: {sender_is_first}");
        ledger.batches.confirm(7).expect("confirmed");
        ledger.records.advance(&[one.digest], Confirmed, Verified).expect("verified");
        let placed = ledger.records.placed(one.digest).expect("read").and_then(|placed| placed.place);
        assert!(placed.is_some_and(|place| !place.is_contradicted), "both say the same block");

        assert_eq!(ledger.batches.take_back(8), Ok((0, 0)), "where the sender saw it is of no matter");
        assert_eq!((stands(&ledger), place(&ledger, &one)), ((mined, Some((7, 7))), (Verified, Some(BATCH), Some(7))));
        assert_eq!(ledger.batches.take_back(7), Ok((1, 1)));
        assert_eq!((stands(&ledger), place(&ledger, &one)), ((open, None), (Submitted, Some(BATCH), None)));
        assert_eq!(ledger.batches.open_roots(OWNER), Ok(vec![root]));

        assert_eq!(root_seen(&ledger, root, BATCH, 8), 1);
        assert_eq!(stands(&ledger), (open, None), "its lane closes it");
        sender_saw(&ledger, 9);
        assert_eq!((stands(&ledger), place(&ledger, &one)), ((mined, Some((8, 8))), (Mined, Some(BATCH), Some(8))));
    }
}

#[test]
fn a_transaction_whose_root_another_anchored_first_stands_where_its_sender_saw_it() {
    let (open, mined) = (TransactionState::Open as u8, TransactionState::Mined as u8);
    let (_home, ledger, one) = with_one();
    let root = close_batch(&ledger);
    send_batch(&ledger, root);
    assert_eq!(root_seen(&ledger, root, STRANGER, 7), 1);
    sender_saw(&ledger, 9);
    assert_eq!((stands(&ledger), place(&ledger, &one)), ((mined, Some((9, 9))), (Mined, Some(STRANGER), Some(7))));
    assert_eq!(ledger.batches.take_back(8), Ok((0, 0)));
    assert_eq!((stands(&ledger), place(&ledger, &one)), ((open, None), (Mined, Some(STRANGER), Some(7))));
    assert_eq!(ledger.batches.take_back(7), Ok((1, 0)));
    assert_eq!(place(&ledger, &one), (Submitted, Some(BATCH), None), "our own goes on");
    fail(&ledger, BATCH);
    assert_eq!(place(&ledger, &one), (Batched, None, None));
    let waiting = ledger.batches.waiting(OWNER, 9).expect("read");
    assert_eq!(waiting, [WaitingBatch { root, count: 1 }]);
}

/// It was submitted alone, and another transaction took that one's place.
fn free(ledger: &Ledger, one: &NewRecord) {
    ledger.lanes.submit(transaction(1, &[one.digest])).expect("kept");
    let nothing = NewTransaction { nonce: 1, anchors: Anchors::Nothing, ..transaction(2, &[]) };
    ledger.lanes.replace_transaction(SINGLE, nothing).expect("replaced");
}

fn see(ledger: &Ledger, one: &NewRecord, transaction: Hash) {
    let seen = Sighting { transaction, ..sighting(one, 5) };
    assert_eq!(ledger.batches.mined(&[seen]), Ok(1));
}

/// Seen alone in block 5, in a batch that is sent, and the transaction that it was seen in is offered again.
fn with_two_open(ledger: &Ledger, one: &NewRecord) -> Hash {
    free(ledger, one);
    let root = close_batch(ledger);
    send_batch(ledger, root);
    see(ledger, one, SINGLE);
    let again = Reissue { hash: SINGLE, nonce: 1, raw: vec![1; 100] };
    ledger.lanes.reissue(NOTHING, again).expect("offered again");
    root
}

#[test]
fn a_record_that_loses_its_own_block_goes_to_the_best_that_is_left() {
    type Prepare = fn(&Ledger, &NewRecord);
    let cases: [(&str, Prepare, Place); 6] = [
        (
            "its batch's block",
            |ledger, one| {
                let root = with_two_open(ledger, one);
                assert_eq!(root_seen(ledger, root, BATCH, 3), 0, "it has a block of its own");
            },
            (Mined, Some(BATCH), Some(3)),
        ),
        (
            "its own transaction",
            |ledger, one| {
                with_two_open(ledger, one);
            },
            (Submitted, Some(SINGLE), None),
        ),
        (
            "its batch's transaction",
            |ledger, one| {
                let root = close_batch(ledger);
                send_batch(ledger, root);
                see(ledger, one, STRANGER);
            },
            (Submitted, Some(BATCH), None),
        ),
        (
            "its place in a batch",
            |ledger, one| {
                close_batch(ledger);
                see(ledger, one, STRANGER);
            },
            (Batched, None, None),
        ),
        (
            "another upload",
            |ledger, one| {
                ledger.lanes.submit(transaction(1, &[one.digest])).expect("kept");
                see(ledger, one, STRANGER);
            },
            (Submitted, Some(SINGLE), None),
        ),
        ("nothing", |ledger, one| see(ledger, one, STRANGER), (Stored, None, None)),
    ];
    for (what, prepare, expected) in cases {
        let (_home, ledger, one) = with_one();
        prepare(&ledger, &one);
        assert_eq!(place(&ledger, &one).2, Some(5), "{what}");
        assert_eq!(ledger.batches.take_back(5), Ok((1, 0)), "{what}");
        assert_eq!(place(&ledger, &one), expected, "{what}");
    }
}

#[test]
fn a_record_whose_own_transaction_fails_waits_for_its_batchs() {
    let (_home, ledger, one) = with_one();
    let root = with_two_open(&ledger, &one);
    ledger.batches.take_back(5).expect("taken back");
    fail(&ledger, SINGLE);
    assert_eq!(place(&ledger, &one), (Submitted, Some(BATCH), None), "that one is still open");
    fail(&ledger, BATCH);
    assert_eq!(place(&ledger, &one), (Batched, None, None));
    send_again(&ledger, root);
}

/// A batch whose transaction failed is sent by another one.
fn send_again(ledger: &Ledger, root: Hash) {
    let again = NewTransaction { anchors: Anchors::Batch(root), ..transaction(4, &[]) };
    ledger.lanes.submit(again).expect("kept");
    assert_eq!(root_seen(ledger, root, Hash([4; 32]), 6), 1);
}

server::on_a_server! {
    a_batchs_transaction_stands_in_the_block_in_which_the_root_was_seen, a_transaction_whose_root_another_anchored_first_stands_where_its_sender_saw_it, a_record_that_loses_its_own_block_goes_to_the_best_that_is_left, a_record_whose_own_transaction_fails_waits_for_its_batchs,
}
