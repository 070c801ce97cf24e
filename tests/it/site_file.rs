//! A site in one file: a dump from one home makes another one behave the same, and contains nothing that others may not
//! read.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::alerts::Webhook;
use crate::support;

use std::fs;

use serde_json::Value;
use support::{Home, is_verified, list, text, wait_until};

const INPUT: i32 = 3;
const DIFFERS: i32 = 8;
const BOB: &str = "0x5aAeb6053F3E94C9b9A09f33669435E7Ef1BeAed";
const DRIVER: &str = "/driver@127.0.0.1:std_msgs/String:992ce8a1687cec8c8bd883ec73ca41d1";
const WATCHED: &str = "/robot1/odom";

/// Puts `config.toml` into a home.
fn settings(home: &Home, text: &str) {
    fs::create_dir_all(home.path()).expect("the home");
    home.file("site/config.toml", text, 0o600);
}

fn dump(home: &Home) -> String {
    home.authros().run(&["config", "dump"]).expect_code(0).stdout
}

fn rules(home: &Home) -> Vec<(Value, Value)> {
    let view = home.authros().json(&["topics", "policy"]);
    let rules = list(&view, "topics").into_iter().map(|row| (row["topic"].clone(), row["rule"].clone()));
    let without_line = |(topic, mut rule): (Value, Value)| {
        rule.as_object_mut().map(|rule| rule.remove("line"));
        (topic, rule)
    };
    rules.map(without_line).collect()
}

#[test]
fn a_site_is_dumped_and_another_home_behaves_alike() {
    let (first, second) = (Home::new(), Home::new());
    let webhook = Webhook::start(0);
    settings(
        &first,
        &format!(
            "# by hand\nrobots = 1\nretention = \"{WATCHED}=1s\"\n[crypto]\nsm4_kernel = \"portable\"\n\
             [alerts]\nwebhook = \"{}\"\nevery = 1\ndisk = \"1000000GiB\"\n\
             [[topic]]\nmatch = \"/robot*/odom\"\nevery = 2\ntags = {{ mission = \"harbour\" }}\n",
            webhook.url()
        ),
    );
    let authros = first.authros();
    authros.enrol();
    for command in [
        &["topics", "watch", WATCHED, "--type", "nav_msgs/Odometry"][..],
        &["topics", "watch", "/nobody/there"],
        &["topics", "pin", "/other", "--publisher", DRIVER],
        &["contacts", "add", "bob", BOB, "--fingerprint", "0011 2233 4455 6677 8899 aabb ccdd eeff"],
        &["gateway", "admit", "bob"],
    ] {
        authros.run(command).expect_code(0);
    }
    let dumped = dump(&first);
    let passphrase = fs::read_to_string(first.path().join("profiles/default/passphrase")).expect("a passphrase");
    assert!(!dumped.contains(passphrase.trim()) && !dumped.contains("sm4_kernel ="), "{dumped}");
    assert!(dumped.contains("# crypto.sm4_kernel is not included"), "{dumped}");
    let file = first.file("site.toml", &dumped, 0o600);

    let other = second.authros();
    other.enrol();
    settings(&second, "[crypto]\nsm4_kernel = \"portable\"\n[console]\nmouse = \"yes\"\n");
    let before = dump(&second);
    let shown = other.run(&["config", "apply", &file, "--check"]).expect_code(DIFFERS).stdout;
    for line in ["~ robots: 4 -> 1", "~ console.mouse: yes -> no", "+ watch /robot1/odom, only nav_msgs/Odometry"] {
        assert!(shown.lines().any(|shown| shown == line), "no '{line}':\n{shown}");
    }
    assert_eq!(dump(&second), before, "looking changes nothing");
    let applied = other.run(&["config", "apply", &file]).expect_code(0);
    assert_eq!(applied.stdout, shown, "what was told is what is done");
    assert_eq!(dump(&second), dumped);
    let config = second.path().join("config.toml");
    let written = fs::read_to_string(&config).expect("the settings");
    assert!(written.contains("sm4_kernel = \"portable\"") && !written.contains("mouse"), "{written}");
    assert!(fs::read_to_string(config.with_extension("toml.before")).expect("kept").contains("mouse"));
    let again = other.json(&["config", "apply", &file]);
    assert!(list(&again, "differences").is_empty(), "{again}");
    assert_eq!(fs::read_to_string(&config).expect("the settings"), written);
    other.run(&["config", "apply", &file, "--check"]).expect_code(0);

    // It watches, samples, tags, deletes and alerts like the first one.
    let site = other.serve(&second);
    wait_until(60, "a disk alert at the webhook", || webhook.told("begun", "disk").pop());
    wait_until(120, "a watched topic is captured and deleted by its retention", || {
        let records = other.records(&["uploads", "list", "--topic", WATCHED, "--tag", "mission=harbour"]);
        records.iter().any(|record| record["state"] == "deleted").then_some(())
    });
    let left_out = wait_until(60, "every second message is left out", || {
        let topics = list(&other.json(&["topics", "policy"]), "topics");
        let row = topics.into_iter().find(|row| row["topic"] == WATCHED)?;
        row["left_out"].as_u64().filter(|left_out| *left_out > 0)
    });
    assert!(left_out > 0);
    let of_second = rules(&second);
    site.stop("INT", 60).expect_code(0);
    let site = authros.serve(&first);
    let of_first = wait_until(30, "the topics of the first site", || {
        Some(rules(&first)).filter(|rules| rules.len() == of_second.len())
    });
    assert_eq!(of_first, of_second);
    site.stop("INT", 60).expect_code(0);
}

