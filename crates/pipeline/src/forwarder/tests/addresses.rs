//! A robot that knows several addresses of its gateway: the next takes over when one is gone, and only its owner adds one.

use super::notices::{enrolment, record};
use super::*;
use crate::crypto::{EoaSecret, GatewayAddresses, Notice, Passphrase, SealedEnrolment, signer_id};
use crate::gateway::Limits;
use crate::model::SignerId;
use crate::pipeline::Author;
use crate::pipeline::notices::Notices;

/// The gateway at the scene's own address, and then at this one.
fn at_both(scene: &Scene, second: &Relay) -> GatewayAccess {
    let mut access = scene.access();
    access.addresses.push(second.address.to_string());
    access
}

fn start(scene: &Scene, mut forwarder: Forwarder) -> Work {
    let (link, refused, stored) = (forwarder.link(), forwarder.refused(), Arc::clone(&scene.stored));
    Work { link, refused, task: tokio::spawn(async move { forwarder.run(&stored).await }) }
}

async fn nowhere() -> std::net::SocketAddr {
    tokio::net::TcpListener::bind("127.0.0.1:0").await.expect("port").local_addr().expect("address")
}

fn in_place(work: &Work) -> bool {
    matches!(&*work.link.borrow(), Link::InPlace(text) if text.contains(" instead of "))
}

