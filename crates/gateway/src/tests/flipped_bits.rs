//! Every bit of a valid frame of each Command, flipped: the connection ends, the desk learns nothing. Server and desk
//! are the real ones over loopback; only the hello is left out, with fixed keys instead.

use std::sync::Arc;
use std::time::Instant;

use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::task::JoinSet;

use super::fixtures::{erasure, notice_of};
use super::hostile::text;
use super::stage::Stage;
use super::*;
use crate::frame::Line;
use crate::gateway::allocation::apply;
use crate::gateway::command::{Inner, RelayCall};
use crate::gateway::connection::{Shared, serve_agreed};
use crate::gateway::frame::{FrameDecoder, FrameKind, encode};
use crate::gateway::hello::Agreed;
use crate::gateway::session::{Session, SessionId, SessionKeys, Side};
use crate::model::{Digest, Hash, Token};

const ID: SessionId = SessionId([0x5e; 16]);

fn session(side: Side) -> Session {
    Session::new(context().provider, ID, side, SessionKeys::derive(&[7; 64], &[8; 32]))
}

fn agreed(stage: &Stage) -> Agreed {
    Agreed {
        gateway: stage.server.id(),
        gateway_key: pair(0x21).public,
        client_nonce: [1; 32],
        gateway_nonce: [2; 32],
        session: ID,
        list: super::fixtures::summary(),
    }
}

/// A session that serves one frame.
struct Scene {
    shared: Arc<Shared>,
    agreed: Agreed,
    member: crate::model::ProfileName,
    binding: Option<Binding>,
    listener: TcpListener,
    running: watch::Sender<bool>,
}

impl Scene {
    async fn new(stage: &Stage, member: &Member, under_key: bool) -> Self {
        let binding = stage.desk.state().bindings.get(&member.name).cloned();
        Self {
            shared: stage.server.shared(),
            agreed: agreed(stage),
            member: member.name.clone(),
            binding: binding.filter(|_| under_key),
            listener: TcpListener::bind("127.0.0.1:0").await.expect("listens"),
            running: watch::channel(false).0,
        }
    }

    /// The answer to these bytes, until the connection ends.
    async fn told(&self, bytes: &[u8]) -> Vec<u8> {
        let address = self.listener.local_addr().expect("an address");
        let seat = self.shared.peers.admit(address.ip(), Instant::now()).expect("within the limits");
        let stop = self.running.subscribe();
        let (client, accepted) = tokio::join!(TcpStream::connect(address), self.listener.accept());
        let line = Line::new(accepted.expect("accepts").0);
        let mut client = client.expect("connects");
        let serving = serve_agreed(
            (Arc::clone(&self.shared), line, seat, stop),
            session(Side::Gateway),
            self.agreed,
            (self.member.clone(), self.binding.clone()),
        );
        let sending = async {
            let mut told = Vec::new();
            client.write_all(bytes).await.expect("sends");
            client.shutdown().await.expect("half-closes");
            // A reset counts as an end too.
            let _ = client.read_to_end(&mut told).await;
            told
        };
        tokio::join!(serving, sending).1
    }
}

fn first_frame(bytes: &[u8]) -> Option<(FrameKind, Vec<u8>)> {
    let mut decoder = FrameDecoder::default();
    decoder.raise_cap();
    decoder.space().extend_from_slice(bytes);
    decoder.next_frame().expect("a gateway's frames").map(|(kind, payload)| (kind, payload.to_vec()))
}

/// The complete frame of a request, with d_C's signature if it carries one.
fn frame(stage: &Stage, member: &Member, request: &Request) -> Vec<u8> {
    let provider = context().provider;
    let signature = request.command().is_signed().then(|| {
        let body = Digest(provider.sm3(&[&request.encode()]));
        let signed = command::signed_bytes(&context().domain, &stage.server.id(), &ID, 0, request.command(), &body);
        provider.sign(&member.signing.secret, &signed).expect("signs")
    });
    let payload = session(Side::Client).seal(&text(request, member.token, signature)).expect("seals");
    encode(FrameKind::Transfer, &payload)
}

