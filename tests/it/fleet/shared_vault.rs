//! Two gateways of a fleet over one Redis cluster: each record is kept there once, whoever took it, and either of them has it.

use std::collections::BTreeSet;

use super::reconciling::{bring, name_each_other, reconciled};
use super::*;
use support::{Redis, skipped};

/// The names of all records that the cluster's nodes hold.
fn held(nodes: &[Redis]) -> Vec<String> {
    let names = |node: &Redis| {
        let said = node.cli(&["KEYS", "authros:????????????????????????????????????????????????????????????????"]);
        said.lines().filter(|line| line.starts_with("authros:")).map(str::to_owned).collect::<Vec<_>>()
    };
    nodes.iter().flat_map(names).collect()
}

#[test]
fn two_gateways_share_a_redis_cluster_and_each_record_is_in_it_once() {
    let _alone = heavy();
    let Some(mut nodes) = Redis::cluster() else { skipped!("no redis-server and redis-cli") };
    let (ground, vault) = (Ground::new(), nodes[0].cluster_url());
    let (mut first, second) = (Gateway::keeping_in(&ground, &vault), Gateway::keeping_in(&ground, &vault));
    let both = [&first, &second];
    let (alice, bob) = (Member::new("alice", &both), Member::new("bob", &[&second]));
    alice.grant(&bob);
    name_each_other(&both);
    let (scout, rover) = (Robot::enrol(&alice, "scout", &[&first]), Robot::enrol(&alice, "rover", &[&second]));
    let all = bring(&scout, "10") + bring(&rover, "10");
    let shared = ["shared", "list", "--owner", &alice.address];
    let at_bob = bob.verified(&shared, all);
    both.into_iter().for_each(|gateway| drop(reconciled(gateway, 10)));
    let names = held(&nodes);
    assert_eq!(names.len(), names.iter().collect::<BTreeSet<_>>().len(), "each on one node");
    for id in &at_bob {
        let of_record = names.iter().filter(|name| name["authros:".len()..].starts_with(id)).count();
        assert_eq!(of_record, 1, "{id} among {} names", names.len());
    }
    assert!(nodes.iter().all(|node| node.keys() > 0), "all three hold some");

    // The one that took them is gone with its ledger; a node of the cluster stops and comes back.
    first.kill();
    drop(std::mem::replace(&mut first.home, Home::new()));
    nodes[1].kill();
    nodes[1].revive();
    let carol = Member::new("carol", &[&second]);
    alice.grant(&carol);
    assert_eq!(carol.verified(&shared, all), at_bob, "a reader who comes afterwards has all of them, once");
}
