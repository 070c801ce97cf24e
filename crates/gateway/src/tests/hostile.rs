//! What an attacker sends: each attempt is refused with its code, changes nothing and harms nobody else.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream};
use tokio::time::timeout;

use super::stage::{Stage, refusal};
use super::*;
use crate::frame::Line;
use crate::gateway::command::{Inner, LARGEST_PART, Part};
use crate::gateway::frame::{FrameKind, encode};
use crate::gateway::hello::ClientHello;
use crate::gateway::session::Session;
use crate::model::{Signature, Token};

pub(super) const PATIENCE: Duration = Duration::from_secs(30);

fn alice() -> Member {
    Member::new("alice", 0x11)
}

/// The code with which the gateway closes a connection; `None` if it gives none.
pub(super) async fn last_words(stream: &mut TcpStream) -> Option<Code> {
    let mut bytes = Vec::new();
    // A reset after the refusal is as good as a close.
    let _ = timeout(PATIENCE, stream.read_to_end(&mut bytes)).await.expect("the gateway closes");
    let refusal = bytes.get(bytes.len().checked_sub(7)?..)?;
    assert_eq!(refusal[..5], [0, 0, 0, 3, FrameKind::Refusal.number()]);
    Code::from_number(u16::from_be_bytes([refusal[5], refusal[6]]))
}

pub(super) async fn raw(stage: &Stage, bytes: &[u8]) -> TcpStream {
    let mut stream = TcpStream::connect(stage.server.address()).await.expect("connects");
    stream.write_all(bytes).await.expect("writes");
    stream
}

/// A session whose frames the test writes itself.
pub(super) async fn session(stage: &Stage, credentials: &Credentials) -> (Line, Session) {
    let mut line = Line::new(TcpStream::connect(stage.server.address()).await.expect("connects"));
    let hello = ClientHello::begin(context()).expect("begins");
    line.send(FrameKind::Hello, &hello.encode(), PATIENCE).await.expect("sends");
    let (_, answer) = line.frame().await.expect("answers");
    let client = hello.agree(&answer).expect("agrees");
    let (identify, session) = client.identify(&credentials.name, Some(&credentials.key)).expect("seals");
    line.send(FrameKind::Identify, &identify, PATIENCE).await.expect("sends");
    (line, session)
}

pub(super) fn text(request: &Request, token: Token, signature: Option<Signature>) -> Vec<u8> {
    let (command, body) = (request.command(), request.encode());
    Inner { command, part: Part::Whole, request: 1, token: Some(token), signature, body: &body }.encode(false)
}

/// Sends a frame and returns the code of the refusal in clear that must follow.
async fn refused(line: &mut Line, payload: &[u8]) -> Code {
    line.send(FrameKind::Transfer, payload, PATIENCE).await.expect("sends");
    let (kind, payload) = timeout(PATIENCE, line.frame()).await.expect("in time").expect("a frame");
    assert_eq!(kind, FrameKind::Refusal);
    Code::from_number(u16::from_be_bytes([payload[0], payload[1]])).expect("a code")
}

#[tokio::test]
async fn frames_over_the_cap_of_no_kind_or_of_another_protocol_are_refused() {
    let stage = Stage::new().await;
    let hello = ClientHello::begin(context()).expect("begins").encode();
    let mut away = hello.clone();
    away[2] ^= 1;
    let mut version = hello.clone();
    version[0] = 2;
    let cases = [
        (4097u32.to_be_bytes().to_vec(), Code::Length),
        (u32::MAX.to_be_bytes().to_vec(), Code::Length),
        (vec![0; 4], Code::Length),
        (b"GET / HTTP/1.1\r\n\r\n".to_vec(), Code::Length),
        (vec![0, 0, 0, 2, 99, 0], Code::Length),
        (encode(FrameKind::Transfer, &[0; 60]), Code::Malformed),
        (encode(FrameKind::Identify, &[0; 50]), Code::Malformed),
        (encode(FrameKind::Hello, &hello[..100]), Code::Malformed),
        (encode(FrameKind::Hello, &away), Code::Network),
        (encode(FrameKind::Hello, &version), Code::Version),
        ([encode(FrameKind::Hello, &hello), encode(FrameKind::Identify, &[0; 50])].concat(), Code::Tag),
    ];
    for (bytes, code) in cases {
        assert_eq!(last_words(&mut raw(&stage, &bytes).await).await, Some(code), "{bytes:02x?}");
    }
    assert_eq!(stage.desk.state().changes, 0);
    stage.enrol(&alice()).await;
}

#[tokio::test]
async fn silent_and_dripping_peers_are_cut() {
    let patience = Duration::from_secs(2);
    let short = Limits { hello_time: patience, frame_time: patience, idle_time: 2 * patience, ..Limits::default() };
    let stage = Stage::with(short).await;
    let credentials = stage.enrol(&alice()).await;
    let mut client = stage.connect(&credentials).await.expect("connects");
    let hello = encode(FrameKind::Hello, &ClientHello::begin(context()).expect("begins").encode());
    // Half-open, half a length, half a hello, a hello without a name.
    let cut = async |bytes: &[u8]| last_words(&mut raw(&stage, bytes).await).await;
    let codes = tokio::join!(cut(&[]), cut(&[0, 0]), cut(&hello[..100]), cut(&hello));
    let slow = Some(Code::TooSlow);
    assert_eq!(codes, (slow, slow, slow, slow));
    assert_eq!(refusal(client.receive(PATIENCE).await), slow, "an idle session ends as well");
    stage.connect(&credentials).await.expect("others are served");
}