/// A request of each Command under a transport key, accepted by the desk.
fn accepted_requests(stage: &Stage, member: &Member) -> Vec<Request> {
    let device = pair(0x66);
    stage.desk.lend(member, &device);
    let record = |seq| member.record(&member.signing, seq, b"a message");
    let known = Digest(context().provider.sm3(&[&record_kept(stage).blob]));
    let (grantee, transaction) = (Member::new("bob", 0x31).account(), Hash([1; 32]));
    vec![
        Request::SystemKeys,
        Request::Upload(record(1)),
        Request::UploadMany(vec![record(2), record(3)]),
        Request::Feed(Feed::of(member.account())),
        Request::Records(true, vec![known]),
        Request::Notice(Notice::Grant(GrantNotice { grantee, epoch: 1, expiry: 0, transaction })),
        Request::Notice(Notice::Revoke(RevokeNotice { grantee, epoch: 2, token: Token([2; 32]), transaction })),
        Request::Ping,
        Request::Relay(RelayCall { method: "eth_blockNumber".to_owned(), parameters: "[]".to_owned() }),
        Request::Erase(vec![erasure()]),
        // The last one: afterwards the name is the device's.
        Request::Notice(Notice::Device(notice_of(&device))),
    ]
}

fn record_kept(stage: &Stage) -> crate::gateway::desk::Received {
    stage.desk.state().records.values().next().expect("one was kept").clone()
}

/// A request of each Command without a transport key, accepted by the desk.
fn accepted_without_key(stage: &Stage, member: &Member) -> Vec<Request> {
    let shared = stage.server.shared();
    let key = shared.system_keys().list.keys[0];
    let (_, body) = apply(&context(), &agreed(stage), &key, &member.applicant()).expect("applies");
    let allocation = Request::parse(Command::KeyAllocation, &body).expect("parses");
    vec![allocation, Request::SystemKeys, Request::Ping]
}

#[tokio::test(flavor = "multi_thread")]
async fn no_bit_of_a_frame_of_any_command_reaches_the_desk_flipped() {
    let stage = Stage::with(Limits { handshakes: 100_000, handshake_burst: 1e9, ..Limits::default() }).await;
    let alice = Member::new("alice", 0x11);
    let credentials = stage.enrol(&alice).await;
    let mut client = stage.connect(&credentials).await.expect("connects");
    client.upload(vec![alice.record(&alice.signing, 100, b"kept before")]).await.expect("receipt");
    let under_key = accepted_requests(&stage, &alice).into_iter().map(|request| (true, request));
    let without = accepted_without_key(&stage, &alice).into_iter().map(|request| (false, request));
    let all: Vec<(bool, Request)> = under_key.chain(without).collect();
    assert!(
        Command::ALL
            .iter()
            .all(|command| { all.iter().any(|(_, request)| request.command() == *command) == command.is_request() })
    );

    let before = stage.desk.state().changes;
    let mut flipping = JoinSet::new();
    for (under_key, request) in &all {
        let (scene, desk) = (Scene::new(&stage, &alice, *under_key).await, Arc::clone(&stage.desk));
        let (frame, command) = (frame(&stage, &alice, request), request.command());
        flipping.spawn(async move {
            for bit in 0..frame.len() * 8 {
                let mut altered = frame.clone();
                altered[bit / 8] ^= 1 << (bit % 8);
                let told = first_frame(&scene.told(&altered).await);
                assert!(told.is_none_or(|(kind, _)| kind == FrameKind::Refusal), "{command:?}, bit {bit} was answered");
                assert_eq!(desk.state().changes, before, "{command:?}, bit {bit} changed something");
            }
            frame.len() * 8
        });
    }
    let mut flipped = 0;
    while let Some(done) = flipping.join_next().await {
        flipped += done.expect("no frame was accepted");
    }
    println!("{flipped} frames with one bit flipped, of {} Commands: 0 accepted", all.len());
    {
        let state = stage.desk.state();
        assert_eq!((state.changes, state.records.len()), (before, 1));
    }

    // The same frames are accepted unaltered, so it was the bit.
    for (under_key, request) in &all {
        let scene = Scene::new(&stage, &alice, *under_key).await;
        let told = first_frame(&scene.told(&frame(&stage, &alice, request)).await);
        let (kind, payload) = told.expect("an answer");
        assert_eq!(kind, FrameKind::Transfer, "{:?}", request.command());
        let (_, answer) = session(Side::Client).open(&payload).expect("opens");
        let inner = Inner::from_gateway(&answer).expect("parses");
        assert_eq!(inner.command, request.command(), "not refused");
    }
    let state = stage.desk.state();
    assert_eq!((state.records.len(), state.grants.len(), state.revokes.len()), (4, 1, 1));
    assert_eq!(state.changes, before + 8);
}
