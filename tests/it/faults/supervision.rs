//! Background tasks that fail are restarted and say so; signals end a site in order, a lost terminal does not.

use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use portable_pty::{CommandBuilder, PtySize, native_pty_system};
use serde_json::json;

use super::kill::now;
use crate::support::process::signal;
use crate::support::{Anvil, Authros, Conservation, Home, Running, faulty, long, poll, skipped, wait_until};

const TOPICS: [&str; 2] = ["/robot1/odom", "/robot1/camera/compressed"];
/// Every task of a site with one open profile and several lanes, except those that are threads.
const TASKS: [&str; 14] = [
    "news",
    "audit",
    "quarantine",
    "heads",
    "room",
    "ros",
    "chain",
    "watcher",
    "verifier",
    "stages",
    "expiry",
    "parties",
    "socket",
    "anchorer default",
];

/// A home whose only robot is captured, and its observer.
fn under_load() -> (Home, Authros, Conservation) {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1"]);
    let site = authros.serve(&home);
    for topic in TOPICS {
        authros.run(&["topics", "watch", topic]).expect_code(0);
    }
    site.stop("TERM", 30).expect_code(0);
    let observer = Conservation::watch(&home.path(), "default");
    (home, authros, observer)
}

/// Ends the load; everything noted is verified, and the law held all the time.
fn settle(home: &Home, authros: &Authros, observer: Conservation) {
    for topic in TOPICS {
        authros.run(&["topics", "unwatch", topic]).expect_code(0);
    }
    let life = wait_until(120, "everything is verified", || {
        observer.seen().life.filter(|life| life.pending == 0 && life.captured > 0)
    });
    assert_eq!((life.dropped, life.tampered, life.quarantined), (0, 0, 0), "{life:?}");
    let kept = authros.records(&["records", "list", "--oldest"]);
    let seen = observer.finish();
    let here = |digest: &String| kept.iter().any(|record| record["digest"] == **digest);
    assert!(seen.noted.keys().all(here), "all {} noted records are there: {}", seen.noted.len(), home.path().display());
}

#[test]
fn every_task_that_panics_is_begun_again_and_nothing_is_lost() {
    let Some(program) = faulty() else {
        skipped!("authros-faulty is not built; cargo test builds it with the examples")
    };
    let (home, authros, observer) = under_load();
    // Twice each, and the sealer once more after an acknowledgement, where nothing may be sealed again.
    let failing = authros.with_program(&program).with_variable("AUTHROS_FAIL_TASK", "all:2");
    let failing = failing.with_variable("AUTHROS_FAIL_POINT", "panic:appended:3").with_variable("RUST_BACKTRACE", "0");
    let site = failing.spawn(&["serve"]);
    let all = || {
        let seen = observer.seen();
        let again =
            |name: &&str| seen.restarts.get(*name).is_some_and(|times| *times >= 2) && seen.running.contains(*name);
        let sealer = seen.restarts.get("sealer") == Some(&1) && seen.running.contains("sealer");
        (TASKS.iter().all(again) && sealer).then_some(())
    };
    let healed = poll(60, all);
    assert!(healed.is_some(), "{:?}", *observer.seen());
    assert!(observer.wait_for_capture_after(now(), 30).is_some(), "capture goes on");
    let said = site.stderr();
    for name in TASKS {
        assert!(
            said.contains(&format!("the task '{name}' of this site failed")),
            "the operator is told of {name}: {said}"
        );
    }
    settle(&home, &authros, observer);
    let outcome = site.stop("TERM", 30).expect_code(0);
    assert!(outcome.stdout.contains("serving"), "{outcome}");
}

/// Its thread hangs, as if the machine had lost a wake-up: nothing fails, and nothing goes on.
#[test]
fn a_stage_that_has_work_and_makes_no_progress_is_told_and_begun_again() {
    let Some(program) = faulty() else {
        skipped!("authros-faulty is not built; cargo test builds it with the examples")
    };
    let (home, authros, observer) = under_load();
    let failing = authros.with_program(&program).with_variable("AUTHROS_FAIL_POINT", "stall:read-back:3");
    let site = failing.spawn(&["serve"]);
    wait_until(180, "the operator is told", || {
        let said = site.stderr();
        (said.contains("records wait to be verified") && said.contains("the verifier has done nothing since"))
            .then_some(())
    });
    let verified = observer.seen().life.map_or(0, |life| life.verified);
    wait_until(60, "it verifies again", || observer.seen().life.filter(|life| life.verified > verified + 20));
    assert!(site.stderr().contains("the task 'verifier' of this site failed"), "{}", site.stderr());
    wait_until(30, "it is over", || {
        let health = authros.json(&["status"])["health"].clone();
        (!health.to_string().contains("\"stages\"")).then_some(())
    });
    site.stop("KILL", 10);
    let _site = authros.serve(&home);
    settle(&home, &authros, observer);
}

