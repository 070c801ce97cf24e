//! Who may sign, in the program's practice: what a suspension or the end of a loan holds back, is kept, and continues
//! by itself; evidence of robots is checked where there are no keys.

use serde_json::Value;

use crate::support;

use support::{Authros, Home, Running, count, free_port, heavy, list, text, wait_until};

const WAITS: &str = "waits: unauthorised";
const TOPICS: [&str; 2] = ["/robot1/odom", "/robot2/odom"];

fn life(authros: &Authros) -> Value {
    let life = authros.with(&["--json"]).run(&["status"]).document()["life"].clone();
    let sum: u64 = ["verified", "pending", "right_ended", "quarantined", "dropped", "tampered"]
        .iter()
        .map(|part| count(&life, part))
        .sum();
    assert_eq!((count(&life, "captured"), life["conserved"].clone()), (sum, true.into()), "the law: {life}");
    life
}

fn all_verified(authros: &Authros, least: u64) -> Value {
    wait_until(120, "everything is verified", || {
        let life = life(authros);
        (count(&life, "verified") >= least && count(&life, "verified") == count(&life, "captured")).then_some(life)
    })
}

fn has_word(authros: &Authros, words: &[&str]) -> bool {
    authros.records(words).iter().any(|record| record["state"] == WAITS)
}

#[test]
fn suspensions_under_load_lose_nothing_and_what_waited_goes_on_by_itself() {
    let _alone = heavy();
    let home = Home::new();
    let boss = home.authros().with(&["--robots", "2"]).with_variable("AUTHROS_ANCHOR_LANES", "3");
    let site = boss.serve(&home);
    let alice = home.profile("alice");
    let address = alice.enrol();
    for topic in TOPICS {
        alice.json(&["topics", "watch", topic]);
    }
    wait_until(60, "the extra accounts anchor", || (count(&life(&alice), "verified") >= 40).then_some(()));
    // A block or two each, while batches are on their way through accounts that nobody suspended.
    for _ in 0..3 {
        boss.json(&["chain", "admin", "suspend", &address]);
        boss.json(&["chain", "admin", "restore", &address]);
    }
    boss.json(&["chain", "admin", "suspend", &address]);
    wait_until(60, "records wait for the right", || (count(&life(&alice), "right_ended") >= 30).then_some(()));
    assert!(has_word(&alice, &["records", "list", "--oldest"]), "the list says so");
    let held = alice.run(&["records", "list", "--oldest", "--state", WAITS]).expect_code(0).stdout;
    assert!(held.contains(WAITS), "{held}");
    let status = alice.run(&["status"]).stdout;
    assert!(status.contains("+ unauthorised ") && status.contains("chain admin restore"), "{status}");
    assert!(site.stderr().contains("records are kept but not anchored"), "{}", site.stderr());
    let before = count(&life(&alice), "verified");
    boss.json(&["chain", "admin", "restore", &address]);
    wait_until(120, "300 are verified", || (count(&life(&alice), "verified") >= before.max(300)).then_some(()));
    for topic in TOPICS {
        alice.json(&["topics", "unwatch", topic]);
    }
    let end = all_verified(&alice, 300);
    assert_eq!((count(&end, "dropped"), count(&end, "tampered"), count(&end, "right_ended")), (0, 0, 0), "{end}");
    assert!(!has_word(&alice, &["records", "list", "--oldest"]));
    alice.run(&["audit", "--deep"]).expect_code(0);
    site.stop("TERM", 30).expect_code(0);
}

/// A gateway of a home, kept by the profile `keeper`; its port and fingerprint.
fn gateway(home: &Home) -> (Running, String, String) {
    let address = format!("127.0.0.1:{}", free_port());
    let keeper = home.profile("keeper").with(&["--json"]);
    let mut site = keeper.spawn(&["gateway", "serve", "--listen", &address]);
    let said = site.wait_for_text("\"gateway\"", 120);
    let line = said.lines().find(|line| line.contains("\"gateway\"")).expect("a document");
    let document: Value = serde_json::from_str(line).expect("JSON");
    (site, address, text(&document["gateway"], "gateway"))
}

#[test]
fn a_robots_record_is_evidence_for_whoever_has_neither_home_nor_keys() {
    let (home, away) = (Home::new(), Home::new());
    let (site, address, fingerprint) = gateway(&home);
    let alice = home.profile("alice");
    alice.enrol();
    let file = away.root().join("robot.enrolment").to_str().expect("UTF-8").to_owned();
    let enrol =
        ["robot", "enrol", "--gateway", &address, "--gateway-key", &fingerprint, "--name", "scout", "--out", &file];
    let device = text(&alice.json(&[&enrol[..], &["--all-topics"]].concat()), "device");
    let agent = ["robot", "run", &file, "--robots", "1", "--topic", "/robot1/odom", "--count", "3"];
    away.authros().with(&["--json"]).spawn(&agent).wait(180).expect_code(0);
    let record = wait_until(60, "the owner has it verified", || {
        let records = alice.records(&["records", "list", "--oldest"]);
        records.into_iter().find(|record| record["state"] == "verified")
    });
    let folder = home.root().join("evidence").to_str().expect("UTF-8").to_owned();
    alice.run(&["records", "export", &text(&record, "id"), "--dir", &folder]).expect_code(0);
    let url = format!("127.0.0.1:{}", free_port());
    let mut chain = alice.spawn(&["chain", "serve", "--listen", &url]);
    chain.wait_for_text(&url, 60);
    let nobody = Home::new();
    let stranger = Authros::bare(nobody.root());
    let arguments = ["evidence", "verify", &folder, "--chain", &format!("http://{url}")];
    let told = stranger.run(&arguments).expect_code(0).stdout;
    assert!(told.contains("VERIFIED") && told.contains("a device that") && told.contains("had authorised"), "{told}");
    let found = stranger.run(&[&arguments[..], &["--json"]].concat()).expect_code(0).document();
    assert!(list(&found, "steps").iter().all(|step| step["ok"] == true), "{found}");
    assert!(!nobody.path().exists(), "no home was made");
    // What was anchored during the loan stays evidence after it has ended.
    alice.json(&["robot", "revoke", &device]);
    stranger.run(&arguments).expect_code(0);
    chain.stop("INT", 30);
    site.stop("TERM", 30);
}

#[test]
fn devices_are_lent_and_recalled() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "0"]);
    authros.enrol();
    let id = "ab".repeat(32);
    authros.json(&["robot", "authorise", &id, "--until", "2h"]);
    authros.fails(3, &["robot", "authorise", "abab"]);
    let row = authros.json(&["robot", "devices"])["devices"][0].clone();
    assert!(row["device"] == id.as_str() && row["state"] == "authorised" && row["until"].is_string(), "{row}");
    authros.json(&["robot", "revoke", &id[..16]]);
    assert_eq!(authros.json(&["robot", "devices"])["devices"][0]["state"], "revoked");
    let again = authros.fails(5, &["robot", "revoke", &id]);
    assert!(again.contains("no such device"), "{again}");
}
