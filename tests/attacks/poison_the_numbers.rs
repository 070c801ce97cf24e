//! The thief of one robot, before its recall, uses up the numbers of its owner's own site: records that the robot signed,
//! under the recorder of that site, with numbers that leave no room behind them. If it worked, the owner's capture would stop
//! for ever, and no other robot would hear of the recall any more.

use authros::crypto::record::signed_bytes;
use authros::crypto::{Enrolment, Provider, ProviderName, SealRequest, notice_topic, provider, random_bytes, seal};
use authros::gateway::{Code, Upload};
use authros::model::{Digest, Header, RecordKind, RecorderId, RecorderPrefix, SignerId, Timestamp, TopicId};
use serde_json::Value;

use crate::enrolled_robot::{Robot, Scene, head, session};
use crate::parts::Parts;
use crate::support::gate::Gate;
use crate::support::member::Member;
use crate::support::{Authros, Home, count, text, wait_until};
use crate::{Outcome, judge};

const TOPIC: &str = "/robot1/odom";
/// What the robot records that nobody stole.
const HONEST_TOPIC: &str = "/robot1/camera/compressed";
/// The last number of a ledger, the last one of the format, one behind it, and some that come next.
const NUMBERS: [u64; 6] = [u64::MAX >> 1, (1 << 40) - 1, 1 << 40, (1 << 40) + 1, 5, 6];
/// How long another robot may take to follow its owner into the epoch that the recall began, seconds.
const BOUND: u64 = 10;

/// A record that the robot signed, under any recorder and number.
fn forged(robot: &Enrolment, place: (TopicId, RecordKind), recorder: RecorderId, seq: u64) -> Upload {
    let provider: &dyn Provider = provider(ProviderName::RustCrypto);
    let body = b"a number is taken";
    let head = head(TOPIC.to_owned(), "std_msgs/String", body);
    let request = SealRequest {
        domain: robot.domain,
        owner: robot.owner,
        signer: &robot.device,
        epoch: robot.keys.now.epoch,
        topic_key: &robot.notice_key,
        recorder: RecorderPrefix::ledger(random_bytes().expect("random")),
        seq: 1,
        topic_id: place.0,
        kind: place.1,
        filters: Vec::new(),
        captured_at: Timestamp::now(),
        head: &head,
        body,
    };
    let sealed = seal(provider, &request).expect("seals");
    let (header, length) = Header::parse(&sealed.blob).expect("a header");
    let header = Header { recorder, seq, ..header };
    let blob = [&header.encode()[..], &sealed.blob[length..]].concat();
    let digest = Digest(provider.sm3(&[&blob]));
    let signature = provider.sign(&robot.device.secret, &signed_bytes(&robot.domain, &digest)).expect("signs");
    Upload { signature, blob }
}

/// Sends such records for every topic that matters to the owner, in a session of the robot.
async fn poison(parts: &mut Parts, robot: &Enrolment, recorder: RecorderId, topics: &[(String, TopicId)]) {
    let mut client = session(robot).await.expect("the robot's own session");
    for (name, topic) in topics {
        for seq in NUMBERS {
            for kind in [RecordKind::Data, RecordKind::Key, RecordKind::Audit] {
                let taken = client.upload(vec![forged(robot, (*topic, kind), recorder, seq)]).await;
                let reached = taken.map(|_| format!("number {seq} of {name} is taken"));
                parts.answered("a number of the owner's site", reached, &[Code::Malformed]);
            }
        }
    }
}

/// The topics whose numbers an owner cannot do without, with their pseudonyms.
fn topics_of(owner: &Member, other: &Robot) -> Vec<(String, TopicId)> {
    let device: SignerId = other.device.parse().expect("an id");
    let names = [TOPIC.to_owned(), "authros/audit".to_owned(), "authros/recorder".to_owned(), notice_topic(&device)];
    names.into_iter().map(|name| (name.clone(), owner.topic(&name).0)).collect()
}

