//! Erasing one recording: who and why are kept with its proofs, what an incident holds stays, and nothing looks lost or
//! altered afterwards.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use serde_json::Value;
use support::{Authros, Home, count, is_verified, list, text, wait_until};

const REFUSED: i32 = 5;
const INPUT: i32 = 3;
const ODOM: &str = "/robot1/odom";
const OTHER: &str = "/robot2/odom";
const WHY: &str = "a passer-by asked for it";

fn of(authros: &Authros, topic: &str) -> Vec<Value> {
    authros.records(&["records", "list", "--oldest", "--topic", topic])
}

fn erase(authros: &Authros, more: &[&str]) -> Value {
    authros.json(&[&["records", "erase", "--reason", WHY], more].concat())
}

#[test]
fn a_recording_is_erased_by_somebody_for_a_reason_and_its_proofs_stay() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "2"]);
    let site = authros.serve(&home);
    authros.enrol();
    authros.capture(&[ODOM, OTHER], 6);
    let before = wait_until(120, "all is verified", || {
        let records = of(&authros, ODOM);
        (records.len() >= 6 && records.iter().all(is_verified)).then_some(records)
    });
    let all = before.len() as u64;

    // Shown, not done.
    let shown = authros.with(&["--json"]).run(&["records", "erase", "--reason", WHY, "--topic", ODOM]);
    let plan = shown.expect_code(2).document();
    for sure in [&[][..], &["--yes"]] {
        let mistyped = [&["records", "erase", "--reason", WHY, "--topic", "/robot1/odm"], sure].concat();
        assert!(authros.fails(INPUT, &mistyped).contains("nothing matches"));
    }
    assert_eq!((count(&plan, "records"), count(&plan, "named")), (all, 0), "{plan}");
    assert!(list(&plan, "stays").len() >= 4, "what is not reached is said: {plan}");
    assert!(of(&authros, ODOM).iter().all(is_verified), "nothing happened");
    authros.fails(INPUT, &["records", "erase", "--record", "abcdef12", "--reason", WHY, "--yes"]);
    authros.fails(INPUT, &["records", "erase", "--topic", ODOM, "--reason", " ", "--yes"]);

    // What an incident holds stays until that is released.
    authros.json(&["incident", "open", "crash", "--since", "-10m", "--topics", ODOM]);
    let told = authros.fails(REFUSED, &["records", "erase", "--topic", ODOM, "--reason", WHY, "--yes"]);
    assert!(told.contains("crash"), "{told}");
    assert!(of(&authros, ODOM).iter().all(is_verified), "nothing happened");
    authros.json(&["incident", "remove", "crash", "--yes"]);

    // One record, then the rest.
    let first = text(&before[0], "id");
    let one = erase(&authros, &["--record", &first, "--yes"]);
    assert_eq!((count(&one, "named"), &one["deleted"]), (1, &Value::Bool(true)), "{one}");
    let done = erase(&authros, &["--topic", ODOM, "--yes"]);
    assert_eq!((count(&done, "named"), count(&done, "gone")), (all - 1, 1), "{done}");
    let after = wait_until(60, "all are deleted", || {
        let records = of(&authros, ODOM);
        records.iter().all(|record| record["state"] == "deleted").then_some(records)
    });
    for record in &after {
        let erased = text(record, "erased");
        assert!(erased.starts_with("erased 20") && erased.contains("by ") && erased.contains(WHY), "{erased}");
    }
    assert!(of(&authros, OTHER).iter().all(is_verified), "what was not chosen stays");

    // The proofs stay, and who, when and why are said wherever the message is asked for.
    let digests = |records: &[Value]| records.iter().map(|record| text(record, "digest")).collect::<Vec<_>>();
    assert_eq!(digests(&before), digests(&after));
    assert_eq!(authros.json(&["records", "check", &first])["verdict"], "deleted");
    assert!(authros.json(&["records", "show", &first])["steps"].to_string().contains(WHY));
    assert!(authros.fails(REFUSED, &["records", "open", &first]).contains(WHY));
    let folder = home.root().join("exported");
    let folder = folder.to_str().expect("UTF-8");
    assert!(authros.fails(REFUSED, &["records", "export", &first, "--dir", folder]).contains(WHY));
    let told = authros.records(&["records", "list", "--oldest", "--kind", "retention"]);
    let report = authros.json(&["records", "open", &text(&told[0], "id")]);
    assert!(text(&report["message"], "rule").contains(WHY), "signed and on the chain: {report}");
    let lines = list(&authros.json(&["audit", "list", "--action", "erase", "--limit", "1000"]), "audit");
    assert!(lines.iter().any(|line| line["outcome"] == "begun" && text(line, "subject").contains(WHY)), "{lines:?}");

    let again = erase(&authros, &["--topic", ODOM, "--yes"]);
    assert_eq!((count(&again, "records"), count(&again, "gone")), (0, all), "{again}");
    site.stop("TERM", 30).expect_code(0);
    authros.run(&["audit", "--deep"]).expect_code(0);
}

