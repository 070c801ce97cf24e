//! A cache of several servers, or behind TLS.

use std::process::Command;

use serde_json::Value;

use super::field::{Load, NO_REDIS, ODOM};
use crate::support::nginx::certificates;
use crate::support::{Redis, Running, count, free_port, skipped, system_program, text, wait_until};

fn cache(load: &Load) -> Value {
    load.authros.json(&["status"])["cache"].clone()
}

/// Opens every record until the cache had as many of them as wanted since.
fn until_hits(load: &Load, records: &[Value], wanted: u64) {
    let before = count(&cache(load), "hits");
    wait_until(90, "hits", || {
        for record in records {
            let opened = load.authros.json(&["records", "open", &text(record, "id")]);
            assert_eq!(opened["verdict"], "verified", "{opened}");
        }
        (count(&cache(load), "hits") >= before + wanted).then_some(())
    });
}

#[test]
fn a_cluster_with_one_of_three_gone_serves_what_the_others_have() {
    let Some(mut nodes) = Redis::cluster() else { skipped!(NO_REDIS) };
    let load = Load::start(&["--cache", &nodes[0].cluster_url()], &[], &[ODOM]);
    load.until("records are verified", 60, |life| count(life, "verified") >= 20);
    wait_until(60, "all three have records", || nodes.iter().all(|node| node.keys() > 0).then_some(()));
    let records = load.authros.records(&["records", "list", "--oldest"]);
    let records = &records[..9.min(records.len())];
    nodes[1].kill();
    wait_until(60, "a part is told to be away", || {
        until_hits(&load, records, 1);
        text(&cache(&load)["away"], "why").contains("1 of 3 nodes").then_some(())
    });
    let before = count(&load.life(), "verified");
    load.until("no record waits for it", 60, |life| count(life, "verified") >= before + 20);
    nodes[1].revive();
    wait_until(60, "it is used again", || (cache(&load)["away"].is_null() && nodes[1].keys() > 0).then_some(()));
    let life = load.settle(&[ODOM]);
    assert_eq!((count(&life, "dropped"), count(&cache(&load), "wrong")), (0, 0), "{life}");
    load.end();
}

/// A master with one replica, and a sentinel that may decide alone.
#[test]
fn a_replica_that_becomes_the_master_is_the_cache_from_then_on() {
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
    let load = Load::start(&["--cache", &format!("redis+sentinel://127.0.0.1:{port}/mine")], &[], &[]);
    load.authros.capture(&[ODOM], 5);
    let records = load.authros.records(&["records", "list", "--oldest"]);
    until_hits(&load, &records, 5);
    master.kill();
    wait_until(90, "the replica is written to", || {
        load.authros.capture(&[ODOM], 1);
        let before = count(&cache(&load), "hits");
        let newest = load.authros.records(&["records", "list", "--oldest"]);
        for record in &newest {
            load.authros.json(&["records", "open", &text(record, "id")]);
        }
        let is_new = replica.cli(&["ROLE"]).contains("master");
        (is_new && count(&cache(&load), "hits") > before).then_some(())
    });
    load.end();
}

#[test]
fn behind_tls_the_right_certificate_is_accepted_and_every_wrong_one_costs_time_alone() {
    let (Some(_), Some(faketime)) = (system_program("openssl"), system_program("faketime")) else {
        skipped!("no openssl or no faketime")
    };
    let folder = tempfile::tempdir().expect("a folder");
    certificates(folder.path(), &faketime);
    let path = |name: &str| folder.path().join(name).to_str().expect("UTF-8").to_owned();
    let roots = path("ca.pem");
    for (name, words) in [
        ("good", None),
        ("own", Some("cache.roots")),
        ("expired", Some("expired")),
        ("other", Some("for another name")),
    ] {
        let port = free_port().to_string();
        let (certificate, key) = (path(&format!("{name}.pem")), path(&format!("{name}.key")));
        let tls =
            ["--tls-port", &port, "--tls-cert-file", &certificate, "--tls-key-file", &key, "--tls-auth-clients", "no"];
        let Some(redis) = Redis::start(&tls) else { skipped!(NO_REDIS) };
        let load = Load::start(
            &["--cache", &format!("rediss://127.0.0.1:{port}")],
            &[("AUTHROS_CACHE_ROOTS", roots.as_str())],
            &[],
        );
        load.authros.capture(&[ODOM], 3);
        let records = load.authros.records(&["records", "list", "--oldest"]);
        match words {
            None => until_hits(&load, &records, 3),
            Some(words) => {
                until_hits(&load, &records, 0);
                let why = wait_until(60, "it is away", || {
                    let told = cache(&load);
                    told["away"]["why"].as_str().map(str::to_owned)
                });
                assert!(why.contains(words), "{name}: {why}");
                assert_eq!((count(&cache(&load), "hits"), redis.keys()), (0, 0), "{name}");
            }
        }
        assert_eq!(count(&cache(&load), "wrong"), 0, "{name}");
        load.end();
    }
}
