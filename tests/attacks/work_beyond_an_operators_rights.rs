//! A user was given the right to look. With it he grants to himself, begins an epoch, reads, gives himself rights and
//! another name, claims a group, and puts a socket of his own where others connect; then he asks until the log should be
//! full.

use std::fs;
use std::path::Path;

use serde_json::{Value, json};

use crate::judge;
use crate::parts::Parts;
use crate::support::{Accounts, list, skipped, text, wait_until};

const TOPIC: &str = "/robot1/odom";
const REFUSED: i32 = 5;
const TRIES: usize = 200;

#[test]
fn work_beyond_an_operators_rights() {
    let accounts = match Accounts::make(&["keeper", "bob", "eve", "mallory"]) {
        Ok(accounts) => accounts,
        Err(reason) => skipped!(reason),
    };
    let [bob, eve, mallory] = ["bob", "eve", "mallory"].map(|name| accounts.name(name));
    let socket = accounts.folder("run", &accounts.name("keeper"), 0o750).join("operators.sock");
    let rights =
        format!("{{ {bob} = [\"look\"], {eve} = [\"look\", \"grant\"], \"@{}\" = [\"look\"] }}", accounts.group);
    let own = accounts.home("keeper").join("site");
    let keeper = accounts
        .authros("keeper")
        .with(&["--home", own.to_str().expect("UTF-8"), "--robots", "1"])
        .with_variable("AUTHROS_OPERATORS_SOCKET", socket.to_str().expect("UTF-8"))
        .with_variable("AUTHROS_OPERATORS_RIGHTS", &rights);
    let alice = keeper.with(&["--profile", "alice"]);
    let mut site = alice.spawn(&["serve"]);
    site.wait_for_text("serving", 60);
    wait_until(60, "the operators' socket", || socket.exists().then_some(()));
    let reader = keeper.with(&["--profile", "carol"]).enrol();
    alice.capture(&[TOPIC], 1);
    let id = text(&alice.records(&["records", "list", "--oldest"])[0], "id");
    let his = accounts.authros("bob").with(&["--site-socket", socket.to_str().expect("UTF-8"), "--profile", "alice"]);
    assert_eq!(list(&his.json(&["records", "list", "--oldest"]), "records").len(), 1, "looking is his");

    let mut parts = Parts::default();
    let bundle = accounts.home("bob").join("bundle.authros");
    for (words, arguments) in [
        ("needs the right 'grant'", &["grant", "add", &reader][..]),
        ("needs the right 'capture'", &["topics", "watch", TOPIC]),
        ("only the owner", &["keys", "rotate"]),
        ("only the owner", &["evidence", "export", bundle.to_str().expect("UTF-8"), "--reveal", &id]),
        ("only the owner", &["records", "open", &id]),
    ] {
        parts.refused(&arguments.join(" "), &his.fails(REFUSED, arguments), words);
    }
    assert!(!bundle.exists(), "nothing was written");
    // Settings and names of his own.
    let stronger = his
        .with_variable("AUTHROS_OPERATORS_RIGHTS", &rights.replace("[\"look\"]", "[\"look\", \"capture\", \"grant\"]"))
        .with_variable("USER", &eve)
        .with_variable("LOGNAME", &eve);
    parts.refused("rights of his own", &stronger.fails(REFUSED, &["grant", "add", &reader]), "needs the right 'grant'");
    // The kernel's word for a group is not enough: the user database does not know it.
    let said = accounts.line(&mallory, &socket).next().expect("a line");
    match said["refused"]["message"].as_str() {
        Some(refusal) => parts.refused("a claimed group", refusal, "no right at this site"),
        None => parts.reached(format!("the rights of a group: {said}")),
    }
    parts.refused("another socket", &replace(&accounts, &bob, &socket), "Permission denied");

    let mut flood = accounts.line(&bob, &socket);
    let elsewhere = flood.ask("mallory", &json!({ "command": "watch_topic", "topic": TOPIC, "type_name": null }));
    parts.refused("a profile that is not there", &text(&elsewhere["Err"], "message"), "no profile 'mallory'");
    let grant = json!({ "command": "grant", "grantee": reader, "topics": [], "from": "now", "expires": null });
    for _ in 0..TRIES {
        let answer = flood.ask("alice", &grant);
        if answer["Err"]["kind"] != "refused" {
            parts.reached(format!("a grant: {answer}"));
        }
    }
    drop(flood);
    site.stop("INT", 30).expect_code(0);

    let lines = list(&alice.json(&["audit", "list", "--limit", "1000", "--by-operator", &bob]), "audit");
    let tried = |line: &&Value| line["action"] == "refused" && line["subject"] == "needs grant";
    let told = lines.iter().filter(tried).count();
    // One line a minute, however often he asked; the whole takes a few minutes at most.
    if !(1..=10).contains(&told) {
        parts.otherwise(format!("{TRIES} refused grants left {told} lines"));
    }
    assert!(lines.iter().all(|line| line["profile"] == "alice" && line["operator"] == *bob), "{lines:?}");
    assert!(list(&alice.json(&["grant", "list"]), "grants").is_empty(), "nobody reads");
    judge("work_beyond_an_operators_rights", parts.outcome());
}

/// A user, who is in the socket's group, moves it away; what the system says.
fn replace(accounts: &Accounts, user: &str, socket: &Path) -> String {
    let away = socket.with_extension("away");
    let mut command = std::process::Command::new("setpriv");
    command.args(accounts.claims_the_group(user)).args(["--", "mv"]).arg(socket).arg(&away).current_dir("/");
    let said = command.env("LC_ALL", "C").output().expect("it runs");
    assert!(fs::symlink_metadata(socket).is_ok(), "it is still there");
    String::from_utf8_lossy(&said.stderr).into_owned()
}
