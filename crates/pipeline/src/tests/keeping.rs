//! Row and bytes are one commit: what is not accepted leaves no bytes, of this owner's records or of others'.

use std::time::Duration;

use super::*;
use crate::chain::merkle::{Inclusion, Leaf};
use crate::chain::{AnchorProof, Call};
use crate::crypto::{SealRequest, SealedRecord, TopicKey, seal};
use crate::gateway::Fetched;
use crate::gateway::desk::Received;
use crate::model::head::Compression;
use crate::model::{Address, FilterId, Hash, Head, RecorderPrefix};
use crate::pipeline::PipelineError;
use crate::pipeline::intake::{Accepted, Anchors, Intake, Reason, Refused, accept_uploads};
use crate::store::StoreError;

pub(super) fn head(body: &[u8]) -> Head {
    Head {
        topic: "/robot1/odom".to_owned(),
        type_name: "nav_msgs/Odometry".to_owned(),
        md5sum: "cd5e73d190d741a2f92e81eda573aca7".to_owned(),
        definition: Digest([4; 32]),
        caller_id: "/robot1".to_owned(),
        boot_id: [5; 16],
        compression: Compression::None,
        plain_length: body.len() as u64,
        tags: std::collections::BTreeMap::new(),
    }
}

/// A record of the owner that another ledger numbered; sealed with the wrong key, if one is given.
pub(super) fn elsewhere(owner: &Owner, seq: u64, body: &[u8], wrong: Option<&TopicKey>) -> SealedRecord {
    sealed_elsewhere(owner, seq, Vec::new(), (&head(body), body), wrong)
}

/// The same with these filters, head and body.
pub(super) fn sealed_elsewhere(
    owner: &Owner,
    seq: u64,
    filters: Vec<FilterId>,
    contents: (&Head, &[u8]),
    wrong: Option<&TopicKey>,
) -> SealedRecord {
    sealed_as(RecordKind::Data, owner, seq, filters, contents, wrong)
}

/// The same of this kind.
pub(super) fn sealed_as(
    kind: RecordKind,
    owner: &Owner,
    seq: u64,
    filters: Vec<FilterId>,
    (head, body): (&Head, &[u8]),
    wrong: Option<&TopicKey>,
) -> SealedRecord {
    sealed_by(RecorderPrefix::ledger([9; 7]), owner.address, (kind, owner, seq), filters, (head, body), wrong)
}

/// The same with a number of this recorder, as a record of `claimed`.
fn sealed_by(
    recorder: RecorderPrefix,
    claimed: Address,
    (kind, owner, seq): (RecordKind, &Owner, u64),
    filters: Vec<FilterId>,
    (head, body): (&Head, &[u8]),
    wrong: Option<&TopicKey>,
) -> SealedRecord {
    let keys = owner.sealing().expect("keys");
    let topic = keys.topic("/robot1/odom").expect("covered");
    let request = SealRequest {
        domain: keys.domain,
        owner: claimed,
        signer: &keys.signing,
        epoch: keys.epoch,
        topic_key: wrong.unwrap_or(&topic.key),
        recorder,
        seq,
        topic_id: topic.id,
        kind,
        filters,
        captured_at: Timestamp(seq),
        head,
        body,
    };
    seal(provider(ProviderName::default()), &request).expect("sealed")
}

/// As a gateway's desk takes it.
fn upload(owner: &Owner, seq: u64, body: &[u8]) -> NewRecord {
    NewRecord::foreign(elsewhere(owner, seq, body, None), Address([8; 20]))
}

/// A proof of a record that is anchored alone in its batch.
pub(super) async fn proof_of(line: &Line, sealed: &SealedRecord) -> Vec<u8> {
    let root = Leaf::of(&sealed.header, sealed.digest).hash();
    let previous = line.network.chain.anchor_head(line.owner.address).await.expect("answered");
    let call = Call::Anchor { root, count: 1, previous };
    let sent = line.sender.send(&line.network.chain, &line.owner.eoa(), call, "anchor").await;
    let (transaction, receipt) = sent.expect("anchored");
    line.watch().await;
    let inclusion = Some(Inclusion { index: 0, count: 1, path: Vec::new(), root });
    let (block, block_hash) = (receipt.block, receipt.block_hash);
    AnchorProof { account: line.owner.address, transaction, block, block_hash, inclusion }.encode()
}

