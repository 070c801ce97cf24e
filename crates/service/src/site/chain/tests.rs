//! The link to the chain and the home's pin.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use std::sync::Arc;
use std::time::{Duration, Instant};

use super::link::{Link, NotFresh};
use crate::chain::{BlockRef, Pin};
use crate::model::{Address, ErrorKind, Hash};
use crate::reply::refused;
use crate::site::testing::Ground;
use crate::site::{Connection, NetworkState};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_asks_waits_for_the_first_attempt_and_then_hears_why_there_is_no_chain() {
    let ground = Ground::with(&[]);
    let link = Arc::new(Link::new(Arc::clone(&ground.parts.hub), true));
    let asked = tokio::spawn({
        let link = Arc::clone(&link);
        async move { link.network().await.err() }
    });
    tokio::task::yield_now().await;
    assert!(!asked.is_finished() && link.network_now().is_none());
    link.lost(NetworkState::Down { failure: refused("nobody answers there"), next: Instant::now() });
    assert_eq!(asked.await.expect("ends").expect("no chain").message, "nobody answers there");
    link.lose_chain(refused("another chain"));
    assert_eq!(link.chain().await.expect_err("no chain").message, "another chain");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_link_that_ended_is_not_lost_again() {
    let ground = Ground::with(&[]);
    let link = Link::new(Arc::clone(&ground.parts.hub), true);
    link.set(NetworkState::Off);
    link.lost(NetworkState::Down { failure: refused("late"), next: Instant::now() });
    assert!(matches!(*link.state(), NetworkState::Off));
    assert_eq!(link.network().await.err().expect("off").kind, ErrorKind::Internal);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_head_is_fresh_for_as_long_as_was_asked_and_no_longer() {
    let ground = Ground::with(&[]);
    let link = Link::new(Arc::clone(&ground.parts.hub), true);
    assert!(link.fresh_head(Duration::MAX).is_none(), "none was told");
    assert_eq!(link.view(), Err(NotFresh::Unread));
    let head = BlockRef { number: 7, hash: Hash([1; 32]), timestamp: 1_700_000_000 };
    link.saw_head(head, Instant::now());
    assert_eq!(link.view().map(|head| head.number), Ok(7));
    assert_eq!(link.fresh_head(Duration::MAX).map(|head| head.number), Some(7));
    std::thread::sleep(Duration::from_millis(2));
    assert!(link.fresh_head(Duration::from_millis(1)).is_none());
    assert_eq!(link.newest_head().map(|head| head.number), Some(7), "stale, but known");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_pin_is_kept_with_the_ledger_and_named_where_it_is_damaged() {
    let ground = Ground::with(&[]);
    let (connection, ledger) = (Connection::new(&ground.parts, None), &ground.parts.plant.ledger);
    assert!(connection.pin().expect("readable").is_none());
    let pin = Pin {
        chain_id: 1337,
        genesis: Hash([2; 32]),
        contract: Address([3; 20]),
        code_hash: Hash([4; 32]),
        deployed_at: 0,
    };
    let text = serde_json::to_string(&pin).expect("written");
    ledger.rights.bind_contract(pin.domain(), &text).expect("bound");
    ledger.rights.bind_contract(pin.domain(), &text).expect("bound again");
    assert_eq!(connection.pin().expect("readable"), Some(pin.clone()));
    ledger.rights.bind_contract(pin.domain(), "{").expect("written");
    let damaged = connection.pin().expect_err("damaged").message;
    assert!(damaged.contains("restore the last backup"), "{damaged}");
}
