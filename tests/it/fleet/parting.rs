//! A fleet that is parted: both gateways take records from their own robots, and only the line between the two is cut. It
//! heals by itself, and both hold everything, each once.

use super::reconciling::{bring, fellows, reconciled};
use super::*;
use support::list;

#[test]
fn two_gateways_that_were_parted_hold_everything_once_when_the_line_is_back() {
    let _alone = heavy();
    let ground = Ground::new();
    let gateways = [Gateway::new(&ground), Gateway::new(&ground)];
    // How each of them is reached by the other one.
    let lines = gateways.each_ref().map(|gateway| Cable::to(gateway.port));
    let (alice, sides) = (Member::new("alice", &gateways.each_ref()), [(0, 1), (1, 0)]);
    for (one, other) in sides {
        let key = &gateways[other].key;
        gateways[one].keeper().json(&["fleet", "add", &lines[other].address(), "--gateway-key", key]);
    }
    let readers = ["bob", "carol"].map(str::to_owned);
    let readers = [0, 1].map(|place| Member::new(&readers[place], &[&gateways[place]]));
    readers.iter().for_each(|reader| alice.grant(reader));
    let robots = [0, 1].map(|place| Robot::enrol(&alice, &format!("scout-{place}"), &[&gateways[place]]));
    let shared = ["shared", "list", "--owner", &alice.address];
    let before: u64 = robots.iter().map(|robot| bring(robot, "5")).sum();
    readers.iter().for_each(|reader| drop(reader.verified(&shared, before)));

    lines.iter().for_each(Cable::cut);
    for gateway in &gateways {
        wait_until(60, "it notices", || fellows(gateway)[0]["problem"].as_str().map(drop));
    }
    let during = [0, 1].map(|place| bring(&robots[place], "5"));
    let all: u64 = during.iter().sum();
    assert!(all > before, "both went on: {during:?} after {before}");
    let own = alice.verified(&["uploads", "list"], all);
    for (reader, gateway) in readers.iter().zip(&gateways) {
        let has = wait_until(60, "a list", || reader.authros.records_so_far(&shared)).len() as u64;
        assert!((before..all).contains(&has), "{has} of {all}: nothing crosses the line");
        assert!(fellows(gateway)[0]["problem"].is_string());
    }

    lines.iter().for_each(Cable::mend);
    let begun = Instant::now();
    for gateway in &gateways {
        let found = reconciled(gateway, 1);
        assert!(found[0]["problem"].is_null() && list(&found[0], "refused").is_empty(), "{found:?}");
    }
    println!("both hold all {all} records {:?} after the line is back", begun.elapsed());
    for reader in &readers {
        assert_eq!(reader.verified(&shared, all), own, "each once, whichever gateway is asked");
    }
}