/// Imports the record, as a gateway returns it, with this proof.
pub(super) async fn taken_with(line: &Line, sealed: SealedRecord, proof: Vec<u8>) -> Result<Accepted, PipelineError> {
    let (plant, network, keeper, patience) = (&line.plant, &line.network, Address([8; 20]), Duration::ZERO);
    let anchors = Anchors::default();
    let intake = Intake { plant, network, anchors: &anchors, keeper, patience };
    let SealedRecord { digest, signature, blob, .. } = sealed;
    let fetched = Fetched { signer: line.owner.signing().public, signature, proof, blob };
    intake.accept(&line.owner, line.owner.address, digest, fetched).await
}

/// The same with its own proof.
pub(super) async fn taken(line: &Line, sealed: SealedRecord) -> Result<Accepted, PipelineError> {
    let proof = proof_of(line, &sealed).await;
    taken_with(line, sealed, proof).await
}

fn entries(plant: &Plant) -> u64 {
    plant.ciphertext.usage().expect("usage").entries
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_a_mirror_does_not_take_in_leaves_no_bytes() {
    let line = Line::new().await;
    let line =
        Line { plant: Plant { observer: Arc::new(super::super::fixture::Notes::default()), ..line.plant }, ..line };
    line.owner.prepare_epoch(line.network.domain, 1).expect("prepared");
    line.owner.seal_under(line.network.domain, 1).expect("seals");
    let held = line.plant.ledger.records.hold();
    let refused = taken(&line, elsewhere(&line.owner, 1, b"one", None)).await;
    assert!(matches!(refused, Err(PipelineError::Store(StoreError::DiskFull { .. }))), "{refused:?}");
    assert_eq!(entries(&line.plant), 0, "the disk takes no more");
    drop(held);
    let wrong = taken(&line, elsewhere(&line.owner, 1, b"one", Some(&TopicKey::new([1; 32])))).await;
    assert!(matches!(wrong, Ok(Accepted::Refused(Refused { reason: Reason::Crypto(_), .. }))), "{wrong:?}");
    assert_eq!(entries(&line.plant), 0, "nobody can open it");
    let first = elsewhere(&line.owner, 1, b"one", None);
    let digest = first.digest;
    let unproven = taken_with(&line, first.clone(), vec![9]).await;
    assert!(matches!(unproven, Ok(Accepted::Refused(Refused { reason: Reason::NoProof, .. }))), "{unproven:?}");
    let taken_back = taken_with(&line, first.clone(), Vec::new()).await;
    assert!(matches!(taken_back, Ok(Accepted::Later)), "the chain may have it again: {taken_back:?}");
    let proof = proof_of(&line, &first).await;
    let known = AnchorProof::parse(&proof).expect("a proof");
    let ahead = AnchorProof { block: known.block + 5_000, transaction: Hash([3; 32]), ..known }.encode();
    let ahead = taken_with(&line, first.clone(), ahead).await;
    assert!(matches!(ahead, Ok(Accepted::Later)), "the node here has a long way to go: {ahead:?}");
    let (block, hash) = line.plant.ledger.trail.cursor().expect("read").expect("it watches");
    line.plant.ledger.trail.set_cursor(0, hash).expect("set");
    let early = taken_with(&line, first.clone(), proof.clone()).await.expect("asked");
    assert!(matches!(early, Accepted::Later), "the watcher has not read its block: {early:?}");
    line.plant.ledger.trail.set_cursor(block, hash).expect("set");
    let held = taken_with(&line, first, proof).await.expect("taken in");
    assert!(matches!(held, Accepted::Held(true)), "{held:?}");
    let row = line.plant.ledger.records.find(digest).expect("read").expect("acknowledged");
    assert_eq!((row.topic.as_str(), row.bytes, row.state), ("/robot1/odom", 3, RecordState::Mined));
    let twin = taken(&line, elsewhere(&line.owner, 1, b"two", None)).await;
    assert!(matches!(twin, Ok(Accepted::Refused(Refused { reason: Reason::Number, .. }))), "{twin:?}");
    assert_eq!(entries(&line.plant), 1, "its number is another's");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_record_that_claims_a_number_of_this_home_is_refused_and_stops_nobody() {
    let line = Line::new().await;
    line.owner.prepare_epoch(line.network.domain, 1).expect("prepared");
    line.owner.seal_under(line.network.domain, 1).expect("seals");
    let (here, there) = (line.plant.ledger.records.recorder(), Address([7; 20]));
    let simulated = Head { tags: [("simulated".to_owned(), "true".to_owned())].into(), ..head(b"one") };
    let seal = |claimed, head: &Head| {
        sealed_by(here, claimed, (RecordKind::Data, &line.owner, 1), Vec::new(), (head, b"one"), None)
    };
    let mallorys = seal(there, &head(b"one"));
    let anchors = Anchors::default();
    let (plant, network, keeper, patience) = (&line.plant, &line.network, Address([8; 20]), Duration::ZERO);
    let intake = Intake { plant, network, anchors: &anchors, keeper, patience };
    let SealedRecord { digest, signature, blob, .. } = mallorys;
    let fetched = Fetched { signer: line.owner.signing().public, signature, proof: vec![9], blob };
    let refused = intake.accept(&line.owner, there, digest, fetched).await;
    assert!(matches!(refused, Ok(Accepted::Refused(Refused { reason: Reason::NumberedHere, .. }))), "{refused:?}");
    // Of the owner's own, which this ledger lost: the row that it would get says something else.
    let refused = taken(&line, seal(line.owner.address, &simulated)).await;
    assert!(matches!(refused, Ok(Accepted::Refused(_))), "{refused:?}");
}

#[test]
fn what_a_gateway_refuses_leaves_no_bytes() {
    let home = tempfile::tempdir().expect("folder");
    let plant = plant(home.path());
    let (owner, _) = owner_with_keys(plant.provider, home.path());
    let keep = |records: Vec<NewRecord>| plant.keep(records, |records| plant.ledger.records.append(records));
    let known = upload(&owner, 1, b"one");
    keep(vec![known.clone()]).expect("kept");
    keep(vec![known.clone()]).expect("sent twice, it is kept once");
    // Altered on the disk meanwhile, and sent again: right again.
    assert_eq!(plant.ciphertext.replace(known.digest, b"altered"), Ok(true));
    keep(vec![known.clone()]).expect("sent a third time");
    let conflict = keep(vec![upload(&owner, 2, b"two"), upload(&owner, 1, b"another one")]);
    assert!(matches!(conflict, Err(StoreError::Conflict { .. })), "{conflict:?}");
    let renamed = NewRecord { topic: "/other".to_owned(), ..upload(&owner, 3, b"three") };
    keep(vec![NewRecord { topic: "/robot1/odom".to_owned(), ..upload(&owner, 4, b"four") }]).expect("named");
    assert!(matches!(keep(vec![renamed]), Err(StoreError::Conflict { .. })));
    let moved = NewRecord { topic_id: TopicId([1; 16]), ..known.clone() };
    assert!(matches!(keep(vec![moved]), Err(StoreError::Conflict { .. })));
    assert_eq!(entries(&plant), 2);
    assert_eq!(plant.ciphertext.get(known.digest).expect("read"), known.blob);
}

#[test]
fn an_upload_with_the_number_of_another_is_refused_for_a_readers_reason_and_told() {
    let home = tempfile::tempdir().expect("folder");
    let notes = Arc::new(super::super::fixture::Notes::default());
    let plant = Plant { observer: Arc::clone(&notes) as _, ..plant(home.path()) };
    let (owner, _) = owner_with_keys(plant.provider, home.path());
    let received = |seq, body: &[u8]| {
        let SealedRecord { header, blob, digest, signature } = elsewhere(&owner, seq, body, None);
        Received { header, digest, signature, signer: owner.signing().public, blob }
    };
    let take = |uploads| accept_uploads(&plant, Address([8; 20]), uploads).expect("asked");
    assert!(take(vec![received(1, b"one")]).is_ok());
    let refused = take(vec![received(2, b"two"), received(1, b"another one")]);
    assert!(matches!(refused, Err(Reason::Number)), "{refused:?}");
    assert_eq!((entries(&plant), notes.with("equivocation")), (1, 1), "none of them is kept, and both signatures are");
}

#[test]
fn what_was_deleted_does_not_come_back_when_it_is_sent_again() {
    let home = tempfile::tempdir().expect("folder");
    let plant = plant(home.path());
    let (owner, _) = owner_with_keys(plant.provider, home.path());
    let keep = |records: Vec<NewRecord>| plant.keep(records, |records| plant.ledger.records.append(records));
    let (face, other) = (upload(&owner, 1, b"a face"), upload(&owner, 2, b"a wall"));
    keep(vec![face.clone()]).expect("kept");
    plant.ciphertext.scour(&[face.digest]).expect("overwritten");
    plant.ledger.retention.deleted(&[face.digest]).expect("noted");
    keep(vec![face.clone(), other.clone()]).expect("acknowledged again, as known");
    assert_eq!(plant.ciphertext.get(face.digest), Ok(None));
    assert_eq!(plant.ciphertext.get(other.digest).expect("read"), other.blob, "what came with it is stored");
    let read = |record: &NewRecord| {
        let row = plant.ledger.records.find(record.digest).expect("reads").expect("known");
        plant.stored_bytes(&row).expect("read")
    };
    assert_eq!((read(&face), read(&other)), (None, other.blob.clone()));
}
