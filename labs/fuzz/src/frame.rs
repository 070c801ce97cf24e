//! Frames: the codec, sessions, ND2 with its requests and answers, parts, the hello.

use std::sync::LazyLock;

use authros::crypto::TransportKey;
use authros::gateway::command::{Inner, LARGEST_PART, Part};
use authros::gateway::frame::{Assembler, Message};
use authros::gateway::frame::{FrameDecoder, FrameKind, encode};
use authros::gateway::hello::{self, ClientHello, GatewayHello, Hello, ListSummary};
use authros::gateway::session::{Session, SessionId, SessionKeys, Side};
use authros::gateway::{Answer, Code, Command, NetworkName, Request};
use authros::model::{Digest, Token};

use crate::cast::{CAST, context, provider};
use crate::messages::{answers, client_text, gateway_text, requests};
use crate::{Sample, masked, sample, way};

const WAYS: u8 = 7;
/// The most parts tried in a row: each may be a MiB.
const MOST_PARTS: usize = 6;
const LIST: ListSummary = ListSummary { version: 3, digest: Digest([3; 32]) };

/// Anything that arrives on a connection.
pub fn run(data: &[u8]) -> bool {
    match way(data, WAYS) {
        Some((0, bytes)) => stream(bytes),
        Some((1, text)) => from_client(text),
        Some((2, text)) => from_gateway(text),
        Some((3, text)) => sealed(text),
        Some((4, script)) => parts(script),
        Some((5, payload)) => greeting(payload),
        Some((6, mask)) => handshake(mask),
        _ => false,
    }
}

fn session(side: Side) -> Session {
    Session::new(provider(), SessionId([0x5e; 16]), side, SessionKeys::derive(&[0x4b; 64], &[0x5a; 32]))
}

/// What the client of [`session`] sealed, by counter; nothing else may open.
static SEALED: LazyLock<Vec<Vec<u8>>> = LazyLock::new(|| {
    let mut client = session(Side::Client);
    requests().iter().map(|request| client.seal(&client_text(request)).expect("seals")).collect()
});

/// Bytes as read from a socket: flags (1: larger frames, 2: larger pieces), length of a piece, bytes.
fn stream(bytes: &[u8]) -> bool {
    let Some((&[flags, step], bytes)) = bytes.split_first_chunk() else { return false };
    let (mut decoder, mut session) = (FrameDecoder::default(), session(Side::Gateway));
    if flags & 1 != 0 {
        decoder.raise_cap();
    }
    let step = usize::from(step).max(1) * if flags & 2 != 0 { 64 } else { 1 };
    let (mut again, mut accepted) = (Vec::new(), false);
    for piece in bytes.chunks(step) {
        decoder.space().extend_from_slice(piece);
        loop {
            match decoder.next_frame() {
                Ok(Some((kind, payload))) => {
                    again.extend(encode(kind, payload));
                    accepted |= payload_of(kind, payload, &mut session);
                }
                Ok(None) => break,
                Err(_) => return accepted,
            }
        }
        decoder.rest();
    }
    assert!(bytes.starts_with(&again), "a frame has one encoding");
    assert_eq!(decoder.is_partial(), again.len() < bytes.len(), "no byte is lost");
    accepted
}

fn payload_of(kind: FrameKind, payload: &[u8], session: &mut Session) -> bool {
    match kind {
        FrameKind::Hello => Hello::parse(payload).is_ok_and(|hello| same(&hello.encode(), payload)),
        FrameKind::Answer => hello::Answer::parse(payload).is_ok_and(|answer| same(&answer.encode(), payload)),
        FrameKind::Identify => false,
        FrameKind::Refusal => match payload {
            &[high, low] => Code::from_number(u16::from_be_bytes([high, low])).is_some(),
            _ => false,
        },
        FrameKind::Transfer => transfer(payload, session),
        FrameKind::Inquiry => payload == NetworkName::INQUIRY,
        FrameKind::Network => NetworkName::parse(payload).is_ok_and(|name| same(&name.encode(), payload)),
    }
}

