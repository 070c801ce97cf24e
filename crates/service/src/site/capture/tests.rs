//! Watch lists and captures, each profile's own.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use super::ros::RosSide;
use super::watches::Watches;
use super::*;
use crate::pipeline::Recorder;
use crate::pipeline::ring::Rings;
use crate::site::testing::{Ground, profile, site_with_chain};

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
                let topic: TopicName = format!("/t{number}").parse().expect("a topic");
                lists.change(&profile("alice"), |list| list.push((topic, None)))
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
        lists.of(&profile("alice")).expect("a list").into_iter().map(|(topic, _)| topic.to_string()).collect();
    kept.sort();
    let mut expected: Vec<_> = (0..16).map(|number| format!("/t{number}")).collect();
    expected.sort();
    assert_eq!(kept, expected);
    assert!(lists.of(&profile("bob")).expect("a list").is_empty());
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
