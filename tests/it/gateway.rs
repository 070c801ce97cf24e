//! `authros gateway serve`: records of robots stored, anchored and served; revocation; replay; what a kill leaves.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]
#![allow(clippy::print_stdout, reason = "figures that the run shows")]

use crate::support;

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::time::Duration;

use authros::chain::AnchorProof;
use authros::crypto::{Anchor, Expected, Names, SmKeyPair, notice_topic, open, signer_id, topic_id};
use authros::gateway::{Client, Code, Credentials, DeviceNotice, Feed, GatewayError, Request, Upload};
use authros::model::bytes::hex;
use authros::model::{Digest, Header, RecordKind, Timestamp};
use support::client_stream::Recorder;
use support::member::{Gateway, Live, Member, connect, told, until_verified};
use support::{Authros, Home, Redis, Running, count, heavy, holds, is_verified, long, poll, skipped, text, wait_until};

const TOPIC: &str = "/robot7/log";

struct Site {
    home: Home,
    process: Running,
    gateway: Gateway,
}

fn gateway_process(home: &Home, listen: &str, options: &[&str]) -> (Running, Gateway) {
    listening(&home.profile("gateway").with(&["--json"]).with(options), listen)
}

fn listening(keeper: &Authros, listen: &str) -> (Running, Gateway) {
    let mut process = keeper.spawn(&["gateway", "serve", "--listen", listen]);
    let told = process.wait_for_text("\"joined\"", 60);
    let line = told.lines().find(|line| line.contains("\"joined\"")).expect("one line").to_owned();
    let gateway = Gateway::of(&serde_json::from_str(&line).expect("JSON"));
    (process, gateway)
}

fn site() -> Site {
    let home = Home::new();
    let (process, gateway) = gateway_process(&home, "127.0.0.1:0", &[]);
    Site { home, process, gateway }
}

fn digest(member: &Member, upload: &Upload) -> Digest {
    Digest(member.provider().sm3(&[&upload.blob]))
}

fn refused(result: Result<impl std::fmt::Debug, GatewayError>) -> Code {
    match result {
        Err(GatewayError::Refused(code) | GatewayError::RefusedInClear(code)) => code,
        other => panic!("not refused: {other:?}"),
    }
}

/// The name under which a record of these bytes is stored; also the order in which they were written.
fn bodies(count: u64) -> Vec<Vec<u8>> {
    (1..=count).map(|number| format!("entry {number} of the log").into_bytes()).collect()
}

/// The operator sees who is connected, which system keys are in use, and what was refused.
fn expect_status(site: &Site) {
    let status = site.home.authros().json(&["gateway", "status"]);
    let robot = support::list(&status, "senders").into_iter().find(|sender| sender["name"] == "robot-7");
    let robot = robot.expect("the robot is among the senders");
    assert!(robot["sessions"] == 1 && robot["frames"].as_u64() >= Some(2) && robot["peer"].is_string(), "{robot}");
    let keys = support::list(&status, "keys");
    assert!(keys.len() == 2 && keys[0]["current"] == true && keys[1]["current"] == false, "{status}");
    let refused = support::list(&status, "refused");
    assert!(refused.iter().any(|row| row["code"] == Code::NotAuthorised.number() && row["count"] == 2), "{status}");
}

