//! A Redis cluster of three, one of which stops: its records wait, all others continue, and it gets all of them on its
//! return.

use super::field::{Load, NO_REDIS, ODOM, sample};
use crate::support::{Redis, count, skipped, wait_until};

#[test]
fn records_of_a_stopped_node_wait_and_all_others_go_on() {
    let Some(mut nodes) = Redis::cluster() else { skipped!(NO_REDIS) };
    let load = Load::start(&["--vault", &nodes[0].cluster_url()], &[], &[ODOM]);
    load.until("records are verified", 60, |life| count(life, "verified") >= 20);
    assert!(nodes.iter().all(|node| node.keys() > 0), "all three hold records");

    nodes[1].kill();
    let before = load.life();
    let grown = |life: &serde_json::Value, part, by| count(life, part) >= count(&before, part) + by;
    load.until("its records wait, others are verified", 90, |life| {
        grown(life, "pending", 15) && grown(life, "verified", 30)
    });
    nodes[1].revive();
    let life = load.settle(&[ODOM]);
    assert_eq!(count(&life, "dropped"), 0, "{life}");
    let records = load.records();
    wait_until(60, "it has its records again", || {
        nodes.iter().map(Redis::keys).sum::<u64>().checked_sub(records.len() as u64)
    });
    load.check(&sample(&records));
    load.end();
}