/// Opens only what the client sealed; after a refusal nothing at all.
fn transfer(payload: &[u8], session: &mut Session) -> bool {
    if let Ok((counter, text)) = session.open(payload) {
        let genuine = usize::try_from(counter).ok().and_then(|counter| SEALED.get(counter));
        assert_eq!(genuine.map(Vec::as_slice), Some(payload), "opened what was not sealed");
        return from_client(&text);
    }
    assert!(SEALED.iter().all(|sealed| session.open(sealed).is_err()), "a session goes on after a refusal");
    false
}

fn same(one: &[u8], other: &[u8]) -> bool {
    assert_eq!(one, other, "one encoding for one meaning");
    true
}

fn from_client(text: &[u8]) -> bool {
    let Ok(inner) = Inner::from_client(text) else { return false };
    same(&inner.encode(false), text);
    assert!(inner.command.is_request() && Inner::from_gateway(text).is_err());
    let taken = Assembler::<()>::default().take(&inner, 0, |_| Ok(()));
    let Ok(Some(message)) = taken else { return false };
    let Ok(request) = Request::parse(message.command, &message.body) else { return false };
    assert_eq!(request.command(), message.command);
    same(&request.encode(), &message.body)
}

fn from_gateway(text: &[u8]) -> bool {
    let Ok(inner) = Inner::from_gateway(text) else { return false };
    same(&inner.encode(true), text);
    assert!(Inner::from_client(text).is_err());
    let Ok(answer) = Answer::parse(inner.command, inner.body) else { return false };
    assert_eq!(answer.command(), inner.command);
    same(&answer.encode(), inner.body)
}

/// A text through a session, unaltered and with one byte changed: position (2), bits (1), text.
fn sealed(bytes: &[u8]) -> bool {
    let Some((&[high, low, bits], text)) = bytes.split_first_chunk() else { return false };
    let (mut client, mut gateway) = (session(Side::Client), session(Side::Gateway));
    let first = client.seal(text).expect("fits");
    assert_eq!(&*gateway.open(&first).expect("the very frame").1, text);
    let second = client.seal(text).expect("fits");
    assert_ne!(first, second, "no two frames are alike");
    let mut altered = second;
    let at = usize::from(u16::from_be_bytes([high, low])) % altered.len();
    altered[at] ^= bits.max(1);
    assert!(gateway.open(&altered).is_err(), "byte {at} does not matter");
    true
}

/// A message in parts, by a script: each step is the claimed part and its length, then the length claimed in the first
/// part.
fn parts(script: &[u8]) -> bool {
    let mut assembler = Assembler::<usize>::default();
    let mut rest = script;
    for counter in 0..MOST_PARTS {
        let Some((&[step, shift, low], after)) = rest.split_first_chunk() else { return false };
        rest = after;
        let part = [Part::Whole, Part::First, Part::Middle, Part::Last][usize::from(step & 3)];
        let length = match step >> 2 & 3 {
            0 => LARGEST_PART,
            1 => LARGEST_PART + 1,
            2 => usize::from(u16::from_be_bytes([shift, low])),
            _ => LARGEST_PART - usize::from(low).min(LARGEST_PART),
        };
        let mut body = vec![0; length];
        let claim = 1u32.rotate_left(u32::from(shift & 31)) | u32::from(low);
        if let Some(first) = body.first_chunk_mut::<4>() {
            *first = claim.to_be_bytes();
        }
        let (command, request) =
            (if step & 16 == 0 { Command::Upload } else { Command::Records }, u32::from(step >> 5));
        let inner = Inner { command, part, request, token: Some(Token([0; 32])), signature: None, body: &body };
        match assembler.take(&inner, counter as u64, Ok) {
            Ok(Some(message)) => return whole(&message, length),
            Ok(None) => assert!(assembler.is_partial() && part != Part::Whole),
            Err(_) => return false,
        }
    }
    false
}

fn whole(message: &Message<usize>, last: usize) -> bool {
    match message.charge {
        Some(charged) => assert_eq!(message.body.len(), charged, "as much as was charged"),
        None => assert_eq!(message.body.len(), last, "a whole message"),
    }
    true
}