/// The reader's grant covers one topic: it opens no retention record, so nothing but the owner's statement tells it.
#[test]
fn a_reader_who_comes_after_the_erasure_is_told_of_it_by_its_owner() {
    let (home, away) = (Home::new(), Home::new());
    let alice = home.profile("alice");
    let _site = alice.with(&["--robots", "1"]).serve(&home);
    let mut gateway = alice.with(&["--json"]).spawn(&["gateway", "serve", "--listen", "127.0.0.1:0"]);
    gateway.wait_for_text("fingerprint", 60);
    let told: Value = serde_json::from_str(gateway.stdout().lines().next().expect("a line")).expect("JSON");
    let (address, key) = (text(&told["gateway"], "address"), text(&told["gateway"], "gateway"));
    alice.capture(&[ODOM], 4);
    let before = wait_until(120, "all is verified", || {
        let records = of(&alice, ODOM);
        (records.len() >= 4 && records.iter().all(is_verified)).then_some(records)
    });
    let gone = text(&before[1], "id");
    let done = erase(&alice, &["--record", &gone, "--yes"]);
    assert_eq!((count(&done, "named"), &done["deleted"]), (1, &Value::Bool(true)), "{done}");

    let bob = away.profile("bob").with(&["--site", &address, "--gateway-key", &key]);
    let account = bob.enrol();
    alice.json(&["gateway", "allow", &account]);
    alice.json(&["grant", "add", &account, "--topic", ODOM]);
    let _reader = bob.serve(&away);
    let listed = wait_until(120, "all are listed and settled", || {
        let records = bob.records_so_far(&["received", "list", "--oldest"])?;
        let settled = |record: &Value| is_verified(record) || record["state"] == "deleted";
        (records.len() == before.len() && records.iter().all(settled)).then_some(records)
    });
    for record in &listed {
        let id = text(record, "id");
        let verdict = wait_until(60, "its anchor is confirmed", || {
            let verdict = bob.json(&["records", "check", &id]);
            (verdict["verdict"] != "unanchored").then_some(verdict)
        });
        let opened = bob.run(&["records", "open", &id]);
        if id != gone {
            assert_eq!((&verdict["verdict"], opened.code), (&"verified".into(), Some(0)), "{record}");
            continue;
        }
        let erased = text(record, "erased");
        assert!(erased.starts_with("erased 20") && erased.ends_with("by its owner, its proof remains"), "{erased}");
        assert!(!record.to_string().contains(WHY), "the reason is the owner's: {record}");
        assert_eq!((&record["state"], &verdict["verdict"]), (&"deleted".into(), &"deleted".into()), "{verdict}");
        assert!(bob.fails(REFUSED, &["records", "open", &id]).contains("by its owner"));
    }
    let shown = bob.run(&["received", "list", "--oldest"]).expect_code(0).stdout;
    assert!(shown.contains("its proof remains"), "{shown}");
}

#[test]
fn an_imported_recording_is_erased_and_what_was_captured_beside_it_stays() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1"]);
    let _site = authros.serve(&home);
    authros.enrol();
    authros.capture(&[ODOM], 4);
    let verified = |least: usize| {
        wait_until(120, "all is verified", || {
            let records = of(&authros, ODOM);
            (records.len() >= least && records.iter().all(is_verified)).then_some(records)
        })
    };
    let captured = verified(4);
    let file = home.root().join("tour.mcap");
    let file = file.to_str().expect("UTF-8");
    authros.json_within(120, &["bag", "export", "--mcap", file]);
    let summary = authros.json_within(120, &["bag", "import", file]);
    assert_eq!(count(&summary, "imported"), captured.len() as u64, "{summary}");
    let all = verified(captured.len() * 2);

    let imported = all.iter().find(|record| !captured.iter().any(|one| one["id"] == record["id"]));
    let opened = authros.json(&["records", "open", &text(imported.expect("imported"), "id")]);
    let tags = list(&opened, "tags");
    let tag = tags.iter().find(|tag| tag[0] == "recording").and_then(|tag| tag[1].as_str()).expect("a tag").to_owned();
    authros.fails(INPUT, &["records", "erase", "--recording", "/nowhere.bag", "--reason", WHY, "--yes"]);
    let shown = authros.with(&["--json"]).run(&["records", "erase", "--reason", WHY, "--recording", &tag]);
    assert_eq!(count(&shown.expect_code(2).document(), "records"), captured.len() as u64, "the tag is the file's");
    let done = erase(&authros, &["--recording", file, "--yes"]);
    assert_eq!((count(&done, "named"), &done["deleted"]), (captured.len() as u64, &Value::Bool(true)), "{done}");
    for record in of(&authros, ODOM) {
        let was_captured = captured.iter().any(|one| one["id"] == record["id"]);
        assert_eq!(is_verified(&record), was_captured, "{record}");
    }
}
