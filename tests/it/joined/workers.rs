//! Three workers of one gateway over one PostgreSQL database: robots bring records to any of them, the one that holds the lease
//! is killed, the next one is stopped past its lease and goes on. Each record with a receipt is there once.

use authros::model::Digest;

use super::swarm::{Load, Swarm};
use super::*;
use support::member::Member as Keys;
use support::postgres::Postgres;
use support::skipped;

const ROBOTS: u16 = 12;

/// What a worker says of the lease.
fn lease(worker: &Gateway) -> Value {
    worker.keeper().json(&["gateway", "status"])["lease"].clone()
}

/// The index of the worker that holds the lease, as all of these say that are asked.
fn holder(workers: &[Gateway], asked: &[usize]) -> Option<usize> {
    asked.iter().copied().find(|index| lease(&workers[*index])["holder"]["is_own"] == true)
}

/// Waits until one of these holds it; returns which, and how long that took.
fn taken_by(workers: &[Gateway], asked: &[usize], what: &str) -> (usize, Duration) {
    let begun = Instant::now();
    let found = wait_until(60, what, || holder(workers, asked));
    (found, begun.elapsed())
}

/// Digests in the database, each as often as it is there.
fn rows(server: &Postgres, condition: &str) -> Vec<String> {
    let sql = format!("SELECT encode(digest, 'hex') FROM records WHERE {condition}");
    server.sql("fleet", &sql).lines().map(str::to_owned).collect()
}

#[test]
#[allow(clippy::print_stdout, reason = "figures for who reads the run")]
fn of_three_workers_one_is_killed_and_one_stopped_and_each_record_is_held_once() {
    let _alone = heavy();
    let server = match Postgres::start() {
        Ok(server) => server,
        Err(reason) => skipped!(reason),
    };
    let (ground, url) = (Ground::new(), server.database("fleet"));
    let first = Gateway::on_server(&ground, &url);
    let mut workers = vec![first.worker_beside(), first.worker_beside()];
    workers.insert(0, first);
    assert_eq!(workers[0].key, workers[2].key, "one gateway");
    assert_eq!(holder(&workers, &[0, 1, 2]), Some(0));
    let seen = lease(&workers[1]);
    assert_eq!((support::list(&seen, "workers").len(), &seen["holder"]["is_own"]), (3, &Value::Bool(false)), "{seen}");

    // A worker that follows refuses until it knows a block that the holder has read.
    let home = Home::new();
    let carol = home
        .profile("carol")
        .with_variable("AUTHROS_SITE", &workers[2].address())
        .with_variable("AUTHROS_GATEWAY_KEY", &workers[2].key);
    wait_until(30, "a worker that follows knows the chain", || {
        (carol.run(&["identity", "register"]).code == Some(0)).then_some(())
    });

    // An owner who is allowed at one worker is known to the others.
    let (alice, bob) = (Member::new("alice", &workers[2]), Member::new("bob", &workers[2]));
    alice.grant(&bob);
    let keys = Keys::of(&alice.home, "alice", workers[0].domain.parse().expect("a domain"));
    let load = Load { clients: ROBOTS, records: 1, every: Duration::from_millis(300), bytes: 256 };
    let mut swarm = Swarm::among(keys, &[&workers[0], &workers[1], &workers[2]], load);
    let more = |swarm: &Swarm| {
        let before = swarm.acknowledged();
        wait_until(90, "records are acknowledged", || (swarm.acknowledged() > before + 40).then_some(()));
    };
    more(&swarm);

    workers[0].kill();
    let (next, time) = taken_by(&workers, &[1, 2], "another takes the lease of one that was killed");
    println!("killed: another holds the lease after {time:?}");
    more(&swarm);
    workers[0].start();

    let rest: Vec<usize> = (0..3).filter(|index| *index != next).collect();
    let stopped = |signal: &str| workers[next].site.as_ref().expect("running").signal(signal);
    stopped("STOP");
    let (last, time) = taken_by(&workers, &rest, "another takes the lease of one that was stopped");
    println!("stopped: another holds the lease after {time:?}");
    more(&swarm);
    stopped("CONT");
    wait_until(30, "it knows that it lost the lease", || {
        (lease(&workers[next])["holder"]["is_own"] == false).then_some(())
    });
    assert_eq!(holder(&workers, &[last]), Some(last));
    more(&swarm);

    let brought = swarm.stop();
    let (late, longest) = (brought.outages.len(), brought.outages.last());
    println!("{} records acknowledged, {late} of them late, max {longest:?}", brought.acknowledged.len());
    each_is_there_once(&server, &swarm, &brought.acknowledged);
    alice.shares_all_with(&bob, brought.acknowledged.len() as u64);
    let audit = workers[last].keeper().json(&["audit", "--deep"]);
    assert_eq!((&audit["ok"], count(&audit, "missing")), (&Value::Bool(true), 0), "{audit}");
    let anchors = server.sql("fleet", "SELECT count(*), count(DISTINCT root) FROM batches WHERE block IS NOT NULL");
    println!("batches on the chain, and their roots: {anchors}");
    for worker in &mut workers {
        worker.site.take().expect("running").stop("TERM", 20).expect_code(0);
    }
    assert_eq!(server.sql("fleet", "SELECT until FROM lease"), "0", "the last one gave it up");
}

fn each_is_there_once(server: &Postgres, swarm: &Swarm, acknowledged: &BTreeSet<Digest>) {
    let wanted: BTreeSet<String> = acknowledged.iter().map(Digest::to_hex).collect();
    let held = swarm.listed(90, "all of them are in the feed", |list| list.is_superset(acknowledged));
    assert_eq!(&held, acknowledged, "nothing that nobody brought");
    let verified = rows(server, "state = 6");
    let found: BTreeSet<String> = verified.iter().cloned().collect();
    assert!(found.is_superset(&wanted), "each is anchored and verified");
    assert_eq!(found.len(), verified.len(), "once");
    let twice = "SELECT count(*) FROM (SELECT record FROM feed GROUP BY record HAVING count(*) > 1) AS twice";
    assert_eq!(server.sql("fleet", twice), "0");
}
