//! A failing Redis is reported as long as it fails: by `status`, its exit code and its words, by one alert and not by
//! hundreds; and what it lost is restored, or reported missing, automatically.

use serde_json::Value;

use super::field::{CAMERA, Load, NO_REDIS, ODOM};
use crate::support::{Console, Redis, Terminal, count, skipped, text, wait_until};

/// The exit code of `status`, and what it says about a part.
fn part(load: &Load, name: &str) -> (Option<i32>, Value) {
    let outcome = load.authros.with(&["--json"]).run(&["status"]);
    let parts = outcome.document()["health"].as_array().cloned().unwrap_or_default();
    (outcome.code, parts.into_iter().find(|part| part["part"] == name).unwrap_or_default())
}

/// Waits until `status` says that the vault does not accept records, with `words`.
fn until_told(load: &Load, words: &str) -> Value {
    let told = || {
        let (code, vault) = part(load, "vault");
        let failed = vault["level"] == "failed" && text(&vault, "text").contains(words);
        assert_eq!(code == Some(0), vault["level"] == "ok", "the exit code is of what is told: {code:?} {vault}");
        failed.then_some(vault)
    };
    let vault = wait_until(60, &format!("the vault is told to be ill, with '{words}'"), told);
    assert!(text(&vault, "text").starts_with("retry in 1 s: ") && count(&vault, "retry") == 1, "{vault}");
    assert!(text(&vault, "since").ends_with('Z'), "{vault}");
    let shown = load.authros.run(&["status"]);
    assert!(shown.code == Some(4) && shown.stdout.contains("vault     failed   retry in"), "{shown}");
    vault
}

fn until_well(load: &Load) {
    wait_until(60, "the vault is told to be well", || (part(load, "vault").1["level"] == "ok").then_some(()));
    let shown = load.authros.run(&["status"]).expect_code(0).stdout;
    assert!(shown.contains("vault     ok"), "{shown}");
}

fn waiting(vault: &Value) -> u64 {
    let words = text(vault, "text");
    words.split_ascii_whitespace().nth(4).and_then(|count| count.parse().ok()).unwrap_or_else(|| panic!("{words}"))
}

/// Failing and healthy again `times`, reported once each.
fn expect_told(load: &Load, times: usize) {
    let told = load.told();
    assert_eq!(told.matches("the vault is not accepting").count(), times, "one alert each time: {told}");
    assert_eq!(told.matches("the vault accepts all records again").count(), times, "closed each time: {told}");
}

#[test]
fn a_redis_that_is_killed_or_stopped_is_told_of_once_and_nothing_is_lost() {
    let Some(mut redis) = Redis::start(&["--appendonly", "yes"]) else { skipped!(NO_REDIS) };
    let load = Load::start(&["--vault", &redis.url()], &[], &[ODOM]);
    load.until("records are verified", 60, |life| count(life, "verified") >= 10);
    until_well(&load);

    redis.kill();
    let vault = until_told(&load, "does not answer");
    let first = waiting(&vault);
    wait_until(60, "the one alert counts on", || {
        (waiting(&until_told(&load, "records wait on disk")) > first + 20).then_some(())
    });
    redis.revive();
    until_well(&load);

    // In the very moment it is back: all that waited is on its way, many records at a time.
    redis.signal("STOP");
    until_told(&load, "does not answer");
    redis.signal("CONT");
    until_well(&load);

    let life = load.settle(&[ODOM]);
    assert_eq!((count(&life, "dropped"), count(&life, "lost_in_transport")), (0, 0), "{life}");
    expect_told(&load, 2);
    load.end();
}

#[test]
fn the_header_of_the_console_says_so_while_redis_is_away_and_no_longer() {
    let Some(mut redis) = Redis::start(&["--appendonly", "yes"]) else { skipped!(NO_REDIS) };
    let load = Load::start(&["--vault", &redis.url()], &[], &[ODOM]);
    let mut console = Console::open_in(&Terminal::of(140, 30), &load.authros, &[]);
    let header = |console: &Console| console.shown().lines().next().unwrap_or_default().to_owned();
    console.wait_for("vault ● ok", 60);
    assert!(header(&console).contains("vault ● ok"), "{}", console.shown());
    redis.kill();
    console.wait_for("vault ✖ retry in 1 s", 60);
    assert!(header(&console).contains("vault ✖ retry in 1 s"), "{}", console.shown());
    redis.revive();
    wait_until(60, "the header says that it is well", || header(&console).contains("vault ● ok").then_some(()));
    // The one alert closed itself: it is shown as over.
    let alerts = || -> Vec<String> {
        let shown = console.shown();
        shown.lines().filter(|line| line.contains("records wait on disk")).map(str::to_owned).collect()
    };
    wait_until(60, "the alert is over", || {
        let alerts = alerts();
        (alerts.len() == 1 && alerts[0].contains("resolved")).then_some(())
    });
    drop(console);
    let life = load.settle(&[ODOM]);
    assert_eq!(count(&life, "dropped"), 0, "{life}");
    load.end();
}

