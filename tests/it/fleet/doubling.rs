//! A record that two gateways anchor: the first one was late, not dead. It is seen and counted, and harms nothing.

use super::reconciling::{fellows, reconciled};
use super::*;

#[test]
fn a_record_that_two_gateways_anchor_is_counted_and_listed_once() {
    let _alone = heavy();
    let ground = Ground::new();
    let line = Cable::to(ground.port);
    let (first, second) = (Gateway::over(&ground, &line), Gateway::new(&ground));
    let both = [&first, &second];
    let (alice, bob) = (Member::new("alice", &both), Member::new("bob", &[&second]));
    alice.grant(&bob);
    name_each_other(&both);
    let robot = Robot::enrol(&alice, "scout", &both);
    let agent = robot.run(&[]);
    accepted(&agent, 5);
    // Its node takes transactions and answers nothing: what it took from the robot has no anchor as far as it knows.
    line.mute();
    let taken = accepted(&agent, count(&figures(&agent, "it is at work", is_home), "accepted"));
    // The robot waits three seconds for a proof and goes to the second one.
    let figure = figures(&agent, "the second one proves what the first one has not", |figures| {
        count(figures, "verified") > taken
    });
    println!("{taken} accepted when the first gateway's chain was cut, {} verified since", count(&figure, "verified"));
    line.mend();
    agent.stop("TERM", 20);
    let all = robot.settle();
    let twice = wait_until(120, "both see what both anchored", || {
        let counted = both.map(|gateway| count(&fellows(gateway)[0], "anchored_twice"));
        (counted.iter().sum::<u64>() > 0).then_some(counted)
    });
    println!("{twice:?} of {all} records were seen to be anchored twice");
    for gateway in both {
        let found = reconciled(gateway, 0);
        assert!(found[0]["problem"].is_null(), "{found:?}");
    }
    let own = alice.verified(&["uploads", "list"], all);
    let shared = ["shared", "list", "--owner", &alice.address];
    assert_eq!(bob.verified(&shared, all), own, "each once");
}
