//! Quarantined messages are shown to their owner alone, and deleted only once the chain counts them.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use super::*;
use crate::model::{Address, RecordKind, Signature, SignerId, TopicId};
use crate::site::Contacts;
use crate::site::testing::{Ground, profile};
use crate::store::{Hold, NewRecord};

fn quarantine(ground: &Ground) -> Arc<Quarantine> {
    let contacts = Arc::new(Contacts::new(&ground.parts));
    Arc::new(Quarantine::new(&ground.parts, &Arc::new(Reading::new(&ground.parts, &contacts))))
}

/// Quarantines a message of the owner, as the sealer does.
fn hold(ground: &Ground, owner: Address, seq: u64) -> Digest {
    let digest = Digest(crate::crypto::sm3::sm3(&[&owner.0, &seq.to_be_bytes()]));
    let record = NewRecord {
        digest,
        owner,
        topic_id: TopicId([1; 16]),
        seq,
        foreign: None,
        epoch: 1,
        kind: RecordKind::Data,
        signer: SignerId([1; 32]),
        signature: Signature([7; 64]),
        filters: Vec::new(),
        topic: "/odom".to_owned(),
        type_name: "a/B".to_owned(),
        bytes: 9,
        captured_at: Timestamp::from_seconds(seq),
        simulated: false,
        state: RecordState::Quarantined,
        blob: Some(b"ciphertext".to_vec()),
    };
    let hold = Hold { digest, reason: "new", publisher: "/evil@h:a/B:0".to_owned() };
    ground.parts.plant.ledger.quarantine.append_held(vec![record], vec![hold]).expect("held");
    digest
}

/// An owner who seals.
fn owner(ground: &Ground, name: &str) -> Arc<Owner> {
    let owner = ground.owner(name);
    let domain = crate::model::Domain([5; 32]);
    owner.prepare_epoch(domain, 1).expect("prepared");
    owner.seal_under(domain, 1).expect("seals");
    owner
}

fn all() -> Held {
    Held { topic: Some("/odom".parse().expect("a topic")), ids: Vec::new() }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nothing_is_deleted_while_no_record_on_the_chain_counts_it() {
    let ground = Ground::with(&[]);
    let (quarantine, owner) = (quarantine(&ground), owner(&ground, "alice"));
    let digest = hold(&ground, owner.address, 1);
    // There is no chain for the quarantine record, and the site ends.
    ground.parts.life.stop();
    let refused = quarantine.discard(&owner, all()).await.expect_err("not counted yet");
    assert_eq!(refused.kind, ErrorKind::Incomplete);
    assert!(refused.message.starts_with("nothing was discarded"), "{}", refused.message);
    assert!(ground.parts.plant.ciphertext.get(digest).expect("readable").is_some());
    let view = quarantine.view(&profile("alice"), None, 10).expect("a list");
    assert_eq!((view.messages, view.records.len()), (1, 1));
    assert!(view.records.iter().all(|held| held.report.is_some()), "counted by a record that waits for the chain");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_release_is_written_down_first_and_touches_nobody_elses_messages() {
    let ground = Ground::with(&[]);
    let quarantine = quarantine(&ground);
    let (alice, bob) = (owner(&ground, "alice"), owner(&ground, "bob"));
    let (own, other) = (hold(&ground, alice.address, 1), hold(&ground, bob.address, 2));
    let id_of = |digest| ground.parts.plant.ledger.records.find(digest).expect("readable").expect("there").id;
    let strange = Held { topic: None, ids: vec![id_of(other)] };
    let refused = quarantine.release(&alice, strange).await.expect_err("another's");
    assert!(refused.message.contains("is not in quarantine"), "{}", refused.message);

    let decided = quarantine.release(&alice, all()).await.expect("released");
    assert_eq!((decided.decision.as_str(), decided.messages), ("released", 1));
    let state = |digest| ground.parts.plant.ledger.records.find(digest).expect("readable").expect("there").state;
    assert_eq!((state(own), state(other)), (RecordState::Stored, RecordState::Quarantined));
    let written = ground.audited("release quarantined");
    assert!(written.iter().all(|(subject, _)| subject.starts_with("/odom: 1 message ")), "{written:?}");
    assert_eq!(written.iter().map(|(_, outcome)| outcome.as_str()).collect::<Vec<_>>(), ["begun", "done"]);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_pattern_names_the_topics_whose_messages_are_decided_about() {
    let ground = Ground::with(&[]);
    let (quarantine, alice) = (quarantine(&ground), owner(&ground, "alice"));
    let digest = hold(&ground, alice.address, 1);
    let pattern = |text: &str| Some(text.parse().expect("a pattern"));
    for (text, messages) in [("/o?om", 1), ("/robot1/**", 0)] {
        let view = quarantine.view(&profile("alice"), pattern(text), 10).expect("a list");
        assert_eq!((view.messages, view.records.len() as u64), (messages, messages), "{text}");
    }
    for (text, messages) in [("/robot1/**", 0), ("/o*", 1)] {
        let held = Held { topic: pattern(text), ids: Vec::new() };
        assert_eq!(quarantine.release(&alice, held).await.expect("decided").messages, messages, "{text}");
    }
    let row = ground.parts.plant.ledger.records.find(digest).expect("readable").expect("there");
    assert_eq!(row.state, RecordState::Stored);
}
