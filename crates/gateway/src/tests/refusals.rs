//! The cases that the issue lists, each with the fixed code it is refused with: by the real server over loopback, or,
//! if the client must refuse, by the client's own checks.

use super::hostile::{PATIENCE, last_words, raw, session, text};
use super::stage::{Stage, refusal};
use super::*;
use crate::crypto::{AccountSignature, SmKeyPair, TransportKey};
use crate::frame::Line;
use crate::gateway::allocation::{AllocationRequest, apply};
use crate::gateway::command::{Inner, Part};
use crate::gateway::frame::{FrameKind, encode};
use crate::gateway::hello::{Agreed, ClientHello, ListSummary};
use crate::gateway::session::Session;
use crate::gateway::system_keys::{SystemKey, SystemKeyList};
use crate::model::bytes::unhex;
use crate::model::{Digest, Domain, Hash, PublicKey, Signature, SignerId, Timestamp, Token};

const ORDER: &str = "fffffffeffffffffffffffffffffffff7203df6b21c6052b53bbf40939d54123";
const PRIME: &str = "fffffffeffffffffffffffffffffffffffffffff00000000ffffffffffffffff";

fn alice() -> Member {
    Member::new("alice", 0x11)
}

fn bob() -> Member {
    Member::new("bob", 0x31)
}

fn away() -> Context {
    Context { domain: Domain([9; 32]), ..context() }
}

/// A case's name, its code, the outcome.
type Case = (String, Code, Option<Code>);

fn case(name: impl Into<String>, code: Code, found: Option<Code>) -> Case {
    (name.into(), code, found)
}

fn expect_all(cases: &[Case]) {
    cases.iter().for_each(|(name, code, found)| println!("{name}: {} {found:?}", code.number()));
    let wrong: Vec<&Case> = cases.iter().filter(|(_, code, found)| *found != Some(*code)).collect();
    assert!(wrong.is_empty(), "{wrong:?}");
}

/// (r, s) with each of 0, n, n-1 in either place, alone and together.
fn degenerate(valid: &Signature) -> Vec<(String, Signature)> {
    let order = unhex(ORDER).expect("hex");
    let mut below = order.clone();
    below[31] -= 1;
    let numbers = [("0", vec![0; 32]), ("n", order), ("n-1", below)];
    let mut all = Vec::new();
    for (name, number) in &numbers {
        for (half, place) in [("r", 0..32), ("s", 32..64)] {
            let mut signature = *valid;
            signature.0[place].copy_from_slice(number);
            all.push((format!("{half} = {name}"), signature));
        }
        for (other, second) in &numbers {
            let both = Signature([&number[..], second].concat().try_into().expect("64 bytes"));
            all.push((format!("r = {name}, s = {other}"), both));
        }
    }
    all
}

