//! What is kept of witnesses, over restarts.

use super::super::tests::numbered;
use super::*;
use crate::model::{Digest, Position, PublicKey, RecorderId, Signature};
use crate::store::{NewBatch, RootSighting};

const OWNER: Address = Address([1; 20]);
const WITNESS: SignerId = SignerId([0xb; 32]);
const NETWORK: Domain = Domain([0xd; 32]);

fn stated(block: u64) -> SignedPosition {
    let position = Position {
        chain_id: 7,
        genesis: Hash([1; 32]),
        contract: Address([2; 20]),
        owner: OWNER,
        key: PublicKey([4; 64]),
        recorder: RecorderId([5; 16]),
        block,
        block_hash: Hash([6; 32]),
        earlier: None,
        top: Hash([8; 32]),
        count: 1,
        head: None,
    };
    SignedPosition { position, signature: Signature([10; 64]) }
}

fn countersigned(block: u64) -> Countersignature {
    let (stated, signature) = (stated(block), Signature([14; 64]));
    Countersignature {
        stated,
        at: Timestamp(50 + block),
        witness: Address([9; 20]),
        key: PublicKey([3; 64]),
        signature,
    }
}

fn close(ledger: &Ledger, number: u8, block: Option<u64>) {
    ledger.append(vec![numbered(number)]).expect("acknowledged");
    let root = Hash([number; 32]);
    let leaves = vec![(Digest([number; 32]), Vec::new())];
    ledger.close_batch(NewBatch { owner: OWNER, root, leaves }).expect("closed");
    if let Some(block) = block {
        let (transaction, block_hash) = (Hash([number; 32]), Hash([number; 32]));
        let sighting = RootSighting { account: OWNER, root, count: 1, transaction, block, block_hash };
        ledger.anchored(&[sighting]).expect("seen");
    }
}

#[test]
fn each_batch_in_a_confirmed_block_is_witnessed_once_by_each_witness_and_on_each_network() {
    let home = tempfile::tempdir().expect("folder");
    let path = home.path().join("ledger.db");
    let ledger = Ledger::open(&path).expect("opens");
    let waiting = |ledger: &Ledger, witness, network, confirmed| -> Option<(Vec<u8>, u64)> {
        let found = ledger.unwitnessed((OWNER, witness), network, confirmed, 9).expect("read");
        found.map(|found| (found.roots.iter().map(|root| root.0[0]).collect(), found.block))
    };
    assert_eq!(waiting(&ledger, WITNESS, NETWORK, 99), None);
    close(&ledger, 1, Some(10));
    close(&ledger, 2, None);
    close(&ledger, 3, Some(12));
    assert_eq!(waiting(&ledger, WITNESS, NETWORK, 11), Some((vec![1], 10)));
    assert_eq!(waiting(&ledger, WITNESS, NETWORK, 12), Some((vec![1, 3], 12)));
    let found = ledger.unwitnessed((OWNER, WITNESS), NETWORK, 12, 9).expect("read").expect("two");
    ledger.keep_position((OWNER, WITNESS), NETWORK, found, countersigned(12)).expect("kept");
    assert_eq!(waiting(&ledger, WITNESS, NETWORK, 99), None);
    assert_eq!(waiting(&ledger, SignerId([0xc; 32]), NETWORK, 99), Some((vec![1, 3], 12)));
    assert_eq!(waiting(&ledger, WITNESS, Domain([0xe; 32]), 99), Some((vec![1, 3], 12)));
    // The one between them reaches the chain late.
    let sighting = RootSighting {
        account: OWNER,
        root: Hash([2; 32]),
        count: 1,
        transaction: Hash([2; 32]),
        block: 20,
        block_hash: Hash([2; 32]),
    };
    ledger.anchored(&[sighting]).expect("seen");
    assert_eq!(waiting(&ledger, WITNESS, NETWORK, 99), Some((vec![2], 20)));
    // Another process, later.
    ledger.close().expect("closed");
    let ledger = Ledger::open(&path).expect("opens");
    assert_eq!(ledger.newest_position((OWNER, WITNESS), NETWORK), Ok(Some(countersigned(12))));
    assert_eq!(ledger.newest_position((OWNER, WITNESS), Domain([0xe; 32])), Ok(None));
    let keys = ledger.positions_of(Hash([3; 32]), NETWORK).expect("read");
    let kept = ledger.position(keys[0]).expect("read").expect("kept");
    assert_eq!(
        (keys.len(), kept.roots, kept.countersignature),
        (1, vec![Hash([1; 32]), Hash([3; 32])], countersigned(12))
    );
    assert_eq!(ledger.positions_of(Hash([3; 32]), Domain([0xe; 32])), Ok(Vec::new()));
    let counts = ledger.position_counts(OWNER, WITNESS).expect("read");
    assert_eq!(counts, PositionCounts { positions: 1, newest: Some(Timestamp(62)) });
}

#[test]
fn a_party_that_is_removed_begins_anew_and_its_contradictions_stay() {
    let home = tempfile::tempdir().expect("folder");
    let ledger = Ledger::open(&home.path().join("ledger.db")).expect("opens");
    let row = |owner: u8, address: Option<&str>, serves| WitnessRow {
        owner: Address([owner; 20]),
        key: WITNESS,
        account: Address([7; 20]),
        name: "The harbour".to_owned(),
        address: address.map(str::to_owned),
        serves,
        added_at: Timestamp(5),
    };
    for owner in [1, 2] {
        ledger.put_witness(row(owner, None, false)).expect("added");
        ledger.put_witness(row(owner, Some("127.0.0.1:9"), true)).expect("changed");
    }
    assert_eq!(ledger.witnesses(), Ok(vec![row(1, Some("127.0.0.1:9"), true), row(2, Some("127.0.0.1:9"), true)]));
    for block in 1..=1003 {
        ledger.keep_countersigned(WITNESS, NETWORK, countersigned(block)).expect("kept");
    }
    assert_eq!(ledger.countersigned_count(WITNESS), Ok((1000, 1)), "bounded");
    let kept = ledger.countersigned_of(WITNESS, NETWORK).expect("read");
    assert_eq!((kept.len(), kept[0], kept[999]), (1000, countersigned(1003), countersigned(4)), "the newest first");
    assert_eq!(ledger.countersigned_of(WITNESS, Domain([0; 32])), Ok(Vec::new()));
    let contradiction = |block| KeptContradiction {
        party: WITNESS,
        at: Timestamp(9),
        what: "block 3 has two hashes".to_owned(),
        kept: countersigned(1003),
        later: stated(block),
    };
    assert_eq!(ledger.keep_contradiction(contradiction(1)), Ok(true));
    assert_eq!(ledger.keep_contradiction(contradiction(1)), Ok(false), "told once");
    let new = (2..60).filter(|block| ledger.keep_contradiction(contradiction(*block)).expect("kept")).count();
    assert_eq!(new, 15, "a flood of them is bounded");
    assert_eq!(ledger.remove_witness(Address([1; 20]), WITNESS), Ok(true));
    assert_eq!(ledger.countersigned_count(WITNESS), Ok((1000, 1)), "another profile still serves it");
    assert_eq!(ledger.remove_witness(Address([2; 20]), WITNESS), Ok(true));
    assert_eq!(ledger.remove_witness(Address([2; 20]), WITNESS), Ok(false));
    assert_eq!((ledger.countersigned_count(WITNESS), ledger.witnesses()), (Ok((0, 0)), Ok(Vec::new())));
    let kept = ledger.two_histories().expect("read");
    assert_eq!((kept.len(), &kept[0]), (16, &contradiction(1)));
}
