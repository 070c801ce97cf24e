//! An incident from the button to its bundle: retention leaves it alone, a backup carries it, and once it is removed
//! its bytes are deleted like others.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::fs;

use serde_json::Value;
use support::{Authros, Home, count, holds, list, text, wait_until};

const INPUT: i32 = 3;
const USAGE: i32 = 2;
const ODOM: &str = "/robot1/odom";
const OTHER: &str = "/robot2/odom";

fn digests(records: &[Value]) -> Vec<String> {
    let mut digests: Vec<String> = records.iter().map(|record| text(record, "digest")).collect();
    digests.sort();
    digests
}

fn is_deleted(authros: &Authros, topic: &str) -> bool {
    let records = authros.records(&["records", "list", "--oldest", "--topic", topic]);
    assert!(!records.is_empty());
    records.iter().all(|record| record["state"] == "deleted")
}

/// Topics of which retention has deleted records, according to the audit log.
fn named(authros: &Authros) -> Vec<String> {
    let lines = list(&authros.json(&["audit", "list", "--action", "retention", "--limit", "1000"]), "audit");
    let named = lines.into_iter().filter(|line| line["outcome"] == "named");
    named.map(|line| text(&line, "subject").split(':').next().expect("a topic").to_owned()).collect()
}

fn hostile_words_are_refused(authros: &Authros) {
    for bad in ["../x", "a b", "", "\u{1b}[2J", "a:b", &"a".repeat(65)] {
        let message = authros.fails(INPUT, &["incident", "open", bad, "--since", "-10m"]);
        assert!(!message.contains('\u{1b}'), "{message:?}");
    }
    let open = |more: &[&str]| authros.fails(INPUT, &[&["incident", "open", "crash"], more].concat());
    assert!(open(&["--since", "2100-01-01"]).contains("is in the future"));
    assert!(open(&["--since", "1m", "--until", "2m"]).contains("before it begins"));
    assert!(open(&["--since", "some day"]).contains("is not a time"));
    open(&["--since", "1m", "--topics", "not a topic"]);
    open(&["--since", "1m", "--note", &"a".repeat(2001)]);
    authros.fails(INPUT, &["incident", "show", "crash"]);
    assert!(list(&authros.json(&["incident", "list"]), "incidents").is_empty(), "nothing was kept of these");
}

#[test]
fn an_incident_is_held_found_exported_carried_by_a_backup_and_let_go() {
    let (home, other) = (Home::new(), Home::new());
    let authros = home.authros().with(&["--robots", "2"]).with_variable("AUTHROS_AUDIT_ANCHOR_EVERY", "86400");
    authros.enrol();
    authros.capture(&[ODOM, OTHER], 3);
    let all = digests(&authros.records(&["records", "list", "--oldest", "--topic", ODOM]));
    hostile_words_are_refused(&authros);

    let note = "hit a \u{1b}[31mwall <b>at bay 3";
    let opened = ["incident", "open", "crash", "--since", "-10m", "--topics", ODOM, "/never/seen", "--note", note];
    let view = authros.json(&opened);
    assert_eq!(
        (view["open"].clone(), count(&view, "records"), view["until"].is_null()),
        (true.into(), 3, true),
        "{view}"
    );
    let told: Vec<(String, u64)> =
        list(&view, "coverage").iter().map(|one| (text(one, "topic"), count(one, "records"))).collect();
    assert_eq!(told, [("/never/seen".to_owned(), 0), (ODOM.to_owned(), 3)], "what is not there is told");
    let people = authros.run(&["incident", "show", "crash"]).expect_code(0).stdout;
    assert!(people.contains("no records of /never/seen in that span") && !people.contains('\u{1b}'), "{people}");
    authros.fails(INPUT, &opened);
    authros.json(&["incident", "open", "second", "--since", "10m", "--topics", ODOM]);
    let found = authros.records(&["records", "list", "--oldest", "--incident", "crash"]);
    assert_eq!(digests(&found), all);
    assert_eq!(authros.records(&["records", "list", "--oldest", "--incident", "crash", "--until", "10m"]).len(), 0);
    authros.fails(INPUT, &["records", "list", "--oldest", "--incident", "none"]);

    let keeps = authros.with_variable("AUTHROS_RETENTION", "/robot*/odom=1s");
    let site = keeps.serve(&home);
    wait_until(120, "what no incident holds is deleted", || is_deleted(&keeps, OTHER).then_some(()));
    assert!(named(&keeps).iter().all(|topic| topic == OTHER), "retention names nothing of the incident");
    let bundle = home.root().join("crash.authros");
    let place = bundle.to_str().expect("UTF-8");
    let exported = keeps.json(&["evidence", "export", place, "--incident", "crash"]);
    assert!(count(&exported, "records") >= 3, "{exported}");
    let report = keeps.with(&["--json"]).run(&["evidence", "verify", place]).expect_code(8).document();
    let proven = list(&report, "records").into_iter().filter(|record| record["bytes"]["standing"] == "proven");
    let proven = digests(&proven.collect::<Vec<_>>());
    assert!(all.iter().all(|digest| proven.contains(digest)), "{report}");
    // Members are stored uncompressed.
    let bytes = fs::read(&bundle).expect("the bundle");
    assert!(holds(&bytes, b"<td>crash</td>") && holds(&bytes, b"wall &lt;b&gt;at bay 3"), "its name and notes");
    assert!(!holds(&bytes, ODOM.as_bytes()), "and no topic by its name");

    keeps.json(&["incident", "note", "crash", "the second note"]);
    let secret = home.file("secret", "a passphrase of its own\n", 0o600);
    let file = home.root().join("all.backup");
    let file = file.to_str().expect("UTF-8");
    keeps.json(&["backup", "create", file, "--passphrase-file", &secret]);
    let restored = other.authros();
    restored.json(&["backup", "restore", file, "--passphrase-file", &secret]);
    let carried = restored.json(&["incident", "show", "crash"]);
    assert_eq!((count(&carried, "records"), list(&carried, "notes").len()), (3, 2), "{carried}");

    let closed = keeps.json(&["incident", "close", "crash"]);
    assert_eq!((&closed["open"], &closed["until"]), (&false.into(), &closed["closed_at"]));
    keeps.fails(INPUT, &["incident", "close", "crash"]);
    keeps.fails(USAGE, &["incident", "remove", "crash"]);
    keeps.json(&["incident", "remove", "crash", "--yes"]);
    assert_eq!(
        digests(&keeps.records(&["records", "list", "--oldest", "--incident", "second"])),
        all,
        "the other one still holds"
    );
    assert!(!is_deleted(&keeps, ODOM));
    assert!(named(&keeps).iter().all(|topic| topic == OTHER));
    keeps.json(&["incident", "remove", "second", "--yes"]);
    wait_until(120, "what no incident holds any more is deleted", || is_deleted(&keeps, ODOM).then_some(()));
    site.stop("INT", 60).expect_code(0);
    let deeds = list(&authros.json(&["audit", "list", "--limit", "1000"]), "audit");
    for (deed, times) in [("open incident", 2), ("note incident", 1), ("close incident", 1), ("remove incident", 2)] {
        let of =
            |outcome: &str| deeds.iter().filter(|line| line["action"] == deed && line["outcome"] == outcome).count();
        assert_eq!((of("begun"), of("done")), (times, times), "{deed}");
    }
    authros.json(&["audit"]);
}
