use proptest::prelude::*;

use super::*;
use crate::crypto::TransportKey;
use crate::gateway::tests::{sample_answers, sample_requests, sessions};

fn client_text(request: &Request, body: &[u8]) -> Vec<u8> {
    let command = request.command();
    let signature = command.is_signed().then_some(Signature([9; 64]));
    Inner { command, part: Part::Whole, request: 7, token: Some(Token([8; 32])), signature, body }.encode(false)
}

#[test]
fn every_request_and_answer_comes_back_as_it_went() {
    let mut seen: Vec<Command> = Vec::new();
    for request in sample_requests() {
        let body = request.encode();
        assert_eq!(Request::parse(request.command(), &body), Ok(request.clone()));
        let text = client_text(&request, &body);
        let inner = Inner::from_client(&text).expect("parses");
        assert_eq!((inner.command, inner.request, inner.body), (request.command(), 7, &body[..]));
        assert_eq!(inner.encode(false), text);
        assert!(Inner::from_gateway(&text).is_err(), "a client's text is no gateway's");
        seen.push(request.command());
    }
    assert!(Command::ALL.iter().all(|command| seen.contains(command) == command.is_request()));
    for answer in sample_answers() {
        let body = answer.encode();
        assert_eq!(Answer::parse(answer.command(), &body), Ok(answer.clone()));
        let texts = split(answer.command(), 3, Speaker::Gateway, &body);
        let inner = Inner::from_gateway(&texts[0]).expect("parses");
        assert_eq!((inner.command, inner.part, inner.body), (answer.command(), Part::Whole, &body[..]));
        assert!(Inner::from_client(&texts[0]).is_err(), "a gateway's text is no client's");
    }
}

#[test]
fn what_is_cut_or_longer_is_refused() {
    for request in sample_requests() {
        let body = request.encode();
        // An upload's record and a request's JSON extend to the end of the body: their
        // own parsers and signatures know their length.
        let open_ended = matches!(request, Request::Upload(_) | Request::Relay(_));
        for cut in 0..body.len() {
            let parsed = Request::parse(request.command(), &body[..cut]);
            assert!(parsed.is_err() || open_ended, "{:?} cut at {cut}", request.command());
        }
        let longer = [&body[..], &[0]].concat();
        assert!(Request::parse(request.command(), &longer).is_err() || open_ended, "{:?}", request.command());
    }
}

#[test]
fn counts_are_bounded_before_anything_is_kept() {
    let many = |count: u16| [&count.to_be_bytes()[..], &vec![0; 40_000]].concat();
    for count in [0, 1025] {
        let uploads = Request::parse(Command::UploadMany, &many(count));
        assert_eq!(uploads.expect_err("a number of records"), WireError::Value("record count"));
        let digests = Request::parse(Command::Records, &[&[1][..], &many(count)].concat());
        assert_eq!(digests.expect_err("a number of digests"), WireError::Value("digest count"));
        let owners = [&[0; 16 + 2 + 1 + 1 + 1][..], &many(count)].concat();
        assert!(Request::parse(Command::Feed, &owners).is_err(), "{count}");
    }
    for named in [33, 255] {
        assert!(Request::parse(Command::Feed, &[&[0; 19][..], &[named], &[0; 9_000]].concat()).is_err());
    }
    assert!(Answer::parse(Command::Records, &many(1025)).is_err());
    assert!(Answer::parse(Command::Feed, &[&[0; 32][..], &many(1025)].concat()).is_err());
    assert!(Answer::parse(Command::Feed, &[&[0; 34][..], &many(257)].concat()).is_err());
    assert!(Answer::parse(Command::Upload, &[&[0; 8][..], &many(1025)].concat()).is_err());
    assert!(Answer::parse(Command::SystemKeys, &[0; 1025]).is_err());
}

#[test]
fn signed_commands_are_whole_and_only_they_carry_a_signature() {
    let text = client_text(&Request::Ping, b"");
    assert_eq!(text.len(), 38);
    for command in Command::ALL.iter().filter(|command| command.is_signed()) {
        let mut text = vec![command.number(), Part::First as u8];
        text.resize(300, 0);
        assert_eq!(Inner::from_client(&text), Err(WireError::Value("part")));
    }
}

/// The protocol's central property: no bit of a valid frame of any Command can be changed.
#[test]
fn every_flipped_bit_of_every_commands_frame_is_refused() {
    let key = TransportKey::new([5; 32]);
    for request in sample_requests() {
        let (mut client, gateway) = sessions(&key);
        let payload = client.seal(&client_text(&request, &request.encode())).expect("seals");
        let mut gateway = gateway;
        for bit in 0..payload.len() * 8 {
            let mut altered = payload.clone();
            altered[bit / 8] ^= 1 << (bit % 8);
            assert!(gateway.open(&altered).is_err(), "{:?}, bit {bit}", request.command());
            gateway.mend();
        }
        gateway.open(&payload).expect("the unaltered frame still opens");
    }
}

proptest! {
    #[test]
    fn garbage_never_panics_and_what_parses_has_one_encoding(number in 0u8..22, noise in proptest::collection::vec(any::<u8>(), 0..400)) {
        let _ = Inner::from_client(&noise);
        let _ = Inner::from_gateway(&noise);
        if let Some(command) = Command::from_number(number) {
            if let Ok(request) = Request::parse(command, &noise) {
                prop_assert_eq!(request.encode(), noise.clone());
            }
            if let Ok(answer) = Answer::parse(command, &noise) {
                prop_assert_eq!(answer.encode(), noise);
            }
        }
    }

    #[test]
    fn an_altered_body_is_refused_or_means_something_else(which: usize, at: usize, bit in 0u8..8) {
        let requests = sample_requests();
        let request = &requests[which % requests.len()];
        let mut body = request.encode();
        if !body.is_empty() {
            let at = at % body.len();
            body[at] ^= 1 << bit;
            if let Ok(other) = Request::parse(request.command(), &body) {
                prop_assert_ne!(&other, request);
                prop_assert_eq!(other.encode(), body);
            }
        }
    }
}
