//! Watch lists and captures, each profile's own.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use super::*;
use crate::pipeline::{Recorder, Rings};
use crate::site::testing::{Ground, profile, site_with_chain};
use crate::site::{RosSide, Watches};

fn watches(ground: &Ground) -> Arc<Watches> {
    let rings = Arc::new(Rings::new(1 << 20));
    let recorder = Arc::new(Recorder::new(rings, Arc::default(), ground.parts.hub.clone()));
    let ros = Arc::new(RosSide::new(&ground.parts, &recorder, false));
    Arc::new(Watches::new(&ground.parts, &recorder, &ros))
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn watch_lists_survive_a_restart_and_none_of_many_changes_at_once_is_lost() {
    let ground = Ground::with(&[]);
    let lists = watches(&ground);
    let changes: Vec<_> = (0..16)
        .map(|number| {
            let lists = Arc::clone(&lists);
            tokio::spawn(async move {
                let topic = format!("/t{number}").parse().expect("a topic");
                lists.change(&profile("alice"), |rules| rules.watch(topic, None, None))
            })
        })
        .collect();
    for change in changes {
        change.await.expect("ends").expect("changed");
    }
    drop(lists);
    let ground = ground.again();
    let lists = watches(&ground);
    let mut kept: Vec<_> =
        lists.of(&profile("alice")).expect("a list").0.into_iter().map(|rule| rule.pattern.to_string()).collect();
    kept.sort();
    let mut expected: Vec<_> = (0..16).map(|number| format!("/t{number}")).collect();
    expected.sort();
    assert_eq!(kept, expected);
    assert!(lists.of(&profile("bob")).expect("a list").0.is_empty());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_profile_ends_its_own_captures_alone() {
    let (site, _folder) = site_with_chain();
    let session = || Arc::new(CaptureSession::new(&[], None, Vec::new()));
    let (own, others, ended) = (session(), session(), session());
    site.capture.note(&profile("alice"), &own);
    site.capture.note(&profile("bob"), &others);
    site.capture.note(&profile("alice"), &ended);
    site.capture.forget(&ended);
    site.capture.stop(&profile("alice"));
    assert_eq!((own.is_closed(), others.is_closed(), ended.is_closed()), (true, false, false));
    site.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_joined_home_says_that_it_captures_nothing() {
    let key = "00112233445566778899aabbccddeeff00112233445566778899aabbccddeeff";
    let joined = [("site.address", "127.0.0.1:1"), ("site.gateway_key", key)];
    let needs = crate::site::Needs { ros: false, chain: false };
    let (site, _folder) = crate::site::testing::site_of(&joined, needs);
    let alice = crate::site::testing::profile("alice");
    let secret = crate::command::SecretText::new(crate::site::testing::PASSPHRASE.to_owned());
    site.profiles.create(alice.clone(), secret).await.expect("an identity");
    let owner = site.unlocked(&alice).expect("open");
    let topics = ["/odom".parse().expect("a topic")];
    let refused = site.capture.capture(&owner, &topics, None, Some(1), None, Vec::new()).await.expect_err("joined");
    assert_eq!(refused.kind, crate::model::ErrorKind::Refused);
    assert!(refused.message.contains("joined a gateway with --site"), "{}", refused.message);
    site.stop().await;
}