/// Not points: off the curve, infinity, coordinates that are not below p.
fn no_points() -> [(&'static str, PublicKey); 4] {
    let mut off = pair(0x44).public;
    off.0[63] ^= 1;
    let prime = unhex(PRIME).expect("hex");
    let not_canonical = [&prime[..], &pair(0x44).public.0[32..]].concat();
    [
        ("off the curve", off),
        ("infinity", PublicKey([0; 64])),
        ("x = p", PublicKey(not_canonical.try_into().expect("64 bytes"))),
        ("all ones", PublicKey([0xff; 64])),
    ]
}

/// The code that answers a frame, in a session that continues or one that ends.
async fn code(line: &mut Line, sealing: &mut Session, payload: &[u8]) -> Option<Code> {
    line.send(FrameKind::Transfer, payload, PATIENCE).await.expect("sends");
    let (kind, payload) = line.frame().await.expect("answers");
    if kind == FrameKind::Refusal {
        return Code::from_number(u16::from_be_bytes([payload[0], payload[1]]));
    }
    let (_, text) = sealing.open(&payload).expect("opens");
    let inner = Inner::from_gateway(&text).expect("parses");
    match Answer::parse(inner.command, inner.body).expect("an answer") {
        Answer::Refused(code) => Some(code),
        _ => None,
    }
}

/// A session for allocation, and the key in use.
async fn for_allocation(stage: &Stage, name: &str) -> (Line, Session, Agreed, SystemKey) {
    let stream = tokio::net::TcpStream::connect(stage.server.address()).await.expect("connects");
    let mut line = Line::new(stream);
    let hello = ClientHello::begin(context()).expect("begins");
    line.send(FrameKind::Hello, &hello.encode(), PATIENCE).await.expect("sends");
    let (_, answer) = line.frame().await.expect("answers");
    let client = hello.agree(&answer).expect("agrees");
    let agreed = *client.agreed();
    let (identify, session) = client.identify(&name.parse().expect("a name"), None).expect("seals");
    line.send(FrameKind::Identify, &identify, PATIENCE).await.expect("sends");
    let key = stage.server.shared().system_keys().list.keys[0];
    (line, session, agreed, key)
}

/// Requests a key as `member` within `context`, with the request changed before it is sent.
async fn allocate(
    stage: &Stage,
    (context, member): (Context, &Member),
    change: impl FnOnce(&mut AllocationRequest, &Agreed),
) -> Option<Code> {
    let (mut line, mut sealing, agreed, key) = for_allocation(stage, member.name.as_str()).await;
    let (_, body) = apply(&context, &agreed, &key, &member.applicant()).expect("applies");
    let mut request = AllocationRequest::parse(&body).expect("parses");
    change(&mut request, &agreed);
    let text = text(&Request::KeyAllocation(request), Token([0; 32]), None);
    let payload = sealing.seal(&text).expect("seals");
    code(&mut line, &mut sealing, &payload).await
}

#[tokio::test]
async fn allocations_are_refused_each_with_its_code() {
    let stage = Stage::new().await;
    let (alice, bob) = (alice(), bob());
    stage.desk.admit(&alice);
    stage.desk.admit(&bob);
    let here = (context(), &alice);
    let mut cases = Vec::new();
    for (name, signature) in degenerate(&Signature([7; 64])) {
        let found = allocate(&stage, here, |request, _| request.signature = signature).await;
        cases.push(case(format!("allocation, {name}"), Code::Signature, found));
    }
    for (name, point) in no_points() {
        let signing = SmKeyPair { public: point, ..alice.signing.clone() };
        let found = allocate(&stage, (context(), &Member { signing, ..self::alice() }), |_, _| ()).await;
        cases.push(case(format!("allocation, P_C {name}"), Code::Signature, found));
    }
    let key = |public| SystemKey { public, not_before: Timestamp(0), not_after: Timestamp(u64::MAX) };
    let (retired, applicant) = (key(pair(0x52).public), alice.applicant());
    let sealed_to_retired = |request: &mut AllocationRequest, agreed: &Agreed| {
        let (_, body) = apply(&context(), agreed, &retired, &applicant).expect("applies");
        let id = std::mem::replace(request, AllocationRequest::parse(&body).expect("parses")).system_key;
        request.system_key = id;
    };
    cases.push(case("wrong P_S", Code::Malformed, allocate(&stage, here, sealed_to_retired).await));
    let unknown = allocate(&stage, here, |request, _| request.system_key = SignerId([1; 32])).await;
    cases.push(case("a P_S that is in no list", Code::SystemKey, unknown));
    let by_bob = |agreed: &Agreed, key: &SystemKey| {
        let (_, body) = apply(&context(), agreed, key, &bob.applicant()).expect("applies");
        AllocationRequest::parse(&body).expect("parses")
    };
    let current = stage.server.shared().system_keys().list.keys[0];
    let found = allocate(&stage, here, |request, agreed| request.signature = by_bob(agreed, &current).signature).await;
    cases.push(case("another user's SM2 signature", Code::Signature, found));
    let found = allocate(&stage, here, |request, agreed| {
        request.account_signature = by_bob(agreed, &current).account_signature;
    });
    cases.push(case("another account's signature", Code::Account, found.await));
    let found = allocate(&stage, here, |request, _| request.account_signature = AccountSignature([0; 65])).await;
    cases.push(case("an account's signature of zeros", Code::Account, found));
    let found = allocate(&stage, (away(), &alice), |_, _| ()).await;
    cases.push(case("signed for another network", Code::Signature, found));
    assert_eq!(stage.desk.state().changes, 0, "nothing was bound");

    assert_eq!(allocate(&stage, here, |_, _| ()).await, None, "unaltered it is accepted");
    let thief = Member { name: alice.name.clone(), ..self::bob() };
    let found = allocate(&stage, (context(), &thief), |_, _| ()).await;
    cases.push(case("a name already bound", Code::NameBound, found));
    let unregistered = Member::new("carol", 0x51);
    let found = allocate(&stage, (context(), &unregistered), |_, _| ()).await;
    cases.push(case("an account that the chain does not know", Code::NotRegistered, found));
    assert_eq!(stage.desk.state().changes, 1);
    expect_all(&cases);
}

#[tokio::test]
async fn hellos_and_frames_are_refused_each_with_its_code() {
    let stage = Stage::new().await;
    let alice = alice();
    let credentials = stage.enrol(&alice).await;
    let hello = |context| ClientHello::begin(context).expect("begins").encode();
    let mut cases = Vec::new();
    for (name, point) in no_points() {
        let bytes = [&hello(context())[..66], &point.0].concat();
        let mut stream = raw(&stage, &encode(FrameKind::Hello, &bytes)).await;
        cases.push(case(format!("ephemeral point {name}"), Code::Malformed, last_words(&mut stream).await));
    }
    let mut stream = raw(&stage, &encode(FrameKind::Hello, &hello(away()))).await;
    cases.push(case("a hello for another network", Code::Network, last_words(&mut stream).await));

    let ping = text(&Request::Ping, alice.token, None);
    let (mut line, mut sealing) = session(&stage, &credentials).await;
    let first = sealing.seal(&ping).expect("seals");
    assert_eq!(code(&mut line, &mut sealing, &first).await, None);
    cases.push(case("a frame replayed", Code::Counter, code(&mut line, &mut sealing, &first).await));
    let (mut line, mut sealing) = session(&stage, &credentials).await;
    cases.push(case("a frame of another session", Code::Session, code(&mut line, &mut sealing, &first).await));
    let wrong = Credentials { key: TransportKey::new([1; 32]), ..credentials.clone() };
    let (mut line, mut sealing) = session(&stage, &wrong).await;
    let payload = sealing.seal(&ping).expect("seals");
    cases.push(case("a frame under another K_T", Code::Tag, code(&mut line, &mut sealing, &payload).await));

    // The body of one Command under the number of another.
    let upload = Request::Upload(alice.record(&alice.signing, 1, b"x"));
    for (command, body) in [(Command::Records, upload.encode()), (Command::UploadMany, upload.encode())] {
        let (mut line, mut sealing) = session(&stage, &credentials).await;
        let (part, token) = (Part::Whole, Some(alice.token));
        let swapped = Inner { command, part, request: 1, token, signature: None, body: &body }.encode(false);
        let payload = sealing.seal(&swapped).expect("seals");
        let found = code(&mut line, &mut sealing, &payload).await;
        cases.push(case(format!("an upload's body swapped into {command:?}"), Code::Malformed, found));
    }
    let (mut line, mut sealing) = session(&stage, &credentials).await;
    let payload = sealing.seal(&text(&Request::Ping, Token([0; 32]), None)).expect("seals");
    cases.push(case("a token never registered", Code::Token, code(&mut line, &mut sealing, &payload).await));
    assert_eq!(stage.desk.state().changes, 1, "only the name was bound");
    expect_all(&cases);
}

/// The fields d_C signs for a Command, and their replacements.
async fn signed(stage: &Stage, credentials: &Credentials, case: &SignedCase<'_>) -> Option<Code> {
    let (mut line, mut sealing) = session(stage, credentials).await;
    let body = Digest(context().provider.sm3(&[&case.sent.encode()]));
    let (gateway, domain, command) = (case.gateway.unwrap_or(stage.server.id()), case.domain, case.signed);
    let signed = command::signed_bytes(&domain, &gateway, &sealing.id(), case.counter, command, &body);
    let signature = context().provider.sign(&case.signer.secret, &signed).expect("signs");
    let signature = case.signature.unwrap_or(signature);
    let payload = sealing.seal(&text(case.sent, credentials.token, Some(signature))).expect("seals");
    code(&mut line, &mut sealing, &payload).await
}

struct SignedCase<'a> {
    sent: &'a Request,
    signed: Command,
    signer: &'a SmKeyPair,
    domain: Domain,
    gateway: Option<SignerId>,
    counter: u64,
    signature: Option<Signature>,
}