#[test]
fn a_file_for_others_holds_no_secret_and_nothing_unknown() {
    let home = Home::new();
    settings(&home, "[vault]\nurl = \"redis://me:hunter2@127.0.0.1:1\"\n");
    let dumped = dump(&home);
    assert!(dumped.contains("# vault.url is not included") && !dumped.contains("hunter2"), "{dumped}");
    let dumped = home.file("dumped.toml", dumped, 0o600);
    assert_eq!(home.authros().run(&["config", "apply", &dumped]).expect_code(0).stdout.trim(), "no differences");
    for (line, text) in [
        (2, "[vault]\nurl = \"redis://me:hunter2@127.0.0.1:1\"\n"),
        (3, "\n[keys]\npassphrase = \"hunter2\"\n"),
        (4, "[[watch]]\ntopic = \"/a\"\n\nkind = \"x\"\n"),
    ] {
        let file = home.file("site.toml", text, 0o600);
        let message = home.authros().fails(INPUT, &["config", "apply", &file]);
        let place = format!("site.toml line {line}");
        assert!(message.contains(&place) && !message.contains("hunter2"), "{message}");
    }
    // Anyone who may write a file that names a program could run it as this user.
    let file = home.file("site.toml", "[alerts]\ncommand = [\"/bin/true\"]\n", 0o622);
    assert!(home.authros().fails(INPUT, &["config", "apply", &file]).contains("chmod go-w"));
    home.authros().fails(INPUT, &["config", "apply", "/not/there"]);
    assert!(!home.path().join("ledger.db").exists(), "nothing was made on the way");
}

#[test]
fn decisions_that_a_file_leaves_out_stay_and_those_it_empties_go() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "0"]);
    authros.enrol();
    authros.run(&["topics", "watch", "/a"]).expect_code(0);
    authros.run(&["contacts", "add", "bob", BOB]).expect_code(0);
    let file = home.file("site.toml", "confirmations = 2\nwatch = []\n", 0o600);
    let told = authros.run(&["config", "apply", &file]).expect_code(0).stdout;
    assert_eq!(told.lines().collect::<Vec<_>>(), ["~ confirmations: 1 -> 2", "- watch /a"]);
    let contacts = list(&authros.json(&["contacts", "list"]), "contacts");
    assert_eq!(contacts.iter().map(|row| text(row, "name")).collect::<Vec<_>>(), ["bob"]);
    authros.run(&["config", "apply", &file, "--check"]).expect_code(0);
    assert!(authros.records(&["uploads", "list"]).iter().all(is_verified));
}
