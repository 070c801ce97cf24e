//! Free space on the disk, and what is reported after an unclean end.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use std::sync::Arc;
use std::time::Duration;

use crate::reply::Event;
use crate::site::testing::Ground;
use crate::site::{Contacts, Parts, Reading, Storage};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn below_the_reserve_no_record_is_taken_and_the_operator_is_told_why() {
    // No disk has as much left.
    let ground = Ground::with(&[("disk.reserve", "1000000GiB")]);
    let storage = Arc::new(Storage::new(&ground.parts, &reading(&ground.parts)));
    assert!(storage.fault() == Ok(None) && ground.parts.plant.ledger.records.takes_records().is_ok());
    let mut events = ground.parts.hub.events().subscribe();
    let kept = tokio::spawn(Arc::clone(&storage).keep_room());
    let text = loop {
        if let Event::Notice { text, .. } = events.recv().await.expect("a notice") {
            break text;
        }
    };
    assert!(text.contains("less than disk.reserve"), "{text}");
    assert!(ground.parts.plant.ledger.records.takes_records().is_err());
    let told = storage.fault().expect("read").expect("told in the health too");
    assert!(told.contains("no further record is acknowledged"), "{told}");
    ground.parts.life.stop();
    kept.await.expect("ends with the site");
    assert!(ground.parts.plant.ledger.records.takes_records().is_ok(), "held by the task alone");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn after_an_unclean_end_it_is_told_whether_all_is_sound() {
    let ground = Ground::with(&[]);
    // The first start of a home is not preceded by an end.
    let clean = ground.parts.plant.ledger.inspection.ended_cleanly();
    let crate::site::testing::Ground { parts, folder, .. } = ground;
    let (home, config) = (parts.home.clone(), crate::config::Config::clone(&parts.config));
    parts.log.write(&crate::site::testing::profile("alice"), "deed", "", "done").await.expect("the first change");
    // Not closed: as after a crash.
    drop(parts);
    let (parts, _opened, _) = crate::site::parts::Parts::open(home, config, false).expect("opens");
    assert!(clean && !parts.plant.ledger.inspection.ended_cleanly());
    let mut events = parts.hub.events().subscribe();
    Arc::new(Storage::new(&parts, &reading(&parts))).check_after_crash().await;
    let told = tokio::time::timeout(Duration::from_secs(60), events.recv()).await.expect("soon").expect("a notice");
    assert!(matches!(told, Event::Notice { text, .. } if text.contains("the store is sound")));
    drop(folder);
}

fn reading(parts: &Parts) -> Arc<Reading> {
    Arc::new(Reading::new(parts, &Arc::new(Contacts::new(parts))))
}