fn good<'a>(sent: &'a Request, signer: &'a SmKeyPair) -> SignedCase<'a> {
    let (signed, domain) = (sent.command(), context().domain);
    SignedCase { sent, signed, signer, domain, gateway: None, counter: 0, signature: None }
}

#[tokio::test]
async fn signed_commands_are_refused_each_with_their_code() {
    let stage = Stage::new().await;
    let (alice, bob) = (alice(), bob());
    let credentials = stage.enrol(&alice).await;
    stage.enrol(&bob).await;
    let before = stage.desk.state().changes;
    let (grantee, transaction) = (bob.account(), Hash([1; 32]));
    let grant = Request::Notice(Notice::Grant(GrantNotice { grantee, epoch: 1, expiry: 0, transaction }));
    let revoke =
        Request::Notice(Notice::Revoke(RevokeNotice { grantee, epoch: 2, token: Token([2; 32]), transaction }));
    let device = Request::Notice(Notice::Device(notice_of(&pair(0x66))));
    let mut cases = Vec::new();
    for sent in [&grant, &revoke, &device] {
        let name = format!("{:?}", sent.command());
        let other = if sent.command() == Command::GrantNotice { Command::RevokeNotice } else { Command::GrantNotice };
        let away = away().domain;
        let wrong = [
            ("signed for another Command", SignedCase { signed: other, ..good(sent, &alice.signing) }),
            ("signed by another user", SignedCase { signer: &bob.signing, ..good(sent, &alice.signing) }),
            ("signed by P_E", SignedCase { signer: &alice.envelope, ..good(sent, &alice.signing) }),
            ("signed for another network", SignedCase { domain: away, ..good(sent, &alice.signing) }),
            (
                "signed for another gateway",
                SignedCase { gateway: Some(SignerId([3; 32])), ..good(sent, &alice.signing) },
            ),
            ("signed for another frame", SignedCase { counter: 1, ..good(sent, &alice.signing) }),
        ];
        for (what, wrong) in wrong {
            cases.push(case(format!("{name} {what}"), Code::Signature, signed(&stage, &credentials, &wrong).await));
        }
        for (what, signature) in degenerate(&Signature([7; 64])) {
            let wrong = SignedCase { signature: Some(signature), ..good(sent, &alice.signing) };
            cases.push(case(format!("{name} {what}"), Code::Signature, signed(&stage, &credentials, &wrong).await));
        }
    }
    for (what, point) in no_points() {
        let sent = Request::Notice(Notice::Device(DeviceNotice { key: point, ..notice_of(&pair(0x66)) }));
        let found = signed(&stage, &credentials, &good(&sent, &alice.signing)).await;
        cases.push(case(format!("a device's key {what}"), Code::Malformed, found));
    }
    assert_eq!(stage.desk.state().changes, before);
    for sent in [&grant, &revoke] {
        assert_eq!(
            signed(&stage, &credentials, &good(sent, &alice.signing)).await,
            None,
            "the right signature is accepted"
        );
    }
    assert_eq!(stage.desk.state().changes, before + 2);
    expect_all(&cases);
}