#[tokio::test]
async fn connections_over_the_limit_are_refused_and_places_are_given_back() {
    let stage = Stage::with(Limits { connections: 3, ..Limits::default() }).await;
    let credentials = stage.enrol(&alice()).await;
    let client = stage.connect(&credentials).await.expect("connects");
    let mut more = Vec::new();
    while stage.server.watch().connections() < 3 {
        more.push(raw(&stage, &[]).await);
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    assert_eq!(last_words(&mut raw(&stage, &[]).await).await, Some(Code::Busy));
    drop((client, more));
    let emptied = async {
        while stage.server.watch().connections() > 0 {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    timeout(PATIENCE, emptied).await.expect("places come back");
    stage.connect(&credentials).await.expect("connects again");
}

#[tokio::test]
async fn replayed_skipped_and_altered_frames_close_the_session() {
    let stage = Stage::new().await;
    let alice = alice();
    let credentials = stage.enrol(&alice).await;
    let upload = Request::Upload(alice.record(&alice.signing, 1, b"once"));
    let (mut line, mut sealing) = session(&stage, &credentials).await;
    let first = sealing.seal(&text(&upload, alice.token, None)).expect("seals");
    line.send(FrameKind::Transfer, &first, PATIENCE).await.expect("sends");
    line.frame().await.expect("a receipt");
    assert_eq!(stage.desk.state().changes, 2);
    assert_eq!(refused(&mut line, &first).await, Code::Counter, "replayed");
    assert!(line.frame().await.is_err(), "closed");

    let next = Request::Upload(alice.record(&alice.signing, 2, b"twice"));
    let (mut line, mut sealing) = session(&stage, &credentials).await;
    sealing.seal(b"lost on the way").expect("seals");
    let second = sealing.seal(&text(&next, alice.token, None)).expect("seals");
    assert_eq!(refused(&mut line, &second).await, Code::Counter, "skipped");
    let (mut line, _) = session(&stage, &credentials).await;
    assert_eq!(refused(&mut line, &first).await, Code::Session, "of another session");

    for (number, request) in sample_requests().iter().chain([&next]).enumerate() {
        let (mut line, mut sealing) = session(&stage, &credentials).await;
        let signature = request.command().is_signed().then_some(Signature([1; 64]));
        let mut payload = sealing.seal(&text(request, alice.token, signature)).expect("seals");
        let at = 24 + number * 7 % (payload.len() - 24);
        payload[at] ^= 1;
        assert_eq!(refused(&mut line, &payload).await, Code::Tag, "{:?}", request.command());
    }
    assert_eq!(stage.desk.state().changes, 2);
}

/// A signed Command's signature covers its own frame: in another frame of the same session it is invalid.
#[tokio::test]
async fn a_signature_of_another_frame_or_command_is_refused() {
    let stage = Stage::new().await;
    let alice = alice();
    let credentials = stage.enrol(&alice).await;
    let requests = sample_requests();
    let of = |command| requests.iter().find(|request| request.command() == command).expect("a sample");
    let (grant, revoke) = (of(Command::GrantNotice), of(Command::RevokeNotice));
    let (mut line, mut sealing) = session(&stage, &credentials).await;
    let sign = |sealing: &Session, counter: u64, request: &Request| {
        let body = crate::model::Digest(context().provider.sm3(&[&request.encode()]));
        let (gateway, domain) = (stage.server.id(), context().domain);
        let signed = command::signed_bytes(&domain, &gateway, &sealing.id(), counter, request.command(), &body);
        Some(context().provider.sign(&alice.signing.secret, &signed).expect("signs"))
    };
    let wrong = [
        (grant, sign(&sealing, 1, grant)),
        (grant, sign(&sealing, 1, revoke)),
        (revoke, sign(&sealing, 1, grant)),
        (grant, Some(Signature([0; 64]))),
    ];
    for (request, signature) in wrong {
        let payload = sealing.seal(&text(request, alice.token, signature)).expect("seals");
        line.send(FrameKind::Transfer, &payload, PATIENCE).await.expect("sends");
        let (_, answer) = line.frame().await.expect("answers");
        let (_, answer) = sealing.open(&answer).expect("opens");
        let inner = Inner::from_gateway(&answer).expect("parses");
        assert_eq!(Answer::parse(inner.command, inner.body), Ok(Answer::Refused(Code::Signature)));
        line.decoder.raise_cap();
    }
    let signature = sign(&sealing, sealing.next_counter(), grant);
    let payload = sealing.seal(&text(grant, alice.token, signature)).expect("seals");
    line.send(FrameKind::Transfer, &payload, PATIENCE).await.expect("sends");
    let (_, answer) = line.frame().await.expect("answers");
    sealing.open(&answer).expect("opens");
    let state = stage.desk.state();
    assert_eq!((state.grants.len(), state.revokes.len()), (1, 0));
}

/// Forwards a connection and records what the client sent.
async fn recording(target: std::net::SocketAddr) -> (String, Arc<Mutex<Vec<u8>>>) {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("listens");
    let address = listener.local_addr().expect("address").to_string();
    let recorded = Arc::new(Mutex::new(Vec::new()));
    let kept = Arc::clone(&recorded);
    tokio::spawn(async move {
        let (client, _) = listener.accept().await.expect("accepts");
        let (mut from_client, mut to_client) = client.into_split();
        let server = TcpStream::connect(target).await.expect("connects");
        let (mut from_server, mut to_server) = server.into_split();
        tokio::spawn(async move { tokio::io::copy(&mut from_server, &mut to_client).await });
        let mut buffer = vec![0; 65_536];
        while let Ok(count @ 1..) = from_client.read(&mut buffer).await {
            kept.lock().expect("not poisoned").extend_from_slice(&buffer[..count]);
            if to_server.write_all(&buffer[..count]).await.is_err() {
                return;
            }
        }
    });
    (address, recorded)
}

#[tokio::test]
async fn a_recorded_session_is_worth_nothing_and_shows_nothing() {
    let stage = Stage::new().await;
    let alice = alice();
    let credentials = stage.enrol(&alice).await;
    let (address, recorded) = recording(stage.server.address()).await;
    let endpoint = Endpoint { addresses: vec![address], ..stage.endpoint.clone() };
    let mut client = Client::connect(&endpoint, &mut stage.trust(), &credentials).await.expect("connects");
    for seq in 1..20 {
        client.upload(vec![alice.record(&alice.signing, seq, b"plaintext of a message")]).await.expect("receipt");
    }
    drop(client);
    let bytes = recorded.lock().expect("not poisoned").clone();
    let before = stage.desk.state().changes;
    for _ in 0..50 {
        assert_eq!(last_words(&mut raw(&stage, &bytes).await).await, Some(Code::Tag), "other keys, the name fails");
    }
    assert_eq!(stage.desk.state().changes, before);
    let key = credentials.key.expose();
    let names: [&[u8]; 6] = [b"alice", b"/robot1/odom", b"nav_msgs", b"plaintext of", &key[..8], &alice.account().0];
    for secret in names {
        assert!(!bytes.windows(secret.len()).any(|window| window == secret), "{secret:02x?}");
    }
}

#[tokio::test]
async fn messages_in_parts_are_charged_to_the_peer() {
    let small = Limits { quota_of_peer: 3 << 20, ..Limits::default() };
    let stage = Stage::with(small).await;
    let alice = alice();
    let credentials = stage.enrol(&alice).await;
    let mut client = stage.connect(&credentials).await.expect("connects");
    client.upload(vec![alice.record(&alice.signing, 1, &vec![1; 2 << 20])]).await.expect("fits");
    client.upload(vec![alice.record(&alice.signing, 2, &vec![2; 2 << 20])]).await.expect("the first was given back");
    let (mut line, mut sealing) = session(&stage, &credentials).await;
    line.send(FrameKind::Transfer, &sealing.seal(&text(&Request::Ping, alice.token, None)).expect("seals"), PATIENCE)
        .await
        .expect("sends");
    line.frame().await.expect("a pong");
    let mut first = (4u32 << 20).to_be_bytes().to_vec();
    first.resize(LARGEST_PART, 0);
    let (command, part) = (Command::Upload, Part::First);
    let inner = Inner { command, part, request: 2, token: Some(alice.token), signature: None, body: &first };
    assert_eq!(refused(&mut line, &sealing.seal(&inner.encode(false)).expect("seals")).await, Code::Quota);
    assert_eq!(stage.desk.record_count(), 2);
}

#[tokio::test]
async fn random_bytes_never_bring_the_gateway_down() {
    let stage = Stage::new().await;
    let credentials = stage.enrol(&alice()).await;
    for round in 0..40u8 {
        let noise: [u8; 200] = crate::crypto::random_bytes().expect("random");
        let bytes = match round % 3 {
            0 => noise.to_vec(),
            1 => encode(FrameKind::Hello, &noise),
            _ => [encode(FrameKind::Hello, &ClientHello::begin(context()).expect("begins").encode()), noise.to_vec()]
                .concat(),
        };
        last_words(&mut raw(&stage, &bytes).await).await;
    }
    // Authenticated noise: correctly sealed, but meaningless.
    for length in [0usize, 1, 5, 38, 100, 1000] {
        let (mut line, mut sealing) = session(&stage, &credentials).await;
        let mut noise = vec![0xee; length];
        if let Some(first) = noise.first_mut() {
            *first = 14;
        }
        assert_eq!(refused(&mut line, &sealing.seal(&noise).expect("seals")).await, Code::Malformed);
    }
    stage.connect(&credentials).await.expect("still serves");
    assert_eq!(stage.desk.state().changes, 1);
}