#[tokio::test(flavor = "multi_thread")]
async fn the_next_address_takes_over_and_the_first_takes_back() {
    let mut scene = Scene::new().await;
    let there = scene.stage.server.address();
    let second = Relay::to(there).await;
    let work = start(&scene, scene.forwarder_to(&at_both(&scene, &second)));
    scene.capture(30, 100);
    scene.until_state(RecordState::Submitted, 30).await;
    scene.until("the first is used", |_| *work.link.borrow() == Link::Up).await;

    scene.relay.lead_to(nowhere().await);
    scene.relay.cut();
    scene.capture(40, 100);
    scene.until("the second is used", |_| in_place(&work)).await;
    scene.until_state(RecordState::Submitted, 70).await;
    scene.until("why is said", |scene| scene.notes.with("cannot be used at") > 0).await;
    // What it signed for at one address it answers for at the other.
    scene.verify();
    scene.until_state(RecordState::Verified, 70).await;

    scene.relay.lead_to(there);
    scene.until("home again", |_| *work.link.borrow() == Link::Up).await;
    second.lead_to(nowhere().await);
    second.cut();
    scene.capture(5, 100);
    scene.until_state(RecordState::Verified, 75).await;
    assert_eq!(scene.at_gateway(), 75, "none lost and none twice");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_address_that_swallows_packets_is_left_for_the_next() {
    let mut scene = Scene::new().await;
    let second = Relay::to(scene.stage.server.address()).await;
    // As a robot in the field: its patience with one of several addresses, and its pauses.
    let robot = Robot { patience: Duration::from_secs(10), ..scene.robot() };
    let forwarder = Forwarder::new(scene.plant.clone(), robot, &at_both(&scene, &second)).expect("trusts");
    let work = start(&scene, forwarder);
    scene.capture(5, 100);
    scene.verify();
    scene.until_state(RecordState::Verified, 5).await;

    // Nothing is on its way: the robot asks whether the gateway is there.
    scene.relay.mute();
    let begun = Instant::now();
    scene.until("the next one is used", |_| in_place(&work)).await;
    println!("nothing to send: the next address is used {:?} after the first one fell silent", begun.elapsed());
    assert!(begun.elapsed() < Duration::from_secs(20), "ten seconds are promised on a machine that is not busy");
    scene.capture(7, 100);
    scene.until("the gateway has them", |scene| scene.at_gateway() == 12).await;
    scene.relay.cut();
    scene.until("home again", |_| *work.link.borrow() == Link::Up).await;

    // Records are on their way: the gateway takes them and its receipt is lost.
    scene.relay.mute();
    scene.capture(3, 100);
    let begun = Instant::now();
    scene.until("each has a receipt", |scene| scene.counts().data_in(RecordState::Stored) == 0).await;
    println!("records on their way: they have a receipt {:?} after the first address fell silent", begun.elapsed());
    assert!(begun.elapsed() < Duration::from_secs(20), "ten seconds are promised on a machine that is not busy");
    assert_eq!(scene.at_gateway(), 15, "none lost and none twice");
}

#[tokio::test(flavor = "multi_thread")]
async fn another_gateway_at_an_address_gets_nothing_and_says_why() {
    let mut scene = Scene::new().await;
    let other = Stage::known_by(0x24, Limits::default()).await;
    let second = Relay::to(other.server.address()).await;
    let there = scene.stage.server.address();
    // Before it starts: a connection that is open already would stay with the first gateway.
    scene.relay.lead_to(nowhere().await);
    let work = start(&scene, scene.forwarder_to(&at_both(&scene, &second)));
    scene.capture(10, 100);
    scene.until("it is refused", |scene| scene.notes.with("not the pinned gateway") > 0).await;
    let told = matches!(&*work.link.borrow(), Link::Away(text) if text.contains(&second.address.to_string()));
    assert!(told, "{:?}: the first may come back", work.link.borrow());
    scene.relay.lead_to(there);
    scene.until_state(RecordState::Submitted, 10).await;
    assert_eq!((scene.at_gateway(), other.desk.record_count()), (10, 0));
}

/// A notice of addresses, signed by the owner's d_C and within it by an account.
fn notice(scene: &Scene, account: &EoaSecret, seq: u64, (gateway, addresses): (SignerId, Vec<String>)) -> Upload {
    let device = signer_id(&scene.device.public);
    let list = GatewayAddresses::sign(&context().domain, account, device, (gateway, addresses)).expect("signs");
    record(scene, &scene.alice.signing, device, (seq, 1), &Notice::Addresses(list))
}

#[tokio::test(flavor = "multi_thread")]
async fn an_address_added_by_the_owner_is_used_and_one_added_by_a_thief_is_not() {
    let mut scene = Scene::new().await;
    let second = Relay::to(scene.stage.server.address()).await;
    let passphrase = Passphrase::new("correct horse".to_owned()).expect("long enough");
    let sealed = SealedEnrolment::new(enrolment(&scene), &passphrase).expect("stretches");
    let (kept, given) = (SealedEnrolment::kept_in(scene.home.path()), scene.home.path().join("given"));
    sealed.create(&given).expect("writes");
    let author = Arc::new(Author::new(scene.alice.account()));
    let observer = Arc::clone(&scene.plant.observer);
    let notices = Notices::new(context().provider, observer, author, sealed, kept.clone(), super::notices::taker());
    let named = notices.gateway();
    let forwarder = scene.forwarder().with_errand(Box::new(notices)).following(named);
    let work = start(&scene, forwarder);
    let known = || {
        let mut robot = SealedEnrolment::open(&given, &passphrase).expect("opens");
        robot.catch_up(&kept).expect("reads");
        robot.enrolment.gateway
    };

    let mut owner = scene.owner().await;
    let GatewayAccess { addresses, fingerprint, .. } = at_both(&scene, &second);
    // A thief of d_C alone cuts no robot off, and its gateway stays the one that it was enrolled at.
    let thief = EoaSecret::generate().expect("an account");
    let elsewhere = vec![second.address.to_string()];
    owner.upload(vec![notice(&scene, &thief, 1, (fingerprint, elsewhere.clone()))]).await.expect("taken");
    scene.until("passed over", |scene| scene.notes.with("ignored a notice") == 1).await;
    let of_another = (SignerId([9; 32]), elsewhere);
    owner.upload(vec![notice(&scene, &scene.alice.eoa, 2, of_another)]).await.expect("taken");
    scene.until("passed over", |scene| scene.notes.with("ignored a notice") == 2).await;
    assert_eq!(known(), scene.access());

    owner.upload(vec![notice(&scene, &scene.alice.eoa, 3, (fingerprint, addresses))]).await.expect("taken");
    scene.until("both are kept", |scene| known() == at_both(scene, &second)).await;
    scene.until("connected", |_| *work.link.borrow() == Link::Up).await;
    scene.relay.lead_to(nowhere().await);
    scene.relay.cut();
    scene.capture(10, 100);
    scene.until("the new one is used", |_| in_place(&work)).await;
    scene.until_state(RecordState::Submitted, 10).await;
}
