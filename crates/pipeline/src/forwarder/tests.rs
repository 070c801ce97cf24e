use std::sync::{Arc, PoisonError};
use std::time::Instant;

use tokio::time::sleep;

use super::*;
use crate::crypto::SmKeyPair;
use crate::gateway::{Client, Upload};
use crate::gateway_stage::{Member, Stage, context, notice_of, pair};
use crate::model::{Header, RecordKind, RecordState};
use crate::pipeline::fixture::Notes;
use crate::store::{Ciphertext, Foreign, Ledger, NewRecord, StateCounts};
use relay::Relay;

mod addresses;
mod notices;
mod relay;

const QUICK: Pace = Pace {
    first_pause: Duration::from_millis(10),
    longest_pause: Duration::from_millis(100),
    check: Duration::from_millis(30),
    tidy: Duration::from_millis(30),
    retry: Duration::from_secs(3600),
};

/// A robot of alice's, a gateway, and the connection between them.
struct Scene {
    stage: Stage,
    relay: Relay,
    alice: Member,
    device: SmKeyPair,
    credentials: Credentials,
    home: tempfile::TempDir,
    plant: Plant,
    notes: Arc<Notes>,
    stored: Arc<Notify>,
    numbers: u64,
    /// How long copies stay that the gateway has proven to hold.
    keep: Duration,
}

/// A running forwarder; dropping it is as abrupt as a killed process.
struct Work {
    link: watch::Receiver<Link>,
    refused: Arc<Mutex<HashSet<Digest>>>,
    task: tokio::task::JoinHandle<()>,
}

impl Drop for Work {
    fn drop(&mut self) {
        self.task.abort();
    }
}

fn plant(home: &std::path::Path, notes: &Arc<Notes>) -> Plant {
    let ledger = Ledger::open(&home.join("ledger.db")).expect("ledger");
    Plant {
        ciphertext: Ciphertext::of(&ledger),
        ledger,
        provider: context().provider,
        observer: Arc::clone(notes) as Arc<dyn crate::pipeline::Observer>,
    }
}

fn paced(mut forwarder: Forwarder, pace: Pace) -> Forwarder {
    forwarder.outbox.pace = pace;
    forwarder
}

impl Scene {
    async fn new() -> Self {
        let stage = Stage::new().await;
        let (alice, device) = (Member::new("alice", 0x11), pair(0x66));
        let credentials = stage.enrol(&alice).await;
        let mut owner = stage.connect(&credentials).await.expect("connects");
        stage.desk.lend(&alice, &device);
        owner.device(&alice.signing, notice_of(&device)).await.expect("told");
        let relay = Relay::to(stage.server.address()).await;
        let home = tempfile::tempdir().expect("folder");
        let notes = Arc::new(Notes::default());
        let plant = plant(home.path(), &notes);
        let stored = Arc::new(Notify::new());
        Self { stage, relay, alice, device, credentials, home, plant, notes, stored, numbers: 0, keep: Duration::ZERO }
    }

    fn robot(&self) -> Robot {
        Robot {
            owner: self.alice.account(),
            context: context(),
            name: self.credentials.name.clone(),
            token: self.credentials.token,
            patience: Duration::from_secs(2),
            home: self.home.path().to_owned(),
        }
    }

    /// A session of the owner herself: the device's brings no notices.
    async fn owner(&self) -> Client {
        let home = Member { name: "alice-home".parse().expect("a name"), ..Member::new("alice", 0x11) };
        let credentials = self.stage.enrol(&home).await;
        self.stage.connect(&credentials).await.expect("connects")
    }

    fn access(&self) -> GatewayAccess {
        let (addresses, fingerprint) = (vec![self.relay.address.to_string()], self.stage.server.id());
        GatewayAccess { addresses, fingerprint, transport: self.credentials.key.clone() }
    }

    fn forwarder(&self) -> Forwarder {
        self.forwarder_to(&self.access())
    }

    fn forwarder_to(&self, access: &GatewayAccess) -> Forwarder {
        let keeping = CopyKeeping { time: self.keep, reserve: 0 };
        let forwarder = Forwarder::new(self.plant.clone(), self.robot(), access).expect("trusts");
        paced(forwarder, QUICK).keeping(keeping)
    }

