//! A gateway's database dies under load and a synchronous standby goes on, and a database is restored to an earlier time.
//! The long run adds Patroni, a line that is cut and a full disk.

use std::process::Command;

use super::swarm::{Load, Swarm};
use super::*;
use support::authros::program_under_test;
use support::member::Member as Keys;
use support::postgres::Postgres;
use support::{long, skipped, system_program};

/// How often the primary is killed.
const KILLS: u32 = 3;
const SCENES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/long/database_failover.py");
/// Seconds for all scenes.
const PATIENCE: u64 = 3_600;
/// A standby must have each commit before it is acknowledged.
const ANY_STANDBY: &str = "ALTER SYSTEM SET synchronous_standby_names = 'ANY 1 (walreceiver)'";
const FOLLOWING: &str = "SELECT count(*) FROM pg_stat_replication WHERE state = 'streaming' AND sync_state = 'quorum'";
/// Of the gateway's own numbers.
const RECORDER: &str = "SELECT encode(recorder, 'hex') FROM about";
/// Bytes of the log that a standby has.
const RECEIVED: &str = "SELECT pg_last_wal_receive_lsn() - '0/0'::pg_lsn";

/// A primary and two standbys, in this order.
struct Cluster([Postgres; 3]);

impl Cluster {
    fn start() -> Result<Self, &'static str> {
        let primary = Postgres::start()?;
        primary.database("fleet");
        // The copies have it from the beginning: whichever is promoted waits for a standby.
        primary.sql("postgres", ANY_STANDBY);
        let standbys = [primary.standby(), primary.standby()];
        primary.sql("postgres", "SELECT pg_reload_conf()");
        let [first, second] = standbys;
        let cluster = Self([primary, first, second]);
        cluster.is_whole();
        Ok(cluster)
    }

    fn url(&self) -> String {
        Postgres::url_of(&self.0, "fleet")
    }

    fn is_whole(&self) {
        let [primary, ..] = &self.0;
        wait_until(60, "two standbys follow", || (primary.sql("postgres", FOLLOWING) == "2").then_some(()));
    }

    /// The primary dies, and the standby that has more goes on.
    fn fail_over(&mut self) {
        let [primary, first, second] = &mut self.0;
        primary.kill();
        let received = |server: &Postgres| server.sql("postgres", RECEIVED).parse::<u64>().expect("a number");
        if received(second) > received(first) {
            std::mem::swap(first, second);
        }
        first.promote();
        second.follow(first);
        std::mem::swap(primary, first);
    }

    /// The server that died follows the new primary.
    fn fail_back(&mut self) {
        let [primary, dead, _] = &mut self.0;
        dead.return_behind(primary);
        self.is_whole();
    }

    fn sql(&self, statement: &str) -> String {
        let [primary, ..] = &self.0;
        primary.sql("fleet", statement)
    }
}

#[test]
#[allow(clippy::print_stdout, reason = "figures for who reads the run")]
fn a_database_fails_over_again_and_again_and_each_record_is_held_once() {
    let _alone = heavy();
    let mut cluster = match Cluster::start() {
        Ok(cluster) => cluster,
        Err(reason) => skipped!(reason),
    };
    let ground = Ground::new();
    let mut gateway = Gateway::on_server(&ground, &cluster.url());
    let (alice, bob) = (Member::new("alice", &gateway), Member::new("bob", &gateway));
    alice.grant(&bob);
    let keys = Keys::of(&alice.home, "alice", gateway.domain.parse().expect("a domain"));
    let load = Load { clients: 8, records: 1, every: Duration::from_millis(250), bytes: 256 };
    let mut swarm = Swarm::start(keys, &gateway, load);
    let (own_recorder, mut writable) = (cluster.sql(RECORDER), Vec::new());
    for _ in 0..KILLS {
        let before = swarm.acknowledged();
        wait_until(120, "records are acknowledged", || (swarm.acknowledged() > before + 8).then_some(()));
        cluster.fail_over();
        let (promoted, before) = (Instant::now(), swarm.acknowledged());
        // One that was acknowledged before may be counted only now.
        wait_until(60, "records are acknowledged again", || (swarm.acknowledged() > before + 8).then_some(()));
        writable.push(promoted.elapsed());
        cluster.fail_back();
    }
    let brought = swarm.stop();
    writable.sort();
    println!(
        "{KILLS} fail-overs: {} records acknowledged; again after a promotion, p50 {:?}, max {:?}",
        brought.acknowledged.len(),
        writable.get(writable.len() / 2),
        writable.last()
    );
    swarm.holds(60, &brought.acknowledged);
    let held = swarm.listed(120, "all of them are verified", |list| list.is_superset(&brought.acknowledged));
    assert_eq!(held, brought.acknowledged, "0 lost, and nothing that nobody brought");
    alice.shares_all_with(&bob, brought.acknowledged.len() as u64);
    assert_eq!(cluster.sql(RECORDER), own_recorder, "a standby that has what was acknowledged is no restored database");
    gateway.site.as_mut().expect("running").expect_running();
}

