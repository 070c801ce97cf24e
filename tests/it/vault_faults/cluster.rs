//! A Redis cluster of three, one of which stops: its records wait, all others continue, and it gets all of them on its
//! return.

use super::field::{Load, NO_REDIS, ODOM, sample};
use crate::support::{Redis, count, skipped, wait_until};

const SLOTS: [(&str, &str); 3] = [("0", "5460"), ("5461", "10922"), ("10923", "16383")];

fn cluster() -> Option<Vec<Redis>> {
    let arguments =
        ["--cluster-enabled", "yes", "--cluster-node-timeout", "1500", "--cluster-require-full-coverage", "no"];
    let nodes = SLOTS.iter().map(|_| Redis::start(&arguments)).collect::<Option<Vec<_>>>()?;
    for (redis, (first, last)) in nodes.iter().zip(SLOTS) {
        redis.cli(&["CLUSTER", "ADDSLOTSRANGE", first, last]);
        for other in &nodes {
            redis.cli(&["CLUSTER", "MEET", "127.0.0.1", &other.port().to_string(), &other.bus().to_string()]);
        }
    }
    for redis in &nodes {
        wait_until(60, "the cluster is one", || {
            let about = redis.cli(&["CLUSTER", "INFO"]);
            (about.contains("cluster_state:ok") && about.contains("cluster_slots_ok:16384")).then_some(())
        });
    }
    Some(nodes)
}

#[test]
fn records_of_a_stopped_node_wait_and_all_others_go_on() {
    let Some(mut nodes) = cluster() else { skipped!(NO_REDIS) };
    // One node is named; the others are learnt.
    let load = Load::start(&["--vault", &format!("redis+cluster://127.0.0.1:{}", nodes[0].port())], &[], &[ODOM]);
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
