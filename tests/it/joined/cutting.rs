//! A gateway whose chain is cut off, and one that sees the same chain: rights hold at both.

use std::time::SystemTime;

use authros::crypto::{SmKeyPair, signer_id};
use authros::gateway::{Code, DeviceNotice, Feed};
use authros::model::{Digest, RecordKind};
use serde_json::json;

use super::sessions::{Asking, known, runtime, session};
use super::*;
use support::anvil::{call, number};
use support::member::{Member as Keys, until_verified};

/// One block and two seconds are promised; the rest is for a busy machine.
const HEEDED: Duration = Duration::from_secs(30);

/// The block of the first event of the contract after a block.
fn first_event_after(ground: &Ground, head: u64) -> u64 {
    let filter = json!([{ "fromBlock": format!("{:#x}", head + 1), "toBlock": "latest", "address": ground.contract }]);
    let logs = call(ground.port, "eth_getLogs", &filter);
    let blocks = logs.as_array().expect("logs").iter().map(|log| number(&log["blockNumber"]));
    blocks.min().expect("the act is on the chain")
}

/// Does something that changes rights; returns the time of its block.
fn act(ground: &Ground, what: impl FnOnce()) -> SystemTime {
    let head = number(&call(ground.port, "eth_blockNumber", &json!([])));
    what();
    SystemTime::UNIX_EPOCH + Duration::from_secs(ground.time_of(first_event_after(ground, head)))
}

/// How long after the first moment the second one was; nothing if it was before.
fn after(first: SystemTime, second: SystemTime) -> Duration {
    second.duration_since(first).unwrap_or_default()
}

/// A gateway that sees the chain refuses soon after the block, and from then on.
#[allow(clippy::print_stdout, reason = "figures for who reads the run")]
fn expect_heeded(asking: &Asking, (block, code): (SystemTime, Code)) {
    let answers = asking.since(block);
    let (at, _) = answers.iter().find(|(_, answer)| *answer == Err(code)).expect("refused");
    println!("{} is refused at gateway {} {:?} after the block", asking.subject, asking.place, after(block, *at));
    assert!(after(block, *at) < HEEDED, "{} at gateway {}", asking.subject, asking.place);
    let later: Vec<_> = answers.iter().filter(|(when, answer)| when > at && *answer != Err(code)).collect();
    assert!(later.iter().all(|(_, answer)| *answer == Err(Code::Stale)), "{}: {later:?}", asking.subject);
}

/// The one that is cut off says nothing but that it does not know, and after that at once what is right.
#[allow(clippy::print_stdout, reason = "figures for who reads the run")]
fn expect_refused_by_the_cut_one(asking: &Asking, (cut, healed): (SystemTime, SystemTime), code: Code) {
    let (meanwhile, later): (Vec<_>, Vec<_>) = asking.since(cut).into_iter().partition(|(at, _)| *at < healed);
    let stale = meanwhile.iter().position(|(_, answer)| *answer == Err(Code::Stale)).expect("it noticed");
    let told = after(cut, meanwhile[stale].0);
    println!("{}: the gateway that is cut off answers Stale {told:?} after that", asking.subject);
    assert!(told < HEEDED, "{}", asking.subject);
    let words: Vec<_> = meanwhile[stale..].iter().filter(|(_, answer)| *answer != Err(Code::Stale)).collect();
    assert!(words.is_empty(), "{}: {words:?}", asking.subject);
    let first = later.iter().find(|(_, answer)| *answer != Err(Code::Stale)).expect("it answers again");
    assert_eq!(first.1, Err(code), "{}: the first answer", asking.subject);
    assert!(later.iter().all(|(_, answer)| answer.is_err()), "{}: {later:?}", asking.subject);
}

