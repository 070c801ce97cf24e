//! A thief of the owner's SM2 key tells her robots that her key is now another one, his own; so does a thief of her
//! account. Each also has what a stolen robot holds.

use std::path::Path;

use authros::crypto::{
    Enrolment, EoaSecret, Keyring, OwnerKeyChange, Passphrase, ProviderName, SealRequest, SealedEnrolment, SmKeyPair,
    notice_topic, provider, random_bytes, seal,
};
use authros::gateway::{Client, Code, GatewayError, Upload};
use authros::model::{PublicKey, RecordKind, RecorderPrefix, Timestamp};

use crate::enrolled_robot::{Robot, Scene, head, session};
use crate::support::member::{Gateway, Member, connect};
use crate::support::{count, poll, wait_until};
use crate::{Outcome, judge};

/// All that alice has; each thief takes one key of it.
fn keyring(scene: &Scene) -> Keyring {
    let directory = scene.home.path().join("profiles").join("alice");
    let passphrase = std::fs::read_to_string(directory.join("passphrase")).expect("a passphrase");
    let passphrase = Passphrase::new(passphrase.trim_end().to_owned()).expect("long enough");
    Keyring::load(&directory.join("keyring"), &passphrase).expect("opens")
}

/// A notice to the robot that its owner's key is `to` from now on, signed by `signer` and, inside, by `account`.
fn notice(robot: &Enrolment, signer: &SmKeyPair, account: &EoaSecret, to: PublicKey) -> Upload {
    let change = OwnerKeyChange::sign(&robot.domain, account, robot.owner_key, to).expect("signs");
    let body = [&[1], &change.encode()[..]].concat();
    let head = head(notice_topic(&robot.device_id()), "authros/Keys", &body);
    let request = SealRequest {
        domain: robot.domain,
        owner: robot.owner,
        signer,
        epoch: robot.keys.now.epoch,
        topic_key: &robot.notice_key,
        recorder: RecorderPrefix::ledger(random_bytes().expect("random")),
        seq: 1,
        topic_id: robot.notice_id,
        kind: RecordKind::Key,
        filters: Vec::new(),
        captured_at: Timestamp::now(),
        head: &head,
        body: &body,
    };
    Upload::from(&seal(provider(ProviderName::RustCrypto), &request).expect("seals"))
}

/// A session of the owner herself.
async fn owners_session(scene: &Scene, robot: &Enrolment) -> Client {
    let address = format!("127.0.0.1:{}", scene.port);
    let (id, domain) = (robot.gateway.fingerprint, robot.domain);
    let gateway = Gateway { address, id, domain, account: String::new() };
    let credentials = Member::of(&scene.home, "alice", domain).allocate(&gateway, "thief").await.expect("allocated");
    connect(&gateway, &credentials).await
}

/// Whom the robot considers its owner, according to its files.
fn believed(robot: &Robot) -> PublicKey {
    let passphrase = std::fs::read_to_string(format!("{}.passphrase", robot.file)).expect("a passphrase");
    let passphrase = Passphrase::new(passphrase.trim_end().to_owned()).expect("long enough");
    let mut kept = SealedEnrolment::open(Path::new(&robot.file), &passphrase).expect("opens");
    kept.catch_up(&SealedEnrolment::kept_in(&robot.home.path())).expect("readable");
    kept.enrolment.owner_key
}

#[tokio::test(flavor = "multi_thread")]
async fn rekey_the_fleet_with_a_stolen_signing_key() {
    let scene = Scene::new();
    let robot = Robot::enrol(&scene, "scout-1", &["/robot1/odom"]);
    let agent = robot.spawn(&[]);
    wait_until(120, "the gateway takes its records", || {
        let figures = agent.stdout().lines().rev().find_map(|line| serde_json::from_str(line).ok());
        figures.filter(|figures: &serde_json::Value| count(figures, "accepted") > 0)
    });
    let (stolen, owner, thief) =
        (robot.stolen(), keyring(&scene), SmKeyPair::generate(provider(ProviderName::RustCrypto)));
    let (thief, account) = (thief.expect("generates"), EoaSecret::generate().expect("generates"));
    let mut client = session(&stolen).await.expect("the robot's own session");

    let by_account = client.upload(vec![notice(&stolen, &thief, &owner.eoa, thief.public)]).await;
    let by_key = || vec![notice(&stolen, &owner.signing, &account, thief.public)];
    let by_robot = client.upload(by_key()).await;
    assert!(matches!(by_robot, Err(GatewayError::Refused(Code::NotYours))), "a robot sends only its own: {by_robot:?}");
    // The thief of d_C who has a session of the owner's too.
    let mut client = owners_session(&scene, &stolen).await;
    let by_key = client.upload(by_key()).await;
    let passed_over = || agent.stderr().contains("ignored a notice");
    let obeyed = || believed(&robot) == thief.public;
    let heard = by_key.is_ok() || by_account.is_ok();
    let settled = poll(60, || (!heard || passed_over() || obeyed()).then_some(()));
    // The account alone signs no record; d_C alone does, and the robot wants the account's word too.
    let named = matches!(by_account, Err(GatewayError::Refused(Code::Signature))) && by_key.is_ok() && passed_over();
    let words = |outcome: Result<_, GatewayError>| outcome.err().map_or("taken".to_owned(), |error| error.to_string());
    let at_gateway = format!("by the account: {}; by d_C: {}", words(by_account), words(by_key));
    let outcome = match (obeyed(), settled) {
        (true, _) => Outcome::Succeeded(format!("the robot obeys the thief ({at_gateway})")),
        (false, Some(())) if named && believed(&robot) == stolen.owner_key => {
            Outcome::Refused(format!("passed over, the robot keeps its owner's key; at the gateway {at_gateway}"))
        }
        (false, Some(())) => Outcome::Otherwise(format!("not passed over by name; at the gateway {at_gateway}")),
        (false, None) => {
            Outcome::Otherwise(format!("the robot heard nothing within a minute ({at_gateway})\n{}", agent.stderr()))
        }
    };
    agent.stop("TERM", 30);
    judge("rekey_the_fleet_with_a_stolen_signing_key", outcome);
}
