//! Loans of devices, on an embedded chain, and the enrolled robots.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use super::*;
use crate::model::{ErrorKind, PublicKey};
use crate::site::Enrolments;
use crate::site::testing::{Ground, registered, site_with_chain};
use crate::store::notes::Enrolled;

const ROBOT: SignerId = SignerId([7; 32]);

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_loan_is_given_once_and_its_recall_begins_an_epoch() {
    let (site, _folder) = site_with_chain();
    let alice = registered(&site, "alice").await;
    let devices = &site.devices;
    let past = Some(Timestamp::from_seconds(1));
    assert_eq!(devices.lend(&alice, ROBOT, past).await.expect_err("ended before it begins").kind, ErrorKind::Input);
    devices.lend(&alice, ROBOT, None).await.expect("lent");
    assert_eq!(devices.lend(&alice, ROBOT, None).await.expect_err("lent already").kind, ErrorKind::Refused);
    let rows = devices.rows(&alice).await.expect("rows");
    assert_eq!(rows.iter().map(|row| (row.device, row.recalled)).collect::<Vec<_>>(), [(ROBOT, None)]);

    let recalled = devices.recall(&alice, &ROBOT.to_string()).await.expect("recalled");
    assert_eq!((recalled.epoch, alice.sealing().map(|keys| keys.epoch)), (2, Some(2)));
    assert!(devices.rows(&alice).await.expect("rows").iter().all(|row| row.recalled.is_some()));
    let twice = devices.recall(&alice, &ROBOT.to_string()).await.expect_err("no longer authorised");
    assert!(twice.message.contains("no such device is authorised"), "{}", twice.message);
    site.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn enrolled_robots_survive_a_restart_and_one_that_was_recalled_stays_ended() {
    let ground = Ground::with(&[]);
    let (alice, bob) = (ground.owner("alice"), ground.owner("bob"));
    let enrolments = Enrolments::new(&ground.parts);
    let robot = |name: &str, device| Enrolled {
        name: name.parse().expect("a name"),
        device,
        topics: vec!["/odom".to_owned()],
        ended: false,
        key: PublicKey([9; 64]),
        gateway: None,
    };
    enrolments.add(&alice, robot("scout-1", ROBOT)).expect("noted");
    enrolments.add(&alice, robot("scout-2", SignerId([8; 32]))).expect("noted");
    enrolments.note_recalled(&alice, ROBOT).expect("noted");
    drop(enrolments);
    let ground = ground.again();
    let enrolments = Enrolments::new(&ground.parts);
    let known = enrolments.of(&alice).expect("robots");
    let told: Vec<_> = known.iter().map(|robot| (robot.name.as_str(), robot.ended)).collect();
    assert_eq!(told, [("scout-1", true), ("scout-2", false)]);
    assert!(enrolments.of(&bob).expect("robots").is_empty(), "each owner has its own");
}