    fn work(&self) -> Work {
        self.work_at(QUICK)
    }

    fn work_at(&self, pace: Pace) -> Work {
        let mut forwarder = paced(self.forwarder(), pace);
        let (link, refused, stored) = (forwarder.link(), forwarder.refused(), Arc::clone(&self.stored));
        Work { link, refused, task: tokio::spawn(async move { forwarder.run(&stored).await }) }
    }

    /// Seals and acknowledges records of this robot.
    fn capture(&mut self, count: u64, length: usize) {
        let mut rows = Vec::new();
        for _ in 0..count {
            self.numbers += 1;
            let upload = self.alice.record(&self.device, self.numbers, &vec![7; length]);
            rows.push(self.row(&upload));
        }
        self.plant.ledger.records.append(rows).expect("acknowledged");
        self.stored.notify_waiters();
    }

    fn row(&self, upload: &Upload) -> NewRecord {
        let (header, _) = Header::parse(&upload.blob).expect("a header");
        NewRecord {
            digest: Digest(context().provider.sm3(&[&upload.blob])),
            owner: header.owner,
            topic_id: header.topic_id,
            seq: header.seq,
            foreign: Some(Foreign { recorder: header.recorder, keeper: header.owner }),
            epoch: header.epoch,
            kind: RecordKind::Data,
            signer: header.signer,
            signature: upload.signature,
            filters: Vec::new(),
            topic: "/robot1/odom".into(),
            type_name: "nav_msgs/Odometry".into(),
            bytes: header.body_length,
            captured_at: header.captured_at,
            simulated: false,
            state: RecordState::Stored,
            blob: Some(upload.blob.clone()),
        }
    }

    fn counts(&self) -> StateCounts {
        self.plant.ledger.counts.by_state(None).expect("counts")
    }

    async fn until(&self, what: &str, mut done: impl FnMut(&Self) -> bool) {
        let deadline = Instant::now() + Duration::from_secs(60);
        while !done(self) {
            assert!(Instant::now() < deadline, "{what}: {:?} {:?}", self.counts(), self.notes.all());
            sleep(Duration::from_millis(10)).await;
        }
    }

    async fn until_state(&self, state: RecordState, count: u64) {
        self.until(state.word(), |scene| scene.counts().data_in(state) == count).await;
    }

    fn at_gateway(&self) -> usize {
        self.stage.desk.record_count()
    }

    fn kept_here(&self) -> u64 {
        self.plant.ciphertext.usage().expect("usage").entries
    }

