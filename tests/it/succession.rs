//! Lost keys: an SM2 key is replaced with its history kept; for a lost account the administrator names a successor.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use support::{Authros, Home, list, skipped, text};

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
    let early = authros.records(&["records", "list", "--oldest"]);
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

    let records = authros.records(&["records", "list", "--oldest"]);
    assert_eq!((early.len(), records.len()), (2, 4));
    for record in &records {
        let id = text(record, "id");
        assert_eq!(authros.json(&["records", "open", &id])["verdict"], "verified", "{record}");
        let directory = home.root().join(&id);
        let place = directory.to_str().expect("UTF-8");
        authros.run(&["records", "export", &id, "--dir", place]).expect_code(0);
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
    let boss = home.authros().with(&["--robots", "0"]);
    let address = boss.enrol();
    let [admin, lost, heir] = ["admin", "lost", "heir"].map(|name| home.profile(name));
    let [_, gone, next] = [&admin, &lost, &heir].map(Authros::enrol);
    let boss_of = administration(&heir);
    assert_eq!((text(&boss_of, "administrator"), boss_of["paused"].clone()), (address, false.into()));
    admin.json(&["contacts", "add", "the-heir", &next]);
    let refused = heir.fails(REFUSED, &["chain", "succession", "propose", &gone, &next]);
    assert!(refused.contains("the administrator of this contract"), "{refused}");
    boss.fails(REFUSED, &["chain", "succession", "propose", &gone, "0x00000000000000000000000000000000000000aa"]);
    let told = boss.json(&["chain", "succession", "propose", &gone, "the-heir"]);
    assert!(text(&told, "text").contains(&gone) && told["transaction"].is_string(), "{told}");
    if support::clock::days_ahead(&boss, 1).is_none() {
        skipped!("no libfaketime (package faketime)");
    }

    let at = |authros: &Authros| support::clock::days_ahead(authros, 15).expect("libfaketime");
    let mut site = at(&boss).serve(&home);
    at(&heir).json(&["chain", "succession", "complete", &gone]);
    let alert = site.wait_for_text("its successor", 30);
    assert!(alert.contains(&gone) && alert.contains(&next), "{alert}");
    let seen = list(&administration(&at(&lost)), "successions");
    assert_eq!((text(&seen[0], "lost"), text(&seen[0], "successor")), (gone.clone(), next.clone()));
    assert_eq!(text(&seen[0], "successor_name"), "the-heir");
    let status = at(&heir).run(&["chain", "status"]).expect_code(0).stdout;
    assert!(status.contains(&format!("the-heir {next} continues for {gone}")), "{status}");
    at(&lost).fails(REFUSED, &["robot", "authorise", &"ab".repeat(32)]);
    at(&boss).fails(REFUSED, &["chain", "admin", "restore", &gone]);
    let line = list(&at(&boss).json(&["audit", "list", "--action", "completeSuccession"]), "audit");
    assert!(line.len() == 2 && line[0]["outcome"] == "done", "{line:?}");

    site.stop("INT", 30).expect_code(0);
    let _again = at(&boss).serve(&home);
    assert_eq!(list(&administration(&at(&heir)), "successions").len(), 1, "written down");
}