#[tokio::test(flavor = "multi_thread")]
async fn what_robots_send_is_anchored_by_the_gateway_and_read_by_a_grantee_until_the_revoke() {
    let site = site();
    let (alice, bob) = (site.home.profile("alice"), site.home.profile("bob"));
    let (_, bob_address) = (alice.enrol(), bob.enrol());
    let owner = Member::of(&site.home, "alice", site.gateway.domain);
    let credentials = owner.allocate(&site.gateway, "robot-7").await.expect("allocates");
    let mut robot = connect(&site.gateway, &credentials).await;
    let sent = bodies(120);
    let uploads: Vec<Upload> =
        (1..).zip(&sent).map(|(seq, body)| owner.record(&owner.keyring.signing, TOPIC, seq, body)).collect();
    let digests: Vec<Digest> = uploads.iter().map(|upload| digest(&owner, upload)).collect();
    let receipt = robot.upload(uploads.clone()).await.expect("accepted");
    assert_eq!(receipt.digests, digests, "a receipt, checked by the client, over exactly these");
    robot.upload(uploads.clone()).await.expect("known ones are acknowledged again");
    until_verified(&mut robot, Feed::of(owner.address()), &digests).await;

    let own = alice.records(&["records", "list", "--oldest"]);
    assert_eq!(own.len(), 120, "each once");
    assert!(own.iter().all(|record| is_verified(record) && record["topic"] == TOPIC), "{:?}", own[0]);
    assert_eq!(own[0]["type"], "std_msgs/String");
    let shown = alice.json(&["records", "show", &text(&own[0], "id")]);
    assert!(shown.to_string().contains(&site.gateway.account), "the gateway's account anchors: {shown}");

    // A reader without a grant learns nothing, not even that there is something.
    let reader = Member::of(&site.home, "bob", site.gateway.domain);
    let reader_credentials = reader.allocate(&site.gateway, "bob").await.expect("allocates");
    let mut session = connect(&site.gateway, &reader_credentials).await;
    assert_eq!(refused(session.feed(&Feed::of(owner.address())).await), Code::NotAuthorised);
    assert_eq!(refused(session.fetch(&digests[0]).await), Code::NotAuthorised);
    let unknown = [0, 1].map(|index| (digests[index], Code::NotFound));
    assert_eq!(session.missing(&digests[..2]).await.expect("answers"), unknown);
    expect_status(&site);

    alice.json(&["grant", "add", &bob_address]);
    let read = read_all(&mut session, &owner, &reader).await;
    assert_eq!(read, sent, "each once, with its proof");
    let (topic, _) = owner.topic(TOPIC);
    let of_topic = Feed { topics: vec![topic], kind: Some(RecordKind::Data), ..Feed::of(owner.address()) };
    assert_eq!(told(&mut session, &of_topic).await.expect("told").len(), 120);
    let of_none = Feed { topics: vec![owner.topic("/never").0], ..of_topic };
    assert!(told(&mut session, &of_none).await.expect("told").is_empty());

    revoked_while_live(&alice, &bob_address, (&owner, &mut robot), &mut session).await;
    site.process.stop("TERM", 20).expect_code(0);
}

/// Follows everything and opens it as a second client would: digest, proof, signature, keys.
async fn read_all(session: &mut Client, owner: &Member, reader: &Member) -> Vec<Vec<u8>> {
    let mut read = Vec::new();
    for entry in told(session, &Feed::of(owner.address())).await.expect("told") {
        let fetched = session.fetch(&entry.digest).await.expect("a record");
        let (header, _) = Header::parse(&fetched.blob).expect("a record");
        assert_eq!(entry.proof, fetched.proof);
        let proof = AnchorProof::parse(&fetched.proof).expect("a proof");
        let leaf = authros::chain::merkle::Leaf::of(&header, entry.digest);
        assert!(proof.inclusion.expect("batched").proves(&leaf));
        let expected = Expected::any_of(owner.domain, owner.address(), Names::Derived(owner.index().clone()));
        let (_, key) = owner.topic(TOPIC);
        let signer = &fetched.signer;
        let anchor = Anchor::Chain(entry.digest);
        let opened = open(reader.provider(), &fetched.blob, &fetched.signature, signer, anchor, &key, &expected);
        read.push((entry.seq, opened.expect("opens").body));
    }
    read.sort();
    read.into_iter().map(|(_, body)| body).collect()
}

