//! With a real Redis: it stores ciphertext but no names, and one that evicts is refused.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::fs;

use support::{Home, Redis, free_port, holds, skipped, text, unhex};

const NO_REDIS: &str = "no redis-server and redis-cli";
const TOPIC: &str = "/robot1/odom";

#[test]
fn a_capture_into_redis_is_verified_from_there() {
    let Some(redis) = Redis::start(&[]) else { skipped!(NO_REDIS) };
    let home = Home::new();
    let authros = home.authros().with(&["--vault", &redis.url(), "--robots", "1"]);
    let _site = authros.serve(&home);
    authros.enrol();
    authros.capture(&[TOPIC, "/robot1/camera/compressed"], 4);
    let records = authros.records(&["uploads", "list"]);
    let keys: usize = redis.cli(&["DBSIZE"]).trim().parse().expect("a number of keys");
    assert!(keys >= records.len(), "{keys} keys for {} records", records.len());

    let dump = redis.dump();
    let export = home.root().join("export");
    let id = text(&records[0], "id");
    authros.run(&["uploads", "export", &id, "--dir", export.to_str().expect("UTF-8")]).expect_code(0);
    let blob = fs::read(export.join("record.bin")).expect("exported");
    assert!(holds(&dump, &blob), "the record is in Redis as it is anchored");
    for secret in ["robot1", "odom", "nav_msgs", "CompressedImage", "seq\n", "JFIF"] {
        assert!(!holds(&dump, secret.as_bytes()), "'{secret}' is in Redis in clear");
    }
    let digest = text(&records[0], "digest");
    assert!(holds(&dump, &unhex(&digest)) || holds(&dump, digest.as_bytes()), "keys are digests");
}

#[test]
fn what_redis_lost_is_found_missing() {
    let Some(redis) = Redis::start(&[]) else { skipped!(NO_REDIS) };
    let home = Home::new();
    let authros = home.authros().with(&["--vault", &redis.url(), "--robots", "1"]);
    let _site = authros.serve(&home);
    authros.enrol();
    authros.capture(&[TOPIC], 2);
    let record = &authros.records(&["uploads", "list"])[0];
    let id = text(record, "id");
    assert_eq!(authros.json(&["shared", "check", &id])["verdict"], "verified");
    // A flush of everything is noticed by the site itself, which puts back what it still has (tests/it/vault_faults).
    redis.cli(&["DEL", &format!("authros:{}", text(record, "digest"))]);
    let outcome = authros.run(&["shared", "check", &id]).expect_code(6);
    assert!((outcome.stdout.clone() + &outcome.stderr).contains("missing"), "{outcome}");
    authros.run(&["shared", "open", &id]).expect_code(6);
}

#[test]
fn a_redis_that_evicts_is_refused() {
    let Some(redis) = Redis::start(&["--maxmemory", "64mb", "--maxmemory-policy", "allkeys-lru"]) else {
        skipped!(NO_REDIS)
    };
    let home = Home::new();
    let authros = home.authros().with(&["--vault", &redis.url(), "--robots", "1"]);
    let message = authros.fails(5, &["capture", "--topic", TOPIC, "--count", "1"]);
    assert!(message.contains("noeviction"), "says what to set: {message}");
    assert_eq!(redis.cli(&["DBSIZE"]).trim(), "0");
}

#[test]
fn a_redis_that_is_down_is_unreachable() {
    let home = Home::new();
    let port = free_port();
    let authros = home.authros().with(&["--vault", &format!("redis://127.0.0.1:{port}"), "--robots", "1"]);
    let message = authros.fails(4, &["capture", "--topic", TOPIC, "--count", "1"]);
    assert!(message.contains(&port.to_string()), "{message}");
}