/// The recorder of what the owner's own key signed.
fn recorder_of(alice: &Authros, home: &Home, owner: &Member) -> RecorderId {
    let signer = authros::crypto::signer_id(&owner.keyring.signing.public);
    wait_until(60, "a record that the owner signed", || {
        let of_kind = |kind| alice.records_so_far(&["records", "list", "--oldest", "--kind", kind]).unwrap_or_default();
        let mut records = ["data", "key", "audit"].into_iter().flat_map(of_kind);
        records.find_map(|record| {
            let id = text(&record, "id");
            let folder = home.root().join(&id);
            let place = folder.to_str().expect("UTF-8");
            alice.run(&["records", "export", &id, "--dir", place]);
            let blob = std::fs::read(folder.join("record.bin")).ok()?;
            let (header, _) = Header::parse(&blob).expect("a header");
            (header.signer == signer).then_some(header.recorder)
        })
    })
}

/// The highest epoch in the records of the robot that nobody stole.
fn epoch_of_honest(alice: &Authros) -> Option<u64> {
    let records = alice.records_so_far(&["records", "list", "--oldest", "--topic", HONEST_TOPIC])?;
    records.iter().map(|record| count(record, "epoch")).max()
}

/// The thief tries with a robot of one topic and with one of all topics; then the owner's site goes on, and the recall
/// reaches the other robot in time. `captures`: whether the owner's site does.
async fn attempt(alice: &Authros, home: &Home, robots: [&Robot; 3], captures: bool) -> Outcome {
    let [scoped, whole, honest] = robots;
    let stolen = [scoped.stolen(), whole.stolen()];
    let capture = || captures.then(|| alice.capture(&[TOPIC], 3));
    let agent = honest.spawn(&["--topic", HONEST_TOPIC]);
    wait_until(120, "the other robot records", || epoch_of_honest(alice));
    capture();
    // Each robot gets a notice of it, a record that the owner signs.
    alice.json(&["keys", "rotate"]);
    let owner = Member::of(home, "alice", stolen[0].domain);
    let (recorder, topics) = (recorder_of(alice, home, &owner), topics_of(&owner, honest));
    let mut parts = Parts::default();
    for robot in &stolen {
        poison(&mut parts, robot, recorder, &topics).await;
    }
    capture();
    let recalled: Value = alice.json(&["robot", "revoke", &whole.device]);
    let epoch = count(&recalled, "epoch");
    let begun = std::time::Instant::now();
    wait_until(BOUND, "the other robot seals under the epoch of the recall", || {
        epoch_of_honest(alice).filter(|sealed| *sealed >= epoch)
    });
    println!("the other robot followed {} ms after the recall was told", begun.elapsed().as_millis());
    capture();
    agent.stop("TERM", 30);
    parts.outcome()
}

#[tokio::test(flavor = "multi_thread")]
async fn poison_the_numbers() {
    let home = Home::new();
    let capturing = home.profile("alice").with(&["--robots", "1"]);
    capturing.enrol();
    let capturing = capturing.serve(&home);
    let scene = Scene::in_home(home);
    let scoped = Robot::enrol(&scene, "scout-1", &[TOPIC]);
    let (whole, honest) = (Robot::enrol(&scene, "scout-2", &[]), Robot::enrol(&scene, "scout-3", &[]));
    let outcome = attempt(&scene.alice, &scene.home, [&scoped, &whole, &honest], true).await;
    judge("poison_the_numbers", outcome);
    let audited = scene.alice.run(&["audit"]);
    assert!(!audited.stdout.contains("missing from the ledger"), "no number is missing: {}", audited.stdout);
    scene.site.stop("TERM", 20);
    capturing.stop("TERM", 20);
}

#[tokio::test(flavor = "multi_thread")]
async fn poison_the_numbers_of_an_owner_elsewhere() {
    let (gate, home) = (Gate::new(), Home::new());
    let alice = home
        .profile("alice")
        .with(&["--robots", "1"])
        .with_variable("AUTHROS_SITE", &gate.gateway.address)
        .with_variable("AUTHROS_GATEWAY_KEY", gate.key());
    let address = alice.enrol();
    gate.home.authros().json(&["gateway", "allow", &address]);
    let site = alice.serve(&home);
    let at = (&gate.gateway.address[..], gate.key());
    let scoped = Robot::enrol_at(&alice, at, "scout-1", &[TOPIC]);
    let (whole, honest) = (Robot::enrol_at(&alice, at, "scout-2", &[]), Robot::enrol_at(&alice, at, "scout-3", &[]));
    let outcome = attempt(&alice, &home, [&scoped, &whole, &honest], false).await;
    judge("poison_the_numbers_of_an_owner_elsewhere", outcome);
    site.stop("TERM", 20);
}