/// No further record reaches a follower after the block of the revoke.
async fn revoked_while_live(alice: &Authros, bob: &str, (owner, robot): (&Member, &mut Client), session: &mut Client) {
    let mut live = Live::begin(session, Feed::of(owner.address())).await.expect("granted");
    let send = async |robot: &mut Client, seq: u64| {
        let upload = owner.record(&owner.keyring.signing, TOPIC, seq, b"live");
        robot.upload(vec![upload]).await.expect("accepted");
    };
    send(robot, 121).await;
    let (entry, _) = live.next(session, Duration::from_secs(30)).await.expect("reaches the follower");
    assert_eq!(entry.seq, 121);
    let revoking = {
        let (alice, bob) = (alice.clone(), bob.to_owned());
        tokio::task::spawn_blocking(move || alice.json(&["grant", "end", &bob]))
    };
    let mut cut = None;
    let mut last = 121;
    while cut.is_none() {
        send(robot, last + 1).await;
        last += 1;
        match live.next(session, Duration::from_millis(300)).await {
            Ok(_) | Err(GatewayError::TimedOut) => {}
            Err(error) => cut = Some((error, Timestamp::now())),
        }
        assert!(last < 500, "never cut");
    }
    let (error, cut_at) = cut.expect("cut");
    let told = tokio::task::spawn_blocking(move || revoking).await.expect("runs").await.expect("revoked");
    let block = count(&told, "block");
    println!("revoked in block {block}; {error}; cut at {cut_at}");
    let since = Timestamp::now().0.saturating_sub(cut_at.0);
    println!("the command that revoked answered {} ms after the cut", since / 1_000_000);
    assert!(matches!(error, GatewayError::Refused(Code::NotAuthorised)), "{error}");
    for seq in last + 1..last + 4 {
        send(robot, seq).await;
    }
    assert!(live.next(session, Duration::from_secs(3)).await.is_err(), "nothing after the cut");
    assert_eq!(refused(session.feed(&Feed::of(owner.address())).await), Code::NotAuthorised);
}

#[tokio::test(flavor = "multi_thread")]
async fn devices_sign_while_they_are_lent_and_names_belong_to_one_account() {
    let site = site();
    let (alice, bob) = (site.home.profile("alice"), site.home.profile("bob"));
    alice.enrol();
    bob.enrol();
    let owner = Member::of(&site.home, "alice", site.gateway.domain);
    let other = Member::of(&site.home, "bob", site.gateway.domain);
    let credentials = owner.allocate(&site.gateway, "robot-1").await.expect("allocates");
    assert_eq!(refused(other.allocate(&site.gateway, "robot-1").await.map(|_| ())), Code::NameBound);
    let device = SmKeyPair::generate(owner.provider()).expect("a pair");
    let id = signer_id(&device.public);
    let notice = DeviceNotice { key: device.public, notices: topic_id(owner.index(), &notice_topic(&id)) };
    let mut robot = connect(&site.gateway, &credentials).await;
    let upload = owner.record(&device, TOPIC, 1, b"signed by a device");
    assert_eq!(refused(robot.upload(vec![upload.clone()]).await), Code::Signature, "not lent");
    assert_eq!(refused(robot.device(&owner.keyring.signing, notice).await), Code::Signature, "not lent");
    alice.json(&["robot", "authorise", &id.to_string()]);
    assert_eq!(refused(robot.upload(vec![upload.clone()]).await), Code::Signature, "lent, but its key is not known");
    robot.device(&owner.keyring.signing, notice).await.expect("noted");
    robot.upload(vec![upload.clone()]).await.expect("accepted");
    let signed_by_it = Feed { recorders: vec![owner.recorder.of_signer(&id)], ..Feed::of(owner.address()) };
    until_verified(&mut robot, signed_by_it, &[digest(&owner, &upload)]).await;
    let opened = alice.json(&["records", "open", &digest(&owner, &upload).to_string()]);
    assert_eq!(opened["verdict"], "verified", "the owner reads what her device signed: {opened}");
    alice.json(&["robot", "revoke", &id.to_string()]);
    let late = owner.record(&device, TOPIC, 2, b"signed by a stolen device");
    assert_eq!(refused(robot.upload(vec![late]).await), Code::Signature, "recalled");
    let stranger = other.record(&other.keyring.signing, TOPIC, 1, b"of another owner");
    assert_eq!(refused(robot.upload(vec![stranger]).await), Code::NotYours);
    site.process.stop("TERM", 20).expect_code(0);
}

