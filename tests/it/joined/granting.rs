//! A grant to somebody whose site is running already. The site knows it from the chain immediately; a gateway gives nothing
//! until the grant's block is as deep as its keeper wants, and the site has to ask again.

use super::*;
use support::skipped;

#[test]
fn a_reader_whose_site_runs_gets_what_was_granted_once_the_gateway_takes_the_grant_for_final() {
    let _alone = heavy();
    let Some(ground) = Ground::on_anvil() else { skipped!("no anvil; tests/run installs it into target/peers") };
    let gateway = Gateway::confirming_after(&ground, "12");
    let member = |name| Member::at(Some(&ground), name, (&gateway, &[&gateway.address()]));
    let [alice, bob, carol] = ["alice", "bob", "carol"].map(member);
    let robot = Robot::enrol(&alice, "scout", &gateway);
    // What is there before the grant, and what comes after it.
    let before = robot.bring("3");
    alice.grant(&bob);
    let shared = ["received", "list", "--oldest", "--owner", &alice.address];
    bob.verified(&shared, before);
    let said = bob.site.as_ref().expect("running").stderr();
    let waits: Vec<&str> =
        said.lines().filter(|line| line.contains("yet: it may require more confirmations")).collect();
    assert!(waits.len() == 1 && waits[0].contains(&alice.address), "he is told once what he waits for: {said}");
    let all = robot.bring("3");
    let own = alice.verified(&["records", "list", "--oldest"], all);
    assert_eq!(bob.verified(&shared, all), own, "and it goes on");
    // For one who is granted it when all of it is there already, it is the same.
    alice.grant(&carol);
    assert_eq!(carol.verified(&shared, all), own);
}
