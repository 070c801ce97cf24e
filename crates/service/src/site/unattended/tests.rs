//! A credential is made once, works without its owner until the loan ends, and makes room when the owner comes.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use super::*;
use crate::chain::Call;
use crate::crypto::{Passphrase, UnlockedKeyring};
use crate::model::ErrorKind;
use crate::pipeline::Owner;
use crate::service::command::{SecretText, UnattendedCommand};
use crate::service::reply::Reply;
use crate::site::Needs;
use crate::site::testing::{PASSPHRASE, config, profile, registered, site_with_chain};
use crate::store::SiteLock;

async fn again(folder: &Path) -> Arc<Site> {
    let home = Home::new(folder.join("home"));
    // Tasks of the site before may still be ending.
    let lock = loop {
        if let Some(lock) = SiteLock::acquire(&home.site_lock()).expect("a lock") {
            break lock;
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    };
    Site::start(home, config(&[]), lock, Needs { ros: false, chain: true }).expect("starts")
}

async fn prepare(site: &Arc<Site>, owner: &Arc<Owner>, topics: &[&str]) -> Result<UnattendedCredential, Failure> {
    let topics = topics.iter().map(|topic| topic.parse().expect("a topic")).collect();
    let until = Timestamp::now().end_after(Duration::from_secs(86_400));
    let command = UnattendedCommand::PrepareUnattended { topics, until };
    match site.unattended.answer(owner, command).await? {
        Reply::UnattendedPrepared(made) => Ok(UnattendedCredential::parse(made.file.expose()).expect("it parses")),
        other => panic!("{other:?}"),
    }
}

/// Waits until the capture of a site has come to this state.
async fn until(site: &Site, state: UnattendedState) -> UnattendedView {
    for _ in 0..600 {
        let view = site.unattended.view(&profile("alice")).expect("read").expect("prepared");
        if view.state == state {
            return view;
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    panic!("not {state:?} within a minute: {:?}", site.unattended.view(&profile("alice")));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_credential_covers_watched_topics_and_there_is_one_at_a_time() {
    let (site, _folder) = site_with_chain();
    let alice = registered(&site, "alice").await;
    assert_eq!(prepare(&site, &alice, &[]).await.expect_err("nothing is watched").kind, ErrorKind::Usage);
    site.capture.watch(&profile("alice"), "/odom".parse().expect("a topic"), None).await.expect("watched");
    assert_eq!(prepare(&site, &alice, &["/imu"]).await.expect_err("not watched").kind, ErrorKind::Input);
    let credential = prepare(&site, &alice, &["/odom"]).await.expect("made");
    let enrolment = &credential.enrolment;
    assert_eq!((enrolment.owner, enrolment.owner_key), (alice.address, alice.public_keys().0));
    assert!(enrolment.index.is_none() && enrolment.gateway.addresses.is_empty());
    let rows = site.devices.rows(&alice).await.expect("rows");
    assert_eq!(rows.iter().map(|row| (row.device, &*row.state)).collect::<Vec<_>>(), [(enrolment.device_id(), "lent")]);
    assert_eq!(until(&site, UnattendedState::Prepared).await.account, credential.witness.address());
    let network = site.network().await.expect("a network");
    assert!(network.directory.identity(credential.witness.address()).is_ok(), "it may anchor");
    let twice = prepare(&site, &alice, &[]).await.expect_err("one stands");
    assert!(twice.kind == ErrorKind::Refused && twice.message.contains("unattended end"), "{}", twice.message);
    site.unattended.answer(&alice, UnattendedCommand::EndUnattended { force: false }).await.expect("ended");
    assert!(site.unattended.view(&profile("alice")).expect("read").is_none());
    assert_eq!(alice.sealing().map(|keys| keys.epoch), Some(2), "a new epoch");
    assert_ne!(prepare(&site, &alice, &[]).await.expect("another").witness, credential.witness);
    site.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn it_stops_when_it_is_recalled_and_makes_room_for_the_owner() {
    let (site, folder) = site_with_chain();
    let alice = registered(&site, "alice").await;
    registered(&site, "bob").await;
    site.capture.watch(&profile("alice"), "/odom".parse().expect("a topic"), None).await.expect("watched");
    let credential = prepare(&site, &alice, &[]).await.expect("made");
    let device = credential.enrolment.device_id();
    drop(alice);
    site.stop().await;

    let site = again(folder.path()).await;
    let other = site.capture_unattended(&profile("bob"), credential.clone()).await.expect_err("alice's");
    assert!(other.message.contains("is for profile 'alice'"), "{}", other.message);
    let view = site.capture_unattended(&profile("alice"), credential).await.expect("begun");
    assert_eq!((view.state, view.topics), (UnattendedState::Capturing, vec!["/odom".to_owned()]));
    assert!(site.recorder.is_watched("/odom", view_owner(&site)));
    let locked = site.unlocked(&profile("alice")).err().expect("locked");
    assert!(
        locked.kind == ErrorKind::Refused && locked.message.contains("runs unattended until"),
        "{}",
        locked.message
    );

    // By the owner's keyring elsewhere.
    let network = site.network().await.expect("a network");
    let passphrase = Passphrase::new(PASSPHRASE.to_owned()).expect("long enough");
    let keyring = UnlockedKeyring::open(&site.home().keyring(&profile("alice")), &passphrase).expect("opens");
    let sent = site.parts.sender.send(&network.chain, &keyring.keyring.eoa, Call::Recall { device }, "recall").await;
    sent.expect("recalled");
    let ended = until(&site, UnattendedState::Ended).await;
    assert!(ended.why.is_some_and(|why| why.contains("recalled")));
    assert!(!site.recorder.is_watched("/odom", view_owner(&site)));

    site.profiles.unlock(profile("alice"), SecretText::new(PASSPHRASE.to_owned())).await.expect("unlocked");
    until(&site, UnattendedState::Attended).await;
    let owner = site.unlocked(&profile("alice")).expect("open");
    assert!(site.recorder.is_watched("/odom", owner.address));
    assert_eq!(owner.sealing().map(|keys| keys.signer), Some(crate::crypto::signer_id(&owner.public_keys().0)));
    for _ in 0..600 {
        if !site.unattended.anchors_for(owner.address) {
            return site.stop().await;
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    panic!("the owner's anchoring waits for ever");
}

fn view_owner(site: &Site) -> Address {
    site.parts.owners.address_of(&profile("alice")).expect("known")
}
