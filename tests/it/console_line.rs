//! The console over a bad line: 4 kB/s, 300 ms for a round trip, 40 records a second. How long a key takes is printed,
//! not judged.
#![allow(
    clippy::expect_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "a test fails by panicking, a measurement prints"
)]

use crate::support;

use std::time::{Duration, Instant};

use support::{Console, Home, Terminal, heavy, long, poll, wait_until};

/// Bytes a second.
const RATE: u32 = 4_000;
const ROUND_TRIP: Duration = Duration::from_millis(300);
/// Presses of each kind; a few are enough to show that every key is answered.
const FEW: usize = 3;
const MANY: usize = 40;

/// The line of the screen on which the cursor is.
fn cursor(console: &Console) -> Option<usize> {
    console.shown().lines().position(|line| line.starts_with('▌'))
}

/// Presses the key and waits until the screen holds what it should; how long that took.
fn answered(console: &mut Console, key: &str, holds: impl Fn(&Console) -> bool) -> Duration {
    // At a moment of its own between two frames for data.
    let pause = 700 + u64::from(console.bytes().to_le_bytes()[0]) * 2;
    std::thread::sleep(Duration::from_millis(pause));
    let begin = Instant::now();
    console.press(key);
    let end = begin + Duration::from_secs(60);
    while !holds(console) {
        assert!(Instant::now() < end, "no answer to {key:?}:\n{}", console.shown());
        std::thread::sleep(Duration::from_millis(2));
    }
    begin.elapsed()
}

/// Moves the cursor down and up again.
fn moves(console: &mut Console, down: &str, up: &str, times: usize) -> Vec<Duration> {
    (0..times)
        .map(|round| {
            let before = wait_until(60, "a cursor", || cursor(console));
            let key = if round % 2 == 0 { down } else { up };
            answered(console, key, |console| cursor(console).is_some_and(|line| line != before))
        })
        .collect()
}

fn print(what: &str, mut took: Vec<Duration>) {
    took.sort();
    let at = |share: usize| took.get(((took.len() - 1) * share).div_ceil(100)).map_or(0, Duration::as_millis);
    eprintln!("{what}: {} keys, median {} ms, p95 {} ms, worst {} ms", took.len(), at(50), at(95), at(100));
}

#[test]
fn every_key_is_answered_over_a_bad_line_while_forty_records_a_second_arrive() {
    let _alone = heavy();
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "2"]);
    authros.enrol();
    for topic in ["/robot1/odom", "/robot2/odom"] {
        authros.run(&["topics", "watch", topic]).expect_code(0);
    }
    let authros = authros.with_variable("SSH_CONNECTION", "192.0.2.1 50000 192.0.2.2 22");
    let line = Terminal { bytes_per_second: Some(RATE), round_trip: Some(ROUND_TRIP), ..Terminal::of(80, 24) };
    let mut console = Console::open_in(&line, &authros, &[]);
    let times = if long() { MANY } else { FEW };
    console.wait_for("captured", 60);

    let mut screens = Vec::new();
    for round in 0..times {
        let (key, shown) = [("2", "Watched"), ("3", "Records  "), ("1", "captured ")][round % 3];
        screens.push(answered(&mut console, key, |console| console.shown().contains(shown)));
    }
    console.press("2");
    console.wait_for("Watched", 60);
    let topics = moves(&mut console, "j", "k", times);
    let letters = (0..times).map(|round| {
        if round == 0 {
            console.press("/");
            console.wait_for("filter:", 60);
        }
        // Letters of a word that every record has.
        let typed: String = "odometry".chars().cycle().take(round % 8 + 1).collect();
        let key = typed.chars().last().map(String::from).unwrap_or_default();
        if round > 0 && round % 8 == 0 {
            console.press("\u{15}");
            let emptied = |console: &Console| !console.shown().contains("filter: o");
            assert!(poll(60, || emptied(&console).then_some(())).is_some());
        }
        answered(&mut console, &key, |console| console.shown().contains(&format!("filter: {typed}")))
    });
    let letters: Vec<Duration> = letters.collect();
    console.press("\u{1b}");
    console.press("\u{1b}");
    console.press("3");
    console.wait_for("newest first", 60);
    wait_until(60, "records to come", || cursor(&console).map(drop));
    let before = console.bytes();
    let begin = Instant::now();
    let uploads = moves(&mut console, "j", "\u{1b}[H", times);
    let rate = f64::from(u32::try_from(console.bytes() - before).unwrap_or(u32::MAX)) / begin.elapsed().as_secs_f64();

    eprintln!("line of {RATE} B/s, round trip {} ms; {rate:.0} B/s on Records", ROUND_TRIP.as_millis());
    print("cursor on Topics", topics.clone());
    print("cursor on Records", uploads.clone());
    print("letter of a filter on Topics", letters.clone());
    print("cursor and letters together", [topics, uploads, letters].concat());
    print("another screen", screens);
    console.signal("TERM");
    console.wait(30);
}
