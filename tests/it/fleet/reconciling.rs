//! Gateways that name each other: what a robot brings to one is at the other, once, whatever happens to the first.

use authros::gateway::{Selection, Standing};
use authros::model::Digest;

use super::sessions::{known, runtime, session};
use super::*;
use support::list;
use support::member::Member as Keys;

/// How soon a reader at one gateway has what was verified at another: asked for by the product.
const ELSEWHERE: Duration = Duration::from_secs(5);

/// Each names all others.
pub(super) fn name_each_other(gateways: &[&Gateway]) {
    for one in gateways {
        for other in gateways.iter().filter(|other| other.key != one.key) {
            one.keeper().json(&["fleet", "add", &other.address(), "--gateway-key", &other.key]);
        }
    }
}

/// What a gateway knows of the others.
pub(super) fn fellows(gateway: &Gateway) -> Vec<Value> {
    list(&gateway.keeper().json(&["fleet", "status"]), "fellows")
}

fn taken(gateway: &Gateway) -> u64 {
    fellows(gateway).iter().map(|fellow| count(fellow, "taken")).sum()
}

/// Waits until a gateway has everything that the others told, and took at least so many records of them.
pub(super) fn reconciled(gateway: &Gateway, least: u64) -> Vec<Value> {
    wait_until(120, "it has what the others hold", || {
        let fellows = fellows(gateway);
        let taken: u64 = fellows.iter().map(|fellow| count(fellow, "taken")).sum();
        (taken >= least && fellows.iter().all(|fellow| fellow["reconciled"] == true)).then_some(fellows)
    })
}

/// Runs a robot for so many messages, until all are verified at its gateway; returns how many it has captured in all.
pub(super) fn bring(robot: &Robot, messages: &str) -> u64 {
    let outcome = robot.run(&["--count", messages]).wait(180).expect_code(0);
    let summary: Value = serde_json::from_str(outcome.stdout.lines().last().expect("a document")).expect("JSON");
    assert_eq!(count(&summary, "verified"), count(&summary, "captured"), "{summary}");
    count(&summary, "captured")
}

#[test]
fn what_robots_bring_to_one_gateway_is_at_the_other_when_its_disk_is_gone() {
    let _alone = heavy();
    let ground = Ground::new();
    let (mut first, second) = (Gateway::new(&ground), Gateway::new(&ground));
    let both = [&first, &second];
    let alice = Member::new("alice", &both);
    // He asks the second one alone.
    let bob = Member::new("bob", &[&second]);
    alice.grant(&bob);
    let (scout, rover) = (Robot::enrol(&alice, "scout", &[&first]), Robot::enrol(&alice, "rover", &[&second]));
    let before = bring(&scout, "10");

    // One side alone is not enough.
    second.keeper().json(&["fleet", "add", &first.address(), "--gateway-key", &first.key]);
    let problem =
        wait_until(60, "the first one refuses", || fellows(&second)[0]["problem"].as_str().map(str::to_owned));
    assert!(problem.contains("authros fleet add"), "{problem}");
    assert_eq!(taken(&second), 0);
    name_each_other(&both);
    let begun = Instant::now();
    let shared = ["shared", "list", "--owner", &alice.address];
    bob.verified(&shared, before);
    println!("the reader has {before} records of the other gateway {:?} after both were named", begun.elapsed());

    let all = bring(&scout, "10") + bring(&rover, "10");
    assert!(all > before + 10, "{before} and then {all}");
    let at_bob = bob.verified(&shared, all);
    assert_eq!(alice.verified(&["uploads", "list"], all), at_bob, "the owner, who asks both, has each once");
    for gateway in both {
        let found = reconciled(gateway, 10);
        assert!(found[0]["problem"].is_null(), "{found:?}");
        assert_eq!(list(&found[0], "refused"), Vec::<Value>::new(), "{found:?}");
    }

    first.kill();
    let lost = std::mem::replace(&mut first.home, Home::new());
    drop(lost);
    let carol = Member::new("carol", &[&second]);
    alice.grant(&carol);
    assert_eq!(carol.verified(&shared, all), at_bob, "a reader who comes afterwards has all of them, once");
}

