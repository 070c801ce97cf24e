//! Journeys of an operator, each at three sizes of the terminal: what the screen says, and whether that is what happens.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::granting::{is_closed, opened};
use crate::robots::{Robot, Site};
use crate::support;

use std::collections::BTreeSet;
use std::fs;

use serde_json::Value;
use support::{
    Anvil, Authros, Home, Operator, PASSPHRASE, SIZES, clock, heavy, ids, is_verified, list, locked_profile, skipped,
    text, two_profiles, wait_until,
};

const TOPIC: &str = "/robot1/odom";
const CAMERA: &str = "/robot1/camera/compressed";
const OTHER: &str = "/robot2/odom";
/// Seconds allowed for anything on a busy machine.
const PATIENCE: u64 = 90;
const NO_FAKETIME: &str = "no libfaketime (package faketime)";

fn records(authros: &Authros) -> Vec<Value> {
    authros.records(&["records", "list", "--oldest"])
}

/// Fills in a grant of everything to a new reader, up to the question.
fn asks_to_grant(home: &Home, operator: &mut Operator, number: usize, from: &str) -> Authros {
    let reader = home.profile(&format!("reader{number}"));
    let address = reader.enrol();
    operator.sees("Overview").presses("5").sees("can read new records now").presses("g");
    operator.reads("Grant", "now from now on: a new key, nothing older");
    operator.presses(&format!("{address}\rall\r\r{from}\r")).reads("Grant this?", &address);
    reader
}

#[test]
fn a_grant_from_now_on_opens_nothing_older() {
    let two = two_profiles(1);
    for (number, size) in (1..).zip(SIZES) {
        two.alice.capture(&[TOPIC], 3);
        let before = records(&two.alice);
        let mut alice = Operator::opens(&two.alice, size);
        let reader = asks_to_grant(&two.home, &mut alice, number, "now");
        alice.reads("Grant this?", "Records from now on, nothing older").reads("Grant this?", "Cost a new epoch:");
        alice.presses("y").sees(&format!("{number} can read new records now"));
        is_closed(&reader, &before[before.len() - 3..]);
        two.alice.capture(&[TOPIC], 2);
        let all = records(&two.alice);
        assert_eq!(opened(&reader), ids(&all[before.len()..]), "and all that came since");
        alice.leaves();
    }
}

#[test]
fn a_grant_an_hour_back_says_from_when_it_opens_and_opens_just_that() {
    let home = Home::new();
    let alice = home.profile("alice");
    let authros = home.authros().with(&["--robots", "1"]);
    let Some(earlier) = clock::shifted(&authros, "-3h") else { skipped!(NO_FAKETIME) };
    let site = earlier.serve(&home);
    alice.enrol();
    alice.capture(&[TOPIC], 3);
    alice.json(&["keys", "rotate"]);
    alice.capture(&[TOPIC], 2);
    site.stop("INT", 30).expect_code(0);
    let _site = authros.serve(&home);
    alice.capture(&[TOPIC], 1);
    alice.json(&["keys", "rotate"]);
    alice.capture(&[TOPIC], 4);
    // What was captured within the hour begins in the second epoch, and a grant opens whole ones.
    let all = records(&alice);
    let since = text(&all[3], "captured_at")[..19].replace('T', " ");
    for (number, size) in (1..).zip(SIZES) {
        let mut operator = Operator::opens(&alice, size);
        let reader = asks_to_grant(&home, &mut operator, number, "1h");
        operator.reads("Grant this?", &since).reads("Grant this?", "UTC, 7 records");
        operator.reads("Grant this?", "Cost 1 transaction").presses("y");
        operator.sees(&format!("{number} can read new records now"));
        assert_eq!(opened(&reader), ids(&all[3..]));
        is_closed(&reader, &all[..3]);
        operator.leaves();
    }
}

