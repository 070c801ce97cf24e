//! Records that two gateways of a fleet have.

use super::*;
use crate::chain::merkle::Inclusion;
use crate::model::Ranges;
use crate::store::{NewBatch, RootSighting};

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
    let taken = ledger.append_anchored(vec![record.clone()], vec![(digest, inclusion, anchor(9, theirs, 5))]);
    assert_eq!(taken, Ok(0), "it is not anchored anew");
    assert_eq!(ledger.anchored(&[anchor(1, own, 6)]), Ok(1));
    assert_eq!((ledger.anchored(&[anchor(9, theirs, 5)]), told()), (Ok(0), (0, Vec::new())));
    let row = ledger.record(digest).expect("read").expect("known");
    assert_eq!((row.state, row.block), (RecordState::Mined, Some(6)));
    let counts = ledger.counts(None).expect("counts");
    assert_eq!(counts.topics[0].captured, 1, "and it is one record");
}
