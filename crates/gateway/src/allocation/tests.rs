use proptest::prelude::*;

use super::*;
use crate::gateway::hello::GatewayHello;
use crate::gateway::tests::{Member, context, greet, pair};
use crate::model::Timestamp;

fn system_key(byte: u8) -> SystemKey {
    SystemKey { public: pair(byte).public, not_before: Timestamp(0), not_after: Timestamp(u64::MAX) }
}

/// A valid request, and everything the gateway needs to examine it.
struct Case {
    agreed: Agreed,
    member: Member,
    key: TransportKey,
    body: Vec<u8>,
    secret: SmSecret,
}

fn case() -> Case {
    let (client, answer, _): (_, _, GatewayHello) = greet();
    let agreed = *client.agree(&answer).expect("agrees").agreed();
    let member = Member::new("robot-1", 0x61);
    let (key, body) = apply(&context(), &agreed, &system_key(0x51), &member.applicant()).expect("applies");
    Case { agreed, member, key, body, secret: pair(0x51).secret }
}

impl Case {
    fn examine(&self, body: &[u8]) -> Result<Allocation, Code> {
        let request = AllocationRequest::parse(body).map_err(|_| Code::Malformed)?;
        examine(&context(), &self.agreed, &self.member.name, &request, Some(&self.secret))
            .map_err(|refusal| refusal.code)
    }

    fn request(&self) -> AllocationRequest {
        AllocationRequest::parse(&self.body).expect("parses")
    }
}

#[test]
fn a_valid_request_gives_what_the_client_meant() {
    let case = case();
    let expected = Allocation {
        name: case.member.name.clone(),
        key: case.key.clone(),
        signing: case.member.signing.public,
        envelope: case.member.envelope.public,
        account: case.member.account(),
    };
    assert_eq!(case.examine(&case.body), Ok(expected));
    assert_eq!(case.request().encode(), case.body);
    assert!(case.body.len() < 1024);
    let hidden = [&case.key.expose()[..], b"robot-1"];
    assert!(hidden.iter().all(|secret| !case.body.windows(secret.len()).any(|window| window == *secret)));
}

#[test]
fn another_system_key_session_name_or_network_is_refused() {
    let case = case();
    let request = case.request();
    let with = |context: &Context, agreed: &Agreed, name: &str, secret: Option<&SmSecret>| {
        let name = name.parse().expect("a name");
        examine(context, agreed, &name, &request, secret).expect_err("refused").code
    };
    let secret = Some(&case.secret);
    assert_eq!(with(&context(), &case.agreed, "robot-1", None), Code::SystemKey);
    assert_eq!(with(&context(), &case.agreed, "robot-1", Some(&pair(0x52).secret)), Code::Malformed);
    assert_eq!(with(&context(), &case.agreed, "robot-2", secret), Code::Malformed);
    let away = Context { domain: Domain([9; 32]), ..context() };
    assert_eq!(with(&away, &case.agreed, "robot-1", secret), Code::Signature);
    for agreed in [
        Agreed { client_nonce: [0; 32], ..case.agreed },
        Agreed { gateway_nonce: [0; 32], ..case.agreed },
        Agreed { gateway: SignerId([0; 32]), ..case.agreed },
    ] {
        assert_eq!(with(&context(), &agreed, "robot-1", secret), Code::Signature);
    }
    let mut other_key = request.clone();
    other_key.system_key = SignerId([0; 32]);
    assert_eq!(case.examine(&other_key.encode()), Err(Code::Signature), "another key's id over the same CT");
}

#[test]
fn signatures_of_others_and_degenerate_ones_are_refused() {
    let case = case();
    let (client, answer, _) = greet();
    let agreed = *client.agree(&answer).expect("agrees").agreed();
    let other = Member::new("robot-1", 0x71);
    let (_, theirs) = apply(&context(), &agreed, &system_key(0x51), &other.applicant()).expect("applies");
    let theirs = AllocationRequest::parse(&theirs).expect("parses");
    let ours = case.request();
    assert_eq!(
        case.examine(&AllocationRequest { signature: theirs.signature, ..ours.clone() }.encode()),
        Err(Code::Signature)
    );
    let swapped = AllocationRequest { account_signature: theirs.account_signature, ..ours.clone() };
    assert_eq!(case.examine(&swapped.encode()), Err(Code::Account));

    let order =
        crate::model::bytes::unhex("fffffffeffffffffffffffffffffffff7203df6b21c6052b53bbf40939d54123").expect("hex");
    let mut below = order.clone();
    below[31] -= 1;
    let numbers = [vec![0; 32], order, below];
    for r in &numbers {
        for s in &numbers {
            let signature = Signature([&r[..], s].concat().try_into().expect("64 bytes"));
            assert_eq!(case.examine(&AllocationRequest { signature, ..ours.clone() }.encode()), Err(Code::Signature));
        }
        for (at, half) in [(0, 0..32), (1, 32..64)] {
            let mut signature = ours.signature;
            signature.0[half].copy_from_slice(r);
            let request = AllocationRequest { signature, ..ours.clone() };
            assert_eq!(case.examine(&request.encode()), Err(Code::Signature), "half {at}");
        }
    }
}

/// The account's signature is bound to the same Command and fields as d_C's.
#[test]
fn a_signature_for_another_command_is_refused() {
    let case = case();
    let request = case.request();
    let allocation = case.examine(&case.body).expect("valid");
    let transcript = Transcript {
        domain: &context().domain,
        agreed: &case.agreed,
        system_key: &request.system_key,
        allocation: &allocation,
        ciphertext: request.digest(context().provider),
    };
    let mut signed = transcript.signed_bytes();
    let at = b"AuthROS/allocation/1".len() + 5 * 32;
    assert_eq!(signed[at], Command::KeyAllocation.number());
    signed[at] = Command::Upload.number();
    let signature = context().provider.sign(&case.member.signing.secret, &signed).expect("signs");
    assert_eq!(case.examine(&AllocationRequest { signature, ..request }.encode()), Err(Code::Signature));
}

#[test]
fn every_byte_of_a_request_matters() {
    let case = case();
    for at in 0..case.body.len() {
        let mut body = case.body.clone();
        body[at] ^= 1 << (at % 8);
        assert!(case.examine(&body).is_err(), "byte {at}");
        assert!(AllocationRequest::parse(&case.body[..at]).is_err());
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn no_bit_of_a_request_can_be_changed(at: usize, bit in 0u8..8) {
        let case = case();
        let mut body = case.body.clone();
        let at = at % body.len();
        body[at] ^= 1 << bit;
        prop_assert!(case.examine(&body).is_err());
    }

    #[test]
    fn garbage_never_panics(noise in proptest::collection::vec(any::<u8>(), 0..700), plain in proptest::collection::vec(any::<u8>(), 213)) {
        prop_assert!(case().examine(&noise).is_err());
        if let Ok(allocation) = Allocation::parse(&plain) {
            prop_assert_eq!(allocation.encode().to_vec(), plain);
        }
    }
}
