//! Key notices as received by a robot: only the owner's, only its own, only newer ones.

use super::*;
use crate::crypto::{
    Enrolment, EoaSecret, EpochIssue, EpochKey, IndexKey, IssuedKeys, LastNotice, Notice, OwnerKeyChange, Passphrase,
    SealRequest, SealedEnrolment, SealingKey, SignedPolicy, TopicKey, TransportKey, notice_topic, seal, signer_id,
    topic_id,
};
use crate::gateway::{FeedEntry, Fetched};
use crate::model::head::Compression;
use crate::model::{Head, RecorderPrefix, RingSpan, SignerId, Timestamp, Token};
use crate::pipeline::notices::{Notices, PolicyTaker};
use crate::pipeline::{Author, disk_ring};

/// Notes the versions of the policies that reach it.
#[derive(Default)]
pub(super) struct Noting(std::sync::Mutex<Vec<u64>>);

impl PolicyTaker for Noting {
    fn take(&self, policy: &SignedPolicy) -> Result<String, crate::pipeline::PipelineError> {
        self.0.lock().expect("not poisoned").push(policy.version);
        Ok(format!("policy {}", policy.version))
    }
}

pub(super) fn taker() -> Arc<Noting> {
    Arc::default()
}

fn issued(epoch: u64) -> IssuedKeys {
    let key = SealingKey::Epoch(EpochKey::new([u8::try_from(epoch).expect("small"); 32]));
    IssuedKeys { now: EpochIssue { epoch, token: Token([9; 32]), ends: None, key }, next: None }
}

pub(super) fn enrolment(scene: &Scene) -> Enrolment {
    Enrolment {
        domain: context().domain,
        chain_id: 1,
        gateway: scene.access(),
        name: scene.credentials.name.clone(),
        owner: scene.alice.account(),
        owner_key: scene.alice.signing.public,
        device: scene.device.clone(),
        index: Some(IndexKey::new([3; 32])),
        notice_id: topic_id(&IndexKey::new([3; 32]), &notice_topic(&signer_id(&scene.device.public))),
        notice_key: TopicKey::new([4; 32]),
        token: scene.credentials.token,
        last_notice: None,
        keys: issued(1),
    }
}

/// A key notice to a device.
fn notice(scene: &Scene, signer: &SmKeyPair, device: SignerId, seq: u64, epoch: u64) -> Upload {
    record(scene, signer, device, (seq, epoch), &Notice::Keys(issued(epoch)))
}

/// A notice to a device.
pub(super) fn record(
    scene: &Scene,
    signer: &SmKeyPair,
    device: SignerId,
    (seq, epoch): (u64, u64),
    notice: &Notice,
) -> Upload {
    numbered(scene, signer, device, (RecorderPrefix::ledger([8; 7]), seq, epoch, Timestamp(seq)), notice)
}

/// The same with the owner's recorder and time.
fn numbered(
    scene: &Scene,
    signer: &SmKeyPair,
    device: SignerId,
    (recorder, seq, epoch, captured_at): (RecorderPrefix, u64, u64, Timestamp),
    notice: &Notice,
) -> Upload {
    let (name, body) = (notice_topic(&device), notice.encode());
    let head = Head {
        topic: name.clone(),
        type_name: "authros/Keys".into(),
        md5sum: String::new(),
        definition: Digest([0; 32]),
        caller_id: String::new(),
        boot_id: [0; 16],
        compression: Compression::None,
        plain_length: body.len() as u64,
        tags: std::collections::BTreeMap::new(),
    };
    let request = SealRequest {
        domain: context().domain,
        owner: scene.alice.account(),
        signer,
        epoch,
        topic_key: &TopicKey::new([4; 32]),
        recorder,
        seq,
        topic_id: topic_id(&IndexKey::new([3; 32]), &name),
        kind: RecordKind::Key,
        filters: Vec::new(),
        captured_at,
        head: &head,
        body: &body,
    };
    Upload::from(&seal(context().provider, &request).expect("seals"))
}

fn passphrase() -> Passphrase {
    Passphrase::new("correct horse".to_owned()).expect("long enough")
}

