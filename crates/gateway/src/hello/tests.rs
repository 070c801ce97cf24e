use proptest::prelude::*;

use super::*;
use crate::gateway::tests::{context, greet, pair};

fn name() -> ProfileName {
    "robot-1".parse().expect("a name")
}

/// Both ends of a session, each with its transport key.
fn session(client_key: Option<&TransportKey>, gateway_key: Option<&TransportKey>) -> (Session, Session) {
    let (client, answer, gateway) = greet();
    let client = client.agree(&answer).expect("agrees");
    assert_eq!(client.agreed(), gateway.agreed());
    let (identify, client) = client.identify(&name(), client_key).expect("seals");
    let identified = gateway.identified(&identify).expect("opens");
    assert_eq!(identified.name, name());
    let purpose = if client_key.is_some() { Purpose::Transfer } else { Purpose::Allocation };
    assert_eq!(identified.purpose, purpose);
    (client, identified.session(gateway_key))
}

#[test]
fn both_ends_agree_with_and_without_a_transport_key() {
    let key = TransportKey::new([7; 32]);
    for key in [None, Some(&key)] {
        let (mut client, mut gateway) = session(key, key);
        let payload = client.seal(b"up").expect("seals");
        assert_eq!(&gateway.open(&payload).expect("opens").1[..], b"up");
        let payload = gateway.seal(b"down").expect("seals");
        assert_eq!(&client.open(&payload).expect("opens").1[..], b"down");
    }
}

#[test]
fn another_transport_key_or_none_opens_nothing() {
    let (one, other) = (TransportKey::new([7; 32]), TransportKey::new([8; 32]));
    for gateway_key in [None, Some(&other)] {
        let (mut client, mut gateway) = session(Some(&one), gateway_key);
        let payload = client.seal(b"up").expect("seals");
        assert_eq!(gateway.open(&payload).expect_err("refused").code, Code::Tag);
    }
}

#[test]
fn two_hellos_share_nothing() {
    let key = TransportKey::new([7; 32]);
    let (mut client, _) = session(Some(&key), Some(&key));
    let (_, mut gateway) = session(Some(&key), Some(&key));
    assert_eq!(gateway.open(&client.seal(b"up").expect("seals")).expect_err("refused").code, Code::Session);
}

#[test]
fn other_versions_networks_and_points_are_refused_with_their_code() {
    let hello = ClientHello::begin(context()).expect("begins").encode();
    assert_eq!(hello.len(), 130);
    let answer = |payload: &[u8]| {
        let list = ListSummary { version: 1, digest: Digest([0; 32]) };
        GatewayHello::answer(context(), &pair(0x21), list, payload).map(|_| ()).map_err(|refusal| refusal.code)
    };
    assert_eq!(answer(&hello), Ok(()));
    let altered = |at: usize| {
        let mut bytes = hello.clone();
        bytes[at] ^= 1;
        answer(&bytes)
    };
    for version in [0, 2, 255] {
        assert_eq!(answer(&[&[version], &hello[1..]].concat()), Err(Code::Version), "{version}");
    }
    assert_eq!(altered(1), Err(Code::Version));
    assert_eq!(altered(2), Err(Code::Network));
    assert_eq!(altered(129), Err(Code::Malformed), "a point off the curve");
    assert_eq!(answer(&hello[..129]), Err(Code::Malformed));
    assert_eq!(answer(&[&hello[..], &[0]].concat()), Err(Code::Malformed));
    for point in [[0; 64], [0xff; 64]] {
        assert_eq!(answer(&[&hello[..66], &point].concat()), Err(Code::Malformed));
    }
}

#[test]
fn a_gateway_with_another_key_or_network_cannot_answer() {
    let other = Context { domain: Domain([9; 32]), ..context() };
    let client = ClientHello::begin(context()).expect("begins");
    // A gateway in the middle passes the hello off as one of its own network.
    let mut payload = client.encode();
    payload[2..34].copy_from_slice(&[9; 32]);
    let list = ListSummary { version: 1, digest: Digest([0; 32]) };
    let (answer, _) = GatewayHello::answer(other, &pair(0x21), list, &payload).expect("answers");
    assert!(matches!(client.agree(&answer), Err(GatewayError::Crypto(_))));

    let (client, answer, _) = greet();
    let mut swapped = answer.clone();
    swapped[154..218].copy_from_slice(&pair(0x33).public.0);
    assert!(client.agree(&swapped).is_err(), "another identity key under the same signature");
}

#[test]
fn every_flipped_bit_of_the_answer_is_refused() {
    let answer_length = greet().1.len();
    assert_eq!(answer_length, 282);
    for at in 0..answer_length {
        let (client, mut answer, _) = greet();
        answer[at] ^= 1 << (at % 8);
        assert!(client.agree(&answer).is_err(), "byte {at}");
    }
}

#[test]
fn the_identify_frame_is_of_one_length_and_hides_the_name() {
    let mut lengths = Vec::new();
    for text in ["a", "a-name-of-thirty-two-characters-x"[..32].trim()] {
        let (client, answer, _) = greet();
        let client = client.agree(&answer).expect("agrees");
        let (identify, _) = client.identify(&text.parse().expect("a name"), None).expect("seals");
        assert!(!identify.windows(text.len().max(4)).any(|window| window == text.as_bytes()));
        lengths.push(identify.len());
    }
    assert_eq!(lengths, [50, 50]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn altered_hellos_and_names_never_reach_a_session(in_hello in 2usize..130, in_identify in 0usize..50, bit in 0u8..8) {
        let client = ClientHello::begin(context()).expect("begins");
        let mut payload = client.encode();
        payload[in_hello] ^= 1 << bit;
        let list = ListSummary { version: 1, digest: Digest([0; 32]) };
        if let Ok((answer, _)) = GatewayHello::answer(context(), &pair(0x21), list, &payload) {
            prop_assert!(client.agree(&answer).is_err(), "the client notices");
        }
        let (client, answer, gateway) = greet();
        let (mut identify, _) = client.agree(&answer).expect("agrees").identify(&name(), None).expect("seals");
        identify[in_identify] ^= 1 << bit;
        prop_assert_eq!(gateway.identified(&identify).err().map(|refusal| refusal.code), Some(Code::Tag));
    }

    #[test]
    fn garbage_never_panics(noise in proptest::collection::vec(any::<u8>(), 0..400)) {
        let (client, _, gateway) = greet();
        prop_assert!(client.agree(&noise).is_err());
        prop_assert!(gateway.identified(&noise).is_err());
        prop_assert!(Hello::parse(&noise).is_err() || noise.len() == 130);
        let plain = zeroize::Zeroizing::new(noise);
        if let Ok((purpose, name)) = parse_name(&plain) {
            prop_assert_eq!(encode_name(purpose, &name), plain.to_vec());
        }
    }
}

impl ClientAgreed {
    /// The steps of the key agreement, for test vectors.
    pub fn steps(&self) -> Vec<(&'static str, Vec<u8>)> {
        let (key, nonce) = self.0.identify_key();
        vec![
            ("shared secret", self.0.secret.to_vec()),
            ("transcript digest", self.0.transcript.0.to_vec()),
            ("identify key and nonce", [&key[..], &nonce].concat()),
        ]
    }
}