    /// The gateway anchors and verifies everything it has.
    fn verify(&self) {
        self.stage.desk.state().verify();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn records_are_accepted_then_verified_and_only_then_forgotten() {
    let mut scene = Scene::new().await;
    scene.capture(400, 200);
    scene.capture(3, 3 << 20);
    let work = scene.work();
    scene.until_state(RecordState::Submitted, 403).await;
    assert_eq!((scene.at_gateway(), scene.kept_here()), (403, 403), "ciphertext stays until it is verified");
    assert_eq!(*work.link.borrow(), Link::Up);
    let digest = scene.plant.ledger.records.in_state(None, RecordState::Submitted, 1).expect("rows")[0].digest;
    let receipt = scene.plant.ledger.forwarding.receipt_of(digest).expect("reads").expect("kept");
    let receipt =
        crate::gateway::Receipt { time: receipt.time, digests: receipt.digests, signature: receipt.signature };
    assert!(receipt.digests.contains(&digest));
    let gateway = pair(0x21).public;
    receipt.verify(context().provider, &context().domain, &gateway).expect("signed by the gateway");
    scene.verify();
    scene.until_state(RecordState::Verified, 403).await;
    scene.until("forgotten", |scene| scene.kept_here() == 0).await;
    assert_eq!(scene.plant.ledger.forwarding.receipt_of(digest), Ok(None));
    scene.capture(1, 10);
    scene.until_state(RecordState::Verified, 404).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lost_receipt_means_that_all_is_sent_again_and_kept_once() {
    let mut scene = Scene::new().await;
    let work = scene.work();
    scene.until("connected", |_| *work.link.borrow() == Link::Up).await;
    scene.relay.mute();
    scene.capture(50, 100);
    scene.until("stored there", |scene| scene.at_gateway() > 0).await;
    assert_eq!(scene.counts().data_in(RecordState::Stored), 50, "no receipt, not accepted");
    scene.relay.cut();
    scene.until_state(RecordState::Submitted, 50).await;
    assert_eq!(scene.at_gateway(), 50);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_line_that_breaks_within_an_upload_loses_and_doubles_nothing() {
    let mut scene = Scene::new().await;
    let work = scene.work();
    for bytes in [1, 5_000, 40_000, 90_000] {
        scene.until("connected", |_| *work.link.borrow() == Link::Up).await;
        scene.relay.break_after(bytes);
        scene.capture(100, 1000);
        scene.until("broken", |scene| scene.relay.broke()).await;
        scene.relay.cut();
        scene.until_state(RecordState::Stored, 0).await;
    }
    scene.until_state(RecordState::Submitted, 400).await;
    assert_eq!(scene.at_gateway(), 400);
}

#[tokio::test(flavor = "multi_thread")]
async fn the_outbox_grows_while_the_gateway_is_away() {
    let mut scene = Scene::new().await;
    scene.capture(5, 100);
    let mut work = scene.work();
    scene.until_state(RecordState::Submitted, 5).await;
    // Nobody listens there.
    let nowhere = tokio::net::TcpListener::bind("127.0.0.1:0").await.expect("port").local_addr().expect("address");
    scene.relay.lead_to(nowhere);
    scene.relay.cut();
    scene.capture(200, 100);
    scene.until("away", |_| matches!(*work.link.borrow_and_update(), Link::Away(_))).await;
    assert_eq!(scene.counts().data_in(RecordState::Stored), 200);
    scene.stage.restart().await;
    scene.relay.lead_to(scene.stage.server.address());
    scene.until_state(RecordState::Submitted, 205).await;
    assert_eq!(scene.at_gateway(), 205);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_gateway_has_lost_is_sent_again_and_said() {
    let mut scene = Scene::new().await;
    scene.capture(30, 100);
    let _work = scene.work();
    scene.until_state(RecordState::Submitted, 30).await;
    scene.stage.desk.state().records.clear();
    scene.until("told", |scene| scene.notes.with("no longer has what") > 0).await;
    scene.until("sent again", |scene| scene.at_gateway() == 30).await;
    scene.until_state(RecordState::Submitted, 30).await;
    scene.stage.desk.state().spoilt = true;
    scene.until_state(RecordState::Tampered, 30).await;
    assert_eq!(scene.kept_here(), 30, "the originals are evidence");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recalled_device_is_refused_and_its_records_wait() {
    let mut scene = Scene::new().await;
    scene.capture(3, 100);
    let mut work = scene.work();
    scene.until_state(RecordState::Submitted, 3).await;
    scene.stage.desk.recall(&scene.alice, &scene.device);
    scene.capture(4, 100);
    scene.until("refused", |_| matches!(*work.link.borrow_and_update(), Link::Refused(_))).await;
    assert_eq!((scene.at_gateway(), scene.counts().data_in(RecordState::Stored)), (3, 4));
    let told = format!("{} revoked this robot at 2023-11-14T22:13:20Z", scene.alice.account());
    scene
        .until(
            "told by whom and when",
            |_| matches!(&*work.link.borrow(), Link::Refused(text) if text.starts_with(&told)),
        )
        .await;
    scene.until("noted", |scene| scene.notes.with(&told) > 0).await;
    scene.stage.desk.lend(&scene.alice, &scene.device);
    let mut owner = scene.stage.connect(&scene.credentials).await.expect("connects");
    owner.device(&scene.alice.signing, notice_of(&scene.device)).await.expect("told again");
    scene.until_state(RecordState::Submitted, 7).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn one_bad_record_does_not_hold_up_the_others() {
    let mut scene = Scene::new().await;
    scene.capture(10, 100);
    // Of another owner: the gateway refuses it for its own sake, and with it the whole window.
    let bob = Member::new("bob", 0x31);
    let foreign = bob.record(&scene.device, 1, b"not alice's");
    let row = scene.row(&foreign);
    let digest = row.digest;
    scene.plant.ledger.records.append(vec![row]).expect("acknowledged");
    // Damaged in the store: never sent.
    let spoilt = scene.plant.ledger.records.in_state(None, RecordState::Stored, 1).expect("rows")[0].digest;
    scene.plant.ciphertext.replace(spoilt, b"something else").expect("replaced");
    scene.capture(10, 100);
    let work = scene.work();
    scene.until_state(RecordState::Submitted, 19).await;
    assert_eq!(scene.counts().data_in(RecordState::Tampered), 1);
    assert_eq!(work.refused.lock().unwrap_or_else(PoisonError::into_inner).iter().collect::<Vec<_>>(), [&digest]);
    assert_eq!(scene.at_gateway(), 19);
}

#[test]
fn what_was_said_in_clear_is_about_no_record() {
    for code in Code::ALL {
        let said = GatewayError::RefusedInClear(*code);
        assert!(!is_about_a_record(&said), "{code:?}");
        assert!(matches!(ForwardError::from(said).link(Address([8; 20])), Link::Away(_)), "{code:?}");
    }
    assert!(is_about_a_record(&GatewayError::Refused(Code::Malformed)));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_record_refused_for_itself_is_sent_again_after_its_pause() {
    let scene = Scene::new().await;
    let bob = Member::new("bob", 0x31);
    let foreign = bob.record(&scene.device, 1, b"not alice's");
    let row = scene.row(&foreign);
    scene.plant.ledger.records.append(vec![row]).expect("acknowledged");
    let _work = scene.work_at(Pace { retry: Duration::from_millis(20), ..QUICK });
    scene.until("refused again and again", |scene| scene.notes.with("stays in the outbox") >= 3).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn abrupt_ends_at_any_moment_lose_and_double_nothing() {
    let mut scene = Scene::new().await;
    scene.keep = Duration::from_secs(3600);
    scene.capture(600, 500);
    for round in 0..12u64 {
        let work = scene.work();
        sleep(Duration::from_millis(7 * round)).await;
        drop(work);
    }
    scene.verify();
    let _work = scene.work();
    scene.until_state(RecordState::Verified, 600).await;
    assert_eq!(scene.at_gateway(), 600);
    // The time is not over, nor is it at the next start; then it is.
    assert_eq!(scene.kept_here(), 600);
    scene.forwarder().tidy().expect("tidies");
    assert_eq!(scene.kept_here(), 600);
    scene.keep = Duration::ZERO;
    scene.forwarder().tidy().expect("tidies");
    scene.until("tidied", |scene| scene.kept_here() == 0).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_the_gateway_cannot_prove_stays_unverified_and_here() {
    let mut scene = Scene::new().await;
    scene.capture(20, 100);
    scene.stage.desk.state().proofless = true;
    scene.verify();
    let _work = scene.work();
    scene.until("told", |scene| scene.notes.with("its proofs show in no anchored batch") > 0).await;
    scene.forwarder().tidy().expect("tidies");
    assert_eq!((scene.counts().data_in(RecordState::Verified), scene.kept_here()), (0, 20));
    scene.stage.desk.state().proofless = false;
    scene.until_state(RecordState::Verified, 20).await;
    scene.until("given up", |scene| scene.kept_here() == 0).await;
    let verified = scene.plant.ledger.records.in_state(None, RecordState::Verified, 20).expect("rows");
    for row in verified {
        let kept = scene.plant.ledger.forwarding.proven(row.digest).expect("reads").expect("kept");
        let signed = [&b"AuthROS/feed/1"[..], &context().domain.0, &kept.statement].concat();
        context().provider.verify(&pair(0x21).public, &signed, &kept.signature).expect("signed by the gateway");
        assert!(kept.statement.windows(32).any(|bytes| bytes == row.digest.0), "and about this record");
        assert!(crate::chain::AnchorProof::parse(&kept.proofs[0].1).is_ok());
    }
}

#[test]
fn another_gateways_note_is_not_taken_for_this_ones() {
    let home = tempfile::tempdir().expect("folder");
    let file = home.path().join("gateway.json");
    let one = crate::model::SignerId([1; 32]);
    assert_eq!(trust_in(&file, one).expect("no note yet"), Trust::pinned(one));
    let list = crate::gateway::hello::ListSummary { version: 1, digest: Digest([0; 32]) };
    Trust { seen: Some(list), ..Trust::pinned(one) }.save(&file).expect("writes");
    assert!(trust_in(&file, one).is_ok_and(|trust| trust.seen.is_some()));
    assert!(trust_in(&file, crate::model::SignerId([2; 32])).is_err());
}

/// What a robot learns of its recorders, without a line: each recorder's rows, by number.
fn hear(proofs: &mut Proofs, rows: &[(u64, RecorderId)], head: u64) -> Vec<u64> {
    let mut told = Vec::new();
    for group in proofs.groups() {
        while let Some(asked) = proofs.asks(&group) {
            let after = asked.places[0].after;
            let wanted = rows.iter().filter(|(number, recorder)| *number > after && group.contains(recorder));
            // Pages of one row.
            let next = wanted.map(|(number, _)| *number).min();
            told.extend(next);
            let upto = next.unwrap_or(head);
            let page = FeedPage::new([1; 16], (head, upto), Vec::new(), Vec::new());
            proofs.took(&FeedPage { is_anew: asked.id != [1; 16], ..page }, &asked);
            if upto == head {
                break;
            }
        }
    }
    told
}

fn recorders(count: u8) -> BTreeSet<RecorderId> {
    (1..=count).map(|number| RecorderId([number; 16])).collect()
}

fn proofs() -> Proofs {
    let recorders = BTreeMap::new();
    Proofs { owner: Address([1; 20]), id: [1; 16], newest: 0, recorders, sweep: None, swept: None }
}

#[test]
fn a_robot_hears_of_all_its_recorders_however_many_starts_of_its_ring_wait() {
    let (mut proofs, all) = (proofs(), recorders(100));
    let rows: Vec<(u64, RecorderId)> = (1..).zip(all.iter().rev().copied()).collect();
    let mut told = BTreeSet::new();
    for _ in 0..5 {
        proofs.follow(&all, Instant::now());
        assert!(proofs.groups().iter().all(|group| group.len() <= MOST_NAMED));
        told.extend(hear(&mut proofs, &rows, 200));
    }
    assert_eq!(told, (1..=100).collect(), "none is passed by");
    assert_eq!(proofs.done(), 200);
    // One that is new here has nothing before.
    let more = recorders(101);
    proofs.follow(&more, Instant::now());
    assert_eq!((proofs.done(), proofs.recorders.len()), (200, 101));
    proofs.follow(&recorders(2), Instant::now());
    assert_eq!(proofs.recorders.len(), 2, "of the others nothing waits any more");
}

#[test]
fn a_proof_that_never_holds_keeps_no_newer_one_waiting() {
    let (mut proofs, all) = (proofs(), recorders(2));
    let [one, other] = [1, 2].map(|number| RecorderId([number; 16]));
    let (mut now, mut rows, mut pauses) = (Instant::now(), vec![(5, one)], Vec::new());
    for round in 0..8u64 {
        let number = 10 + round;
        rows.push((number, other));
        proofs.follow(&all, now);
        let told = hear(&mut proofs, &rows, number);
        assert!(told.contains(&number), "{round}: {told:?}");
        assert!(told.contains(&5), "{round}: looked at again");
        proofs.hold((one, 5), Duration::from_secs(1));
        assert_eq!(proofs.done(), 4, "and is again after a restart");
        pauses.push(proofs.recorders[&one].pause.as_secs());
        now = Instant::now() + LONGEST_HOLD;
    }
    assert_eq!(pauses, [1, 2, 4, 8, 16, 32, 64, 128]);
}
