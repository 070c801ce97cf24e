//! Who may use the gateway of this home.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use std::net::SocketAddr;
use std::sync::Arc;

use crate::gateway::Desk as _;
use crate::model::{Address, Party};
use crate::reply::{Event, NoticeLevel};
use crate::site::testing::{Ground, profile, registered, site_with_chain};
use crate::site::{Admissions, Contacts};

const GUEST: Address = Address([9; 20]);

fn admissions(ground: &Ground) -> Arc<Admissions> {
    Arc::new(Admissions::new(&ground.parts, &Arc::new(Contacts::new(&ground.parts))))
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_admission_survives_a_restart_and_ends_with_the_dismissal() {
    let ground = Ground::with(&[]);
    let keeper = profile("keeper");
    let list = admissions(&ground);
    list.admit(&keeper, &Party::Address(GUEST)).await.expect("admitted");
    list.admit(&keeper, &Party::Address(GUEST)).await.expect("once is enough");
    assert_eq!(
        ground.audited("gateway allow"),
        ["begun", "done"].map(|outcome| (GUEST.to_string(), outcome.to_owned()))
    );
    drop(list);

    let ground = ground.again();
    let list = admissions(&ground);
    assert!(!list.is_on_list(&GUEST), "not read yet");
    list.open().expect("read");
    assert!(list.is_on_list(&GUEST));
    let rows = list.rows().expect("rows");
    assert_eq!(rows.iter().map(|row| (row.owner, row.by.as_str())).collect::<Vec<_>>(), [(GUEST, "keeper")]);
    assert!(list.dismiss(&keeper, &Party::Address(GUEST)).await.expect("dismissed").is_empty());
    assert!(!list.is_on_list(&GUEST));
    let twice = list.dismiss(&keeper, &Party::Address(GUEST)).await.expect_err("not admitted");
    assert!(twice.message.contains("gateway allowed"), "{}", twice.message);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_profile_of_the_home_cannot_be_dismissed_also_while_it_is_not_open() {
    let ground = Ground::with(&[]);
    let own = ground.owner("alice").address;
    let ground = ground.again();
    let refused = admissions(&ground).dismiss(&profile("alice"), &Party::Address(own)).await.expect_err("of this home");
    assert!(refused.message.contains("a profile of this home"), "{}", refused.message);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn each_account_that_is_not_allowed_has_a_notice_of_its_own() {
    let (site, _folder) = site_with_chain();
    let keeper = registered(&site, "keeper").await;
    let desk = site.gateway.desk_of(&keeper, site.network().await.expect("a chain").domain);
    let mut events = site.parts.hub.events().subscribe();
    let other = Address([8; 20]);
    for (number, guest) in [(1, GUEST), (2, other)] {
        let refusal = desk.admits(&guest, None).await.expect_err("not allowed");
        desk.refused(SocketAddr::from(([192, 0, 2, number], 1)), &refusal);
    }
    site.gateway.admissions.admit(&keeper.profile, &Party::Address(GUEST)).await.expect("allowed");
    let mut told = Vec::new();
    while let Ok(event) = events.try_recv() {
        if let Event::Notice { about: Some(about), level, .. } = event
            && about.starts_with("allow ")
        {
            told.push((about, level));
        }
    }
    let [guest, other] = [GUEST, other].map(|account| format!("allow {account}"));
    let expected = [(guest.clone(), NoticeLevel::Warning), (other, NoticeLevel::Warning), (guest, NoticeLevel::Info)];
    assert_eq!(told, expected, "what is done about one account leaves the other's notice");
    site.stop().await;
}
