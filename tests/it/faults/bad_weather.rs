//! Peers that are slow or go away, disks that refuse now and then, clocks that jump: the work waits and continues.

use std::fs;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use super::kill::now;
use super::storage::Shim;
use crate::support::proxy::EVERY;
use crate::support::{
    Anvil, Authros, Conservation, Home, Proxy, Redis, Running, Spoil, long, poll, skipped, system_program, text,
    wait_until,
};

fn watch(authros: &Authros, robots: usize) {
    for robot in 1..=robots {
        authros.run(&["topics", "watch", &format!("/robot{robot}/odom")]).expect_code(0);
    }
}

fn unwatch(authros: &Authros, robots: usize) {
    for robot in 1..=robots {
        authros.run(&["topics", "unwatch", &format!("/robot{robot}/odom")]).expect_code(0);
    }
}

/// Everything captured is verified, nothing was dropped, and the law held.
fn settle(authros: &Authros, robots: usize, observer: Conservation, seconds: u64) -> u64 {
    unwatch(authros, robots);
    let life = wait_until(seconds, "everything is verified", || {
        observer.seen().life.filter(|life| life.pending == 0 && life.captured > 0)
    });
    assert_eq!((life.dropped, life.tampered), (0, 0), "{life:?}");
    assert_eq!(life.captured, life.verified + life.quarantined, "{life:?}");
    let seen = observer.finish();
    assert!(seen.noted.len() as u64 <= life.captured, "{} noted: {life:?}", seen.noted.len());
    life.captured
}

/// Resident memory of a process, KiB.
fn memory(site: &Running) -> u64 {
    let status = fs::read_to_string(format!("/proc/{}/status", site.id())).expect("it runs");
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).expect("its memory");
    line.trim().trim_end_matches(" kB").parse().expect("a number")
}

#[test]
fn a_chain_that_answers_after_half_a_minute_costs_neither_memory_nor_messages() {
    let Some(anvil) = Anvil::start(&[]) else { skipped!("no anvil") };
    let (proxy, home, robots) = (Proxy::before(anvil.port()), Home::new(), 10);
    let authros = home.authros().with(&["--robots", "10", "--chain", &proxy.http()]);
    let site = authros.serve(&home);
    let observer = Conservation::watch(&home.path(), "default");
    watch(&authros, robots);
    observer.wait_for_capture_after(0, 60).expect("it captures");
    proxy.spoil(EVERY, Spoil::Delay(Duration::from_secs(30)), u64::MAX);
    let length = Duration::from_secs(if long() { 600 } else { 60 });
    let (begun, before) = (Instant::now(), observer.seen().life.map_or(0, |life| life.captured));
    // Caches of SQLite and the first batches are not counted.
    let warm = Duration::from_secs(20);
    let (mut least, mut most) = (u64::MAX, 0);
    while begun.elapsed() < length {
        std::thread::sleep(Duration::from_secs(1));
        if begun.elapsed() >= warm {
            let now = memory(&site);
            (least, most) = (least.min(now), most.max(now));
        }
    }
    let life = observer.seen().life.expect("seen");
    let rate = (life.captured - before) / length.as_secs();
    println!("slow chain: {} s, {rate} messages a second, memory {least} to {most} KiB, {life:?}", length.as_secs());
    assert_eq!(life.dropped, 0, "{life:?}");
    assert!(most - least <= 32 * 1024, "memory grew from {least} to {most} KiB");
    assert!(proxy.spoilt() > 0, "the chain was slow");
    proxy.calm();
    let captured = settle(&authros, robots, observer, 240);
    println!("slow chain: all {captured} verified");
}

/// Waits until records captured from now on are verified; returns how long that takes.
fn heals(observer: &Conservation, what: &str) {
    let begun = Instant::now();
    let life = || observer.seen().life.expect("a site that answers");
    let (verified, owed) = (life().verified, life().pending);
    wait_until(60, &format!("records are verified after {what} is back"), || {
        (life().verified > verified).then_some(())
    });
    let first = begun.elapsed();
    wait_until(60, &format!("what waited for {what} is verified"), || {
        (life().verified >= verified + owed).then_some(())
    });
    // The target is ten seconds; a busy machine gets more.
    println!(
        "{what} is back: first record verified after {first:?}, all {owed} that waited after {:?}",
        begun.elapsed()
    );
}