/// A forwarder that takes notices, for whom it seals, and the files of its enrolment: as it was given, and what it keeps.
fn obeying(scene: &Scene) -> (Forwarder, Arc<Author>, [PathBuf; 2]) {
    let sealed = SealedEnrolment::new(enrolment(scene), &passphrase()).expect("stretches");
    let (kept, given) = (SealedEnrolment::kept_in(scene.home.path()), scene.home.path().join("given"));
    sealed.create(&given).expect("writes");
    let author = Arc::new(Author::new(scene.alice.account()));
    author.obey(&sealed.enrolment);
    let observer = Arc::clone(&scene.plant.observer);
    let notices = Notices::new(context().provider, observer, Arc::clone(&author), sealed, kept.clone(), taker());
    (scene.forwarder().with_errand(Box::new(notices)), author, [given, kept])
}

#[tokio::test(flavor = "multi_thread")]
async fn only_the_owners_newest_notice_to_this_device_is_obeyed() {
    let mut scene = Scene::new().await;
    let (mut forwarder, author, [given, kept]) = obeying(&scene);
    let (stored, epoch) = (Arc::clone(&scene.stored), || author.sealing().expect("keys").epoch);

    let mut owner = scene.owner().await;
    let own = signer_id(&scene.device.public);
    // Before the robot connects.
    let early = notice(&scene, &scene.alice.signing, own, 3, 3);
    let older = notice(&scene, &scene.alice.signing, own, 2, 2);
    owner.upload(vec![early]).await.expect("receipt");
    owner.upload(vec![older]).await.expect("receipt");
    let work = tokio::spawn(async move { forwarder.run(&stored).await });
    scene.until("the newest of them", |_| epoch() == 3).await;

    // While it is connected. A robot stolen from the same owner cannot speak for the owner.
    owner.upload(vec![notice(&scene, &scene.device, own, 9, 9)]).await.expect("the gateway takes it");
    scene.until("passed over", |scene| scene.notes.with("ignored a notice") > 0).await;
    owner.upload(vec![notice(&scene, &scene.alice.signing, SignerId([1; 32]), 10, 10)]).await.expect("receipt");
    owner.upload(vec![notice(&scene, &scene.alice.signing, own, 1, 4)]).await.expect("an old number");
    owner.upload(vec![notice(&scene, &scene.alice.signing, own, 11, 5)]).await.expect("receipt");
    scene.until("the next one", |_| epoch() == 5).await;
    scene.capture(3, 10);
    scene.until_state(RecordState::Submitted, 3).await;
    assert_eq!(epoch(), 5);
    work.abort();

    let mut again = SealedEnrolment::open(&given, &passphrase()).expect("opens");
    again.catch_up(&kept).expect("reads");
    let recorder = RecorderPrefix::ledger([8; 7]).of_signer(&signer_id(&scene.alice.signing.public));
    let last = LastNotice { recorder, number: 11, at: Timestamp(11) };
    assert_eq!((again.enrolment.keys.now.epoch, again.enrolment.last_notice), (5, Some(last)));
}