#[test]
fn a_gateway_that_was_cut_off_catches_up_by_itself() {
    let _alone = heavy();
    let ground = Ground::new();
    let (first, mut second) = (Gateway::new(&ground), Gateway::new(&ground));
    let alice = Member::new("alice", &[&first, &second]);
    let bob = Member::new("bob", &[&second]);
    alice.grant(&bob);
    name_each_other(&[&first, &second]);
    let robot = Robot::enrol(&alice, "scout", &[&first]);
    let shared = ["shared", "list", "--owner", &alice.address];
    let before = bring(&robot, "5");
    bob.verified(&shared, before);
    // It neither answers nor closes anything.
    second.site.as_ref().expect("running").signal("STOP");
    let during = bring(&robot, "5");
    wait_until(60, "the first one notices", || fellows(&first)[0]["problem"].as_str().map(drop));
    second.site.as_ref().expect("running").signal("CONT");
    bob.verified(&shared, during);
    // It dies in the middle of things and has forgotten all but what it holds.
    let agent = robot.run(&[]);
    accepted(&agent, 10);
    second.kill();
    accepted(&agent, 20);
    second.start();
    agent.stop("TERM", 20);
    let all = robot.settle();
    let at_bob = bob.verified(&shared, all);
    assert_eq!(alice.verified(&["uploads", "list"], all), at_bob, "the owner, who asks both, has each once");
    wait_until(60, "the first one is at ease", || fellows(&first)[0]["problem"].is_null().then_some(()));
}

#[test]
fn a_reader_at_one_gateway_has_what_is_verified_at_another_within_five_seconds() {
    let _alone = heavy();
    let (ground, runtime) = (Ground::new(), runtime());
    let (first, second) = (Gateway::new(&ground), Gateway::new(&ground));
    let both = [&first, &second];
    let (alice, bob) = (Member::new("alice", &both), Member::new("bob", &[&second]));
    alice.grant(&bob);
    name_each_other(&both);
    let domain = first.domain.parse().expect("a domain");
    let (keys, his) = (Keys::of(&alice.home, "alice", domain), Keys::of(&bob.home, "bob", domain));
    let mut waits = runtime.block_on(async {
        let (first, second) = (known(&first), known(&second));
        let (mut robot, _) = session(&keys, &first, "scout").await;
        let (mut owner, _) = session(&keys, &first, "owner").await;
        let (mut reader, _) = session(&his, &second, "bob-reads").await;
        while reader.subscribe(&Selection::all(keys.address())).await.is_err() {
            // The gateway has not read the grant yet.
            tokio::time::sleep(Duration::from_millis(200)).await;
        }
        let mut waits = Vec::new();
        for seq in 1..=20 {
            let record = keys.record(&keys.keyring.signing, TOPIC, seq, b"one of twenty");
            let digest = Digest(keys.provider().sm3(&[&record.blob]));
            robot.upload(vec![record]).await.expect("taken");
            let verified = async {
                while owner.check(&[digest]).await.expect("answers").standings() != [Standing::Verified] {
                    tokio::time::sleep(Duration::from_millis(10)).await;
                }
                Instant::now()
            };
            let arrived = async {
                let (_, entry, _) = reader.next_event(Duration::from_secs(120)).await.expect("arrives");
                assert_eq!(entry.digest, digest, "in their order, each once");
                Instant::now()
            };
            let (verified, arrived) = tokio::join!(verified, arrived);
            waits.push(arrived.saturating_duration_since(verified));
        }
        waits
    });
    waits.sort();
    let (middle, longest) = (waits[waits.len() / 2], waits[waits.len() - 1]);
    println!(
        "from verified at one gateway to the reader at another: p50 {middle:?}, max {longest:?} of {}",
        waits.len()
    );
    // A machine that stands still for a moment may delay one of them.
    assert!(middle < ELSEWHERE && longest < 6 * ELSEWHERE, "{waits:?}");
}
