//! The command line: exit codes by kind of error, clear messages, and standard output only for the result.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::fs;
use std::net::TcpListener;

use serde_json::Value;
use support::{Authros, Console, Home, free_port, list, text};

/// Exit codes by kind of error.
const USAGE: i32 = 2;
const INPUT: i32 = 3;
const UNREACHABLE: i32 = 4;
const REFUSED: i32 = 5;
const HOME: i32 = 7;
const INCOMPLETE: i32 = 8;

fn quiet(home: &Home) -> Authros {
    home.authros().with(&["--robots", "0"])
}

fn setting(authros: &Authros, name: &str) -> Value {
    let shown = authros.json(&["config", "show"]);
    list(&shown, "settings").into_iter().find(|setting| setting["name"] == name).expect("the setting is shown")
}

#[test]
fn a_wrong_call_is_a_usage_error_and_prints_no_result() {
    let home = Home::new();
    for arguments in [
        &["fly"][..],
        &["capture"],
        &["capture", "--fast"],
        &["keys", "load"],
        &["grant", "add"],
        &["tour", "--seconds", "4"],
    ] {
        let outcome = home.authros().run(arguments).expect_code(USAGE);
        assert!(outcome.stdout.is_empty() && !outcome.stderr.is_empty(), "{outcome}");
        let outcome = home.authros().with(&["--json"]).run(arguments).expect_code(USAGE);
        let document: Value = serde_json::from_str(&outcome.stdout).expect("one document");
        assert_eq!(document["error"]["kind"], "usage", "{outcome}");
    }
    assert!(!home.path().exists(), "and makes no home");
}

#[test]
fn help_and_version_need_no_home() {
    let home = Home::new();
    let help = home.authros().run(&["--help"]).expect_code(0);
    for verb in
        ["identity", "keys", "topics", "capture", "records", "grant", "received", "robot", "tour", "serve", "help"]
    {
        assert!(help.stdout.contains(verb), "{verb}: {help}");
    }
    let options = home.authros().run(&["help", "options"]).expect_code(0);
    assert!(options.stdout.contains("--passphrase-file") && !help.stdout.contains("--passphrase-file"), "{options}");
    let grant = home.authros().run(&["help", "grant"]).expect_code(0);
    assert!(grant.stdout.contains("authros grant add bob --from now"), "{grant}");
    let own = home.authros().run(&["help", "grant", "add"]).expect_code(0);
    assert_eq!(own.stdout, home.authros().run(&["grant", "add", "-h"]).expect_code(0).stdout);
    home.authros().run(&["help", "fly"]).expect_code(USAGE);
    let version = home.authros().run(&["--version"]).expect_code(0);
    assert_eq!(version.stdout.trim(), concat!("authros ", env!("CARGO_PKG_VERSION")));
    assert!(!home.path().exists());
}

#[test]
fn an_invalid_topic_name_is_bad_input() {
    let home = Home::new();
    for topic in ["robot1/odom", "/robot 1", "/a//b", "/\u{202e}mod", ""] {
        let message = quiet(&home).fails(INPUT, &["capture", "--topic", topic, "--count", "1"]);
        assert!(message.contains("topic"), "{message}");
        assert!(!message.contains('\u{202e}'), "shown through the sanitiser: {message}");
    }
    quiet(&home).fails(INPUT, &["capture", "--topic", "/a", "--type", "Odometry", "--count", "1"]);
    quiet(&home).fails(INPUT, &["capture", "--topic", "/a", "--for", "soon"]);
}

#[test]
fn a_topic_never_seen_is_incomplete_with_nothing_captured() {
    let home = Home::new();
    let outcome = quiet(&home).with(&["--json"]).run(&["capture", "--topic", "/nobody/here", "--for", "2s"]);
    let summary = outcome.expect_code(INCOMPLETE).document();
    for field in ["captured", "verified", "lost", "skipped"] {
        assert_eq!(summary[field], 0, "{field}: {summary}");
    }
    let topics = list(&summary, "topics");
    assert_eq!((topics.len(), &topics[0]["topic"]), (1, &"/nobody/here".into()), "{summary}");
}

#[test]
fn a_bad_address_is_bad_input() {
    let home = Home::new();
    quiet(&home).enrol();
    for address in ["0x12", "alice", "0x5aAeb6053F3E94C9b9A09f33669435E7Ef1Beaed"] {
        for verb in ["add", "end"] {
            let message = quiet(&home).fails(INPUT, &["grant", verb, address]);
            assert!(message.contains("address"), "{message}");
        }
    }
}

#[test]
fn a_grantee_who_is_not_registered_is_refused() {
    let home = Home::new();
    quiet(&home).enrol();
    let stranger = "0x5aAeb6053F3E94C9b9A09f33669435E7Ef1BeAed";
    let message = quiet(&home).fails(REFUSED, &["grant", "add", stranger]);
    assert!(message.contains("regist"), "{message}");
    assert!(list(&quiet(&home).json(&["grant", "list"]), "grants").is_empty());
}