#[test]
fn the_administrator_admits_suspends_pauses_and_hands_over() {
    let home = Home::new();
    let _site = home.authros().with(&["--robots", "0"]).serve(&home);
    let (boss, alice, bob) = (home.authros(), home.profile("alice"), home.profile("bob"));
    let address = alice.enrol();
    let act = |words: &[&str]| boss.json(&[&["chain", "admin"], words].concat());
    act(&["close"]);
    let stranger = text(&bob.json(&["identity", "create"]), "address");
    bob.fails(REFUSED, &["identity", "register"]);
    act(&["allow", &stranger]);
    act(&["deny", &stranger]);
    bob.fails(REFUSED, &["identity", "register"]);
    act(&["allow", &stranger]);
    bob.enrol();
    let registered = boss.fails(REFUSED, &["chain", "admin", "deny", &stranger]);
    assert!(registered.contains("chain admin suspend"), "{registered}");
    act(&["suspend", &address]);
    alice.fails(REFUSED, &["grant", "add", &stranger]);
    act(&["restore", &address]);
    boss.fails(REFUSED, &["chain", "admin", "pause", "--for", "4d"]);
    act(&["pause", "--for", "1h"]);
    alice.fails(REFUSED, &["grant", "add", &stranger]);
    let status = administration(&alice);
    assert_eq!((&status["paused"], &status["open"]), (&true.into(), &false.into()), "{status}");
    assert!(status["paused_until"].is_string(), "{status}");
    act(&["resume"]);
    let again = boss.fails(REFUSED, &["chain", "admin", "pause"]);
    assert!(again.contains("the next pause must wait"), "{again}");
    alice.json(&["grant", "add", &stranger, "--expires", "1h"]);
    let ends = |authros: &Authros| text(&list(&authros.json(&["grant", "list"]), "grants")[0], "expires");
    let before = ends(&bob);
    let shorter = alice.fails(REFUSED, &["grant", "extend", &stranger, "--expires", "1m"]);
    assert!(shorter.contains("only lengthens"), "{shorter}");
    alice.json(&["grant", "extend", &stranger, "--expires", "2h"]);
    assert!(ends(&bob) > before && ends(&alice) == ends(&bob));
    alice.json(&["grant", "extend", &stranger, "--endless"]);
    assert!(list(&bob.json(&["grant", "list"]), "grants")[0]["expires"].is_null());
    bob.fails(REFUSED, &["grant", "extend", &address, "--expires", "2h"]);
    act(&["hand-over", &address]);
    bob.fails(REFUSED, &["chain", "admin", "accept"]);
    alice.json(&["chain", "admin", "accept"]);
    assert_eq!(text(&administration(&bob), "administrator"), address);
    boss.fails(REFUSED, &["chain", "admin", "pause"]);
}

#[test]
fn a_succession_waits_and_the_recovery_account_stops_it() {
    let home = Home::new();
    let [boss, owner, heir, friend] = ["boss", "owner", "heir", "friend"].map(|name| home.profile(name));
    let [_, lost, next, recovery] = [&boss, &owner, &heir, &friend].map(Authros::enrol);
    if support::clock::days_ahead(&boss, 1).is_none() {
        skipped!("no libfaketime (package faketime)");
    }
    let at = |authros: &Authros, days| support::clock::days_ahead(authros, days).expect("libfaketime");
    let waiting = |authros: &Authros| list(&authros.json(&["chain", "succession", "list"]), "proposals");
    owner.fails(REFUSED, &["identity", "recovery", &lost]);
    owner.json(&["identity", "recovery", &recovery]);
    let own = owner.json(&["chain", "succession", "list"])["recovery"].clone();
    assert!(own["account"].is_null() && text(&own, "next") == recovery, "it takes effect later: {own}");

    let told = text(&at(&boss, 8).json(&["chain", "succession", "propose", &lost, &next]), "text");
    assert!(told.contains("in 7 days") && told.contains(&recovery), "{told}");
    let seen = waiting(&at(&heir, 8));
    assert_eq!((text(&seen[0], "lost"), text(&seen[0], "recovery")), (lost.clone(), recovery.clone()));
    let early = at(&boss, 8).fails(REFUSED, &["chain", "succession", "complete", &lost]);
    assert!(early.contains("still pending"), "{early}");
    let thief = at(&owner, 9).fails(REFUSED, &["chain", "succession", "cancel", &lost]);
    assert!(thief.contains("recovery account"), "{thief}");
    at(&friend, 9).json(&["chain", "succession", "cancel", &lost]);
    at(&boss, 16).fails(REFUSED, &["chain", "succession", "complete", &lost]);

    at(&boss, 16).json(&["chain", "succession", "propose", &lost, &next]);
    let shown = at(&heir, 16).run(&["chain", "status"]).expect_code(0).stdout;
    assert!(shown.contains(&format!("{next} can continue for {lost}")), "{shown}");
    at(&heir, 24).json(&["chain", "succession", "complete", &lost]);
    assert_eq!(text(&list(&administration(&at(&heir, 24)), "successions")[0], "successor"), next);
    assert!(waiting(&at(&heir, 24)).is_empty());
    at(&owner, 24).fails(REFUSED, &["robot", "authorise", &"ab".repeat(32)]);
}
