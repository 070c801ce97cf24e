//! What is left of records that a rule of retention deleted, for readers who never had them.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use super::super::erasing::tests::{Ground, TOPIC, until};
use crate::model::hex;

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn what_a_rule_deleted_is_stated_to_readers_when_they_ask() {
    let ground = Ground::with(&[("retention", "/odom=1s")]).await;
    let (plant, ledger) = (&ground.site.plant, &ground.site.plant.ledger);
    let (sealed, _) = ground.here(1).await;
    ledger.names.keep(ground.alice.address, hex(&TOPIC.0), "/odom".to_owned()).expect("learned");
    until("deleted by the rule", || {
        ledger.records.find(sealed.digest).expect("read").is_some_and(|row| row.deleted_at.is_some())
    })
    .await;
    let row = ledger.records.find(sealed.digest).expect("read").expect("listed");
    let retained = ledger.retention.find(sealed.digest).expect("read").expect("accounted for");
    assert_eq!((retained.anchored, &retained.erased), (true, &None), "by nobody in person");
    let stated = ground.desk.stated(&ground.network, &row, &retained).expect("asked").expect("stated");
    stated.check(plant.provider, &sealed.digest, &sealed.header.encode()).expect("signed for this record");
    assert_eq!((stated.signer, Some(stated.at)), (ground.alice.signing().public, retained.deleted_at));
    assert_eq!(stated.report, retained.report);
    assert_eq!(ledger.erasures.kept(sealed.digest), Ok(None), "signed on request, and not kept");
    assert_eq!(ledger.erasures.list(0, 9).map(|page| page.erasures), Ok(Vec::new()), "no gateway learns of it");
    ground.site.stop().await;
}
