//! Records that two gateways of a fleet have.

use std::collections::BTreeMap;

use super::*;
use crate::chain::merkle::Inclusion;
use crate::model::{PublicKey, Ranges, RecorderId};
use crate::store::{Foreign, NewBatch, RootSighting};

#[test]
fn a_record_that_two_gateways_anchor_is_counted_and_keeps_the_first_anchor_seen() {
    let (_home, ledger) = open();
    let record = record(1, 1, 1);
    let (digest, owner) = (record.digest, record.owner);
    ledger.append(vec![record.clone()]).expect("acknowledged");
    let which = (owner, ledger.recorder(), record.topic_id);
    let told = || {
        let lacking = ledger.lacking(which, &Ranges::of(vec![1])).expect("read");
        (lacking.numbers.count(), lacking.twice)
    };
    assert_eq!(told(), (1, Vec::new()), "nobody anchors it here yet: it is taken with the other one's anchor");

    let (own, theirs) = (Hash([1; 32]), Hash([2; 32]));
    ledger.close_batch(NewBatch { owner, root: own, leaves: vec![(digest, Vec::new())] }).expect("closed");
    assert_eq!(told(), (0, vec![digest]), "on its way here, and anchored there");
    let anchor = |account: u8, root: Hash, block: u64| RootSighting {
        account: Address([account; 20]),
        root,
        count: 1,
        transaction: Hash([account; 32]),
        block,
        block_hash: Hash([account; 32]),
    };
    let inclusion = Inclusion { index: 0, count: 1, path: Vec::new(), root: theirs };
    let taken =
        ledger.append_anchored(vec![record.clone()], vec![(digest, inclusion, anchor(9, theirs, 5))], BTreeMap::new());
    assert_eq!(taken, Ok(0), "it is not anchored anew");
    assert_eq!(ledger.anchored(&[anchor(1, own, 6)]), Ok(1));
    assert_eq!((ledger.anchored(&[anchor(9, theirs, 5)]), told()), (Ok(0), (0, Vec::new())));
    let row = ledger.record(digest).expect("read").expect("known");
    assert_eq!((row.state, row.block), (RecordState::Mined, Some(6)));
    let counts = ledger.counts(None).expect("counts");
    assert_eq!(counts.topics[0].captured, 1, "and it is one record");
}

/// A record of another recorder, with its place in a batch of `count` whose root is of `batch`, anchored in `block`.
fn anchored(number: u64, batch: u8, (over, count): (u64, u64), block: u64) -> (NewRecord, Anchored) {
    let foreign = Some(Foreign { recorder: RecorderId([7; 16]), keeper: Address([9; 20]) });
    let record = NewRecord { foreign, ..record(1, 1, number) };
    let (root, account) = (Hash([batch; 32]), Address([batch; 20]));
    let inclusion = Inclusion { index: number, count: over, path: vec![Hash([3; 32]), Hash([4; 32])], root };
    let (transaction, block_hash) = (Hash([batch + 100; 32]), Hash([5; 32]));
    let digest = record.digest;
    (record, (digest, inclusion, RootSighting { account, root, count, transaction, block, block_hash }))
}

type Anchored = (Digest, Inclusion, RootSighting);

/// Two ways to the same rows: acknowledged first and anchored afterwards, and both at once.
#[test]
fn a_record_that_comes_with_its_anchor_is_as_one_that_got_it_later() {
    let ((_one, later), (_other, once)) = (open(), open());
    let ledgers = [&later, &once];
    let mut all: Vec<(NewRecord, Anchored)> = Vec::new();
    // A new batch; one whose root the watcher saw earlier; one of another number of leaves than the chain says; one of
    // two records, of which one is here already, in a state in which it may be anchored or not.
    all.extend([1, 2, 3].map(|number| anchored(number, 11, (8, 8), 20)));
    all.extend([4, 5].map(|number| anchored(number, 12, (8, 8), 21)));
    all.extend([6, 7].map(|number| anchored(number, 13, (8, 9), 22)));
    all.extend([8, 9, 10].map(|number| anchored(number, 14, (8, 8), 23)));
    for ledger in ledgers {
        ledger.walk_to("watcher", (30, Hash([6; 32])), Vec::new()).expect("walked");
        for block in 20..30 {
            ledger.walk_to("watcher", (block, Hash([5; 32])), Vec::new()).expect("walked");
        }
        ledger.append(vec![all[8].0.clone()]).expect("acknowledged");
        let held = NewRecord { state: RecordState::Quarantined, ..all[9].0.clone() };
        ledger.append(vec![held]).expect("acknowledged");
        let (earlier, (digest, inclusion, anchor)) = anchored(99, 12, (8, 8), 18);
        ledger.walk_to("watcher", (18, Hash([5; 32])), Vec::new()).expect("walked");
        ledger.append(vec![earlier]).expect("acknowledged");
        assert_eq!(ledger.take_in(digest, inclusion, anchor), Ok(true));
    }
    let (records, anchors): (Vec<_>, Vec<_>) = all.into_iter().unzip();
    later.append(records.clone()).expect("acknowledged");
    let taken = anchors
        .iter()
        .filter(|(digest, inclusion, anchor)| later.take_in(*digest, inclusion.clone(), *anchor).expect("taken"));
    let taken = taken.count() as u64;
    let devices = BTreeMap::from([(SignerId([1; 32]), PublicKey([2; 64]))]);
    assert_eq!((once.append_anchored(records.clone(), anchors.clone(), devices.clone()), taken), (Ok(9), 9));
    assert_eq!(once.signer(SignerId([1; 32])), Ok(Some(PublicKey([2; 64]))));

    let seen = |ledger: &Ledger| {
        let digests: Vec<Digest> = records.iter().map(|record| record.digest).collect();
        let mut rows: Vec<_> = ledger.records(&digests).expect("read").into_iter().flatten().collect();
        rows.iter_mut().for_each(|row| row.acknowledged_at = Timestamp(0));
        let mut places = ledger.batch_places(&digests).expect("read");
        places.iter_mut().flatten().for_each(|place| place.closed_at = Timestamp(0));
        (rows, places, ledger.counts(None).expect("counts"), ledger.data_by_state().expect("counts"))
    };
    let (found, expected) = (seen(&once), seen(&later));
    let states: Vec<_> = found.0.iter().map(|row| (row.state, row.block)).collect();
    let mined = |block| (RecordState::Mined, Some(block));
    let mut named =
        [[mined(20); 3].to_vec(), [mined(18); 2].to_vec(), [(RecordState::Batched, None); 2].to_vec()].concat();
    named.extend([mined(23), mined(23), (RecordState::Quarantined, None)]);
    assert_eq!((states, &found), (named, &expected));
    assert_eq!(found.2.data, found.3);
    assert_eq!(once.append_anchored(records.clone(), anchors, devices), Ok(0), "twice is once");
    for block in [23, 20, 18] {
        for ledger in ledgers {
            ledger.unmine(block).expect("the blocks are gone");
        }
        assert_eq!(seen(&once), seen(&later), "block {block}");
    }
}
