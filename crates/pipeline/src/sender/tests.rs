//! Lanes on the embedded chain.

use super::*;
use crate::chain::Call;
use crate::model::{RecordState, SignerId};
use crate::pipeline::fixture::{Process, by_hand};
use crate::store::{Anchors, NewTransaction, Reissue, TransactionOutcome};

fn lend(number: u8) -> Call {
    Call::Lend { device: SignerId([number; 32]), until: None }
}

fn states(process: &Process, hash: Hash) -> TransactionState {
    process.plant.ledger.lanes.transaction(hash).expect("read").expect("kept").state
}

/// Stores a signed transaction as if the process had ended right after.
async fn keep(process: &Process, nonce: u64, outgoing: &Outgoing) -> (Hash, Vec<u8>) {
    let signed = process.network.chain.sign(&process.eoa, nonce, &outgoing.call).await.expect("signs");
    let (account, raw) = (process.eoa.address(), signed.raw.clone());
    let (purpose, anchors) = (outgoing.purpose.clone(), outgoing.anchors.clone());
    let row = NewTransaction { hash: signed.hash, account, nonce, raw, purpose, anchors };
    process.plant.ledger.lanes.submit(row).expect("kept");
    (signed.hash, signed.raw)
}

async fn next(process: &Process) -> u64 {
    process.network.chain.nonce(process.eoa.address(), true).await.expect("nonce")
}