#[test]
fn a_revocation_a_recall_and_a_suspension_hold_at_a_gateway_and_at_one_that_is_cut_off() {
    let _alone = heavy();
    let (ground, runtime) = (Ground::new(), runtime());
    let line = Cable::to(ground.port);
    let gateways = [Gateway::over(&ground, &line), Gateway::new(&ground)];
    // They join the one that sees the chain, and the other one admits them too.
    let alice = Member::new("alice", &gateways[1]);
    let readers = ["bob", "dave", "erin"].map(|name| (name, Member::new(name, &gateways[1])));
    readers.iter().for_each(|(_, reader)| alice.grant(reader));
    readers.iter().map(|(_, reader)| reader).chain([&alice]).for_each(|member| gateways[0].admit(&member.address));
    let domain = gateways[0].domain.parse().expect("a domain");
    let keys = Keys::of(&alice.home, "alice", domain);
    let (device, (notices, _)) = (SmKeyPair::generate(keys.provider()).expect("a pair"), keys.topic("of the robot"));
    let id = signer_id(&device.public).to_string();
    alice.authros.json(&["robot", "authorise", &id]);

    let hers = keys.record(&keys.keyring.signing, TOPIC, 1, b"one message");
    let digest = Digest(keys.provider().sm3(&[&hers.blob]));
    let mut asked = Vec::new();
    for (place, gateway) in gateways.iter().enumerate() {
        let gateway = known(gateway);
        runtime.block_on(async {
            let (mut owner, _) = session(&keys, &gateway, "owner").await;
            owner.upload(vec![hers.clone()]).await.expect("taken");
            let (mut robot, credentials) = session(&keys, &gateway, "scout").await;
            let notice = DeviceNotice { key: device.public, notices };
            while robot.device(&keys.keyring.signing, notice).await.is_err() {
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
            until_verified(&mut owner, Feed::of(keys.address()), &[digest]).await;
            let of_robot = Feed { topics: vec![notices], kind: Some(RecordKind::Key), ..Feed::of(keys.address()) };
            asked.push(Asking::begin(&runtime, ("scout", place), (gateway.clone(), credentials), of_robot));
            for (name, reader) in &readers {
                let his = Keys::of(&reader.home, name, domain);
                let (_, credentials) = session(&his, &gateway, &format!("{name}-reads")).await;
                let feed = Feed::of(keys.address());
                asked.push(Asking::begin(&runtime, (*name, place), (gateway.clone(), credentials), feed));
            }
        });
    }
    wait_until(60, "everybody is answered everywhere", || {
        let is_answered = |asking: &Asking| match asking.newest() {
            Some(Ok(count)) => count == usize::from(asking.subject != "scout"),
            _ => false,
        };
        asked.iter().all(is_answered).then_some(())
    });

    let cut = SystemTime::now();
    line.cut();
    let [bob, dave] = [&readers[0].1.address, &readers[1].1.address];
    let revoked = act(&ground, || drop(alice.authros.json(&["grant", "end", bob])));
    let recalled = act(&ground, || drop(alice.authros.json(&["robot", "revoke", &id])));
    let suspended = act(&ground, || drop(ground.founder.json(&["chain", "admin", "suspend", dave])));
    let wanted = |subject: &str| match subject {
        "bob" => Some((revoked, Code::NotAuthorised)),
        "scout" => Some((recalled, Code::NotAuthorised)),
        "dave" => Some((suspended, Code::Suspended)),
        _ => None,
    };
    wait_until(60, "the one that sees the chain refuses", || {
        let mut seeing = asked.iter().filter(|asking| asking.place > 0);
        let is_right =
            |asking: &Asking| wanted(asking.subject).is_none_or(|(_, code)| asking.newest() == Some(Err(code)));
        seeing.all(is_right).then_some(())
    });
    // A while longer than any promise.
    std::thread::sleep(Duration::from_secs(3));
    let healed = SystemTime::now();
    line.mend();
    wait_until(60, "the one that was cut off answers again", || {
        let here = || asked.iter().filter(|asking| asking.place == 0);
        let reads = here().any(|asking| asking.subject == "erin" && matches!(asking.newest(), Some(Ok(1))));
        (reads && here().all(|asking| asking.newest() != Some(Err(Code::Stale)))).then_some(())
    });
    for asking in &asked {
        match (wanted(asking.subject), asking.place) {
            (Some((_, code)), 0) => expect_refused_by_the_cut_one(asking, (cut, healed), code),
            (Some(wanted), _) => expect_heeded(asking, wanted),
            (None, _) => assert_eq!(asking.newest(), Some(Ok(1)), "{} has his right", asking.subject),
        }
    }
}
