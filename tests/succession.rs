//! Lost keys: an SM2 key is replaced with its history kept; for a lost account the administrator names who continues.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

mod support;

use support::{Authros, Home, list, text};

const REFUSED: i32 = 5;
const TOPIC: &str = "/robot1/odom";

#[test]
fn a_lost_signing_key_is_replaced_and_what_it_signed_still_verifies() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1"]);
    let _site = authros.serve(&home);
    authros.enrol();
    let before = authros.json(&["identity", "show"]);
    authros.capture(&[TOPIC], 2);
    let early = authros.records(&["uploads", "list"]);
    let key = home.file("new.hex", "3945208f7b2144b13f36e38ac6d39f95889393692860b51a42fb81ef4df7c5b8", 0o600);
    authros.json(&["keys", "load", "--sm2", &key]);
    let after = authros.json(&["identity", "show"]);
    assert_eq!(
        (&after["registered"], &after["address"]),
        (&true.into(), &before["address"]),
        "the chain has the new key"
    );
    assert_ne!((&after["signing_key"], &after["fingerprint"]), (&before["signing_key"], &before["fingerprint"]));
    authros.capture(&[TOPIC], 2);

    let records = authros.records(&["uploads", "list"]);
    assert_eq!((early.len(), records.len()), (2, 4));
    for record in &records {
        let id = text(record, "id");
        assert_eq!(authros.json(&["shared", "open", &id])["verdict"], "verified", "{record}");
        let directory = home.root().join(&id);
        let place = directory.to_str().expect("UTF-8");
        authros.run(&["uploads", "export", &id, "--dir", place]).expect_code(0);
        let proof = std::fs::read(directory.join("proof.json")).expect("written");
        let proof: serde_json::Value = serde_json::from_slice(&proof).expect("JSON");
        let signer = if early.iter().any(|old| old["id"] == record["id"]) { &before } else { &after };
        assert_eq!(proof["signing_key"], signer["signing_key"], "each by the key of its time");
    }
}

fn administration(authros: &Authros) -> serde_json::Value {
    authros.json(&["chain", "status"])["administration"].clone()
}

#[test]
fn a_lost_account_has_the_successor_that_the_administrator_names_for_all_to_see() {
    let home = Home::new();
    let mut site = home.authros().with(&["--robots", "0"]).serve(&home);
    let [admin, lost, heir] = ["admin", "lost", "heir"].map(|name| home.profile(name));
    let boss = text(&home.authros().json(&["identity", "show"]), "address");
    let [_, gone, next] = [&admin, &lost, &heir].map(Authros::enrol);
    // The site's own profile put the contract there.
    let boss_of = administration(&heir);
    assert_eq!((text(&boss_of, "administrator"), boss_of["paused"].clone()), (boss, false.into()));
    admin.json(&["contacts", "add", "the-heir", &next]);

    let refused = heir.fails(REFUSED, &["chain", "succeed", &gone, &next]);
    assert!(refused.contains("administers this contract"), "{refused}");
    let boss = home.authros();
    boss.fails(REFUSED, &["chain", "succeed", &gone, "0x00000000000000000000000000000000000000aa"]);
    let told = boss.json(&["chain", "succeed", &gone, "the-heir"]);
    assert!(text(&told, "text").contains(&gone) && told["transaction"].is_string(), "{told}");

    let alert = site.wait_for_text("the successor of", 30);
    assert!(alert.contains(&gone) && alert.contains(&next), "{alert}");
    let seen = list(&administration(&lost), "successions");
    assert_eq!((text(&seen[0], "lost"), text(&seen[0], "successor")), (gone.clone(), next.clone()));
    assert_eq!(text(&seen[0], "successor_name"), "the-heir");
    let status = heir.run(&["chain", "status"]).expect_code(0).stdout;
    assert!(status.contains(&format!("the-heir {next} continues for {gone}")), "{status}");
    lost.fails(REFUSED, &["devices", "lend", &"ab".repeat(32)]);
    boss.fails(REFUSED, &["chain", "restore", &gone]);
    let line = list(&boss.json(&["audit", "list", "--action", "succeed"]), "audit");
    assert!(line.len() == 2 && line[0]["outcome"] == "done", "{line:?}");

    site.stop("INT", 30).expect_code(0);
    let _again = boss.with(&["--robots", "0"]).serve(&home);
    assert_eq!(list(&administration(&heir), "successions").len(), 1, "written down");
}

#[test]
fn the_administrator_admits_suspends_pauses_and_hands_over() {
    let home = Home::new();
    let _site = home.authros().with(&["--robots", "0"]).serve(&home);
    let (boss, alice, bob) = (home.authros(), home.profile("alice"), home.profile("bob"));
    let address = alice.enrol();
    let act = |words: &[&str]| boss.json(&[&["chain"], words].concat());
    act(&["close"]);
    let stranger = text(&bob.json(&["identity", "create"]), "address");
    bob.fails(REFUSED, &["register"]);
    act(&["admit", &stranger]);
    bob.enrol();
    act(&["suspend", &address]);
    alice.fails(REFUSED, &["grant", &stranger]);
    act(&["restore", &address]);
    act(&["pause"]);
    alice.fails(REFUSED, &["grant", &stranger]);
    let status = administration(&alice);
    assert_eq!((&status["paused"], &status["open"]), (&true.into(), &false.into()), "{status}");
    act(&["resume"]);
    alice.json(&["grant", &stranger]);
    act(&["hand-over", &address]);
    bob.fails(REFUSED, &["chain", "accept"]);
    alice.json(&["chain", "accept"]);
    assert_eq!(text(&administration(&bob), "administrator"), address);
    boss.fails(REFUSED, &["chain", "pause"]);
}