#[tokio::test(flavor = "multi_thread")]
async fn what_was_stored_and_never_sent_is_sent() {
    let home = tempfile::tempdir().expect("folder");
    let process = Process::on_embedded(home.path()).await;
    process.store(0..3);
    let first = next(&process).await;
    for number in 0..3 {
        keep(&process, first + number, &Process::upload(number)).await;
    }
    let state = process.sender.state_of(process.eoa.address()).expect("state");
    assert!(state.open == 3 && state.oldest.is_some() && state.paused.is_none());
    process.rounds_until("all are confirmed", |process| process.count(RecordState::Confirmed) == 3).await;
    assert_eq!(process.anchored(0..3).await, [1, 1, 1]);
    process
        .rounds_until("the lane is empty", |process| {
            process.sender.state_of(process.eoa.address()).expect("state") == LaneState::idle(process.eoa.address())
        })
        .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn two_processes_with_one_account_interleave() {
    let home = tempfile::tempdir().expect("folder");
    let one = Process::on_embedded(home.path()).await;
    let two = Process::new(one.network.chain.clone(), one.eoa.clone(), Policy::default()).await;
    one.store(0..60);
    two.store(100..160);
    let deadline = Instant::now() + Duration::from_secs(120);
    while one.count(RecordState::Confirmed) + two.count(RecordState::Confirmed) < 120 {
        tokio::join!(one.anchor(7), two.anchor(5));
        tokio::join!(one.round(), two.round());
        assert!(
            Instant::now() < deadline,
            "{:?} {:?}",
            one.plant.ledger.counts.by_state(None),
            two.plant.ledger.counts.by_state(None)
        );
    }
    assert!(one.anchored(0..60).await.into_iter().chain(one.anchored(100..160).await).all(|times| times == 1));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_hole_in_the_nonces_is_filled() {
    let home = tempfile::tempdir().expect("folder");
    let process = Process::on_embedded(home.path()).await;
    process.store(0..1);
    let first = next(&process).await;
    keep(&process, first + 3, &Process::upload(0)).await;
    process.rounds_until("it is confirmed", |process| process.count(RecordState::Confirmed) == 1).await;
    assert_eq!(next(&process).await, first + 4);
    assert_eq!(process.anchored(0..1).await, [1]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_taken_nonce_gives_records_back_and_signs_other_calls_again() {
    let home = tempfile::tempdir().expect("folder");
    let process = Process::on_embedded(home.path()).await;
    process.store(0..1);
    let first = next(&process).await;
    let (upload, _) = keep(&process, first, &Process::upload(0)).await;
    let (lent, _) = keep(&process, first + 1, &Outgoing::plain(lend(9), "lend")).await;
    by_hand(&process.network.chain, &process.eoa, &lend(1)).await;
    by_hand(&process.network.chain, &process.eoa, &lend(2)).await;
    process.rounds_until("the record is stored again", |process| process.count(RecordState::Stored) == 1).await;
    assert_eq!(states(&process, upload), TransactionState::Replaced);
    let device = SignerId([9; 32]);
    process
        .rounds_until("the device is lent", |process| {
            let account = process.network.directory.account(process.eoa.address());
            account.is_some_and(|account| account.devices.iter().any(|lending| lending.device == device))
        })
        .await;
    let (hash, receipt) =
        process.sender.wait_mined(&process.network.chain, &process.eoa, lent, "lend").await.expect("followed");
    assert!(hash != lent && receipt.success && states(&process, lent) == TransactionState::Replaced);
    process.anchor(1).await;
    process.rounds_until("it is confirmed", |process| process.count(RecordState::Confirmed) == 1).await;
    assert_eq!(process.anchored(0..1).await, [1]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_replaced_transaction_that_was_mined_after_all_is_recognised() {
    let home = tempfile::tempdir().expect("folder");
    let process = Process::on_embedded(home.path()).await;
    process.store(0..1);
    let nonce = next(&process).await;
    let (old, raw) = keep(&process, nonce, &Process::upload(0)).await;
    // At a price: this account holds nothing, so the more expensive one can never be mined.
    let dearer = process.network.chain.resign(&process.eoa, &raw, nonce, 5).await.expect("signs");
    let reissue = Reissue { hash: dearer.hash, nonce, raw: dearer.raw };
    process.plant.ledger.lanes.reissue(old, reissue.clone()).expect("replaced");
    assert!(process.plant.ledger.lanes.reissue(old, reissue).is_err(), "only an open one is replaced");
    let row = process.plant.ledger.records.find(crate::pipeline::fixture::digest(0)).expect("read").expect("kept");
    assert_eq!((row.state, row.transaction), (RecordState::Submitted, Some(dearer.hash)));
    process.network.chain.broadcast(&raw).await.expect("sent");
    process.rounds_until("it is confirmed", |process| process.count(RecordState::Confirmed) == 1).await;
    process.rounds_until("the nonce is decided", |process| states(process, old) == TransactionState::Mined).await;
    assert_eq!(states(&process, dearer.hash), TransactionState::Replaced);
    let row = process.plant.ledger.records.find(crate::pipeline::fixture::digest(0)).expect("read").expect("kept");
    assert_eq!((row.transaction, process.anchored(0..1).await), (Some(old), vec![1]));
}

#[tokio::test(flavor = "multi_thread")]
async fn an_account_that_cannot_pay_pauses_its_lane_and_tells_once() {
    let home = tempfile::tempdir().expect("folder");
    let process = Process::on_embedded(home.path()).await;
    let (account, nonce) = (process.eoa.address(), next(&process).await);
    // Gas is free here, so the unaffordable part is the ether to send.
    let signed = process.network.chain.sign_transfer(&process.eoa, nonce, account, 5, 0).expect("signs");
    let (hash, raw) = (signed.hash, signed.raw);
    let row = NewTransaction { hash, account, nonce, raw, purpose: "x".to_owned(), anchors: Anchors::Nothing };
    process.plant.ledger.lanes.submit(row).expect("kept");
    process
        .rounds_until("it is paused", |process| {
            matches!(process.sender.state_of(account).expect("state").paused, Some(PauseReason::NoEther(_)))
        })
        .await;
    assert_eq!(process.sender.room(account).expect("room"), 0);
    process.round().await;
    process.round().await;
    assert_eq!((process.notes.with("too little ether"), process.notes.with("resumes")), (1, 0));
    assert!(process.notes.all().iter().any(|(urgent, text)| *urgent && text.contains("records are safe")));
    process.plant.ledger.lanes.close_transactions(vec![(hash, TransactionOutcome::Replaced)]).expect("given up");
    process.round().await;
    assert_eq!((process.notes.with("resumes"), process.sender.room(account).expect("room")), (1, 1024));
}

#[tokio::test(flavor = "multi_thread")]
async fn what_offered_far_too_much_is_offered_again_for_less() {
    let home = tempfile::tempdir().expect("folder");
    let process = Process::on_embedded(home.path()).await;
    process.store(0..1);
    let nonce = next(&process).await;
    let (old, raw) = keep(&process, nonce, &Process::upload(0)).await;
    let dear = process.network.chain.resign(&process.eoa, &raw, nonce, 1_000).await.expect("signs");
    let reissue = Reissue { hash: dear.hash, nonce, raw: dear.raw };
    process.plant.ledger.lanes.reissue(old, reissue).expect("replaced");
    // The price is 0 now, so the very first bytes come out again.
    process.rounds_until("it is confirmed", |process| process.count(RecordState::Confirmed) == 1).await;
    assert_eq!(process.anchored(0..1).await, [1]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lane_is_bounded_and_a_refused_call_keeps_nothing() {
    let home = tempfile::tempdir().expect("folder");
    let process = Process::on_embedded(home.path()).await;
    process.store(0..2);
    let account = process.eoa.address();
    let far = next(&process).await + 1_000_000;
    let room = process.sender.room(account).expect("room");
    keep(&process, far, &Process::upload(0)).await;
    assert_eq!(process.sender.room(account).expect("room"), room - 1);
    let lane = process.sender.lane(&process.network.chain, &process.eoa).await;
    assert_eq!(lane.next_nonce().await.expect("nonce"), far + 1);
    let recall = Outgoing::plain(Call::Recall { device: SignerId([1; 32]) }, "recall");
    let error = lane.submit(vec![Outgoing::plain(lend(4), "lend"), recall]).await.expect_err("no loan");
    assert!(error.to_string().contains("not authorised"), "{error}");
    assert_eq!(process.sender.state_of(account).expect("state").open, 1);
}