#[test]
fn redis_and_the_chain_come_back_and_nobody_needs_to_do_anything() {
    let Some(mut redis) = Redis::start(&["--appendonly", "yes", "--appendfsync", "always"]) else {
        skipped!("no redis-server")
    };
    let home = Home::new();
    let state = home.root().join("state.json");
    let state = ["--state", state.to_str().expect("UTF-8"), "--preserve-historical-states"];
    let Some(anvil) = Anvil::start(&state) else { skipped!("no anvil") };
    let authros = home.authros().with(&["--robots", "1", "--vault", &redis.url(), "--chain", &anvil.http()]);
    let site = authros.serve(&home);
    let observer = Conservation::watch(&home.path(), "default");
    watch(&authros, 1);
    observer.wait_for_capture_after(0, 60).expect("it captures");
    let more = |count: u64, what: &str| {
        let captured = observer.seen().life.map_or(0, |life| life.captured);
        let grown = || observer.seen().life.filter(|life| life.captured >= captured + count);
        wait_until(60, &format!("messages are captured without {what}"), grown);
    };
    redis.kill();
    more(80, "Redis");
    redis.revive();
    heals(&observer, "Redis");
    let mut again = None;
    let _anvil = anvil.end_and_start_again(&state, || {
        more(80, "the chain");
        // A site started without its chain captures all the same.
        site.stop("TERM", 30).expect_code(0);
        again = Some(authros.serve(&home));
        more(80, "the chain, in a new site");
    });
    heals(&observer, "the chain");
    settle(&authros, 1, observer, 120);
}

#[test]
fn a_disk_that_refuses_now_and_then_holds_messages_up_and_loses_none() {
    let Some(shim) = Shim::compile() else { skipped!("no C compiler") };
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1"]);
    drop(authros.serve(&home));
    let switch = home.root().join("switch");
    let refused = authros
        .with_variable("LD_PRELOAD", &shim.path())
        .with_variable("SHIM_DIR", home.path().to_str().expect("UTF-8"))
        .with_variable("SHIM_SWITCH", switch.to_str().expect("UTF-8"))
        .with_variable("SHIM_MODE", "often")
        .with_variable("SHIM_AT", "23");
    let mut site = refused.serve(&home);
    let observer = Conservation::watch(&home.path(), "default");
    watch(&authros, 1);
    observer.wait_for_capture_after(0, 60).expect("it captures");
    fs::write(&switch, "on").expect("switched on");
    wait_until(60, "the operator is told", || site.stderr().contains("cannot be stored").then_some(()));
    std::thread::sleep(Duration::from_secs(if long() { 60 } else { 5 }));
    fs::remove_file(&switch).expect("switched off");
    site.expect_running();
    assert!(observer.wait_for_capture_after(now(), 60).is_some(), "it goes on by itself");
    let captured = settle(&authros, 1, observer, 120);
    println!("each 23rd write or sync refused for some seconds: all {captured} verified");
    site.stop("TERM", 30).expect_code(0);
}

/// libfiu, on the real program: a tenth of all fsyncs fail.
#[test]
fn fsyncs_that_fail_by_libfiu_lose_nothing() {
    let (Some(run), Some(control)) = (system_program("fiu-run"), system_program("fiu-ctrl")) else {
        skipped!("no fiu-run and fiu-ctrl (package fiu-utils)")
    };
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1"]);
    drop(authros.serve(&home));
    let under_fiu = authros.with_program(&run).with_prefix(&["-x", env!("CARGO_BIN_EXE_authros")]);
    let mut site = under_fiu.serve(&home);
    let observer = Conservation::watch(&home.path(), "default");
    watch(&authros, 1);
    observer.wait_for_capture_after(0, 60).expect("it captures");
    let command = "enable_random name=posix/io/sync/fsync,probability=0.1,failinfo=5";
    let fiu = |command: &str| {
        let id = site.id().to_string();
        crate::support::process::output_of(control.to_str().expect("UTF-8"), &["-c", command, &id]);
    };
    fiu(command);
    wait_until(60, "the operator is told", || site.stderr().contains("cannot be stored").then_some(()));
    std::thread::sleep(Duration::from_secs(if long() { 60 } else { 3 }));
    fiu("disable name=posix/io/sync/fsync");
    site.expect_running();
    assert!(observer.wait_for_capture_after(now(), 60).is_some(), "it goes on by itself");
    let captured = settle(&authros, 1, observer, 120);
    println!("a tenth of all fsyncs failed for some seconds: all {captured} verified");
    site.stop("TERM", 30).expect_code(0);
}

fn faketime() -> Option<PathBuf> {
    let places = ["/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/lib"];
    places.iter().map(|place| PathBuf::from(place).join("faketime/libfaketimeMT.so.1")).find(|path| path.exists())
}