/// What a store of a gateway, or its cache, must not hold: names, types, tags, plaintext, keys.
fn expect_blind(dump: &[u8], owner: &Member, credentials: &Credentials, record: &Upload) {
    assert!(holds(dump, &record.blob), "the ciphertext is there, so the search is worth something");
    let (_, topic_key) = owner.topic(TOPIC);
    let epoch_key = owner.epoch_key();
    let secrets: [(&str, &[u8]); 9] = [
        ("topic", TOPIC.as_bytes()),
        ("type", b"std_msgs/String"),
        ("profile", b"alice"),
        ("name", b"robot-blind"),
        ("plaintext", b"the burglar wore a hat"),
        ("topic key", topic_key.expose()),
        ("epoch key", epoch_key.expose()),
        ("index key", owner.index().expose()),
        ("transport key", credentials.key.expose()),
    ];
    for (what, secret) in secrets {
        assert!(!holds(dump, secret), "it holds the {what}");
    }
}

async fn keep_one(home: &Home, gateway: &Gateway) -> (Member, Credentials, Upload) {
    home.profile("alice").enrol();
    let owner = Member::of(home, "alice", gateway.domain);
    let credentials = owner.allocate(gateway, "robot-blind").await.expect("allocates");
    let upload = owner.record(&owner.keyring.signing, TOPIC, 1, b"the burglar wore a hat");
    let mut robot = connect(gateway, &credentials).await;
    robot.upload(vec![upload.clone()]).await.expect("accepted");
    until_verified(&mut robot, Feed::of(owner.address()), &[digest(&owner, &upload)]).await;
    (owner, credentials, upload)
}

#[tokio::test(flavor = "multi_thread")]
async fn the_gateways_store_is_blind() {
    let site = site();
    let (owner, credentials, upload) = keep_one(&site.home, &site.gateway).await;
    site.process.stop("TERM", 20).expect_code(0);
    // The owner's records here are all foreign: nothing in the file is from her own home.
    let store = rusqlite::Connection::open(site.home.path().join("ledger.db")).expect("opens");
    let mut rows = store.prepare("SELECT bytes FROM ciphertext").expect("a table");
    let blobs = rows.query_map([], |row| row.get::<_, Vec<u8>>(0)).expect("rows");
    let dump: Vec<u8> = blobs.flat_map(|blob| blob.expect("bytes")).collect();
    expect_blind(&dump, &owner, &credentials, &upload);
}

#[tokio::test(flavor = "multi_thread")]
async fn the_gateways_redis_is_blind() {
    let Some(redis) = Redis::start(&[]) else { skipped!("no redis-server and redis-cli") };
    let home = Home::new();
    let (process, gateway) = gateway_process(&home, "127.0.0.1:0", &["--cache", &redis.url()]);
    let (owner, credentials, upload) = keep_one(&home, &gateway).await;
    wait_until(30, "it is in the cache", || holds(&redis.dump(), &upload.blob).then_some(()));
    expect_blind(&redis.dump(), &owner, &credentials, &upload);
    process.stop("TERM", 20).expect_code(0);
}