#[test]
#[allow(clippy::print_stdout, reason = "figures for who reads the run")]
fn a_database_under_patroni_fails_over_in_each_scene() {
    if !long() {
        return; // Takes half an hour: `tests/run --long`.
    }
    let _alone = heavy();
    for program in ["patroni", "etcd", "ip"] {
        if system_program(program).is_none() {
            skipped!(format!("no {program}"));
        }
    }
    let mut command = Command::new("/usr/bin/python3");
    command.arg(SCENES).arg(program_under_test());
    println!("{}", Running::start(command).wait(PATIENCE).expect_code(0).stdout);
}

fn feeds(server: &Postgres) -> BTreeSet<String> {
    server.sql("fleet", "SELECT encode(id, 'hex') FROM feeds").lines().map(str::to_owned).collect()
}

#[test]
fn a_database_that_is_restored_under_a_gateway_is_noticed_and_its_robot_brings_what_is_missing() {
    let _alone = heavy();
    let mut server = match Postgres::start() {
        Ok(server) => server,
        Err(reason) => skipped!(reason),
    };
    let (ground, url) = (Ground::new(), server.database("fleet"));
    let mut gateway = Gateway::on_server(&ground, &url);
    let (alice, bob) = (Member::new("alice", &gateway), Member::new("bob", &gateway));
    alice.grant(&bob);
    let robot = Robot::enrol(&alice, "scout", &gateway);
    let before = robot.bring("5");
    let shared = ["received", "list", "--oldest", "--owner", &alice.address];
    bob.verified(&shared, before);
    let backup = server.backup();

    // It signs receipts for what follows, and proves none of it.
    gateway.kill();
    gateway.confirmations = "1000";
    gateway.start();
    let agent = robot.run(&[]);
    let receipted = accepted(&agent, before + 10);
    let (old, known) = (server.sql("fleet", RECORDER), feeds(&server));
    server.kill();
    server.restore(&backup);
    let ended = gateway.site.take().expect("running").wait(120).expect_code(REFUSED);
    agent.stop("TERM", 20);
    let said = [&*ended.stdout, &ended.stderr].concat();
    assert!(said.contains("restored to an earlier time") && said.contains("authros gateway serve"), "{said}");
    let rows = server.sql("fleet", "SELECT count(*) FROM records").parse::<u64>().expect("a number");
    assert!(rows < receipted && server.sql("fleet", RECORDER) == old, "nothing was written: {rows} of {receipted}");

    // What only looks says so, and leaves it to the gateway.
    let left = feeds(&server);
    for look in [&["gateway", "status"][..], &["status"]] {
        let said = gateway.keeper().fails(REFUSED, look);
        assert!(said.contains("restored to an earlier time") && said.contains("authros gateway serve"), "{said}");
    }
    let told = gateway.keeper().run(&["doctor"]).stdout;
    assert!(told.contains("restored to an earlier time"), "{told}");
    assert!(server.sql("fleet", RECORDER) == old && feeds(&server) == left, "a look changes nothing");

    gateway.confirmations = "1";
    gateway.start();
    gateway.site.as_mut().expect("running").wait_for_text("the database was restored to an earlier time", 60);
    assert_ne!(server.sql("fleet", RECORDER), old, "no number of its own is given twice");
    assert!(feeds(&server).is_disjoint(&known), "each reader begins again");
    let all = robot.bring("5");
    assert!(all > receipted, "{all} of {receipted}");
    let own = alice.verified(&["records", "list", "--oldest"], all);
    assert_eq!(bob.verified(&shared, all), own, "the reader has the same");
    let audit = gateway.keeper().json(&["audit", "--deep"]);
    assert_eq!((&audit["ok"], count(&audit, "missing")), (&Value::Bool(true), 0), "{audit}");
    // It is accepted once.
    gateway.site.take().expect("running").stop("TERM", 20).expect_code(0);
    let now = server.sql("fleet", RECORDER);
    gateway.start();
    assert_eq!(server.sql("fleet", RECORDER), now);
}