#[test]
fn a_watch_by_pattern_is_of_the_robot_that_comes_the_next_day() {
    let _alone = heavy();
    let home = Home::new();
    let with = |robots: &str| home.authros().with(&["--robots", robots]);
    let of = |topic: &str| with("2").records(&["records", "list", "--topic", topic]);
    let watched = || {
        let rows = list(&with("2").json(&["topics", "list"]), "topics");
        rows.iter().filter(|row| row["watched"] == true).map(|row| text(row, "topic")).collect::<Vec<_>>()
    };
    with("1").enrol();
    for size in SIZES {
        let mut operator = Operator::opens(&with("1"), size);
        operator.sees("Overview").presses("2").sees(TOPIC).presses(":watch /robot*/odom");
        operator.reads("Commands", "Watch what matches, also topics that come later").presses("\r");
        operator.sees_row(&[TOPIC, "watched"]).leaves();

        let before = of(OTHER).len();
        let mut operator = Operator::opens(&with("2"), size);
        operator.sees("Overview").presses("2").sees_row(&[OTHER, "watched"]);
        wait_until(PATIENCE, "what the other robot says is verified", || {
            let records = of(OTHER);
            (records.len() > before && records.iter().any(is_verified)).then_some(())
        });
        assert_eq!(watched(), [TOPIC, OTHER]);
        operator.presses(":unwatch /robot*/odom").reads("Commands", "Stop watching what matches").presses("\r");
        wait_until(PATIENCE, "nothing to be watched", || watched().is_empty().then_some(()));
        operator.leaves();
    }
}

#[test]
fn a_wiped_chain_is_one_alert_that_begins_with_its_remedy() {
    let _alone = heavy();
    let Some(node) = Anvil::start(&[]) else { skipped!("no anvil; tests/run installs it into target/peers") };
    let home = Home::new();
    let authros = home.authros().with(&["--chain", &node.http(), "--robots", "1"]);
    let _site = authros.serve(&home);
    authros.capture(&[TOPIC], 3);
    let operators = SIZES.map(|size| {
        let owner = home.profile(&format!("owner{}", size.0));
        owner.enrol();
        let mut operator = Operator::opens(&owner, size);
        operator.sees("embedded master");
        operator
    });
    let _node = node.kill_and_start_empty(&[]);
    for mut operator in operators {
        operator.sees_row(&["chain", "start the pinned chain, or", "--home NEW records import"]).presses("\r");
        operator.reads("Alerts", "chain: start the pinned chain, or `authros --home NEW records import OLD`");
        operator.reads("Alerts", "anchoring is paused, records are safe");
        let alerts = operator.popup("Alerts");
        assert_eq!(alerts.matches("since 20").count(), 1, "one cause, one alert: {alerts}");
        // What was registered on the old one is not said to be missing.
        operator.presses("q").no_longer_sees("┌ Alerts").presses("5").sees("can read new records now").presses("g");
        operator.reads("Grant", "start all records, of every epoch").presses("\u{1b}").no_longer_sees("┌ Grant");
        operator.presses("6").sees("unknown until the chain answers");
    }
}

#[test]
fn a_clock_two_days_off_is_one_alert_that_begins_with_its_remedy() {
    let home = Home::new();
    let offset = home.file("offset", "+0\n", 0o600);
    let set = |to: &str| fs::write(&offset, format!("{to}\n")).expect("the clock is set");
    let authros = home.authros().with(&["--robots", "1"]);
    let Some(authros) = clock::shifted_by_file(&authros, &offset) else { skipped!(NO_FAKETIME) };
    let _site = authros.serve(&home);
    for size in SIZES {
        let owner = authros.with(&["--profile", &format!("owner{}", size.0)]);
        owner.enrol();
        let mut operator = Operator::opens(&owner, size);
        operator.sees("Overview").presses("1").sees("embedded master");
        for (to, jumped) in [("+2d", "it jumped 2 d ahead"), ("-2d", "it jumped 2 d back")] {
            set(to);
            operator.sees_row(&["clock", "run `timedatectl set-ntp true` if it is wrong", jumped]).presses("\r");
            let told = format!("{jumped}, and is not used until it has been stable for 30 s");
            operator.reads("Alerts", &format!("clock: run `timedatectl set-ntp true` if it is wrong: {told}"));
            let alerts = operator.popup("Alerts");
            let now = |alert: &&str| alert.contains("timedatectl") && !alert.contains("resolved");
            assert_eq!(alerts.split('◐').filter(now).count(), 1, "one cause, one alert: {alerts}");
            operator.presses("q").no_longer_sees("┌ Alerts");
            set("+0");
            // By the clock two days passed without a key.
            operator.no_longer_sees("clock ◐").sees("LOCKED");
        }
        operator.sees("locked: by this machine's clock").leaves();
    }
}

