//! Whose keys are open, and the errors if they are not.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use std::sync::Arc;

use crate::model::ErrorKind;
use crate::site::testing::{Ground, profile};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_locked_profile_is_known_but_not_unlocked_and_an_absent_one_is_neither() {
    let ground = Ground::with(&[]);
    let owners = &ground.parts.owners;
    let owner = ground.owner("alice");
    assert!(owners.is_open(&owner) && owners.unlocked(&profile("alice")).is_ok());
    owner.lock(ground.parts.plant.provider).expect("locked");
    let locked = owners.unlocked(&profile("alice")).err().expect("locked");
    assert_eq!(locked.kind, ErrorKind::Refused);
    assert!(locked.message.contains("is locked"), "{}", locked.message);
    assert_eq!(owners.address_of(&profile("alice")).ok(), Some(owner.address));
    let absent = owners.unlocked(&profile("bob")).err().expect("absent");
    assert_eq!(absent.kind, ErrorKind::Input);
    assert!(absent.message.contains("--profile bob identity create"), "{}", absent.message);
    assert_eq!(owners.address_of(&profile("bob")).expect_err("absent").message, absent.message);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn accounts_are_known_after_a_restart_without_a_passphrase() {
    let ground = Ground::with(&[]);
    let (alice, bob) = (ground.owner("alice").address, ground.owner("bob").address);
    let ground = ground.again();
    let owners = &ground.parts.owners;
    assert!(owners.all().is_empty());
    assert_eq!(owners.address_of(&profile("alice")).ok(), Some(alice));
    let mut accounts = owners.accounts();
    accounts.sort();
    let mut expected = vec![alice, bob];
    expected.sort();
    assert_eq!(accounts, expected);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_owner_who_is_opened_anew_takes_the_place_of_the_former_one() {
    let ground = Ground::with(&[]);
    let former = ground.owner("alice");
    let keyring = former.keyring().duplicate();
    let anew = Arc::new(crate::pipeline::Owner::new(profile("alice"), keyring));
    ground.parts.owners.insert(&anew);
    assert!(ground.parts.owners.is_open(&anew) && !ground.parts.owners.is_open(&former));
    assert_eq!(ground.parts.owners.all().len(), 1);
}
