//! The address book: names for accounts, their keys, and what is revealed of them to others.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::fs;

use serde_json::Value;
use support::{Authros, Home, Running, list, text};

const INPUT: i32 = 3;
const REFUSED: i32 = 5;
const TOPIC: &str = "/robot1/odom";

struct Two {
    home: Home,
    site: Running,
    alice: Authros,
    bob: Authros,
    reader: String,
    owner: String,
}

fn two_profiles() -> Two {
    let home = Home::new();
    let site = home.authros().with(&["--robots", "1"]).serve(&home);
    let (alice, bob) = (home.profile("alice"), home.profile("bob"));
    let (owner, reader) = (alice.enrol(), bob.enrol());
    Two { home, site, alice, bob, reader, owner }
}

fn fingerprint(authros: &Authros) -> String {
    text(&authros.json(&["identity", "show"]), "fingerprint")
}

fn contact(authros: &Authros) -> Value {
    list(&authros.json(&["contacts", "list"]), "contacts")[0].clone()
}

#[test]
fn a_name_stands_for_its_address_and_is_shown_beside_it() {
    let two = two_profiles();
    let (alice, bob) = (&two.alice, &two.bob);
    let print = fingerprint(bob);
    assert_eq!(print.split(' ').map(str::len).collect::<Vec<_>>(), [4; 8]);
    alice.fails(INPUT, &["grant", "add", "--to", "robert"]);
    alice.fails(INPUT, &["contacts", "add", "0xbob", &two.reader]);
    let differs = alice.fails(REFUSED, &["contacts", "add", "bob", &two.reader, "--fingerprint", &fingerprint(alice)]);
    assert!(differs.contains(&print) && differs.contains("'bob' was not added"), "{differs}");
    assert!(list(&alice.json(&["contacts", "list"]), "contacts").is_empty());
    alice.json(&["contacts", "add", "bob", &two.reader, "--fingerprint", &print.to_uppercase()]);
    alice.fails(REFUSED, &["contacts", "add", "robert", &two.reader]);
    let row = contact(alice);
    assert_eq!(
        (&row["state"], &row["fingerprint"], &row["given"]),
        (&"same".into(), &print.as_str().into(), &true.into())
    );

    let compare = |given: &str| alice.run(&["identity", "compare", given, "--account", "bob"]).code;
    assert_eq!((compare(&print), compare(&print.replace(' ', ""))), (Some(0), Some(0)));
    assert_eq!((compare(&fingerprint(alice)), compare(&print[..19])), (Some(REFUSED), Some(INPUT)));
    bob.run(&["identity", "compare", &print]).expect_code(0);

    alice.capture(&[TOPIC], 2);
    alice.json(&["grant", "add", "--to", "bob"]);
    let grant = list(&alice.json(&["grant", "list"]), "grants")[0].clone();
    assert_eq!((text(&grant, "grantee"), text(&grant, "name")), (two.reader.clone(), "bob".to_owned()));
    assert_eq!(text(&grant, "fingerprint"), print, "in the same form everywhere");
    assert!(alice.run(&["grant", "list"]).stdout.contains(&format!("bob {}", two.reader)));
    bob.json(&["contacts", "add", "alice", &two.owner]);
    let shared = bob.records(&["received", "list", "--oldest", "--owner", "alice"]);
    assert!(shared.len() == 2 && shared.iter().all(|record| record["owner_name"] == "alice"), "{shared:?}");
    alice.json(&["grant", "end", "bob"]);
    alice.json(&["contacts", "remove", "bob"]);
    let told = alice.fails(REFUSED, &["grant", "end", "bob"]);
    assert!(told.contains(&two.reader) && told.contains("no active grant"), "the profile of that name: {told}");

    let device = "5a1f09c277e041bd".repeat(4);
    alice.json(&["robot", "authorise", &device]);
    let row = alice.json(&["robot", "devices"])["devices"][0].clone();
    assert_eq!(text(&row, "fingerprint").replace(' ', ""), device[..32], "as the device shows it");
}

#[test]
fn another_key_than_the_noted_one_is_told_and_refused_until_it_is_confirmed() {
    let mut two = two_profiles();
    let (alice, bob) = (&two.alice, &two.bob);
    alice.json(&["contacts", "add", "bob", &two.reader]);
    let before = contact(alice);
    assert_eq!((&before["state"], &before["given"]), (&"same".into(), &false.into()), "found on the chain");

    let key = two.home.file("new.hex", "3945208f7b2144b13f36e38ac6d39f95889393692860b51a42fb81ef4df7c5b8", 0o600);
    bob.json(&["keys", "load", "--sm2", &key]);
    let told = two.site.wait_for_text("authros contacts confirm bob", 30);
    assert!(told.contains(&text(&before, "fingerprint")) && told.contains(&fingerprint(bob)), "{told}");
    assert_eq!(contact(alice)["state"], "differs");
    let refused = alice.fails(REFUSED, &["grant", "add", "bob"]);
    assert!(refused.contains("contacts confirm bob"), "{refused}");
    alice.fails(REFUSED, &["grant", "add", &two.reader]);
    assert!(list(&alice.json(&["grant", "list"]), "grants").is_empty());

    alice.fails(REFUSED, &["contacts", "confirm", "bob", "--fingerprint", &text(&before, "fingerprint")]);
    alice.json(&["contacts", "confirm", "bob", "--fingerprint", &fingerprint(bob)]);
    assert_eq!(contact(alice)["state"], "same");
    alice.json(&["grant", "add", "bob"]);
}

#[test]
fn files_for_others_name_no_account_unless_asked() {
    let two = two_profiles();
    let alice = &two.alice;
    alice.json(&["contacts", "add", "bob", &two.reader]);
    alice.capture(&[TOPIC], 1);
    let id = text(&alice.records(&["records", "list", "--oldest"])[0], "id");
    let proof = |options: &[&str]| {
        let directory = two.home.root().join(format!("export{}", options.concat()));
        let export = ["records", "export", &id, "--dir", directory.to_str().expect("UTF-8")];
        alice.run(&[&export[..], options].concat()).expect_code(0);
        alice.run(&[&export[..], options].concat()).expect_code(3);
        fs::read_to_string(directory.join("proof.json")).expect("written")
    };
    let redacted = proof(&[]);
    assert!(redacted.contains(&format!("\"{}…\"", &two.owner[..6])), "{redacted}");
    assert!(!redacted.to_lowercase().contains(&two.owner.to_lowercase()), "{redacted}");
    let full = proof(&["--addresses"]);
    assert!(full.contains(&two.owner), "{full}");
    let owner = support::unhex(&two.owner);
    assert!(
        support::holds(&fs::read(two.home.root().join("export--addresses/record.bin")).expect("written"), &owner),
        "what is signed stays whole"
    );
    for written in fs::read_dir(two.home.path().join("chain")).expect("the embedded chain").flatten() {
        assert!(!support::holds(&fs::read(written.path()).unwrap_or_default(), b"bob"), "names stay off the chain");
    }
}