#[test]
fn a_revoked_robot_says_who_revoked_it_and_what_helps() {
    let site = Site::new();
    let alice = site.owner("alice");
    let owner = text(&alice.json(&["identity", "show"]), "address");
    for size in SIZES {
        let name = format!("scout-{}", size.0);
        let robot = Robot::enrol(&site, &alice, &name, &[TOPIC]);
        let mut screen = robot.shows(size);
        screen.sees_broken("lost 0; gateway: connected");
        alice.json(&["robot", "revoke", &name]);
        screen.sees_broken(&format!("gateway: {owner} revoked this robot at 20"));
        screen.sees_broken("ask that owner to enrol it again (`authros robot enrol`)").presses("\u{3}");
        screen.sees_broken("ended: stopped on request").is_gone();
        let mut operator = Operator::opens(&alice, size);
        operator.sees("Overview").presses("8").sees("the owner revoked this robot").leaves();
    }
    // What it brought after the revoke has left its batches, whose anchors are proven all the same.
    let health = list(&alice.json(&["status"]), "health");
    let proofs = health.iter().find(|part| part["part"] == "proofs").expect("proofs are kept");
    assert!(proofs["level"] == "ok" && !text(proofs, "text").contains("none"), "{proofs}");
}

/// Ends a process that outlives its parents, also if the test fails.
struct Ended(String);

impl Drop for Ended {
    fn drop(&mut self) {
        support::process::signal("KILL", &self.0);
    }
}

/// Leaves the site running, up to the question for the passphrase. One asked before is still on the screen.
fn is_asked_before_leaving(operator: &mut Operator) -> &mut Operator {
    let questions = |operator: &Operator| String::from_utf8_lossy(&operator.0.raw()).matches("enter alone").count();
    let before = questions(operator);
    operator.presses("q").sees("leave it running").presses("s");
    wait_until(PATIENCE, "the question", || Some(()).filter(|()| questions(operator) > before));
    operator
}

#[test]
fn a_site_is_left_running_in_the_consoles_place() {
    let _alone = heavy();
    for size in SIZES {
        let home = Home::new();
        let authros = locked_profile(&home);
        let count = || records(&authros).len();
        let mut operator = Operator::opens(&authros, size);
        operator.sees("Unlock the keyring").presses(PASSPHRASE).presses("\r").sees("HOST").no_longer_sees("LOCKED");
        operator.presses("2").sees(CAMERA).presses("/odom\r").no_longer_sees(CAMERA).presses("w").sees("watched");
        wait_until(PATIENCE, "a first record", || (count() > 0).then_some(()));
        // Neither wrong passphrases nor none end anything: the console comes back, and the site captures all the time.
        for keys in ["a wrong guess\ra wrong guess\ra wrong guess\r", "\r", "half a secret\u{3}"] {
            let before = count();
            is_asked_before_leaving(&mut operator)
                .presses(keys)
                .sees("the site continues in this console")
                .sees("HOST");
            operator.sees("watched");
            wait_until(PATIENCE, "more records", || (count() > before).then_some(()));
        }
        // A wrong one, and the right one typed while that is tried.
        is_asked_before_leaving(&mut operator).presses(&format!("another passphrase\r{PASSPHRASE}\r"));
        operator.sees("serving").sees("stop it with: kill -INT").is_gone();
        let shown = operator.0.shown();
        for typed in [PASSPHRASE, "another passphrase", "a wrong guess", "half a secret"] {
            assert!(!support::holds(&operator.0.raw(), typed.as_bytes()), "'{typed}' was shown:\n{shown}");
        }
        let process = shown.split("kill -INT ").nth(1).and_then(|rest| rest.split_whitespace().next());
        let ended = Ended(process.expect("a process").to_owned());
        // The terminal is closed; the site is in no session of it, and captures.
        drop(operator);
        let line = fs::read(format!("/proc/{}/cmdline", ended.0)).expect("it runs");
        assert!(!support::holds(&line, PASSPHRASE.as_bytes()), "no passphrase among the arguments");
        let before = count();
        wait_until(PATIENCE, "more records", || (count() > before).then_some(()));
        // A second one is refused, in words.
        let refused = authros.run(&["serve", "--detach"]).expect_code(7);
        assert!(refused.stderr.contains("already running"), "{}", refused.stderr);
        support::process::signal("INT", &ended.0);
        wait_until(PATIENCE, "the site to end", || home.socket().is_none().then_some(()));
        // Nothing acknowledged was lost on the way: what is there is whole.
        authros.run(&["audit", "--deep"]).expect_code(0);
    }
}

