//! Shell completion, when there are records of a topic, and who is in a home: the same with and without a site.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::process::Command;

use support::{Console, Home, list, skipped, system_program, text};

const TOPIC: &str = "/robot1/odom";

/// The words of a completion.
fn words(home: &Home, kind: &str, begun: &str) -> Vec<String> {
    let outcome = home.authros().run(&["complete", kind, begun]).expect_code(0);
    outcome.stdout.lines().map(str::to_owned).collect()
}

#[test]
fn names_and_ids_are_completed_a_topic_has_its_coverage_and_a_home_its_identities() {
    let home = Home::new();
    assert!(words(&home, "topic", "/").is_empty() && !home.path().exists(), "looking makes no home");
    let authros = home.authros().with(&["--robots", "1"]);
    authros.capture(&[TOPIC], 5);
    let record = text(&authros.records(&["records", "list", "--oldest"])[0], "id");
    authros.json(&["contacts", "add", "bob", "0x5aAeb6053F3E94C9b9A09f33669435E7Ef1BeAed"]);

    let files = || {
        let mut files = support::authros::files_below(&home.path());
        files.sort();
        files
    };
    let before = files();
    assert_eq!(words(&home, "topic", "/ro"), [TOPIC]);
    assert_eq!(words(&home, "contact", ""), ["bob"]);
    assert_eq!(words(&home, "record", &record[..5]), std::slice::from_ref(&record));
    assert_eq!(words(&home, "profile", "de"), ["default"]);
    assert!(words(&home, "record", "zz").is_empty() && words(&home, "topic", "/none").is_empty());
    assert_eq!(files(), before, "looking leaves nothing behind");

    let coverage = authros.json(&["topics", "coverage", TOPIC, "--parts", "4"]);
    let parts = list(&coverage, "parts");
    assert!((1..=4).contains(&parts.len()), "{coverage}");
    assert_eq!(parts[0]["data"], true, "the first record is where it begins: {coverage}");
    assert!(parts.iter().all(|part| part["quarantined"] == false && part["tampered"] == false), "{coverage}");
    let strip = authros.run(&["topics", "coverage", TOPIC]).expect_code(0);
    assert!(strip.stdout.contains("█ recorded"), "{strip}");
    assert_eq!(authros.json(&["topics", "coverage", "/never/seen"])["first"], serde_json::Value::Null);
    authros.fails(3, &["topics", "coverage", TOPIC, "--since", "1h", "--until", "2h"]);

    let shown = authros.json(&["identity", "show"]);
    let all = list(&authros.json(&["identity", "list"]), "identities");
    assert_eq!(all.len(), 1);
    for field in ["profile", "address", "fingerprint"] {
        assert_eq!(all[0][field], shown[field], "{field}");
    }
}

#[test]
fn bash_completes_a_topic_behind_watch_and_flags_as_ever() {
    let Some(bash) = system_program("bash") else {
        skipped!("there is no bash");
    };
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1"]);
    authros.capture(&[TOPIC], 2);
    let script = home.file("authros.bash", authros.run(&["--print-completions", "bash"]).expect_code(0).stdout, 0o600);
    let folder = authros.program().parent().expect("a folder").display().to_string();
    let complete = |line: &[&str]| {
        let words = line.iter().map(|word| format!("'{word}'")).collect::<Vec<_>>().join(" ");
        let ask = format!(
            "source {script}; COMP_WORDS=({words}); COMP_CWORD={}; _authros_words authros '{}' ''; printf '%s\\n' \"${{COMPREPLY[@]}}\"",
            line.len() - 1,
            line.last().expect("a word"),
        );
        let path = format!("{folder}:{}", std::env::var("PATH").unwrap_or_default());
        let told = Command::new(&bash).args(["--norc", "-c", &ask]).env("PATH", path).output().expect("runs");
        String::from_utf8_lossy(&told.stdout).trim().to_owned()
    };
    let root = home.path().display().to_string();
    assert_eq!(complete(&["authros", "--home", &root, "topics", "watch", "/rob"]), TOPIC);
    assert_eq!(complete(&["authros", "--home", &root, "capture", "--topic", "/rob"]), TOPIC);
    assert!(complete(&["authros", "topics", "wat"]).contains("watch"), "verbs as ever");
}

#[test]
fn the_tour_says_what_to_do_first_and_ends_by_its_key() {
    let home = Home::new();
    let bare = support::Authros::bare(home.root());
    let mut console = Console::open_in(&support::Terminal::of(80, 24), &bare, &["tour", "--robots", "1"]);
    console.wait_for("Tour 1 of 7", 60);
    let screen = console.wait_for(TOPIC, 60);
    assert!(screen.contains("Press n"), "{screen}");
    console.press("E");
    support::wait_until(20, "the strip to go", || Some(()).filter(|()| !console.shown().contains("Tour 1 of 7")));
    console.press("q");
    assert!(console.wait(30).success(), "{}", console.shown());
    console.expect_restored();
}
