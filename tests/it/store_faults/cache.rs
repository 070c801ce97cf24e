//! One Redis in front of a store: whatever happens to it costs time and nothing else.

use std::io::{Read as _, Write as _};
use std::net::TcpListener;
use std::time::{Duration, Instant};

use serde_json::Value;

use super::field::{CAMERA, Load, NO_REDIS, ODOM, sample};
use crate::support::process::peak_memory;
use crate::support::{Console, Redis, Terminal, count, holds, skipped, text, unhex, wait_until};

/// How long an opening may take while a cache stands still: the silence itself, on a busy machine.
const LATE: Duration = Duration::from_secs(10);

/// What the site says of its cache.
fn cache(load: &Load) -> Value {
    load.authros.json(&["status"])["cache"].clone()
}

/// Opens records, and fails unless each is verified and in time.
fn open_all(load: &Load, records: &[Value]) {
    for record in records {
        let begun = Instant::now();
        let opened = load.authros.json(&["records", "open", &text(record, "id")]);
        assert_eq!(opened["verdict"], "verified", "{opened}");
        assert!(begun.elapsed() < LATE, "{:?}: {opened}", begun.elapsed());
    }
}

/// Opens records until the cache has one of them.
fn until_hit(load: &Load, records: &[Value]) {
    wait_until(60, "a hit", || {
        let before = count(&cache(load), "hits");
        open_all(load, records);
        (count(&cache(load), "hits") > before).then_some(())
    });
}

/// More records become verified.
fn goes_on(load: &Load, what: &str) {
    let before = count(&load.life(), "verified");
    load.until(what, 60, |life| count(life, "verified") >= before + 15);
}

fn is_away(load: &Load) -> bool {
    let outcome = load.authros.with(&["--json"]).run(&["status"]).expect_code(0);
    let view = outcome.document();
    let part = view["health"].as_array().into_iter().flatten().find(|part| part["part"] == "cache").cloned();
    let part = part.expect("a cache is one of its parts");
    let since = &view["cache"]["away"]["since"];
    assert_eq!(since.is_string(), part["level"] == "absent", "{part} {}", view["cache"]);
    since.is_string()
}

fn until_away(load: &Load, records: &[Value]) {
    wait_until(60, "the cache is said to be away", || {
        open_all(load, records);
        is_away(load).then_some(())
    });
}

#[test]
fn killed_stopped_and_flushed_it_holds_up_no_record_and_shows_none_false() {
    let Some(mut redis) = Redis::start(&[]) else { skipped!(NO_REDIS) };
    let load = Load::start(&["--cache", &redis.url()], &[], &[ODOM]);
    load.until("records are verified", 60, |life| count(life, "verified") >= 10);
    let records = sample(&load.records());
    until_hit(&load, &records);

    redis.kill();
    until_away(&load, &records);
    goes_on(&load, "records are verified without it");
    redis.revive();
    wait_until(60, "it is back", || (!is_away(&load)).then_some(()));
    until_hit(&load, &records);

    redis.signal("STOP");
    until_away(&load, &records);
    goes_on(&load, "records are verified while it stands still");
    open_all(&load, &records);
    redis.signal("CONT");
    wait_until(60, "it goes on", || (!is_away(&load)).then_some(()));

    redis.cli(&["FLUSHALL"]);
    until_hit(&load, &records);
    let told = cache(&load);
    assert_eq!(count(&told, "wrong"), 0, "{told}");
    assert!(count(&told, "hits") > 0 && count(&told, "misses") > 0, "{told}");
    let shown = load.authros.run(&["status"]).stdout;
    assert!(shown.contains("cache") && shown.contains(" hits, "), "{shown}");
    let life = load.settle(&[ODOM]);
    assert_eq!(["dropped", "lost_in_recorder"].map(|loss| count(&life, loss)), [0, 0], "{life}");
    load.authros.run(&["audit", "--deep"]).expect_code(0);
    load.end();
}

#[test]
fn the_console_says_how_it_does() {
    let Some(redis) = Redis::start(&[]) else { skipped!(NO_REDIS) };
    let load = Load::start(&["--cache", &redis.url()], &[], &[]);
    load.authros.capture(&[ODOM], 2);
    let mut console = Console::open_in(&Terminal::of(140, 30), &load.authros, &[]);
    console.wait_for("cache ● ok", 60);
    console.wait_for(" hits, ", 60);
    drop(console);
    load.end();
}

