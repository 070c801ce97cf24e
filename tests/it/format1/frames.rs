//! Two sessions with a gateway, byte by byte, opened with their keys: one of a robot, one of a reader.

use authros::crypto::{Ephemeral, ProviderName, SmSecret, provider};
use authros::gateway::command::{Answer, Command, Inner, Part, Request};
use authros::gateway::frame::{FrameDecoder, FrameKind};
use authros::gateway::hello::{self, Hello};
use authros::gateway::session::{Session, SessionKeys, Side};
use authros::gateway::system_keys::SystemKeyList;
use authros::model::{Domain, PublicKey, SignerId};
use serde_json::Value;

use super::{expected, sample};
use crate::support::{text, unhex};

/// The frames of one direction.
fn frames(stream: &[u8]) -> Vec<(FrameKind, Vec<u8>)> {
    let mut decoder = FrameDecoder::default();
    decoder.raise_cap();
    decoder.space().extend_from_slice(stream);
    let mut found = Vec::new();
    while let Some((kind, payload)) = decoder.next_frame().expect("whole frames") {
        found.push((kind, payload.to_vec()));
    }
    assert!(!decoder.is_partial(), "the stream ends with a frame");
    found
}

/// What of a session's bytes a later version would change first.
pub(super) struct Stream {
    pub hello: Vec<u8>,
    pub answer: Vec<u8>,
    pub system_keys: Vec<u8>,
}

pub(super) fn stream(name: &str) -> Stream {
    let told = document(name);
    let first = |side: &str| frames(&unhex(&text(&told, side))).remove(0).1;
    let (_, system_keys) = opened(name).answers.swap_remove(1);
    Stream { hello: first("client"), answer: first("gateway"), system_keys }
}

fn document(name: &str) -> Value {
    serde_json::from_slice(&std::fs::read(sample(&format!("frames/{name}.json"))).expect("read")).expect("JSON")
}

/// A session as both sides saw it.
struct Opened {
    requests: Vec<Request>,
    answers: Vec<(Command, Vec<u8>)>,
    gateway: PublicKey,
    domain: Domain,
}

fn array<const N: usize>(document: &Value, name: &str) -> [u8; N] {
    unhex(&text(document, name)).try_into().expect("its length")
}

fn opened(name: &str) -> Opened {
    let told = document(name);
    let provider = provider(ProviderName::RustCrypto);
    let (client, gateway) = (frames(&unhex(&text(&told, "client"))), frames(&unhex(&text(&told, "gateway"))));
    let kinds = |frames: &[(FrameKind, Vec<u8>)]| frames.iter().take(3).map(|(kind, _)| *kind).collect::<Vec<_>>();
    assert_eq!(kinds(&client), [FrameKind::Hello, FrameKind::Identify, FrameKind::Transfer]);
    assert_eq!(kinds(&gateway)[..2], [FrameKind::Answer, FrameKind::Transfer]);

    let hello = Hello::parse(&client[0].1).expect("a hello of version 1");
    let answer = hello::Answer::parse(&gateway[0].1).expect("an answer of version 1");
    let domain = Domain(array(&told, "domain"));
    assert_eq!(hello.domain, domain);
    let transcript = provider.sm3(&[b"AuthROS/transcript/1", &domain.0, &client[0].1, &answer.unsigned()]);
    let signed = [&b"AuthROS/hello/1"[..], &domain.0, &transcript].concat();
    provider.verify(&answer.identity, &signed, &answer.signature).expect("signed by the gateway");
    let secret = SmSecret::from_slice(&array::<32>(&told, "ephemeral")).expect("a secret");
    let ephemeral = Ephemeral::from_secret(provider, secret).expect("a pair");
    assert_eq!(ephemeral.public(), hello.point);
    let shared = ephemeral.agree(&answer.point).expect("a point");
    let material = [&shared[..], &array::<32>(&told, "transport_key")].concat();
    let salt = provider.sm3(&[b"AuthROS/transcript/1", &transcript, &client[1].1]);
    let session = |side| Session::new(provider, answer.session, side, SessionKeys::derive(&material, &salt));

    let mut at_gateway = session(Side::Gateway);
    let request = |(_, payload): &(FrameKind, Vec<u8>)| {
        let (_, text) = at_gateway.open(payload).expect("opens");
        let inner = Inner::from_client(&text).expect("an ND2");
        assert_eq!(inner.part, Part::Whole);
        Request::parse(inner.command, inner.body).expect("a request")
    };
    let requests = client[2..].iter().map(request).collect();
    let mut at_client = session(Side::Client);
    let heard = |(_, payload): &(FrameKind, Vec<u8>)| {
        let (_, text) = at_client.open(payload).expect("opens");
        let inner = Inner::from_gateway(&text).expect("an ND2");
        assert_eq!(inner.part, Part::Whole);
        (inner.command, inner.body.to_vec())
    };
    let answers = gateway[1..].iter().map(heard).collect();
    Opened { requests, answers, gateway: answer.identity, domain }
}

fn expect_system_keys(opened: &Opened) {
    let (command, body) = &opened.answers[1];
    assert_eq!(*command, Command::SystemKeys);
    let list = SystemKeyList::parse(body).expect("a list of version 1");
    assert_eq!((list.domain, list.keys.is_empty()), (opened.domain, false));
    assert_eq!(list.gateway, text(&expected(), "gateway").parse::<SignerId>().expect("an id"));
}

#[test]
fn a_session_of_a_robot_is_read() {
    let opened = opened("robot");
    expect_system_keys(&opened);
    let [Request::Ping, Request::SystemKeys, Request::Upload(upload), Request::Feed(_)] = &opened.requests[..] else {
        panic!("{:?}", opened.requests);
    };
    let provider = provider(ProviderName::RustCrypto);
    let (command, body) = &opened.answers[2];
    let Ok(Answer::Receipt(_, receipt)) = Answer::parse(*command, body) else { panic!("no receipt for {command:?}") };
    receipt.verify(provider, &opened.domain, &opened.gateway).expect("signed by the gateway");
    assert_eq!(receipt.digests.iter().map(|digest| digest.0).collect::<Vec<_>>(), [provider.sm3(&[&upload.blob])]);
    let (command, body) = &opened.answers[3];
    assert!(matches!(Answer::parse(*command, body), Ok(Answer::Feed(_))), "{command:?}");
}

#[test]
fn a_session_of_a_reader_is_read() {
    let opened = opened("reader");
    expect_system_keys(&opened);
    let provider = provider(ProviderName::RustCrypto);
    let (command, body) = &opened.answers[2];
    let Ok(Answer::Feed(page)) = Answer::parse(*command, body) else { panic!("no page for {command:?}") };
    page.verify(provider, &opened.domain, &opened.gateway).expect("signed by the gateway");
    let (command, body) = &opened.answers[3];
    assert!(matches!(Answer::parse(*command, body), Ok(Answer::Records(found)) if found.len() == page.entries.len()));
    assert!(!page.entries.is_empty(), "{page:?}");
}
