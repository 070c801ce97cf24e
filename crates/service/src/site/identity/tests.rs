//! Whose keys are open, and the errors if they are not.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use std::sync::Arc;

use crate::command::SecretText;
use crate::crypto::{Keyring, Passphrase, UnlockedKeyring};
use crate::model::{Domain, ErrorKind};
use crate::pipeline::Owner;
use crate::reply::Result;
use crate::site::testing::{Ground, PASSPHRASE, profile, site_of};
use crate::site::{Needs, Site};

const DOMAIN: Domain = Domain([1; 32]);

/// A site without a chain, and in its home the keyring of alice, which nobody has opened yet.
fn site_with_keyring() -> (Arc<Site>, tempfile::TempDir) {
    let (site, folder) = site_of(&[], Needs { ros: false, chain: false });
    let keyring = Keyring::generate(site.plant.provider).expect("keys");
    let path = site.parts.home.keyring(&profile("alice"));
    UnlockedKeyring::create(keyring, &path, &passphrase(PASSPHRASE)).expect("a keyring");
    (site, folder)
}

fn passphrase(text: &str) -> Passphrase {
    Passphrase::new(text.to_owned()).expect("long enough")
}

/// Unlocks alice, and returns the owner whom a command that comes next would use.
fn unlock(site: &Arc<Site>, words: &str) -> tokio::task::JoinHandle<Result<Arc<Owner>>> {
    let (site, secret) = (Arc::clone(site), SecretText::new(words.to_owned()));
    tokio::spawn(async move {
        site.profiles.unlock(profile("alice"), secret).await?;
        site.unlocked(&profile("alice"))
    })
}

fn epochs_in_file(site: &Site, words: &str) -> Vec<u64> {
    let path = site.parts.home.keyring(&profile("alice"));
    let keyring = Keyring::load(&path, &passphrase(words)).expect("it opens");
    keyring.networks.get(&DOMAIN).map(|network| network.epochs.keys().copied().collect()).unwrap_or_default()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn unlocks_at_once_are_one_and_each_checks_its_passphrase() {
    let (site, _folder) = site_with_keyring();
    let wrong = unlock(&site, "not the passphrase");
    let unlocks = [(); 4].map(|()| unlock(&site, PASSPHRASE));
    assert_eq!(wrong.await.expect("ends").err().expect("refused").kind, ErrorKind::Refused);
    let mut owners = Vec::new();
    for (epoch, unlocked) in (1..).zip(unlocks) {
        let owner = unlocked.await.expect("ends").expect("opens");
        owner.prepare_epoch(DOMAIN, epoch).expect("saved, in either order");
        owners.push(owner);
    }
    assert!(owners.iter().all(|owner| Arc::ptr_eq(owner, &owners[0])), "one owner");
    assert_eq!(epochs_in_file(&site, PASSPHRASE), [1, 2, 3, 4]);
    site.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_keyring_opened_while_its_passphrase_changes_can_still_be_saved() {
    const NEW: &str = "battery staple horse";
    let (site, _folder) = site_with_keyring();
    let changing = {
        let site = Arc::clone(&site);
        let [old, new] = [PASSPHRASE, NEW].map(|words| SecretText::new(words.to_owned()));
        tokio::spawn(async move { site.profiles.change_passphrase(&profile("alice"), old, new).await })
    };
    let unlocked = unlock(&site, PASSPHRASE).await.expect("ends");
    changing.await.expect("ends").expect("changed");
    // Whichever came first: the old passphrase opened it before the change, or no longer does.
    let owner = match unlocked {
        Ok(owner) => owner,
        Err(_) => unlock(&site, NEW).await.expect("ends").expect("opens"),
    };
    owner.prepare_epoch(DOMAIN, 1).expect("saved");
    assert_eq!(epochs_in_file(&site, NEW), [1]);
    site.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn keys_that_are_open_are_not_replaced_by_a_copy_of_the_file() {
    let ground = Ground::with(&[]);
    let owner = ground.owner("alice");
    let path = ground.parts.home.keyring(&profile("alice"));
    let copy = || UnlockedKeyring::open(&path, &passphrase(PASSPHRASE)).expect("opens");
    let older = copy();
    owner.prepare_epoch(DOMAIN, 1).expect("saved");
    owner.unlock(older);
    assert_eq!(owner.epochs(DOMAIN), [1]);
    owner.lock(ground.parts.plant.provider).expect("locked");
    assert!(owner.epochs(DOMAIN).is_empty());
    owner.unlock(copy());
    owner.prepare_epoch(DOMAIN, 2).expect("saved");
    assert_eq!(owner.epochs(DOMAIN), [1, 2]);
}

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
    let anew = Arc::new(former.with_new_account());
    ground.parts.owners.insert(&anew);
    assert!(ground.parts.owners.is_open(&anew) && !ground.parts.owners.is_open(&former));
    assert_eq!(ground.parts.owners.all().len(), 1);
    // Both have the one keyring: neither can lose what the other begins.
    for (owner, epoch) in [(&anew, 1), (&former, 2), (&anew, 3)] {
        owner.prepare_epoch(DOMAIN, epoch).expect("saved");
    }
    assert_eq!(anew.epochs(DOMAIN), [1, 2, 3]);
}
