//! A robot of two gateways: one takes over when the other is gone, and nothing rests on one gateway's word alone.

use super::notices::{Noting, enrolment, record};
use super::*;
use crate::crypto::{EoaSecret, GatewayList, ListedGateway, Notice, Passphrase, SealedEnrolment, signer_id};
use crate::gateway::Limits;
use crate::pipeline::Author;
use crate::pipeline::notices::Notices;

/// The second gateway, which knows the robot as well.
struct Second {
    stage: Stage,
    relay: Relay,
    credentials: Credentials,
}

impl Second {
    async fn beside(scene: &Scene) -> Self {
        let stage = Stage::known_by(0x24, Limits::default()).await;
        let credentials = stage.enrol(&scene.alice).await;
        let mut owner = stage.connect(&credentials).await.expect("connects");
        stage.desk.lend(&scene.alice, &scene.device);
        owner.device(&scene.alice.signing, notice_of(&scene.device)).await.expect("told");
        let relay = Relay::to(stage.server.address()).await;
        Self { stage, relay, credentials }
    }

    fn access(&self) -> GatewayAccess {
        let (address, fingerprint) = (self.relay.address.to_string(), self.stage.server.id());
        GatewayAccess { address, fingerprint, transport: self.credentials.key.clone() }
    }

    fn holds(&self) -> usize {
        self.stage.desk.record_count()
    }
}

fn start(scene: &Scene, mut forwarder: Forwarder) -> Work {
    let (link, refused, stored) = (forwarder.link(), forwarder.refused(), Arc::clone(&scene.stored));
    Work { link, refused, task: tokio::spawn(async move { forwarder.run(&stored).await }) }
}

/// Where nobody listens.
async fn nowhere() -> std::net::SocketAddr {
    tokio::net::TcpListener::bind("127.0.0.1:0").await.expect("port").local_addr().expect("address")
}

