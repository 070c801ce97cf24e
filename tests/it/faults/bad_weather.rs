//! Peers that are slow or go away, disks that refuse now and then, clocks that jump: the work waits and continues.

use std::fs;
use std::time::{Duration, Instant};

use serde_json::Value;

use super::kill::now;
use super::storage::Shim;
use crate::support::process::own_memory;
use crate::support::proxy::EVERY;
use crate::support::{
    Anvil, Authros, Conservation, Home, Proxy, Redis, Running, Spoil, clock, long, poll, skipped, system_program, text,
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
    let length = Duration::from_secs(if long() { 600 } else { 40 });
    let (begun, before) = (Instant::now(), observer.seen().life.map_or(0, |life| life.captured));
    // The first batches, and caches that fill once within two minutes, are not counted against it; pages of files are the
    // system's.
    let warm = (length / 5).max(Duration::from_secs(20));
    let (mut least, mut most) = (u64::MAX, 0);
    while begun.elapsed() < length {
        std::thread::sleep(Duration::from_secs(1));
        if begun.elapsed() >= warm {
            let now = own_memory(site.id());
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
    let Some(mut redis) = Redis::start(&[]) else { skipped!("no redis-server") };
    let home = Home::new();
    let state = home.root().join("state.json");
    let state = ["--state", state.to_str().expect("UTF-8"), "--preserve-historical-states"];
    let Some(anvil) = Anvil::start(&state) else { skipped!("no anvil") };
    let authros = home.authros().with(&["--robots", "1", "--cache", &redis.url(), "--chain", &anvil.http()]);
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
    // A cache that is away holds up no record.
    let verified = || observer.seen().life.map_or(0, |life| life.verified);
    let before = verified();
    wait_until(60, "records are verified without Redis", || (verified() >= before + 80).then_some(()));
    redis.revive();
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

/// List, contract and reader say the same of a grant that a jump of the clock has ended; a new one is given at once.
fn expect_agreement(authros: &Authros, reader: &Authros, address: &str) {
    let states = || -> Vec<String> {
        let rows = authros.json(&["grant", "list"])["grants"].as_array().cloned().unwrap_or_default();
        rows.iter().map(|row| text(row, "state")).collect()
    };
    assert!(!states().contains(&"active".to_owned()), "{:?}", states());
    let message = authros.fails(3, &["grant", "add", address, "--expires", "1h"]);
    assert!(message.contains("chain"), "it would end before it begins, by the chain's time: {message}");
    authros.json(&["grant", "add", address, "--expires", "2d"]);
    assert!(states().contains(&"active".to_owned()), "{:?}", states());
    wait_until(60, "the reader opens what is captured now", || {
        let shared = reader.json(&["received", "list", "--limit", "1"])["records"].get(0).cloned()?;
        (reader.run(&["records", "open", &text(&shared, "id")]).code == Some(0)).then_some(())
    });
}

/// A site whose clock the test sets, and somebody who reads there.
struct Shifted {
    home: Home,
    offset: String,
    authros: Authros,
    site: Running,
    reader: Authros,
    address: String,
}

impl Shifted {
    fn start() -> Option<Self> {
        let library = clock::faketime()?;
        let home = Home::new();
        let offset = home.file("offset", "+0\n", 0o600);
        let authros = home.authros().with(&["--robots", "1"]);
        let shifted = authros
            .with_variable("LD_PRELOAD", library.to_str().expect("UTF-8"))
            .with_variable("FAKETIME_TIMESTAMP_FILE", &offset)
            .with_variable("FAKETIME_NO_CACHE", "1")
            // As when a real clock is set: durations are not affected.
            .with_variable("FAKETIME_DONT_FAKE_MONOTONIC", "1")
            .with_variable("DONT_FAKE_MONOTONIC", "1");
        let site = shifted.serve(&home);
        let reader = home.profile("reader");
        let address = reader.enrol();
        Some(Self { home, offset, authros, site, reader, address })
    }

    fn set(&self, offset: &str) {
        fs::write(&self.offset, format!("{offset}\n")).expect("the clock is set");
    }

    /// What `status` says about the clock, once it contains these words.
    fn told(&self, words: &str) {
        let told = || {
            let parts = self.authros.json(&["status"])["health"].as_array().cloned().unwrap_or_default();
            let part = parts.into_iter().find(|part| part["part"] == "clock");
            part.filter(|part| part["level"] == "waiting" && text(part, "text").contains(words))
        };
        wait_until(60, &format!("the clock is told to be '{words}'"), told);
    }

    fn newest(&self) -> Option<Value> {
        let page = self.authros.json(&["records", "list", "--limit", "1", "--state", "verified"]);
        page["records"].get(0).cloned()
    }

    /// Records captured after now are sealed and verified.
    fn goes_on(&self, observer: &Conservation, what: &str) {
        let before = observer.seen().life.map_or(0, |life| life.verified);
        let more = || observer.seen().life.filter(|life| life.verified > before + 40);
        wait_until(60, &format!("records are verified {what}"), more);
    }

    /// Ends the site; all is verified, and both jumps are in the audit log.
    fn end(self, observer: Conservation, told: &str) {
        let audit = self.authros.run(&["audit", "list"]).stdout;
        assert!(audit.contains(" ahead") && audit.contains(" back"), "both jumps are in the audit log: {audit}");
        let captured = settle(&self.authros, 1, observer, 120);
        println!("{told}: all {captured} verified");
        self.site.stop("TERM", 30).expect_code(0);
        assert!(poll(1, || self.home.socket()).is_none());
    }
}

#[test]
fn a_clock_that_jumps_by_a_day_and_back_breaks_nothing() {
    let Some(shifted) = Shifted::start() else { skipped!("no libfaketime (package faketime)") };
    let Shifted { home, authros, reader, address, .. } = &shifted;
    authros.json(&["grant", "add", address, "--expires", "12h"]);
    let observer = Conservation::watch(&home.path(), "default");
    watch(authros, 1);
    let first = wait_until(60, "records are verified", || shifted.newest());
    let opened = || reader.json(&["received", "list", "--oldest", "--limit", "1000"]);
    let shared = wait_until(60, "the reader sees some", || opened()["records"].get(0).cloned());
    assert_eq!(reader.json(&["records", "open", &text(&shared, "id")])["verdict"], "verified");

    shifted.set("+1d");
    shifted.told("h ahead");
    let day = |record: &Value| text(record, "captured_at")[..10].to_owned();
    // Some may be sealed before the site has looked at the clock.
    let of_tomorrow = |record: &Value| day(record) > day(&first) && record["epoch"] != first["epoch"];
    let later = wait_until(120, "records of tomorrow are verified", || shifted.newest().filter(of_tomorrow));
    // The grant has ended: what is captured from now on is not for the reader.
    wait_until(60, "the reader is refused", || {
        (reader.run(&["records", "open", &text(&later, "id"), "--json"]).code != Some(0)).then_some(())
    });

    shifted.set("+0");
    shifted.goes_on(&observer, "after the clock was set back");
    reader.is_refused(&["records", "open", &text(&later, "id")]);
    expect_agreement(authros, reader, address);
    shifted.told("behind the chain");
    shifted.end(observer, "a day forth and back");
}

/// Like a machine that boots without a battery: the clock is a day behind, until somebody sets it.
#[test]
fn a_clock_that_falls_back_by_a_day_and_is_set_again_breaks_nothing() {
    let Some(shifted) = Shifted::start() else { skipped!("no libfaketime (package faketime)") };
    let Shifted { home, authros, reader, address, .. } = &shifted;
    authros.json(&["grant", "add", address, "--expires", "12h"]);
    let observer = Conservation::watch(&home.path(), "default");
    watch(authros, 1);
    let first = wait_until(60, "records are verified", || shifted.newest());

    shifted.set("-1d");
    shifted.told("behind the chain");
    shifted.goes_on(&observer, "by yesterday's clock");
    // The chain's time goes on: no grant begins or ends because of this.
    let states = || -> Vec<String> {
        let rows = authros.json(&["grant", "list"])["grants"].as_array().cloned().unwrap_or_default();
        rows.iter().map(|row| text(row, "state")).collect()
    };
    assert_eq!(states(), ["active"]);

    shifted.set("+0");
    shifted.goes_on(&observer, "after the clock was set again");
    assert_eq!(states(), ["active"], "list and contract agree");
    let newest = wait_until(60, "records of today", || shifted.newest());
    assert_eq!(newest["epoch"], first["epoch"], "no epoch began by it");
    let opens = |record: &Value| reader.run(&["records", "open", &text(record, "id")]).code == Some(0);
    wait_until(60, "the reader opens what is captured now", || opens(&newest).then_some(()));
    assert!(opens(&first), "and what was captured before");
    // The contract considers it active: it can be extended, and is listed so.
    authros.json(&["grant", "extend", address, "--expires", "2d"]);
    assert_eq!(states(), ["active"]);
    shifted.end(observer, "a day back and set again");
}
