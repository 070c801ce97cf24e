//! The address book: names are unique, it survives a restart, and a gateway's word alone confirms nobody's key.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use std::sync::Arc;

use super::*;
use crate::model::ErrorKind;
use crate::site::testing::{Ground, profile};

const JOINED: [(&str, &str); 2] = [("site.address", "127.0.0.1:1"), ("site.gateway_key", KEY)];
const KEY: &str = "00112233445566778899aabbccddeeff00112233445566778899aabbccddeeff";

fn name(text: &str) -> ContactName {
    text.parse().expect("a contact's name")
}

/// A fingerprint as a person types it.
fn typed(byte: u8) -> String {
    Fingerprint::of_signer(&crate::model::SignerId([byte; 32])).to_string()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_name_stands_for_one_account_and_an_account_has_one_name() {
    let ground = Ground::with(&[]);
    let contacts = Arc::new(Contacts::new(&ground.parts));
    let (alice, one, two) = (profile("alice"), Address([1; 20]), Address([2; 20]));
    contacts.add(&alice, name("bob"), one, Some(typed(1))).await.expect("added");
    for (other, address) in [("bob", two), ("robert", one)] {
        let twice = contacts.add(&alice, name(other), address, Some(typed(1))).await.expect_err("known already");
        assert_eq!(twice.kind, ErrorKind::Refused);
        assert!(twice.message.contains("contacts remove bob"), "{}", twice.message);
    }
    let other_key = contacts.add(&alice, name("bob"), one, Some(typed(2))).await.expect_err("another key");
    assert_eq!(other_key.kind, ErrorKind::Refused);
    for fingerprint in [Some(typed(1)), None] {
        assert_eq!(contacts.add(&alice, name("bob"), one, fingerprint).await.expect("repeated").len(), 1);
    }
    assert_eq!(contacts.resolve(&Party::Contact(name("bob"))).ok(), Some(one));
    let stranger = contacts.resolve(&Party::Contact(name("carol"))).expect_err("not in the book");
    assert!(stranger.message.contains("contacts add carol"), "{}", stranger.message);
    let lines = ["begun", "done"].map(|outcome| (format!("bob {one}"), outcome.to_owned()));
    assert_eq!(ground.audited("contact add"), lines);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_book_survives_a_restart_and_forgets_who_is_removed() {
    let ground = Ground::with(&[]);
    let contacts = Arc::new(Contacts::new(&ground.parts));
    let alice = profile("alice");
    for (text, byte) in [("carol", 3), ("bob", 2)] {
        contacts.add(&alice, name(text), Address([byte; 20]), Some(typed(byte))).await.expect("added");
    }
    drop(contacts);
    let ground = ground.again();
    let contacts = Arc::new(Contacts::new(&ground.parts));
    let rows = contacts.rows().await.expect("rows");
    assert_eq!(rows.iter().map(|row| row.name.to_string()).collect::<Vec<_>>(), ["bob", "carol"]);
    assert!(rows.iter().all(|row| row.given && row.registered.is_none()), "{rows:?}");
    assert_eq!(contacts.remove(&alice, &name("bob")).await.expect("removed").len(), 1);
    assert_eq!(contacts.names().expect("read").into_values().collect::<Vec<_>>(), ["carol"]);
    assert!(contacts.remove(&alice, &name("bob")).await.is_err());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn where_a_gateway_tells_the_chain_nobody_is_entered_without_a_fingerprint() {
    let ground = Ground::with(&JOINED);
    let contacts = Arc::new(Contacts::new(&ground.parts));
    let (alice, account) = (profile("alice"), Address([1; 20]));
    let refused = contacts.add(&alice, name("bob"), account, None).await.expect_err("a gateway's word");
    assert_eq!(refused.kind, ErrorKind::Refused);
    assert!(refused.message.contains("--fingerprint"), "{}", refused.message);
    let damaged = contacts.add(&alice, name("bob"), account, Some("abc".to_owned())).await.expect_err("no fingerprint");
    assert_eq!(damaged.kind, ErrorKind::Input);
    assert!(contacts.rows().await.expect("rows").is_empty() && ground.audited("contact add").is_empty());
    contacts.add(&alice, name("bob"), account, Some(typed(7))).await.expect("compared");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_profile_of_the_same_home_goes_by_its_name_unless_the_address_book_has_that() {
    let ground = Ground::with(&[]);
    let contacts = Arc::new(Contacts::new(&ground.parts));
    let (here, elsewhere) = (ground.owner("dave").address, Address([2; 20]));
    let dave = Party::Contact(name("dave"));
    assert_eq!(contacts.resolve(&dave).ok(), Some(here));
    contacts.add(&profile("alice"), name("dave"), elsewhere, Some(typed(3))).await.expect("added");
    assert_eq!(contacts.resolve(&dave).ok(), Some(elsewhere));
    let stranger = contacts.resolve(&Party::Contact(name("carol"))).expect_err("neither");
    assert!(stranger.message.contains("is not in the address book"), "{}", stranger.message);
}
