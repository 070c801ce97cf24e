//! A fleet in which two gateways keep each record: the third one is spared, and when a disk dies nothing is lost.

use super::*;

/// Three gateways of which two keep each record, and which miss a silent one after twenty seconds.
fn three(ground: &Ground) -> [Gateway; 3] {
    let variables = [("AUTHROS_FLEET_COPIES", "2"), ("AUTHROS_FLEET_AWAY_AFTER", "20s")];
    std::array::from_fn(|_| Gateway::set(ground, &variables))
}

#[test]
fn two_gateways_keep_each_record_and_another_one_takes_the_place_of_a_dead_disk() {
    let _alone = heavy();
    let ground = Ground::new();
    let [mut first, second, third] = three(&ground);
    let all = [&first, &second, &third];
    let alice = Member::new("alice", &all);
    // Each asks one gateway alone.
    let (bob, carol) = (Member::new("bob", &[&second]), Member::new("carol", &[&third]));
    for reader in [&bob, &carol] {
        alice.grant(reader);
    }
    name_each_other(&all);
    // All of them are at home at the first one; what falls to it stays there, the rest has three copies.
    let names = ["scout-1", "scout-2", "scout-3", "scout-4", "scout-5", "scout-6", "scout-7", "scout-8"];
    let robots = names.map(|name| Robot::enrol(&alice, name, &[&first]));
    let wanted: u64 = robots.iter().map(|robot| reconciling::bring(robot, "3")).sum();
    let shared = ["shared", "list", "--owner", &alice.address];
    let own = alice.verified(&["uploads", "list"], wanted);
    reconciled(&second, 1);
    reconciled(&third, 1);
    let at = |reader: &Member| -> Option<BTreeSet<String>> {
        let records = reader.authros.records_so_far(&shared)?;
        Some(records.iter().map(|record| text(record, "id")).collect())
    };
    let (here, there) = wait_until(60, "the two others have all of it between them", || {
        let (here, there) = (at(&bob)?, at(&carol)?);
        (here.union(&there).count() as u64 == wanted).then_some((here, there))
    });
    println!("of {wanted} records the second keeps {}, the third {}", here.len(), there.len());
    assert!(here.len() + there.len() < 2 * own.len(), "not every gateway keeps every record");
    assert!(here.is_subset(&own) && there.is_subset(&own));

    first.kill();
    drop(std::mem::replace(&mut first.home, Home::new()));
    // Two are left, and two are to keep each record.
    assert_eq!(bob.verified(&shared, wanted), own, "what fell to the dead one falls to the second");
    assert_eq!(carol.verified(&shared, wanted), own, "or to the third");
}