/// A payload as the first message of a client, and as a gateway's answer to a fresh hello.
fn greeting(payload: &[u8]) -> bool {
    let fresh = ClientHello::begin(context()).expect("random");
    assert!(fresh.agree(payload).is_err(), "an answer to another hello");
    let Ok((answer, gateway)) = GatewayHello::answer(context(), &CAST.gateway, LIST, payload) else { return false };
    let hello = Hello::parse(payload).expect("it was answered");
    same(&hello.encode(), payload);
    assert!(hello.domain == context().domain && provider().check_public_key(&hello.point).is_ok());
    same(&hello::Answer::parse(&answer).expect("ours").encode(), &answer);
    assert!(gateway.identified(payload).is_err(), "a name under another key");
    true
}

/// A hello in which one message is altered in transit: which (1), then the mask.
fn handshake(bytes: &[u8]) -> bool {
    let Some((which, mask)) = bytes.split_first() else { return false };
    let mask_of = |number| if which % 4 == number { mask } else { &[] };
    let key = TransportKey::new([7; 32]);
    let client = ClientHello::begin(context()).expect("random");
    let (hello, changed) = masked(&client.encode(), mask_of(0));
    let Ok((answer, gateway)) = GatewayHello::answer(context(), &CAST.gateway, LIST, &hello) else {
        assert!(changed, "a good hello was refused");
        return false;
    };
    let (answer, answer_changed) = masked(&answer, mask_of(1));
    let Ok(client) = client.agree(&answer) else {
        assert!(changed || answer_changed, "a good answer was refused");
        return false;
    };
    assert!(!changed && !answer_changed, "agreed on something else");
    let (identify, mut client) = client.identify(&"robot-1".parse().expect("a name"), Some(&key)).expect("seals");
    let (identify, changed) = masked(&identify, mask_of(2));
    let Ok(identified) = gateway.identified(&identify) else {
        assert!(changed, "a good name was refused");
        return false;
    };
    assert!(!changed, "another name was accepted");
    let mut gateway = identified.session(Some(&key));
    let (first, changed) = masked(&client.seal(b"first").expect("seals"), mask_of(3));
    assert_eq!(gateway.open(&first).is_ok(), !changed);
    true
}

/// Valid encodings of every kind.
pub fn samples() -> Vec<Sample> {
    let hello = ClientHello::begin(context()).expect("random").encode();
    let (answer, _) = GatewayHello::answer(context(), &CAST.gateway, LIST, &hello).expect("answers");
    let mut line = vec![0, 200];
    line.extend(encode(FrameKind::Hello, &hello));
    line.extend(encode(FrameKind::Answer, &answer));
    SEALED.iter().for_each(|payload| line.extend(encode(FrameKind::Transfer, payload)));
    line.extend(encode(FrameKind::Refusal, &Code::Tag.number().to_be_bytes()));
    let mut samples = vec![
        sample("stream", 0, &line),
        sample("sealed", 3, &[&[0, 40, 1], &client_text(&Request::Ping)[..]].concat()),
        // First, claiming 2 MiB, a middle one, and a last one with the rest.
        sample("parts", 4, &[1, 21, 0, 2, 0, 0, 3 | 2 << 2, 1, 86]),
        sample("one_part", 4, &[2 << 2, 0, 90]),
        sample("greeting", 5, &hello),
        sample("handshake", 6, &[0; 8]),
    ];
    let names = [
        "ping",
        "system_keys",
        "key_allocation",
        "upload",
        "upload_many",
        "feed",
        "feed_all",
        "records",
        "records_here",
        "grant_notice",
        "revoke_notice",
        "device_notice",
        "relay",
        "erase",
    ];
    samples.extend(names.iter().zip(requests()).map(|(name, request)| sample(name, 1, &client_text(&request))));
    let names = ["list", "receipt", "feed_page", "found", "time", "erasures", "refused"];
    samples.extend(names.iter().zip(answers()).map(|(name, answer)| sample(name, 2, &gateway_text(&answer))));
    samples
}
