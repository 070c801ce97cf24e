//! Witnesses as an operator adds and removes them, and what becomes of one that does not answer.

use super::*;
use crate::crypto::signer_id;
use crate::model::ErrorKind;
use crate::service::hub::Hub;
use crate::site::testing::{Ground, profile};
use crate::store::KeptContradiction;

const PARTY: SignerId = SignerId([7; 32]);

fn add(name: &str, gateway: Option<&str>, serves: bool) -> WitnessCommand {
    let (account, gateway) = (Address([9; 20]), gateway.map(str::to_owned));
    WitnessCommand::AddWitness { name: name.to_owned(), account, key: PARTY, gateway, serves }
}

async fn listed(witnesses: &Arc<Witnesses>, command: WitnessCommand) -> Result<Vec<WitnessView>, Failure> {
    match witnesses.answer(&profile("default"), command).await? {
        Reply::Witnesses(rows) => Ok(rows),
        other => panic!("{other:?}"),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_party_is_added_changed_and_removed_and_the_log_says_so() {
    let ground = Ground::with(&[]);
    let owner = ground.owner("default");
    let witnesses = Arc::new(Witnesses::new(&ground.parts));
    assert_eq!(witnesses.health().expect("read"), None, "nothing is said where there is none");
    for wrong in [
        add("", Some("h:1"), true),
        add(" w", Some("h:1"), true),
        add("a\u{1b}[2J", Some("h:1"), true),
        add("w", Some("h"), true),
        add("w", Some("h:x"), true),
        add("w", None, false),
    ] {
        let failure = listed(&witnesses, wrong.clone()).await.expect_err("refused");
        assert_eq!(failure.kind, ErrorKind::Input, "{wrong:?}");
    }
    let own = WitnessCommand::AddWitness {
        name: "me".to_owned(),
        account: Address([8; 20]),
        key: signer_id(&owner.signing().public),
        gateway: Some("h:1".to_owned()),
        serves: false,
    };
    assert!(listed(&witnesses, own).await.expect_err("refused").message.contains("that is this profile"));
    listed(&witnesses, add("The harbour", Some("h:1"), false)).await.expect("added");
    let rows = listed(&witnesses, add("The harbour", Some("h:2"), true)).await.expect("changed");
    assert_eq!((rows.len(), rows[0].gateway.as_deref(), rows[0].serves), (1, Some("h:2"), true));
    let health = witnesses.health().expect("read").expect("there is one");
    assert_eq!((health.level, health.text.as_str()), (HealthLevel::Ok, "1 asked, none yet; 1 served"));
    let gone = WitnessCommand::RemoveWitness { name: "The harbour".to_owned() };
    assert!(listed(&witnesses, gone.clone()).await.expect("removed").is_empty());
    assert!(listed(&witnesses, gone).await.expect_err("gone").message.contains("no witness is named"));
    let lines = (ground.audited("add witness").len(), ground.audited("remove witness").len());
    assert_eq!(lines, (4, 2), "each begun and done, and what was refused is neither");
}

#[tokio::test(flavor = "multi_thread")]
async fn one_that_does_not_answer_is_told_once_and_asked_later_and_later() {
    let ground = Ground::with(&[]);
    let owner = ground.owner("default").address;
    let witnesses = Arc::new(Witnesses::new(&ground.parts));
    listed(&witnesses, add("The harbour", Some("h:1"), true)).await.expect("added");
    let row = witnesses.of(owner).await.expect("read").remove(0);
    let mut events = Hub::events(&ground.parts.hub).subscribe();
    let failure = Failure::new(ErrorKind::Unreachable, "nobody is there");
    let mut pauses = Vec::new();
    for _ in 0..8 {
        witnesses.failed(&row, &failure);
        pauses.push(witnesses.with(|last| last[&(owner, PARTY)].pause.as_secs()));
    }
    assert_eq!(pauses, [60, 120, 240, 480, 960, 1920, 3600, 3600]);
    let mut told = 0;
    while let Ok(event) = events.try_recv() {
        told += usize::from(format!("{event:?}").contains("waits for its witness"));
    }
    assert_eq!(told, 1);
    let health = witnesses.health().expect("read").expect("there is one");
    assert_eq!(health.level, HealthLevel::Waiting);
    assert!(health.text.contains("8 attempts failed: nobody is there"), "{}", health.text);
    witnesses.succeeded(&row);
    assert_eq!(witnesses.health().expect("read").expect("there is one").level, HealthLevel::Ok);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_party_with_two_histories_is_shown_with_both_statements_until_it_is_removed() {
    let ground = Ground::with(&[]);
    ground.owner("default");
    let witnesses = Arc::new(Witnesses::new(&ground.parts));
    listed(&witnesses, add("The fleet", None, true)).await.expect("added");
    let position = crate::model::Position {
        chain_id: 7,
        genesis: crate::model::Hash([1; 32]),
        contract: Address([2; 20]),
        owner: Address([9; 20]),
        key: crate::model::PublicKey([4; 64]),
        recorder: crate::model::RecorderId([5; 16]),
        block: 6,
        block_hash: crate::model::Hash([7; 32]),
        earlier: None,
        top: crate::model::Hash([8; 32]),
        count: 1,
        head: None,
    };
    let later = crate::model::SignedPosition { position, signature: crate::model::Signature([3; 64]) };
    let kept = crate::model::Countersignature {
        stated: later,
        at: Timestamp(5),
        witness: Address([6; 20]),
        key: crate::model::PublicKey([7; 64]),
        signature: crate::model::Signature([8; 64]),
    };
    let what = "block 6 of its chain has two hashes".to_owned();
    let found = KeptContradiction { party: PARTY, at: Timestamp(9), what, kept, later };
    assert!(ground.parts.plant.ledger.keep_contradiction(found).expect("kept"));
    let health = witnesses.health().expect("read").expect("there is one");
    assert!(
        health.level == HealthLevel::Failed && health.text.contains("The fleet stated two histories"),
        "{health:?}"
    );
    let view = witnesses.answer(&profile("default"), WitnessCommand::WitnessStatus).await.expect("answered");
    let Reply::WitnessStatus(view) = view else { panic!("{view:?}") };
    let shown = &view.contradictions[0];
    assert_eq!((shown.name.as_deref(), shown.kept.len(), shown.later.len()), (Some("The fleet"), 2 * 541, 2 * 385));
    listed(&witnesses, WitnessCommand::RemoveWitness { name: "The fleet".to_owned() }).await.expect("removed");
    assert_eq!(witnesses.health().expect("read"), None);
    let view = witnesses.answer(&profile("default"), WitnessCommand::WitnessStatus).await.expect("answered");
    let Reply::WitnessStatus(view) = view else { panic!("{view:?}") };
    assert_eq!((view.contradictions.len(), view.contradictions[0].name.clone()), (1, None), "they are kept");
}