/// List, contract and reader agree about a grant that a jump of the clock has ended; a new one is given at once.
fn expect_agreement(authros: &Authros, reader: &Authros, address: &str) {
    let states = || -> Vec<String> {
        let rows = authros.json(&["grants", "list"])["grants"].as_array().cloned().unwrap_or_default();
        rows.iter().map(|row| text(row, "state")).collect()
    };
    assert!(!states().contains(&"active".to_owned()), "{:?}", states());
    let message = authros.fails(3, &["grant", address, "--expires", "1h"]);
    assert!(message.contains("chain"), "it would end before it begins, by the chain's time: {message}");
    authros.json(&["grant", address, "--expires", "2d"]);
    assert!(states().contains(&"active".to_owned()), "{:?}", states());
    wait_until(60, "the reader opens what is captured now", || {
        let shared = reader.json(&["shared", "list", "--newest", "--limit", "1"])["records"].get(0).cloned()?;
        (reader.run(&["shared", "open", &text(&shared, "id")]).code == Some(0)).then_some(())
    });
}

#[test]
fn a_clock_that_jumps_by_a_day_and_back_breaks_nothing() {
    let Some(library) = faketime() else { skipped!("no libfaketime (package faketime)") };
    let home = Home::new();
    let offset = home.file("offset", "+0\n", 0o600);
    let authros = home.authros().with(&["--robots", "1"]);
    let shifted = |authros: &Authros| {
        authros
            .with_variable("LD_PRELOAD", library.to_str().expect("UTF-8"))
            .with_variable("FAKETIME_TIMESTAMP_FILE", &offset)
            .with_variable("FAKETIME_NO_CACHE", "1")
            // As when a real clock is set: durations are not affected.
            .with_variable("FAKETIME_DONT_FAKE_MONOTONIC", "1")
            .with_variable("DONT_FAKE_MONOTONIC", "1")
    };
    let site = shifted(&authros).serve(&home);
    let reader = home.profile("reader");
    let address = reader.enrol();
    authros.json(&["grant", &address, "--expires", "12h"]);
    let observer = Conservation::watch(&home.path(), "default");
    watch(&authros, 1);
    let newest = || {
        let page = authros.json(&["uploads", "list", "--newest", "--limit", "1", "--state", "verified"]);
        page["records"].get(0).cloned()
    };
    let first = wait_until(60, "records are verified", newest);
    let opened = || reader.json(&["shared", "list", "--limit", "1000"]);
    let shared = wait_until(60, "the reader sees some", || opened()["records"].get(0).cloned());
    assert_eq!(reader.json(&["shared", "open", &text(&shared, "id")])["verdict"], "verified");

    fs::write(&offset, "+1d\n").expect("the clock is set");
    let clock = |words: &str| {
        let parts = authros.json(&["status"])["health"].as_array().cloned().unwrap_or_default();
        let part = parts.into_iter().find(|part| part["part"] == "clock");
        part.filter(|part| part["level"] == "waiting" && text(part, "text").contains(words))
    };
    wait_until(60, "the jump is told", || clock("s ahead"));
    let day = |record: &serde_json::Value| text(record, "captured_at")[..10].to_owned();
    // Some may be sealed before the site has read the clock.
    let of_tomorrow = |record: &serde_json::Value| day(record) > day(&first) && record["epoch"] != first["epoch"];
    let later = wait_until(120, "records of tomorrow are verified", || newest().filter(of_tomorrow));
    // The grant has ended: what is captured from now on is not for the reader.
    wait_until(60, "the reader is refused", || {
        (reader.run(&["shared", "open", &text(&later, "id"), "--json"]).code != Some(0)).then_some(())
    });

    fs::write(&offset, "+0\n").expect("the clock is set back");
    let before = observer.seen().life.map_or(0, |life| life.verified);
    wait_until(60, "records are verified after the clock was set back", || {
        observer.seen().life.filter(|life| life.verified > before + 40)
    });
    reader.is_refused(&["shared", "open", &text(&later, "id")]);
    expect_agreement(&authros, &reader, &address);
    wait_until(60, "the chain is told to be ahead", || clock("behind the chain"));
    let audit = authros.run(&["audit", "list"]).stdout;
    assert!(audit.contains("s ahead") && audit.contains("s back"), "both jumps are in the audit log: {audit}");
    let captured = settle(&authros, 1, observer, 120);
    println!("a day forth and back: all {captured} verified");
    site.stop("TERM", 30).expect_code(0);
    assert!(poll(1, || home.socket()).is_none());
}