/// Robots named by two digits; several are enrolled at a time.
fn enrolled(site: &Site, alice: &Authros, robots: usize) -> Vec<Robot> {
    let numbers: Vec<usize> = (1..=robots).collect();
    let enrol = |number: &usize| Robot::enrol(site, alice, &format!("scout-{number:02}"), &[TOPIC]);
    std::thread::scope(|scope| {
        let few = numbers.chunks(robots.div_ceil(6));
        let begun: Vec<_> = few.map(|few| scope.spawn(move || few.iter().map(enrol).collect::<Vec<_>>())).collect();
        begun.into_iter().flat_map(|few| few.join().expect("enrolled")).collect()
    })
}

#[test]
fn thirty_robots_are_a_row_each_and_everything_of_one_is_a_grant() {
    let _alone = heavy();
    let site = Site::new();
    let alice = site.owner("alice");
    enrolled(&site, &alice, 30)[16].brings("3");
    let all = wait_until(PATIENCE, "what it brought is verified", || {
        let all = records(&alice);
        (all.len() >= 3 && all.iter().all(is_verified)).then_some(all)
    });
    for (number, size) in (1..).zip(SIZES) {
        let mut operator = Operator::opens(&alice, size);
        operator.sees("Overview").presses("8").sees("Robots and senders").presses("/\u{15}\r").sees("30 of 30");
        for (tens, robots) in [(0, 9), (1, 10), (2, 10), (3, 1)] {
            operator.presses(&format!("/\u{15}scout-{tens}\r")).sees(&format!("{robots} of 30"));
            let rows = |shown: &str| {
                let words = shown.split_whitespace().filter(|word| word.starts_with(&format!("scout-{tens}")));
                words.filter(|word| word.len() == 8).map(str::to_owned).collect::<BTreeSet<_>>()
            };
            wait_until(PATIENCE, "a row for each", || (rows(&operator.0.shown()).len() == robots).then_some(()));
        }
        operator.presses("/\u{15}scout-17\r").sees_row(&["▌", "scout-17"]).presses("\r").reads("Robot scout-17", TOPIC);
        operator.presses("q").no_longer_sees("┌ Robot").presses("g").reads("Grant", "robot:scout-17");
        let reader = site.home.profile(&format!("reader{number}"));
        let address = reader.enrol();
        operator.presses(&format!("{address}\r\rfriday 18:00 UTC\rstart\r"));
        operator.reads("Grant this?", &format!("Topics {TOPIC} Records since"));
        operator.reads("Grant this?", &format!("{} records", all.len())).reads("Grant this?", "18:00:00 UTC");
        operator.presses("y").no_longer_sees("┌ Grant");
        let is_open = || (opened(&reader) == ids(&all)).then_some(());
        wait_until(PATIENCE, "the reader to open what it brought", is_open);
        operator.leaves();
    }
}