#[tokio::test]
async fn records_are_refused_each_with_their_code() {
    let stage = Stage::new().await;
    let (alice, bob) = (alice(), bob());
    let credentials = stage.enrol(&alice).await;
    stage.enrol(&bob).await;
    let mut client = stage.connect(&credentials).await.expect("connects");
    let device = pair(0x66);
    stage.desk.lend(&alice, &device);
    client.device(&alice.signing, notice_of(&device)).await.expect("told");
    client.upload(vec![alice.record(&device, 1, b"while it is lent")]).await.expect("accepted");
    stage.desk.recall(&alice, &device);
    let before = stage.desk.state().changes;
    let record = alice.record(&alice.signing, 2, b"x");
    let mut foreign = record.clone();
    // The domain comes after magic, version, suite and kind; the owner signs the altered record again.
    foreign.blob[11..43].copy_from_slice(&away().domain.0);
    let digest = Digest(context().provider.sm3(&[&foreign.blob]));
    let signed = crate::crypto::record::signed_bytes(&away().domain, &digest);
    foreign.signature = context().provider.sign(&alice.signing.secret, &signed).expect("signs");
    let mut squatted = record.clone();
    // The recorder comes after the epoch: that of another key.
    squatted.blob[111..119].copy_from_slice(&[9; 8]);
    let digest = Digest(context().provider.sm3(&[&squatted.blob]));
    let signed = crate::crypto::record::signed_bytes(&context().domain, &digest);
    squatted.signature = context().provider.sign(&alice.signing.secret, &signed).expect("signs");
    let with = |signature| Upload { signature, ..record.clone() };
    let mut uploads = vec![
        ("a number under another key's recorder".to_owned(), Code::Malformed, squatted),
        ("a recalled device's record".to_owned(), Code::Signature, alice.record(&device, 3, b"x")),
        ("another user's signature on a record".to_owned(), Code::Signature, alice.record(&bob.signing, 3, b"x")),
        ("another user's record".to_owned(), Code::NotYours, bob.record(&bob.signing, 3, b"x")),
        ("a record of another network".to_owned(), Code::NotYours, foreign),
        (
            "another record's signature".to_owned(),
            Code::Signature,
            with(alice.record(&alice.signing, 9, b"x").signature),
        ),
    ];
    let degenerate = degenerate(&record.signature).into_iter();
    uploads.extend(degenerate.map(|(name, signature)| (format!("a record, {name}"), Code::Signature, with(signature))));
    let mut cases = Vec::new();
    for (name, code, upload) in uploads {
        cases.push(case(name, code, refusal(client.upload(vec![upload]).await)));
    }
    assert_eq!(stage.desk.state().changes, before);
    let ended = refusal(client.missing(&[digest]).await);
    assert_eq!(ended, Some(Code::NotAuthorised), "the name ended with the loan");
    assert_eq!(refusal(client.upload(vec![record.clone()]).await), Some(Code::NotYours));
    stage.desk.lend(&alice, &device);
    let own = refusal(client.upload(vec![record.clone()]).await);
    assert_eq!(own, Some(Code::NotYours), "a device's session adds to no numbers but the device's");
    let credentials = stage.enrol(&alice).await;
    let mut owner = stage.connect(&credentials).await.expect("connects");
    owner.upload(vec![record]).await.expect("unaltered it is accepted");
    expect_all(&cases);
}

