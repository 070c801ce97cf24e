//! Every writer asks before it writes: what is not accepted leaves no bytes in the vault, and a vault that accepts
//! nothing does not fill the disk, whoever owns the records.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use super::*;
use crate::chain::merkle::{Inclusion, Leaf};
use crate::chain::{AnchorProof, Call};
use crate::crypto::{SealRequest, SealedRecord, TopicKey, seal};
use crate::gateway::Fetched;
use crate::model::head::Compression;
use crate::model::{Address, FilterId, Head, RecorderPrefix};
use crate::pipeline::PipelineError;
use crate::pipeline::intake::{Accepted, Anchors, Intake, Reason, Refused};
use crate::pipeline::statement::{Statement, state};
use crate::pipeline::watcher::CURSOR;
use crate::store::{StoreError, Usage, Vault};

/// A vault that may forget, and counts what it is given. It loses a record between two requests (whether it has it, and
/// for its bytes), as often as `forgets` says.
pub(super) struct Forgetful {
    vault: Arc<dyn Vault>,
    given: AtomicUsize,
    forgets: AtomicUsize,
}

impl Forgetful {
    pub(super) fn over(vault: &Arc<dyn Vault>, forgets: usize) -> Arc<Self> {
        Arc::new(Self { vault: Arc::clone(vault), given: AtomicUsize::new(0), forgets: AtomicUsize::new(forgets) })
    }
}

impl Vault for Forgetful {
    fn name(&self) -> &'static str {
        "forgetful"
    }
    fn durable(&self) -> bool {
        false
    }
    fn put(&self, entries: &[(Digest, &[u8])]) -> Result<(), StoreError> {
        self.given.fetch_add(entries.len(), Ordering::Relaxed);
        self.vault.put(entries)
    }
    fn get(&self, digest: Digest) -> Result<Option<Vec<u8>>, StoreError> {
        let left = |left: usize| left.checked_sub(1);
        if self.forgets.fetch_update(Ordering::Relaxed, Ordering::Relaxed, left).is_ok() {
            self.vault.delete(digest)?;
        }
        self.vault.get(digest)
    }
    fn delete(&self, digest: Digest) -> Result<bool, StoreError> {
        self.vault.delete(digest)
    }
    fn contains(&self, digest: Digest) -> Result<bool, StoreError> {
        self.vault.contains(digest)
    }
    fn usage(&self) -> Result<Usage, StoreError> {
        self.vault.usage()
    }
    fn policy_warnings(&self) -> Vec<String> {
        Vec::new()
    }
    fn dump(&self, each: &mut dyn FnMut(Digest, &[u8])) -> Result<(), StoreError> {
        self.vault.dump(each)
    }
    fn replace(&self, digest: Digest, bytes: &[u8]) -> Result<bool, StoreError> {
        self.vault.replace(digest, bytes)
    }
}