/// Written from PROTOCOL.md alone: it greets, follows the feed and checks what it gets.
#[tokio::test(flavor = "multi_thread")]
async fn a_second_client_written_from_the_document_follows_the_feed() {
    let Some(python) = support::system_program("python3") else { skipped!("no python3") };
    let site = site();
    let (alice, bob) = (site.home.profile("alice"), site.home.profile("bob"));
    let (_, bob_address) = (alice.enrol(), bob.enrol());
    let owner = Member::of(&site.home, "alice", site.gateway.domain);
    let credentials = owner.allocate(&site.gateway, "robot-7").await.expect("allocates");
    let mut robot = connect(&site.gateway, &credentials).await;
    let record = |(seq, body): (u64, &Vec<u8>)| owner.record(&owner.keyring.signing, TOPIC, seq, body);
    let uploads: Vec<Upload> = (1..).zip(&bodies(5)).map(record).collect();
    let digests: Vec<Digest> = uploads.iter().map(|upload| digest(&owner, upload)).collect();
    robot.upload(uploads).await.expect("accepted");
    until_verified(&mut robot, Feed::of(owner.address()), &digests).await;
    alice.json(&["grant", "add", &bob_address]);
    let reader = Member::of(&site.home, "bob", site.gateway.domain);
    let credentials = reader.allocate(&site.gateway, "bob-2").await.expect("allocates");
    let mut session = connect(&site.gateway, &credentials).await;
    while session.feed(&Feed::of(owner.address())).await.is_err() {
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    let read = |key: &[u8]| {
        let mut command = std::process::Command::new(&python);
        command.args(["-B", concat!(env!("CARGO_MANIFEST_DIR"), "/tests/support/second_client.py")]);
        let Gateway { address, id, domain, .. } = &site.gateway;
        command.arg(address).args([hex(&domain.0), hex(&id.0), "bob-2".to_owned(), hex(key)]);
        command.args([hex(&reader.token().0), hex(&owner.address().0)]);
        Running::start(command).wait(120)
    };
    let told = read(credentials.key.expose()).expect_code(0).document();
    let records = support::list(&told, "records");
    let mut seen: Vec<(u64, String)> = records.iter().map(|one| (count(one, "seq"), text(one, "digest"))).collect();
    assert!(records.iter().all(|one| one["fact"] == "verified" && one["bytes"].as_u64() > Some(300)), "{told}");
    assert!(records.is_sorted_by_key(|one| count(one, "number")) && count(&told, "head") >= 5, "{told}");
    seen.sort();
    assert_eq!(seen, (1..).zip(digests.iter().map(ToString::to_string)).collect::<Vec<_>>());

    let id = text(&alice.records(&["records", "list", "--oldest"])[1], "id");
    alice.json(&["records", "erase", "--record", &id, "--reason", "a face", "--yes"]);
    let erased = poll(60, || {
        let told = read(credentials.key.expose()).expect_code(0).document();
        let last = support::list(&told, "records").pop().expect("five of them");
        (last["fact"] == "erased").then_some(last)
    });
    let erased = erased.expect("its row is the last one now");
    assert_eq!(
        (&erased["header"], count(&erased, "number") > 5),
        (&erased["bytes"], true),
        "its header is left: {erased}"
    );
    assert_ne!(read(&[7; 32]).code, Some(0), "nothing without the transport key");
    site.process.stop("TERM", 20).expect_code(0);
}

/// The frames of a stream: length (4), then that many bytes.
fn frames(stream: &[u8]) -> Vec<&[u8]> {
    let (mut rest, mut found) = (stream, Vec::new());
    while let Some((length, _)) = rest.split_first_chunk::<4>() {
        let end = 4 + usize::try_from(u32::from_be_bytes(*length)).expect("fits");
        let Some((frame, more)) = rest.split_at_checked(end) else { break };
        found.push(frame);
        rest = more;
    }
    found
}

/// Sends bytes to the gateway and returns how many bytes it answered before it closed.
fn replay(address: &str, bytes: &[u8]) -> Vec<u8> {
    let mut stream = TcpStream::connect(address).expect("connects");
    stream.set_read_timeout(Some(Duration::from_secs(20))).expect("sets");
    // The gateway is supposed to close in between.
    drop(stream.write_all(bytes));
    let mut answer = Vec::new();
    drop(stream.read_to_end(&mut answer));
    answer
}

/// Replays every recorded stream in full: the answers are a hello and a refusal, never a transfer frame.
fn expect_refused(address: &str, streams: &[Vec<u8>]) -> usize {
    const TRANSFER: u8 = 4;
    let mut replayed = 0;
    for stream in streams {
        let answer = replay(address, stream);
        for frame in frames(&answer) {
            assert_ne!(frame.get(4), Some(&TRANSFER), "a replayed frame was answered");
        }
        replayed += frames(stream).len();
    }
    replayed
}

#[test]
fn recorded_frames_are_never_accepted_again_not_even_after_a_kill() {
    let _alone = heavy();
    tokio::runtime::Runtime::new().expect("a runtime").block_on(replay_all());
}

async fn replay_all() {
    let site = site();
    let alice = site.home.profile("alice");
    alice.enrol();
    let owner = Member::of(&site.home, "alice", site.gateway.domain);
    let recorder = Recorder::before(&site.gateway.address);
    let through = Gateway { address: recorder.address.clone(), ..site.gateway.clone() };
    let credentials = owner.allocate(&through, "robot-1").await.expect("allocates");
    let (sessions, each) = if long() { (20, 5_000) } else { (5, 2_000) };
    let mut seq = 0;
    for _ in 0..sessions {
        let mut robot = connect(&through, &credentials).await;
        for number in 0..each {
            if number % 100 == 0 {
                seq += 1;
                robot
                    .send(&Request::Upload(owner.record(&owner.keyring.signing, TOPIC, seq, b"once")))
                    .await
                    .expect("sent");
            } else {
                robot.send(&Request::Ping).await.expect("sent");
            }
            if number % 50 == 49 {
                for _ in 0..50 {
                    robot.receive(Duration::from_secs(20)).await.expect("answered");
                }
            }
        }
    }
    let records = |home: &Home| home.profile("alice").records(&["records", "list", "--oldest"]).len() as u64;
    wait_until(30, "all are there", || Some(()).filter(|()| records(&site.home) == seq));
    let streams = recorder.recorded();
    let before = expect_refused(&site.gateway.address, &streams);
    assert_eq!(records(&site.home), seq);
    inject(&site.gateway, &owner, &credentials, &streams).await;
    assert_eq!(records(&site.home), seq, "nothing twice");

    let address = site.gateway.address.clone();
    site.process.signal("KILL");
    site.process.wait(20);
    let (process, gateway) = gateway_process(&site.home, &address, &[]);
    let after = expect_refused(&gateway.address, &streams);
    assert_eq!(records(&site.home), seq);
    inject(&gateway, &owner, &credentials, &streams).await;
    assert_eq!(records(&site.home), seq, "nothing twice after a kill");
    println!("{before} recorded frames replayed before the kill and {after} after it: 0 accepted");
    assert!(before >= sessions * each && after == before);
    process.stop("TERM", 20).expect_code(0);
}

/// Recorded frames inside a present session: it ends at the first, without any effect.
async fn inject(gateway: &Gateway, owner: &Member, credentials: &Credentials, streams: &[Vec<u8>]) {
    let stream = streams.last().expect("recorded");
    for frame in frames(stream).iter().rev().take(5) {
        let recorder = Recorder::before(&gateway.address);
        let through = Gateway { address: recorder.address.clone(), ..gateway.clone() };
        let mut session = connect(&through, credentials).await;
        session.ping().await.expect("alive");
        let own = recorder.recorded().concat();
        // The same bytes again on their own connection, then the old frame: neither opens.
        assert!(!replay(&gateway.address, &[&own[..], frame].concat()).is_empty(), "refused in words");
    }
    let mut session = connect(gateway, credentials).await;
    assert!(session.feed(&Feed::of(owner.address())).await.is_ok(), "an honest session works");
}

#[test]
fn a_gateway_says_what_it_cannot_do() {
    let home = Home::new();
    let told = home
        .profile("gateway")
        .with(&["--anchor-mode", "each"])
        .fails(3, &["gateway", "serve", "--listen", "127.0.0.1:0"]);
    assert!(told.contains("anchor.mode"), "{told}");
    let taken = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = taken.local_addr().expect("an address").to_string();
    let told = home.profile("gateway").fails(3, &["gateway", "serve", "--listen", &address]);
    assert!(told.contains(&address), "{told}");
    assert!(poll(1, || home.socket()).is_none(), "no site is left behind");
}

#[test]
fn a_gateway_waits_for_a_short_command_and_does_not_end_with_it() {
    let home = Home::new();
    let keeper = home.profile("gateway").with(&["--robots", "1"]);
    keeper.enrol();
    // A command that is the site until it ends, with a chain and all.
    let short = keeper.spawn(&["capture", "--topic", "/robot1/odom", "--count", "100000"]);
    wait_until(60, "it has the home", || (keeper.json(&["status"])["process"] == short.id()).then_some(()));
    let mut serving = keeper.with(&["--json"]).spawn(&["gateway", "serve", "--listen", "127.0.0.1:0"]);
    wait_until(60, "it waits", || serving.stderr().contains("another command is using").then_some(()));
    assert!(serving.is_running() && !serving.stdout().contains("\"joined\""), "nor does it join");
    short.stop("INT", 60);
    let told = serving.wait_for_text("\"joined\"", 60);
    assert!(told.contains("\"joined\":false") || told.contains("\"joined\": false"), "{told}");
    std::thread::sleep(Duration::from_secs(1));
    serving.expect_running();
    let status = keeper.json(&["gateway", "status"]);
    assert!(status["served"].is_object(), "{status}");
    serving.stop("TERM", 30).expect_code(0);
}