#[tokio::test(flavor = "multi_thread")]
async fn the_next_gateway_takes_over_and_the_first_takes_back() {
    let mut scene = Scene::new().await;
    let second = Second::beside(&scene).await;
    let forwarder = scene.forwarder_to(&[scene.access(), second.access()]);
    let work = start(&scene, forwarder.resending_after(Duration::from_secs(3600)));
    scene.capture(30, 100);
    scene.until_state(RecordState::Submitted, 30).await;
    assert_eq!((scene.at_gateway(), second.holds()), (30, 0), "the first alone");

    let first = scene.stage.server.address();
    scene.relay.lead_to(nowhere().await);
    scene.relay.cut();
    scene.capture(40, 100);
    scene.until_state(RecordState::Submitted, 70).await;
    assert_eq!((scene.at_gateway(), second.holds()), (30, 40), "none twice");
    assert!(matches!(&*work.link.borrow(), Link::InPlace(text) if text.contains("in place of")));

    // Each gateway answers for what it signed for.
    second.stage.desk.state().standing = Some(Standing::Verified);
    scene.until_state(RecordState::Verified, 40).await;
    scene.verify();
    scene.relay.lead_to(first);
    scene.until_state(RecordState::Verified, 70).await;
    scene.until("home again", |_| *work.link.borrow() == Link::Up).await;
    scene.capture(5, 100);
    scene.until_state(RecordState::Verified, 75).await;
    assert_eq!((scene.at_gateway(), second.holds()), (35, 40));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_gateway_that_swallows_packets_is_left_for_the_next() {
    let mut scene = Scene::new().await;
    let second = Second::beside(&scene).await;
    // As a robot in the field: its patience with one of several gateways, and its pauses.
    let robot = Robot { patience: Duration::from_secs(10), ..scene.robot() };
    let list = [scene.access(), second.access()];
    let forwarder = Forwarder::new(scene.plant.clone(), robot, &list).expect("trusts");
    let work = start(&scene, forwarder.resending_after(Duration::from_secs(3600)));
    scene.capture(5, 100);
    scene.verify();
    scene.until_state(RecordState::Verified, 5).await;
    let in_place = |work: &Work| matches!(&*work.link.borrow(), Link::InPlace(text) if text.contains("in place of"));

    // Nothing is on its way: the robot asks whether the gateway is there.
    scene.relay.mute();
    let begun = Instant::now();
    scene.until("the next one is on duty", |_| in_place(&work)).await;
    println!("nothing to send: the next gateway is on duty {:?} after the first one fell silent", begun.elapsed());
    assert!(begun.elapsed() < Duration::from_secs(20), "ten seconds are promised on a machine that is not busy");
    scene.capture(7, 100);
    scene.until("the next one has them", |_| second.holds() == 7).await;
    scene.relay.cut();
    scene.until("home again", |_| *work.link.borrow() == Link::Up).await;

    // Records are on their way: it takes them and its receipt is lost.
    scene.relay.mute();
    scene.capture(3, 100);
    let begun = Instant::now();
    scene.until("the next one has these too", |_| second.holds() == 10).await;
    println!("records on their way: the next gateway has them {:?} after the first one fell silent", begun.elapsed());
    assert!(begun.elapsed() < Duration::from_secs(20), "ten seconds are promised on a machine that is not busy");
    scene.until("each has a receipt", |scene| scene.counts().data_in(RecordState::Stored) == 0).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_one_gateway_does_not_prove_goes_to_the_next_once() {
    let mut scene = Scene::new().await;
    let second = Second::beside(&scene).await;
    let list = [scene.access(), second.access()];
    // Long enough for the first one to take all of them on a busy machine.
    let after = Duration::from_secs(1);
    let work = start(&scene, scene.forwarder_to(&list).resending_after(after));
    scene.capture(300, 100);
    scene.until("the next one has them", |_| second.holds() == 300).await;
    // Both have all of them, and neither gets one again.
    sleep(after * 4).await;
    assert_eq!((scene.at_gateway(), second.holds(), scene.counts().data_in(RecordState::Submitted)), (300, 300, 300));
    drop(work);

    // The first one's disk is gone; whoever proves them first decides.
    scene.stage.desk.state().records.clear();
    scene.stage.desk.state().standing = Some(Standing::Unknown);
    second.stage.desk.state().standing = Some(Standing::Verified);
    let _work = start(&scene, scene.forwarder_to(&list).resending_after(after));
    scene.until_state(RecordState::Verified, 300).await;
    assert_eq!(scene.counts().data_in(RecordState::Tampered), 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_receipt_of_a_gateway_that_never_comes_back_is_not_the_end() {
    let mut scene = Scene::new().await;
    let second = Second::beside(&scene).await;
    let list = [scene.access(), second.access()];
    let work = start(&scene, scene.forwarder_to(&list).resending_after(Duration::from_millis(200)));
    scene.until("connected", |_| *work.link.borrow() == Link::Up).await;
    scene.capture(20, 100);
    scene.until_state(RecordState::Submitted, 20).await;
    scene.relay.lead_to(nowhere().await);
    scene.relay.cut();
    second.stage.desk.state().standing = Some(Standing::Verified);
    scene.until_state(RecordState::Verified, 20).await;
    assert_eq!(second.holds(), 20);
    // A robot that starts again without the first one knows what the second one proved.
    drop(work);
    let _work = start(&scene, scene.forwarder_to(&list));
    scene.capture(3, 100);
    scene.until_state(RecordState::Verified, 23).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_gateway_that_was_away_is_tried_again_for_what_another_does_not_prove() {
    let mut scene = Scene::new().await;
    let second = Second::beside(&scene).await;
    let there = second.stage.server.address();
    second.relay.lead_to(nowhere().await);
    let list = [scene.access(), second.access()];
    let work = start(&scene, scene.forwarder_to(&list).resending_after(Duration::from_millis(200)));
    scene.capture(10, 100);
    scene.until("the next one was tried", |scene| scene.notes.with("accepts no records") > 0).await;
    assert_eq!((scene.at_gateway(), second.holds(), work.link.borrow().clone()), (10, 0, Link::Up));
    second.relay.lead_to(there);
    scene.until("it is tried again", |_| second.holds() == 10).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn one_gateways_word_alone_keeps_no_record_from_the_next() {
    let mut scene = Scene::new().await;
    let second = Second::beside(&scene).await;
    let list = [scene.access(), second.access()];
    // It says that it holds other bytes,
    scene.stage.desk.state().standing = Some(Standing::Tampered);
    let _work = start(&scene, scene.forwarder_to(&list).resending_after(Duration::from_millis(200)));
    scene.capture(10, 100);
    scene.until("told", |scene| scene.notes.with("go to the next gateway") > 0).await;
    scene.until("the next one has them", |_| second.holds() == 10).await;
    assert_eq!(scene.counts().data_in(RecordState::Tampered), 0);
    // and that all is verified, without a proof.
    {
        let mut state = scene.stage.desk.state();
        (state.proofless, state.standing) = (true, Some(Standing::Verified));
    }
    scene.capture(5, 100);
    scene.until("the next one has these too", |_| second.holds() == 15).await;
    assert_eq!(scene.counts().data_in(RecordState::Verified), 0);
    second.stage.desk.state().standing = Some(Standing::Verified);
    scene.until_state(RecordState::Verified, 15).await;
}

/// A notice of gateways, signed by the owner's d_C and within it by an account.
fn notice(scene: &Scene, account: &EoaSecret, seq: u64, gateways: Vec<ListedGateway>) -> Upload {
    let device = signer_id(&scene.device.public);
    let list = GatewayList::sign(&context().domain, account, device, gateways).expect("signs");
    record(scene, &scene.alice.signing, device, (seq, 1), &Notice::Gateways(list))
}

#[tokio::test(flavor = "multi_thread")]
async fn a_gateway_added_by_the_owner_is_used_and_one_added_by_a_thief_is_not() {
    let mut scene = Scene::new().await;
    let second = Second::beside(&scene).await;
    let passphrase = Passphrase::new("correct horse".to_owned()).expect("long enough");
    let sealed = SealedEnrolment::new(enrolment(&scene), &passphrase).expect("stretches");
    let (kept, given) = (SealedEnrolment::kept_in(scene.home.path()), scene.home.path().join("given"));
    sealed.create(&given).expect("writes");
    let author = Arc::new(Author::new(scene.alice.account()));
    let observer = Arc::clone(&scene.plant.observer);
    let notices = Notices::new(context().provider, observer, author, sealed, kept.clone(), Arc::new(Noting::default()));
    let told = notices.gateways();
    let forwarder = scene.forwarder().with_errand(Box::new(notices)).following(told);
    let work = start(&scene, forwarder);
    let known = || {
        let mut robot = SealedEnrolment::open(&given, &passphrase).expect("opens");
        robot.catch_up(&kept).expect("reads");
        robot.enrolment.gateways
    };

    let mut owner = scene.stage.connect(&scene.credentials).await.expect("connects");
    let listed = |access: GatewayAccess, with_key: bool| ListedGateway {
        address: access.address,
        fingerprint: access.fingerprint,
        transport: with_key.then_some(access.transport),
    };
    // Whoever has d_C alone leads no robot away.
    let thief = EoaSecret::generate().expect("an account");
    owner.upload(vec![notice(&scene, &thief, 1, vec![listed(second.access(), true)])]).await.expect("taken");
    scene.until("passed over", |scene| scene.notes.with("ignored a notice") > 0).await;
    assert_eq!(known(), [scene.access()]);

    let both = vec![listed(scene.access(), false), listed(second.access(), true)];
    owner.upload(vec![notice(&scene, &scene.alice.eoa, 2, both)]).await.expect("taken");
    scene.until("both are kept", |_| known() == [scene.access(), second.access()]).await;
    scene.until("connected", |_| *work.link.borrow() == Link::Up).await;
    scene.relay.lead_to(nowhere().await);
    scene.relay.cut();
    scene.capture(10, 100);
    scene.until("the new one has them", |_| second.holds() == 10).await;
    scene.until_state(RecordState::Submitted, 10).await;
}