/// A plant whose vault may forget, in which no more than one record may wait.
fn forgetful(home: &Path) -> (Plant, Arc<Forgetful>) {
    let plant = plant(home);
    let vault = Forgetful::over(&plant.vault, 0);
    (Plant { vault: Arc::clone(&vault) as _, backlog: 0, ..plant }, vault)
}

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
    let keys = owner.sealing().expect("keys");
    let topic = keys.topic("/robot1/odom").expect("covered");
    let request = SealRequest {
        domain: keys.domain,
        owner: owner.address,
        signer: &keys.signing,
        epoch: keys.epoch,
        topic_key: wrong.unwrap_or(&topic.key),
        recorder: RecorderPrefix::ledger([9; 7]),
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
    plant.vault.usage().expect("usage").entries
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_a_mirror_does_not_take_in_leaves_no_bytes_in_the_vault() {
    let line = Line::new().await;
    let line =
        Line { plant: Plant { observer: Arc::new(super::super::fixture::Notes::default()), ..line.plant }, ..line };
    line.owner.prepare_epoch(line.network.domain, 1).expect("prepared");
    line.owner.seal_under(line.network.domain, 1).expect("seals");
    let held = line.plant.ledger.hold_records();
    let refused = taken(&line, elsewhere(&line.owner, 1, b"one", None)).await;
    assert!(matches!(refused, Err(PipelineError::Store(StoreError::DiskFull { .. }))), "{refused:?}");
    assert_eq!(entries(&line.plant), 0, "the disk takes no more");
    drop(held);
    let wrong = taken(&line, elsewhere(&line.owner, 1, b"one", Some(&TopicKey::new([1; 32])))).await;
    assert!(matches!(wrong, Ok(Accepted::Refused(Refused { reason: Reason::Crypto(_), .. }))), "{wrong:?}");
    assert_eq!(entries(&line.plant), 0, "nobody can open it");
    let first = elsewhere(&line.owner, 1, b"one", None);
    let digest = first.digest;
    let unproven = taken_with(&line, first.clone(), Vec::new()).await;
    assert!(matches!(unproven, Ok(Accepted::Refused(Refused { reason: Reason::NoProof, .. }))), "{unproven:?}");
    let proof = proof_of(&line, &first).await;
    let (block, hash) = line.plant.ledger.cursor(CURSOR).expect("read").expect("it watches");
    line.plant.ledger.set_cursor(CURSOR, 0, hash).expect("set");
    let early = taken_with(&line, first.clone(), proof.clone()).await.expect("asked");
    assert!(matches!(early, Accepted::Later), "the watcher has not read its block: {early:?}");
    line.plant.ledger.set_cursor(CURSOR, block, hash).expect("set");
    let held = taken_with(&line, first, proof).await.expect("taken in");
    assert!(matches!(held, Accepted::Held(true)), "{held:?}");
    let row = line.plant.ledger.record(digest).expect("read").expect("acknowledged");
    assert_eq!((row.topic.as_str(), row.bytes, row.state), ("/robot1/odom", 3, RecordState::Mined));
    let twin = taken(&line, elsewhere(&line.owner, 1, b"two", None)).await;
    assert!(matches!(twin, Ok(Accepted::Refused(Refused { reason: Reason::Number, .. }))), "{twin:?}");
    assert_eq!(entries(&line.plant), 1, "its number is another's");
}

#[test]
fn what_a_gateway_refuses_leaves_no_bytes_in_the_vault() {
    let home = tempfile::tempdir().expect("folder");
    let plant = plant(home.path());
    let (owner, _) = owner_with_keys(plant.provider, home.path());
    let keep = |records: Vec<NewRecord>| plant.keep(records, |records| plant.ledger.append(records));
    let known = upload(&owner, 1, b"one");
    keep(vec![known.clone()]).expect("kept");
    keep(vec![known.clone()]).expect("sent twice, it is kept once");
    let conflict = keep(vec![upload(&owner, 2, b"two"), upload(&owner, 1, b"another one")]);
    assert!(matches!(conflict, Err(StoreError::Conflict { .. })), "{conflict:?}");
    let renamed = NewRecord { topic: "/other".to_owned(), ..upload(&owner, 3, b"three") };
    keep(vec![NewRecord { topic: "/robot1/odom".to_owned(), ..upload(&owner, 4, b"four") }]).expect("named");
    assert!(matches!(keep(vec![renamed]), Err(StoreError::Conflict { .. })));
    let moved = NewRecord { topic_id: TopicId([1; 16]), ..known.clone() };
    assert!(matches!(keep(vec![moved]), Err(StoreError::Conflict { .. })));
    assert_eq!(entries(&plant), 2);
    assert_eq!(plant.vault.get(known.digest).expect("read"), known.local_copy);
}

#[test]
fn what_was_deleted_does_not_come_back_when_it_is_sent_again() {
    let home = tempfile::tempdir().expect("folder");
    let plant = plant(home.path());
    let (owner, _) = owner_with_keys(plant.provider, home.path());
    let keep = |records: Vec<NewRecord>| plant.keep(records, |records| plant.ledger.append(records));
    let (face, other) = (upload(&owner, 1, b"a face"), upload(&owner, 2, b"a wall"));
    keep(vec![face.clone()]).expect("kept");
    plant.vault.scour(&[face.digest]).expect("overwritten");
    plant.ledger.deleted(&[face.digest]).expect("noted");
    keep(vec![face.clone(), other.clone()]).expect("acknowledged again, as known");
    assert_eq!(plant.vault.get(face.digest).expect("read"), None);
    assert_eq!(plant.ledger.local_copy(face.digest).expect("read"), None);
    assert_eq!(plant.vault.get(other.digest).expect("read"), other.local_copy, "what came with it is stored");
    // Even bytes that lie in the vault stay out of bundles and exports.
    plant.vault.put(&[(face.digest, &b"a face"[..])]).expect("there again");
    let read = |record: &NewRecord| {
        let row = plant.ledger.record(record.digest).expect("reads").expect("known");
        plant.stored_bytes(&row).expect("read")
    };
    assert_eq!((read(&face), read(&other)), (None, other.local_copy.clone()));
}

#[test]
fn beyond_the_backlog_no_writer_adds_a_record() {
    let home = tempfile::tempdir().expect("folder");
    let (plant, vault) = forgetful(home.path());
    let (owner, _) = owner_with_keys(plant.provider, home.path());
    let keep = |record| plant.keep([record], |[record]| plant.ledger.append(vec![record]));
    let first = upload(&owner, 1, b"one");
    keep(first.clone()).expect("nothing waits yet");
    let row = plant.ledger.record(first.digest).expect("read").expect("acknowledged");
    assert_eq!(row.state, RecordState::Sealed);
    assert_eq!(plant.ledger.local_copy(first.digest).expect("read"), first.local_copy, "the ledger has its bytes");
    let refused = keep(upload(&owner, 2, b"two"));
    assert!(matches!(refused, Err(StoreError::Backlog { limit: 0, .. })), "a gateway's: {refused:?}");
    let keys = owner.sealing().expect("keys");
    let said = Statement { kind: RecordKind::Audit, topic: "authros/audit", type_name: "a/B", body: b"said" };
    let refused = state(&plant, owner.address, &keys, said);
    assert!(matches!(refused, Err(PipelineError::Store(StoreError::Backlog { .. }))), "a statement: {refused:?}");
    assert_eq!(plant.ledger.counts(None).expect("counts").acknowledged, 1);
    assert_eq!(vault.given.load(Ordering::Relaxed), 0, "the storer alone gives it records");
}