#[test]
fn a_redis_without_memory_is_told_of_and_goes_on_when_it_has_some() {
    let Some(redis) = Redis::start(&["--maxmemory", "3mb"]) else { skipped!(NO_REDIS) };
    let load = Load::start(&["--vault", &redis.url()], &[], &[CAMERA]);
    until_told(&load, "out of memory");
    redis.cli(&["CONFIG", "SET", "maxmemory", "500mb"]);
    until_well(&load);
    let life = load.settle(&[CAMERA]);
    assert_eq!(count(&life, "dropped"), 0, "{life}");
    expect_told(&load, 1);
    load.end();
}

#[test]
fn a_redis_that_is_told_to_evict_is_not_used_until_it_is_not() {
    let Some(redis) = Redis::start(&["--maxmemory", "64mb"]) else { skipped!(NO_REDIS) };
    let load = Load::start(&["--vault", &redis.url()], &[], &[ODOM]);
    load.until("records are verified", 60, |life| count(life, "verified") >= 10);
    redis.cli(&["CONFIG", "SET", "maxmemory-policy", "allkeys-lru"]);
    until_told(&load, "CONFIG SET maxmemory-policy noeviction");
    let keys = redis.keys();
    let life = load.life();
    load.until("records wait", 60, |now| count(now, "captured") >= count(&life, "captured") + 20);
    assert_eq!(redis.keys(), keys, "nothing is put into it");
    redis.cli(&["CONFIG", "SET", "maxmemory-policy", "noeviction"]);
    until_well(&load);
    load.settle(&[ODOM]);
    expect_told(&load, 1);
    load.end();
}

#[test]
fn a_flushed_redis_is_filled_again_by_the_site_that_runs() {
    let Some(redis) = Redis::start(&[]) else { skipped!(NO_REDIS) };
    let load = Load::start(&["--vault", &redis.url()], &[], &[ODOM]);
    load.until("records are verified", 60, |life| count(life, "verified") >= 20);
    load.settle(&[ODOM]);
    let records = load.records();
    for command in ["FLUSHALL", "FLUSHDB"] {
        redis.cli(&[command]);
        wait_until(60, "what it forgot is put back", || redis.keys().checked_sub(records.len() as u64 + 1));
        load.check(&records);
    }
    assert!(load.told().contains("they were put back from their local copies"), "{}", load.told());
    load.authros.run(&["status"]).expect_code(0);
    load.end();
}

#[test]
fn verified_records_that_are_gone_without_a_copy_are_missed_at_once_and_go_on_when_they_are_back() {
    let Some(redis) = Redis::start(&[]) else { skipped!(NO_REDIS) };
    let none = [("AUTHROS_VAULT_LOCAL", "0s")];
    let load = Load::start(&["--vault", &redis.url()], &none, &[]);
    load.authros.capture(&[ODOM], 8);
    let records = load.records();
    let key = |record: &Value| format!("authros:{}", text(record, "digest"));
    // A record deleted behind the program's back is restored as long as there is a copy.
    wait_until(90, "the copies are given up", || {
        redis.cli(&["EVAL", "redis.call('RENAME',KEYS[1],'aside')", "1", &key(&records[0])]);
        redis.cli(&["DEL", "authros:mark"]);
        wait_until(60, "the look has begun", || redis.keys().checked_sub(records.len() as u64));
        let code = wait_until(30, "the look is over", || {
            let put_back = redis.cli(&["EXISTS", &key(&records[0])]).trim() == "1";
            let code = load.authros.run(&["status"]).code;
            (put_back || code == Some(6)).then_some(code)
        });
        redis.cli(&["RENAME", "aside", &key(&records[0])]);
        (code == Some(6)).then_some(())
    });
    let told = load.told();
    assert!(told.contains("MISSING: the vault lost 1 verified records"), "{told}");
    redis.cli(&["DEL", "authros:mark"]);
    wait_until(60, "what is there again is verified again", || {
        (load.authros.run(&["status"]).code == Some(0)).then_some(())
    });

    redis.cli(&["FLUSHALL"]);
    wait_until(60, "all of it is missed", || (load.authros.run(&["status"]).code == Some(6)).then_some(()));
    let shown = load.authros.run(&["status"]).stdout;
    assert!(shown.contains("MISSING"), "{shown}");
    let audit = load.authros.with(&["--json"]).run(&["audit"]).expect_code(6).document();
    let messages = load.authros.records(&["uploads", "list"]).len();
    assert!(messages >= 8 && count(&audit, "missing") >= messages as u64, "{audit}");
    load.end();
}