#[test]
fn key_files_of_wrong_length_or_open_to_others_are_refused_and_change_nothing() {
    let home = Home::new();
    let authros = quiet(&home);
    authros.enrol();
    let before = authros.json(&["keys", "list"]);
    let short = home.file("short", [7; 15], 0o600);
    let long = home.file("long", [7; 17], 0o600);
    let open = home.file("open", [7; 16], 0o644);
    let absent = home.root().join("absent");
    let absent = absent.to_str().expect("UTF-8").to_owned();
    let zero = home.file("zero", "0".repeat(64), 0o600);
    for (flag, file) in [("--sm4", &short), ("--sm4", &long), ("--sm4", &open), ("--sm4", &absent), ("--sm2", &zero)] {
        authros.fails(INPUT, &["keys", "load", flag, file]);
    }
    home.profile("fresh").with(&["--robots", "0"]).fails(INPUT, &["keys", "load", "--eoa", &zero]);
    assert!(authros.fails(INPUT, &["keys", "load", "--sm4", &short]).contains("16"), "says how long it must be");
    assert!(authros.fails(INPUT, &["keys", "load", "--sm4", &open]).contains("600"), "says which mode it must have");
    assert_eq!(authros.json(&["keys", "list"]), before);
}

#[test]
fn a_peer_that_is_set_but_does_not_answer_is_never_replaced_by_an_embedded_part() {
    let closed = free_port();
    let mute = TcpListener::bind("127.0.0.1:0").expect("a listener that never answers");
    let mute = mute.local_addr().expect("its address").port();
    // All at once: each waits until its patience ends.
    let mut waiting = Vec::new();
    for port in [closed, mute] {
        for flag in ["--ros-master", "--chain"] {
            let (home, url) = (Home::new(), format!("http://127.0.0.1:{port}"));
            let capture = ["capture", "--topic", "/a", "--count", "1", flag, &url, "--json"];
            waiting.push((home.authros().spawn(&capture), home, port));
        }
    }
    for (capture, _home, port) in waiting {
        let outcome = capture.wait(120).expect_code(UNREACHABLE);
        let message = text(&outcome.document()["error"], "message");
        assert!(message.contains(&port.to_string()), "names the peer at {port}: {message}");
    }
    let home = Home::new();
    home.authros().json(&["identity", "create"]);
    let socket = home.root().join("no.ipc");
    home.authros().fails(UNREACHABLE, &["chain", "status", "--chain", socket.to_str().expect("UTF-8")]);
}

#[test]
fn a_home_that_cannot_be_written_is_said() {
    let home = Home::new();
    let file = home.file("file", "", 0o600);
    for place in [format!("{file}/site"), "/proc/authros".to_owned()] {
        let message = Authros::bare(home.root()).fails(HOME, &["identity", "create", "--home", &place]);
        assert!(message.contains(&place), "{message}");
    }
}

#[test]
fn a_profile_name_is_no_path() {
    let home = Home::new();
    for name in ["../x", "A", "a/b", ""] {
        quiet(&home).fails(INPUT, &["identity", "create", "--profile", name]);
    }
    assert!(!home.path().join("x").exists() && !home.root().join("x").exists());
}

#[test]
fn settings_come_from_flag_then_environment_then_file() {
    let home = Home::new();
    fs::create_dir(home.path()).expect("the home");
    fs::write(home.path().join("config.toml"), "[ros]\nmaster = \"http://file:1\"\n").expect("the settings");
    let from_file = home.authros();
    assert_eq!(setting(&from_file, "ros.master")["value"], "http://file:1");
    let from_environment = from_file.with_variable("ROS_MASTER_URI", "http://environment:2");
    assert_eq!(setting(&from_environment, "ros.master")["value"], "http://environment:2");
    let from_flag = from_environment.with(&["--ros-master", "http://flag:3"]);
    assert_eq!(setting(&from_flag, "ros.master")["value"], "http://flag:3");
    let sources =
        [&from_file, &from_environment, &from_flag].map(|authros| text(&setting(authros, "ros.master"), "source"));
    assert_eq!(sources, ["config.toml line 2", "environment ROS_MASTER_URI", "flag"]);
    assert_eq!(setting(&from_file, "cache.url")["source"], "default");
}

#[test]
fn a_wrong_settings_file_is_named_with_its_line() {
    let home = Home::new();
    fs::create_dir(home.path()).expect("the home");
    home.authros().run(&["config", "check"]).expect_code(0);
    for (settings, place) in
        [("robots = 1\n[ros]\nmastr = \"x\"\n", "line 3"), ("robots = 99\n", "line 1"), ("robots = \n", "line 1")]
    {
        fs::write(home.path().join("config.toml"), settings).expect("the settings");
        let message = home.authros().fails(INPUT, &["config", "check"]);
        assert!(message.contains("config.toml") && message.contains(place), "{message}");
    }
    let theme = home.authros().with_variable("AUTHROS_THEME", "dusk");
    fs::write(home.path().join("config.toml"), "").expect("the settings");
    let message = theme.fails(INPUT, &["config", "check"]);
    assert!(message.contains("'dusk'") && message.contains("night, day, contrast, mono"), "{message}");
}