#[tokio::test(flavor = "multi_thread")]
async fn another_key_of_the_owner_needs_the_old_one_and_the_account() {
    let scene = Scene::new().await;
    let (mut forwarder, author, [given, kept]) = obeying(&scene);
    let (stored, epoch) = (Arc::clone(&scene.stored), || author.sealing().expect("keys").epoch);
    let known = || {
        let mut robot = SealedEnrolment::open(&given, &passphrase()).expect("opens");
        robot.catch_up(&kept).expect("reads");
        robot.enrolment.owner_key
    };

    let mut owner = scene.owner().await;
    let (own, old) = (signer_id(&scene.device.public), scene.alice.signing.clone());
    // The gateway accepts what they sign, so it is the robot that refuses.
    let (new, thief) = (pair(0x77), pair(0x78));
    let mut telling = scene.stage.connect(&scene.credentials).await.expect("connects");
    for other in [&new, &thief] {
        scene.stage.desk.lend(&scene.alice, other);
        telling
            .device(&old, crate::gateway::DeviceNotice { key: other.public, ..notice_of(&scene.device) })
            .await
            .expect("told");
    }
    let change = |account: &EoaSecret, to: &SmKeyPair| {
        let domain = context().domain;
        Notice::OwnerKey(OwnerKeyChange::sign(&domain, account, old.public, to.public).expect("signs"))
    };
    let work = tokio::spawn(async move { forwarder.run(&stored).await });

    // A thief who has only d_C, and one who has only the account.
    let stolen_key = record(&scene, &old, own, (2, 1), &change(&EoaSecret::generate().expect("an account"), &thief));
    let stolen_account = record(&scene, &thief, own, (3, 1), &change(&scene.alice.eoa, &thief));
    for (passed, forged) in [(1, stolen_key), (2, stolen_account)] {
        owner.upload(vec![forged]).await.expect("the gateway takes it");
        scene.until("passed over", |scene| scene.notes.with("ignored a notice") >= passed).await;
        assert_eq!(known(), old.public);
    }
    owner.upload(vec![notice(&scene, &new, own, 4, 7)]).await.expect("receipt");
    scene.until("passed over", |scene| scene.notes.with("ignored a notice") >= 3).await;

    owner.upload(vec![record(&scene, &old, own, (5, 1), &change(&scene.alice.eoa, &new))]).await.expect("receipt");
    scene.until("the new key is kept", |_| known() == new.public).await;
    owner.upload(vec![notice(&scene, &old, own, 6, 8)]).await.expect("the gateway takes it");
    scene.until("the old key says nothing any more", |scene| scene.notes.with("ignored a notice") >= 4).await;
    owner.upload(vec![notice(&scene, &new, own, 7, 5)]).await.expect("receipt");
    scene.until("the new key's keys", |_| epoch() == 5).await;
    work.abort();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_ring_is_asked_for_by_its_owner_alone_and_each_request_counts_once() {
    let scene = Scene::new().await;
    let passphrase = Passphrase::new("correct horse".to_owned()).expect("long enough");
    let sealed = SealedEnrolment::new(enrolment(&scene), &passphrase).expect("stretches");
    let (kept, author) = (SealedEnrolment::kept_in(scene.home.path()), Arc::new(Author::new(scene.alice.account())));
    let observer = Arc::clone(&scene.plant.observer);
    let notices = Notices::new(context().provider, observer, author, sealed, kept, taker());
    let mut forwarder = scene.forwarder().with_errand(Box::new(notices.with_ring(scene.plant.ledger.notes.clone())));
    let stored = Arc::clone(&scene.stored);
    let span = |since: u64| {
        let topics = "/camera/**".parse().expect("a pattern");
        RingSpan { since: Timestamp(since), until: Timestamp(100), topics }
    };
    let mut owner = scene.owner().await;
    let own = signer_id(&scene.device.public);
    let asked = |seq: u64, signer: &SmKeyPair, device: SignerId| {
        record(&scene, signer, device, (seq, 1), &Notice::Pull(span(seq)))
    };
    let waiting = |scene: &Scene| disk_ring::waiting(&scene.plant.ledger.notes).expect("noted");
    owner.upload(vec![asked(2, &scene.alice.signing, own)]).await.expect("receipt");
    let work = tokio::spawn(async move { forwarder.run(&stored).await });
    scene.until("asked", |scene| waiting(scene) == [span(2)]).await;
    owner.upload(vec![asked(3, &scene.device, own)]).await.expect("the gateway takes it");
    scene.until("passed over", |scene| scene.notes.with("ignored a notice") > 0).await;
    owner.upload(vec![asked(4, &scene.alice.signing, SignerId([1; 32]))]).await.expect("another robot's");
    owner.upload(vec![asked(1, &scene.alice.signing, own)]).await.expect("an old number");
    owner.upload(vec![asked(5, &scene.alice.signing, own)]).await.expect("receipt");
    scene.until("asked again", |scene| waiting(scene) == [span(2), span(5)]).await;
    work.abort();
}

/// A notice as a gateway gives it, under the number and epoch that it says.
fn given(scene: &Scene, upload: Upload, seq: u64, epoch: u64) -> (FeedEntry, Fetched) {
    let (header, _) = Header::parse(&upload.blob).expect("a header");
    let entry = FeedEntry {
        number: seq,
        fact: Fact::Verified,
        digest: Digest(context().provider.sm3(&[&upload.blob])),
        owner: header.owner,
        recorder: header.recorder,
        seq,
        topic_id: header.topic_id,
        epoch,
        captured_at: header.captured_at,
        length: upload.blob.len() as u64,
        kind: header.kind,
        proof: Vec::new(),
    };
    let Upload { signature, blob } = upload;
    (entry, Fetched { signer: scene.alice.signing.public, signature, proof: Vec::new(), blob })
}

/// The owner's home was restored: another recorder, numbers from 1, the same epoch.
#[tokio::test(flavor = "multi_thread")]
async fn after_a_restore_an_owner_is_obeyed_at_once_and_what_is_older_never() {
    let scene = Scene::new().await;
    let passphrase = Passphrase::new("correct horse".to_owned()).expect("long enough");
    let own = signer_id(&scene.device.public);
    let topics = "/camera/**".parse().expect("a pattern");
    let span = RingSpan { since: Timestamp(1), until: Timestamp(100), topics };
    let (before, restored) = (RecorderPrefix::ledger([8; 7]), RecorderPrefix::ledger([7; 7]));
    let sealed = SealedEnrolment::new(enrolment(&scene), &passphrase).expect("stretches");
    let (kept, author) = (scene.home.path().join("kept"), Arc::new(Author::new(scene.alice.account())));
    author.obey(&sealed.enrolment);
    let notices = Notices::new(context().provider, Arc::clone(&scene.plant.observer), author, sealed, kept, taker());
    let mut notices = notices.with_ring(scene.plant.ledger.notes.clone());
    let mut hear = |recorder, seq, at| {
        let (signer, place) = (&scene.alice.signing, (recorder, seq, 1, Timestamp(at)));
        let upload = numbered(&scene, signer, own, place, &Notice::Pull(span.clone()));
        let (entry, fetched) = given(&scene, upload, seq, 1);
        assert!(notices.hear(&entry, &fetched), "dealt with");
        disk_ring::waiting(&scene.plant.ledger.notes).expect("noted").len()
    };
    assert_eq!(hear(before, 9, 900), 1);
    assert_eq!(hear(restored, 1, 800), 1, "older than what was taken");
    assert_eq!(hear(restored, 1, 1000), 2);
    assert_eq!(hear(restored, 2, 999), 3, "by its number");
    assert_eq!(hear(before, 10, 950), 3, "of the home before, and replayed");
}

/// A gateway that gives an owner's old notice a new number: the entry is its word, the header is signed.
#[tokio::test(flavor = "multi_thread")]
async fn an_old_notice_is_not_new_because_a_gateway_says_so() {
    let scene = Scene::new().await;
    let passphrase = Passphrase::new("correct horse".to_owned()).expect("long enough");
    let sealed = SealedEnrolment::new(enrolment(&scene), &passphrase).expect("stretches");
    let (kept, author) = (SealedEnrolment::kept_in(scene.home.path()), Arc::new(Author::new(scene.alice.account())));
    author.obey(&sealed.enrolment);
    let observer = Arc::clone(&scene.plant.observer);
    let mut notices = Notices::new(context().provider, observer, Arc::clone(&author), sealed, kept, taker())
        .with_ring(scene.plant.ledger.notes.clone());
    let own = signer_id(&scene.device.public);
    let topics = "/camera/**".parse().expect("a pattern");
    let span = RingSpan { since: Timestamp(1), until: Timestamp(100), topics };
    let pull = || record(&scene, &scene.alice.signing, own, (4, 1), &Notice::Pull(span.clone()));
    let waiting = || disk_ring::waiting(&scene.plant.ledger.notes).expect("noted");
    let mut hear = |upload: Upload, seq: u64, epoch: u64| {
        let (entry, fetched) = given(&scene, upload, seq, epoch);
        notices.hear(&entry, &fetched);
    };
    let epoch = || author.sealing().expect("keys").epoch;
    hear(notice(&scene, &scene.alice.signing, own, 3, 2), 3, 2);
    hear(notice(&scene, &scene.alice.signing, own, 9, 5), 9, 5);
    assert_eq!((epoch(), scene.notes.with("ignored a notice")), (5, 0));
    // Keys that are no longer used, and a span from before them: both are the owner's, and old.
    hear(notice(&scene, &scene.alice.signing, own, 3, 2), 10, 6);
    hear(pull(), 11, 6);
    assert_eq!((epoch(), waiting(), scene.notes.with("an old notice")), (5, Vec::new(), 2));
    hear(notice(&scene, &scene.alice.signing, own, 10, 6), 10, 6);
    assert_eq!(epoch(), 6, "a new one is taken");
}

#[tokio::test(flavor = "multi_thread")]
async fn policies_come_from_the_owner_alone() {
    let scene = Scene::new().await;
    let passphrase = Passphrase::new("correct horse".to_owned()).expect("long enough");
    let sealed = SealedEnrolment::new(enrolment(&scene), &passphrase).expect("stretches");
    let (kept, author) = (SealedEnrolment::kept_in(scene.home.path()), Arc::new(Author::new(scene.alice.account())));
    author.obey(&sealed.enrolment);
    let (observer, taker) = (Arc::clone(&scene.plant.observer), Arc::new(Noting::default()));
    let policies = Arc::clone(&taker) as Arc<dyn PolicyTaker>;
    let notices = Notices::new(context().provider, observer, Arc::clone(&author), sealed, kept, policies);
    let mut forwarder = scene.forwarder().with_errand(Box::new(notices));
    let stored = Arc::clone(&scene.stored);
    let mut owner = scene.owner().await;
    let own = signer_id(&scene.device.public);
    let policy = |version| {
        let signed = SignedPolicy::sign(&context().domain, &scene.alice.eoa, own, version, "").expect("signs");
        Notice::Policy(signed)
    };
    let work = tokio::spawn(async move { forwarder.run(&stored).await });
    // The robot's own key says nothing about it.
    owner.upload(vec![record(&scene, &scene.device, own, (2, 1), &policy(7))]).await.expect("taken");
    scene.until("passed over", |scene| scene.notes.with("ignored a notice") > 0).await;
    owner.upload(vec![record(&scene, &scene.alice.signing, own, (3, 1), &policy(8))]).await.expect("receipt");
    owner.upload(vec![notice(&scene, &scene.alice.signing, own, 4, 5)]).await.expect("receipt");
    scene.until("what comes after it", |_| author.sealing().is_some_and(|keys| keys.epoch == 5)).await;
    assert_eq!(*taker.0.lock().expect("not poisoned"), [8]);
    work.abort();
}

#[test]
fn nothing_is_sealed_under_an_epoch_that_has_ended() {
    let device = pair(0x66);
    let stage = |ends: Option<Timestamp>, next: Option<(Timestamp, EpochIssue)>| {
        let mut keys = issued(1);
        keys.now.ends = ends;
        let enrolment = Enrolment {
            domain: context().domain,
            chain_id: 1,
            gateway: GatewayAccess {
                addresses: Vec::new(),
                fingerprint: SignerId([0; 32]),
                transport: TransportKey::new([0; 32]),
            },
            name: "robot".parse().expect("a name"),
            owner: crate::model::Address([1; 20]),
            owner_key: device.public,
            device: device.clone(),
            index: Some(IndexKey::new([3; 32])),
            notice_id: crate::model::TopicId([0; 16]),
            notice_key: TopicKey::new([4; 32]),
            token: Token([0; 32]),
            last_notice: None,
            keys: IssuedKeys { next, ..keys },
        };
        let author = Author::new(enrolment.owner);
        author.obey(&enrolment);
        author.sealing().map(|keys| keys.epoch)
    };
    let (past, future) = (Timestamp(1), Timestamp(u64::MAX));
    assert_eq!(stage(None, None), Some(1));
    assert_eq!(stage(Some(future), None), Some(1));
    assert_eq!(stage(Some(past), None), None, "not captured rather than readable by whom it was to end for");
    assert_eq!(stage(Some(past), Some((past, issued(2).now))), Some(2));
    assert_eq!(stage(Some(future), Some((future, issued(2).now))), Some(1));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_notice_that_cannot_be_had_stops_no_uploads_and_is_taken_once_it_can() {
    let mut scene = Scene::new().await;
    let (mut forwarder, author, _) = obeying(&scene);
    let (stored, epoch) = (Arc::clone(&scene.stored), || author.sealing().expect("keys").epoch);
    let mut owner = scene.owner().await;
    let own = signer_id(&scene.device.public);
    owner.upload(vec![notice(&scene, &scene.alice.signing, own, 3, 3)]).await.expect("receipt");
    scene.stage.desk.state().spoilt = true;
    scene.capture(3, 10);
    let work = tokio::spawn(async move { forwarder.run(&stored).await });
    scene.until("uploaded", |scene| scene.at_gateway() == 4).await;
    assert_eq!(epoch(), 1);
    scene.stage.desk.state().spoilt = false;
    scene.until("taken", |_| epoch() == 3).await;
    work.abort();
}
