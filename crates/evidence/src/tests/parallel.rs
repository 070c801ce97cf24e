//! Many records, checked on all cores: in order, and with the same result each time.

use super::hostile::unanchored;
use super::world::{World, genesis, ours, sealed};
use crate::{Bundle, Outcome, Report, Standing, verify};

/// Enough records for every helper.
const MANY: u64 = 300;

fn many() -> Bundle {
    let world = World::new();
    let (mut packing, mut disclosed) = (world.packing(), Vec::new());
    for seq in 10..10 + MANY {
        let one = sealed(world.owner, &world.keys, &world.topic_key, seq, &seq.to_be_bytes());
        let mut record = unanchored(one.clone());
        if seq % 7 == 0 {
            // The last bytes are under the digest alone.
            *record.record.last_mut().expect("a record") ^= 1;
        }
        packing.record(one.digest, record).expect("added");
        disclosed.extend((seq % 3 == 0).then_some(one));
    }
    packing.disclosure(&world.disclosing(&disclosed));
    let members = packing.sign(genesis(), world.owner, &world.keys, ours()).expect("packs");
    Bundle::of_members(&members, ours()).expect("reads")
}

#[test]
fn many_records_are_judged_in_order_and_each_by_itself() {
    let bundle = many();
    let judged = || -> Report { verify(&bundle, Some(&World::trust()), ours()) };
    let report = judged();
    assert_eq!(report.outcome, Outcome::Refused);
    let told: Vec<_> = report.records.iter().map(|record| record.digest).collect();
    assert_eq!(told, bundle.records.keys().copied().collect::<Vec<_>>(), "in the order of their digests");
    let refused = report.records.iter().filter(|record| record.bytes.standing == Standing::Refused).count();
    assert_eq!(refused, (10..10 + MANY).filter(|seq| seq % 7 == 0).count());
    // What opened is the message of that record, and of no other.
    let opened = report.records.iter().filter(|record| record.disclosed.is_some());
    for record in opened.clone() {
        let message = report.messages.get(&record.digest).expect("opened");
        assert_eq!(message.body, record.seq.expect("a number").to_be_bytes());
    }
    assert_eq!(opened.count(), (10..10 + MANY).filter(|seq| seq % 3 == 0 && seq % 7 != 0).count());
    assert_eq!(report.messages.len(), report.records.iter().filter(|record| record.disclosed.is_some()).count());
    for _ in 0..5 {
        assert_eq!(judged(), report, "the same each time");
    }
}