#[test]
fn full_with_any_policy_it_has_what_it_likes_and_every_record_opens() {
    for policy in ["allkeys-lru", "noeviction"] {
        let full = ["--maxmemory", "3mb", "--maxmemory-policy", policy];
        let Some(redis) = Redis::start(&full) else { skipped!(NO_REDIS) };
        let load = Load::start(&["--cache", &redis.url()], &[], &[CAMERA, ODOM]);
        load.until("more than it holds is verified", 90, |life| count(life, "verified") >= 150);
        let life = load.settle(&[CAMERA, ODOM]);
        assert_eq!(["dropped", "lost_in_recorder"].map(|loss| count(&life, loss)), [0, 0], "{life}");
        let records = load.authros.records(&["records", "list", "--oldest", "--topic", CAMERA]);
        open_all(&load, &sample(&records));
        open_all(&load, &sample(&records));
        let told = cache(&load);
        assert_eq!((count(&told, "wrong"), &told["away"]), (0, &Value::Null), "{policy}: {told}");
        load.end();
    }
}

#[test]
fn what_it_has_is_ciphertext_by_digest_and_an_erased_record_is_deleted_there() {
    let Some(redis) = Redis::start(&[]) else { skipped!(NO_REDIS) };
    let load = Load::start(&["--cache", &redis.url()], &[], &[]);
    load.authros.capture(&[ODOM, CAMERA], 4);
    let records = load.records();
    let key = |record: &Value| format!("authros:{}", text(record, "digest"));
    let has = |record: &Value| redis.cli(&["EXISTS", &key(record)]).contains('1');
    wait_until(60, "it has all of them", || records.iter().all(has).then_some(()));
    let dump = redis.dump();
    let export = load.home.root().join("export");
    load.authros
        .run(&["records", "export", &text(&records[0], "id"), "--dir", export.to_str().expect("UTF-8")])
        .expect_code(0);
    let blob = std::fs::read(export.join("record.bin")).expect("exported");
    assert!(holds(&dump, &blob), "the record is there as it is anchored");
    for secret in ["robot1", "odom", "nav_msgs", "CompressedImage", "seq\n", "JFIF"] {
        assert!(!holds(&dump, secret.as_bytes()), "'{secret}' is there in clear");
    }
    let digest = text(&records[0], "digest");
    assert!(holds(&dump, &unhex(&digest)) || holds(&dump, digest.as_bytes()), "keys are digests");

    load.authros.json(&["records", "erase", "--topic", CAMERA, "--reason", "a face is in it", "--yes"]);
    let pictures = load.authros.records(&["records", "list", "--oldest", "--topic", CAMERA]);
    wait_until(120, "they are gone from both", || (!pictures.iter().any(has)).then_some(()));
    assert!(records.iter().filter(|record| record["topic"] == ODOM).all(has), "and nothing else");
    for picture in &pictures {
        let refused = load.authros.run(&["records", "open", &text(picture, "id")]);
        assert!(refused.code != Some(0) && !refused.stdout.contains("message"), "{refused}");
    }
    load.end();
}

/// A server that answers `PING`, takes everything, and gives another value for each record.
fn liar() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("binds");
    let url = format!("redis://{}", listener.local_addr().expect("an address"));
    std::thread::spawn(move || {
        for (number, mut stream) in listener.incoming().map_while(Result::ok).enumerate() {
            std::thread::spawn(move || {
                let (mut request, mut value) = (vec![0; 1 << 20], Vec::new());
                while let Ok(length @ 1..) = stream.read(&mut request) {
                    let text = &request[..length];
                    let reply = if holds(text, b"PING") {
                        b"+PONG\r\n".to_vec()
                    } else if holds(text, b"GET") && number % 3 == 2 {
                        // Never ends.
                        drop(stream.write_all(b"$9000000000000\r\n"));
                        while stream.write_all(&[b'0'; 4096]).is_ok() {}
                        return;
                    } else if holds(text, b"GET") && number % 3 == 1 {
                        b"$5\r\nwrong\r\n".to_vec()
                    } else if holds(text, b"GET") {
                        // Another record, if any was ever written to it.
                        [format!("${}\r\n", value.len()).as_bytes(), &value[..], b"\r\n"].concat()
                    } else {
                        value = text.to_vec();
                        b"+OK\r\n".repeat(text.windows(3).filter(|word| word == b"SET").count().max(1))
                    };
                    if stream.write_all(&reply).is_err() {
                        return;
                    }
                }
            });
        }
    });
    url
}

#[test]
fn no_lie_of_it_is_shown_and_none_takes_more_memory_than_a_record() {
    let load = Load::start(&["--cache", &liar()], &[], &[ODOM]);
    load.until("records are verified", 60, |life| count(life, "verified") >= 10);
    let records = sample(&load.records());
    let before = peak_memory(load.id()).expect("it runs");
    wait_until(90, "it was caught", || {
        open_all(&load, &records);
        (count(&cache(&load), "wrong") >= 3).then_some(())
    });
    let told = cache(&load);
    assert_eq!(count(&told, "hits"), 0, "{told}");
    let more = peak_memory(load.id()).expect("it runs").saturating_sub(before);
    assert!(more < 200 * 1024, "{more} KiB more");
    goes_on(&load, "records are verified");
    load.settle(&[ODOM]);
    load.end();
}