#[test]
fn without_a_terminal_the_console_names_what_works_without_one() {
    let home = Home::new();
    let outcome = home.authros().run(&[]).expect_code(USAGE);
    for verb in ["tour --plain", "capture", "serve"] {
        assert!(outcome.stderr.contains(verb), "{outcome}");
    }
    assert!(outcome.stdout.is_empty() && !home.path().exists(), "{outcome}");
}

#[test]
fn a_second_console_of_the_same_profile_is_refused_and_another_profile_joins() {
    let home = Home::new();
    let mut first = Console::open(&home.authros().with(&["--robots", "1"]));
    first.wait_for("/robot1/odom", 30);
    let mut second = Console::open(&home.authros());
    let ended = second.wait(30);
    assert_eq!(ended.exit_code(), u32::try_from(HOME).expect("small"), "{}", second.shown());
    second.expect_restored();

    let bob = home.profile("bob");
    bob.enrol();
    bob.capture(&["/robot1/odom"], 3);
    assert!(first.shown().contains("/robot1/odom"), "the first goes on");
}

#[test]
fn serve_waits_for_a_command_that_is_the_site_until_it_ends_and_not_for_a_site() {
    let home = Home::new();
    quiet(&home).json(&["identity", "create"]);
    let follower = quiet(&home).spawn(&["records", "list", "--follow"]);
    support::wait_until(30, "it is the site", || home.socket());
    // With other settings than the command has, which nobody joins.
    let authros = home.authros().with(&["--robots", "1"]);
    let mut site = authros.spawn(&["serve"]);
    site.wait_for_text("waiting up to", 30);
    assert!(!site.stdout().contains("serving"), "{}", site.stdout());
    follower.stop("INT", 30).expect_code(0);
    site.wait_for_text("stop it with Ctrl-C", 60);
    let told = authros.fails(HOME, &["serve"]);
    assert!(told.contains("already running"), "{told}");
    site.stop("INT", 30).expect_code(0);
}

#[test]
fn with_json_every_answer_is_one_document_and_without_it_text() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1"]);
    let _site = authros.serve(&home);
    authros.enrol();
    authros.capture(&["/robot1/odom"], 2);
    for command in [
        &["identity", "show"][..],
        &["keys", "list"],
        &["topics", "list"],
        &["records", "list", "--oldest"],
        &["grant", "list"],
        &["received", "list", "--oldest"],
        &["chain", "status"],
        &["config", "show"],
        &["identity", "register"],
    ] {
        assert!(authros.json(command).is_object(), "{command:?}");
        let plain = authros.run(command).expect_code(0);
        assert!(serde_json::from_str::<Value>(&plain.stdout).is_err(), "text for people: {plain}");
        assert!(!plain.stdout.contains('\u{1b}'), "no escape codes without a terminal: {plain}");
    }
}

#[test]
fn topics_and_chain_are_described_in_the_promised_fields() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "2"]);
    let _site = authros.serve(&home);
    let address = authros.enrol();
    let topics = support::wait_until(30, "both robots publish both topics", || {
        Some(list(&authros.json(&["topics", "list"]), "topics")).filter(|topics| {
            let simulated = topics.iter().filter(|topic| topic["simulated"] == true).count();
            simulated >= 4
        })
    });
    let odometry = topics.iter().find(|topic| topic["topic"] == "/robot2/odom").expect("the second robot's odometry");
    assert_eq!(odometry["type"], "nav_msgs/Odometry");
    assert_eq!(list(odometry, "publishers").len(), 1, "{odometry}");

    let chain = authros.json(&["chain", "status"]);
    assert_eq!(chain["kind"], "embedded");
    assert_eq!(support::unhex(&text(&chain, "genesis")).len(), 32);
    assert!(chain["chain_id"].as_u64().is_some_and(|id| id > 1) && chain["block"].is_u64(), "{chain}");
    assert!(text(&chain, "contract").starts_with("0x") && text(&chain, "contract") != address, "{chain}");
    assert!(chain["nonce"].as_u64() >= Some(1) && chain["pending"] == 0, "{chain}");
    assert!(text(&chain, "balance").chars().all(|digit| digit.is_ascii_digit()), "{chain}");
}

/// The program's memory is closed to other processes of the same user, and leaves no core.
#[test]
fn nobody_else_reads_the_memory() {
    use std::os::unix::fs::MetadataExt;
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "0"]);
    let site = authros.serve(&home);
    let limits = std::fs::read_to_string(format!("/proc/{}/limits", site.id())).expect("it runs");
    let limit = limits.lines().find(|line| line.starts_with("Max core file size")).expect("told");
    assert_eq!(limit.split_whitespace().collect::<Vec<_>>()[4..6], ["0", "0"], "{limit}");
    // For a process that cannot be dumped, everything in /proc belongs to root; to root itself that proves nothing.
    let own = std::fs::metadata("/proc/self").expect("Linux").uid();
    let owner = std::fs::metadata(format!("/proc/{}/mem", site.id())).expect("it runs").uid();
    assert_eq!(owner, 0);
    if own != 0 {
        assert!(std::fs::File::open(format!("/proc/{}/mem", site.id())).is_err());
    }
    drop(site.stop("TERM", 20));
}
