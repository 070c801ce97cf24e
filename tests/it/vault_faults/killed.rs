//! One Redis that is killed, full, evicts keys, or fails over to a replica.

use std::process::Command;

use authros::store::vault::{Gravity, examine};

use super::field::{CAMERA, Load, NO_REDIS, ODOM, sample};
use crate::support::{Redis, Running, count, free_port, long, skipped, wait_until};

/// Killed while records come, as often as requested: nothing acknowledged is lost, whatever its state.
fn killed(arguments: &[&str]) -> Option<()> {
    let mut redis = Redis::start(arguments)?;
    let load = Load::start(&["--vault", &redis.url()], &[], &[ODOM]);
    for round in 1..=if long() { 20 } else { 1 } {
        let before = load.until("records are verified", 60, |life| count(life, "verified") >= 15 * round);
        redis.kill();
        let (captured, pending) = (count(&before, "captured"), count(&before, "pending"));
        load.until("records wait in the ledger", 60, |life| {
            count(life, "captured") >= captured + 20 && count(life, "pending") >= pending + 10
        });
        redis.revive();
    }
    let life = load.settle(&[ODOM]);
    let losses = ["dropped", "lost_in_transport"].map(|loss| count(&life, loss));
    assert_eq!(losses, [0, 0], "{life}");
    let records = load.records();
    let lacking = || redis.keys().checked_sub(records.len() as u64);
    wait_until(60, "what it forgot is put back", lacking);
    load.check(&sample(&records));
    load.end();
    Some(())
}

#[test]
fn killed_without_an_append_only_file_nothing_is_lost() {
    if killed(&[]).is_none() {
        skipped!(NO_REDIS);
    }
}

#[test]
fn killed_with_an_append_only_file_nothing_is_lost() {
    if killed(&["--appendonly", "yes"]).is_none() {
        skipped!(NO_REDIS);
    }
}

#[test]
fn every_policy_that_evicts_is_refused_and_the_rest_is_warned_of() {
    let Some(redis) = Redis::start(&["--maxmemory", "64mb"]) else { skipped!(NO_REDIS) };
    let url = redis.url();
    let gravities = || -> Vec<Gravity> {
        let findings = examine(Some(&url)).expect("reachable");
        assert!(findings.iter().all(|finding| finding.advice.contains("CONFIG SET")), "{findings:?}");
        findings.into_iter().map(|finding| finding.gravity).collect()
    };
    let evicting = [
        "allkeys-lru",
        "allkeys-lfu",
        "allkeys-random",
        "volatile-lru",
        "volatile-lfu",
        "volatile-random",
        "volatile-ttl",
    ];
    for policy in evicting {
        redis.cli(&["CONFIG", "SET", "maxmemory-policy", policy]);
        assert_eq!(gravities(), [Gravity::Refused], "{policy}");
    }
    redis.cli(&["CONFIG", "SET", "maxmemory-policy", "noeviction"]);
    assert_eq!(gravities(), [Gravity::Warning], "no append-only file");
    redis.cli(&["CONFIG", "SET", "appendonly", "yes"]);
    assert_eq!(gravities(), []);
    assert_eq!(examine(None), Ok(Vec::new()));
}

/// Redis without memory: records wait on disk as far as allowed, then the newest are counted and reported.
#[test]
fn what_a_full_redis_does_not_take_waits_and_what_does_not_fit_is_told_in_gap_records() {
    let Some(redis) = Redis::start(&["--maxmemory", "2mb"]) else { skipped!(NO_REDIS) };
    let small = [("AUTHROS_VAULT_BACKLOG", "200KiB"), ("AUTHROS_CAPTURE_MEMORY", "1MiB")];
    let load = Load::start(&["--vault", &redis.url()], &small, &[CAMERA, ODOM]);
    let full = load.until("losses are counted", 90, |life| count(life, "lost_in_recorder") > 5);
    assert!(count(&full, "pending") > 0, "{full}");
    redis.cli(&["CONFIG", "SET", "maxmemory", "500mb"]);
    let life = load.settle(&[CAMERA, ODOM]);
    let lost = count(&life, "lost_in_recorder");
    assert_eq!(count(&life, "dropped"), lost, "{life}");
    let told = wait_until(60, "all losses are told of in verified gap records", || {
        let gaps = load.authros.records(&["uploads", "list", "--kind", "gap", "--state", "verified"]);
        let opened = gaps.iter().map(|gap| load.authros.json(&["shared", "open", gap["id"].as_str().expect("an id")]));
        let opened: Vec<_> = opened.collect();
        let told: u64 = opened.iter().map(|gap| count(&gap["message"], "lost")).sum();
        (told == count(&load.life(), "lost_in_recorder")).then_some(opened)
    });
    for gap in &told {
        assert_eq!(gap["message"]["reason"], "vault behind", "{gap}");
        assert!(gap["message"]["first_number"].is_u64() && gap["topic"] == gap["message"]["topic"], "{gap}");
    }
    load.end();
}

/// A master with one replica, and a sentinel that may decide alone.
#[test]
fn a_replica_that_becomes_the_master_gets_what_it_lacks() {
    let Some(mut master) = Redis::start(&[]) else { skipped!(NO_REDIS) };
    let to = format!("127.0.0.1 {}", master.port());
    let Some(replica) = Redis::start(&["--replicaof", &to]) else { skipped!(NO_REDIS) };
    let (directory, port) = (tempfile::tempdir().expect("a directory"), free_port());
    let file = directory.path().join("sentinel.conf");
    let rules = format!(
        "port {port}\nbind 127.0.0.1\nsentinel monitor mine 127.0.0.1 {} 1\nsentinel down-after-milliseconds mine 1000\n\
         sentinel failover-timeout mine 3000\n",
        master.port()
    );
    std::fs::write(&file, rules).expect("written");
    let mut command = Command::new("redis-server");
    command.arg(&file).arg("--sentinel");
    let mut sentinel = Running::start(command);
    sentinel.wait_for_text("+monitor master mine", 30);
    wait_until(60, "the sentinel knows the replica", || {
        let known =
            crate::support::process::output_of("redis-cli", &["-p", &port.to_string(), "SENTINEL", "REPLICAS", "mine"]);
        known.contains(&replica.port().to_string()).then_some(())
    });
    let load = Load::start(&["--vault", &format!("redis+sentinel://127.0.0.1:{port}/mine")], &[], &[ODOM]);
    load.until("records are verified", 60, |life| count(life, "verified") >= 10);
    master.kill();
    let at = count(&load.life(), "verified");
    load.until("the replica is written to", 90, |life| count(life, "verified") >= at + 30);
    let life = load.settle(&[ODOM]);
    assert_eq!(count(&life, "dropped"), 0, "{life}");
    let records = load.records();
    wait_until(60, "the new master has all", || replica.keys().checked_sub(records.len() as u64));
    load.check(&sample(&records));
    load.end();
}