/// A panic in the middle of sealing, storing or verifying means another try, not another loss.
#[test]
fn a_panic_in_the_middle_of_a_records_life_is_one_more_try() {
    let Some(program) = faulty() else {
        skipped!("authros-faulty is not built; cargo test builds it with the examples")
    };
    let (home, authros, observer) = under_load();
    let all = ["sealed:4", "checked:2", "block-due:3", "committed:4", "batch-closed:2", "signed-kept:2", "mined:2"];
    for place in if long() { &all[..] } else { &all[..3] } {
        let point = format!("panic:{place}");
        let failing = authros.with_program(&program).with_variable("AUTHROS_FAIL_POINT", &point);
        let mut site = failing.with_variable("RUST_BACKTRACE", "0").spawn(&["serve"]);
        site.wait_for_text("fail point", 60);
        let verified = observer.seen().life.map_or(0, |life| life.verified);
        let goes_on = || observer.seen().life.filter(|life| life.verified > verified + 5);
        wait_until(60, &format!("records are verified after {point}"), goes_on);
        site.stop("TERM", 30).expect_code(0);
    }
    let _site = authros.serve(&home);
    settle(&home, &authros, observer);
}

/// Ends a working site by a signal; returns how long that took. It is started so that nothing waits for a passphrase.
fn ends(authros: &Authros, observer: &Conservation, name: &str) -> Duration {
    let since = now();
    let site = authros.spawn(&["serve"]);
    assert!(observer.wait_for_capture_after(since, 60).is_some(), "it captures");
    let begun = Instant::now();
    site.stop(name, 30).expect_code(0);
    begun.elapsed()
}

#[test]
fn each_signal_ends_a_site_in_order() {
    let (home, authros, observer) = under_load();
    for name in ["HUP", "TERM", "INT"] {
        let took = ends(&authros, &observer, name);
        println!("SIG{name}: ended in order within {took:?}");
        // The target is five seconds; a busy machine gets more.
        assert!(took < Duration::from_secs(29), "SIG{name} took {took:?}");
    }
    let _site = authros.serve(&home);
    settle(&home, &authros, observer);
}

#[test]
fn a_site_ends_in_order_while_a_chain_that_stands_still_keeps_others_waiting() {
    let Some(anvil) = Anvil::start(&[]) else { skipped!("no anvil") };
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1", "--chain", &anvil.http()]);
    let site = authros.serve(&home);
    anvil.call("evm_setAutomine", &json!([false]));
    let capture = authros.with(&["--json"]).spawn(&["capture", "--topic", TOPICS[0], "--count", "5"]);
    wait_until(60, "its records are acknowledged", || {
        (authros.records(&["records", "list", "--oldest"]).len() >= 5).then_some(())
    });
    let begun = Instant::now();
    site.stop("TERM", 30).expect_code(0);
    println!("ended in order within {:?} although a capture waits", begun.elapsed());
    assert_eq!(capture.wait(30).code, Some(4), "who waited is told that the site is gone");
}

/// A working site that was started to outlive its terminal.
fn outlives(mut site_is_running: impl FnMut() -> bool, observer: &Conservation) {
    assert!(observer.wait_for_capture_after(now(), 60).is_some(), "capture goes on without a terminal");
    assert!(site_is_running());
}

#[test]
fn a_site_under_nohup_keeps_on_without_a_terminal() {
    let (home, authros, observer) = under_load();
    // Its own terminal, which then goes away.
    let pair = native_pty_system().openpty(PtySize::default()).expect("a pseudo-terminal");
    let mut command = CommandBuilder::new("nohup");
    command.arg(env!("CARGO_BIN_EXE_authros"));
    command.args(authros.arguments(&["serve"]));
    command.env_clear();
    authros.variables().into_iter().for_each(|(name, value)| command.env(name, value));
    command.cwd(home.root());
    let mut site = pair.slave.spawn_command(command).expect("it starts");
    let id = site.process_id().expect("an id").to_string();
    assert!(observer.wait_for_capture_after(now(), 60).is_some(), "it captures");
    drop(pair);
    signal("HUP", &id);
    outlives(|| matches!(site.try_wait(), Ok(None)), &observer);
    signal("TERM", &id);
    assert!(poll(30, || site.try_wait().ok().flatten()).is_some_and(|status| status.success()), "and ends in order");
    let _site = authros.serve(&home);
    settle(&home, &authros, observer);
}

#[test]
fn a_site_with_all_its_streams_closed_works() {
    let (home, authros, observer) = under_load();
    let mut command = Command::new("sh");
    command.args(["-c", "exec \"$@\" <&- >&- 2>&-", "sh", env!("CARGO_BIN_EXE_authros")]);
    command.args(authros.arguments(&["serve"])).env_clear().envs(authros.variables()).stdin(Stdio::null());
    let mut site = Running::start(command);
    outlives(|| site.is_running(), &observer);
    settle(&home, &authros, observer);
    site.stop("TERM", 30).expect_code(0);
}