/// What the client refuses about a gateway's system-key list, in its own words.
#[test]
fn lists_that_are_stale_or_of_others_are_refused_by_the_client() {
    let (provider, domain, identity) = (context().provider, context().domain, pair(0x21));
    let key = SystemKey { public: pair(0x51).public, not_before: Timestamp(100), not_after: Timestamp(900) };
    let list = |domain, identity: &SmKeyPair, version| {
        let dates = (Timestamp(100), Timestamp(1000));
        SystemKeyList::sign(Context { provider, domain }, identity, version, dates, vec![key]).expect("signs")
    };
    let agreed = |list: &SystemKeyList| Agreed {
        gateway: crate::crypto::signer_id(&identity.public),
        gateway_key: identity.public,
        client_nonce: [1; 32],
        gateway_nonce: [2; 32],
        session: crate::gateway::session::SessionId([3; 16]),
        list: list.summary(provider),
    };
    let told = |list: &SystemKeyList, announced: &SystemKeyList, now| {
        list.check(context(), &agreed(announced), Timestamp(now)).map(|_| ()).map_err(|error| error.to_string())
    };
    let good = list(domain, &identity, 7);
    assert_eq!(told(&good, &good, 500), Ok(()));
    let mut forged = list(domain, &pair(0x22), 7);
    forged.gateway = good.gateway;
    for (what, list, announced, now, words) in [
        ("expired", &good, &good, 1000, "has expired"),
        ("no key in use any more", &good, &good, 950, "none of its keys is currently valid"),
        ("of another network", &list(away().domain, &identity, 7), &good, 500, "another network"),
        ("another gateway's", &list(domain, &pair(0x22), 7), &good, 500, "another gateway"),
        ("older than announced", &list(domain, &identity, 6), &good, 500, "not the one the gateway announced"),
        ("signed by another gateway", &forged, &forged, 500, "signature"),
    ] {
        let found = told(list, announced, now).expect_err(what);
        println!("{what}: {found}");
        assert!(found.contains(words), "{what}: {found}");
    }
    let mut trust = Trust::pinned(good.gateway);
    trust.judge(&agreed(&good)).expect("the first one");
    let older = agreed(&list(domain, &identity, 6));
    assert!(matches!(trust.judge(&older), Err(GatewayError::RolledBack { seen: 7, found: 6 })));
    let twin = Agreed { list: ListSummary { version: 7, digest: Digest([0; 32]) }, ..agreed(&good) };
    assert!(matches!(trust.judge(&twin), Err(GatewayError::TwoLists(7))));
    let other = Agreed { gateway: SignerId([1; 32]), ..agreed(&good) };
    assert!(matches!(trust.judge(&other), Err(GatewayError::NotTheGateway { .. })));
}
