//! Key allocation: the request and its identity check, the system-key list, registrations, SM2 ciphertexts.

use std::sync::LazyLock;

use authros::crypto::{self, ProviderName, check_identity, prove, signature_der, signature_from_der};
use authros::gateway::allocation::{AllocationRequest, Applicant, apply, examine};
use authros::gateway::hello::{Agreed, ListSummary};
use authros::gateway::session::SessionId;
use authros::gateway::system_keys::{SystemKey, SystemKeyList};
use authros::model::{Address, Digest, Identity, ProfileName, Signature, Timestamp, Token};

use crate::cast::{CAST, DOMAIN, context, provider};
use crate::{Sample, masked, sample, way};

const WAYS: u8 = 7;
/// The bytes of a valid request, list and registration: signatures differ each time, so they are stored.
const REQUEST: &[u8] = include_bytes!("../corpus/key_allocation/request");
const LIST: &[u8] = include_bytes!("../corpus/key_allocation/list");
const REGISTRATION: &[u8] = include_bytes!("../corpus/key_allocation/registration");

/// Without its first byte, which selects the test.
fn genuine(file: &'static [u8]) -> &'static [u8] {
    &file[1..]
}

fn name() -> ProfileName {
    "robot-1".parse().expect("a name")
}

fn system_key() -> SystemKey {
    SystemKey { public: CAST.system.public, not_before: Timestamp(1), not_after: Timestamp(u64::MAX) }
}

fn agreed(list: ListSummary) -> Agreed {
    Agreed {
        gateway: crypto::signer_id(&CAST.gateway.public),
        gateway_key: CAST.gateway.public,
        client_nonce: [0xc1; 32],
        gateway_nonce: [0xd1; 32],
        session: SessionId([0x5e; 16]),
        list,
    }
}

static AGREED: LazyLock<Agreed> = LazyLock::new(|| agreed(ListSummary { version: 7, digest: Digest([0x77; 32]) }));

/// Anything that arrives in a session for allocation.
pub fn run(data: &[u8]) -> bool {
    match way(data, WAYS) {
        Some((0, body)) => request(body),
        Some((1, mask)) => request(&masked(genuine(REQUEST), mask).0),
        Some((2, plain)) => plaintext(plain),
        Some((3, bytes)) => list(bytes),
        Some((4, body)) => registration(body),
        Some((5, mask)) => registration(&masked(genuine(REGISTRATION), mask).0),
        Some((6, bytes)) => both_providers(bytes),
        _ => false,
    }
}

fn request(body: &[u8]) -> bool {
    let Ok(request) = AllocationRequest::parse(body) else { return false };
    assert_eq!(request.encode(), body, "one encoding for one request");
    let examined = examine(&context(), &AGREED, &name(), &request, Some(&CAST.system.secret));
    assert_eq!(examined.is_ok(), body == genuine(REQUEST), "accepted what nobody signed, or refused what was signed");
    let Ok(allocation) = examined else { return false };
    assert_eq!((allocation.account, allocation.signing), (CAST.address(), CAST.owner.public));
    true
}

/// Anything sealed to the system key under the valid request's signatures.
fn plaintext(plain: &[u8]) -> bool {
    let Ok(ciphertext) = provider().encrypt(&CAST.system.public, plain) else { return false };
    let valid = AllocationRequest::parse(genuine(REQUEST)).expect("valid");
    let request = AllocationRequest { ciphertext, ..valid };
    let examined = examine(&context(), &AGREED, &name(), &request, Some(&CAST.system.secret));
    assert!(examined.is_err(), "a signature for another ciphertext");
    plain.len() == 213
}

fn list(bytes: &[u8]) -> bool {
    let Ok(list) = SystemKeyList::parse(bytes) else { return false };
    assert_eq!(list.encode(), bytes, "one encoding for one list");
    // As if the gateway had announced exactly this one.
    let agreed = agreed(list.summary(provider()));
    let checked = list.check(context(), &agreed, Timestamp(500));
    assert_eq!(checked.is_ok(), bytes == genuine(LIST), "took a list that nobody signed, or refused one that was");
    checked.is_ok_and(|key| key == system_key())
}

fn registration(body: &[u8]) -> bool {
    let Some((account, identity)) = body.split_first_chunk() else { return false };
    let Ok(parsed) = Identity::parse(identity) else { return false };
    assert_eq!(parsed.encode(), identity, "one encoding for one identity");
    let checked = check_identity(provider(), &DOMAIN, &Address(*account), &parsed);
    assert_eq!(checked.is_ok(), body == genuine(REGISTRATION), "took an identity that is not proven, or refused one");
    checked.is_ok()
}

/// Both providers open the same ciphertexts, and both forms of a signature give the same verdict.
fn both_providers(bytes: &[u8]) -> bool {
    let one = provider().decrypt(&CAST.system.secret, bytes);
    let other = crypto::provider(ProviderName::Libsm).decrypt(&CAST.system.secret, bytes);
    assert_eq!(one.is_ok(), other.is_ok(), "one provider opens what the other does not");
    if let (Ok(one), Ok(other)) = (&one, &other) {
        assert_eq!(one, other, "the providers open different texts");
    }
    let signature = signature_from_der(bytes);
    if let Ok(signature) = &signature {
        assert_eq!(signature_der(signature), bytes, "one encoding for one signature");
    }
    let raw = bytes.try_into();
    if let Ok(raw) = raw {
        let (signature, message) = (Signature(raw), b"a message");
        let one = provider().verify(&CAST.owner.public, message, &signature);
        let other = crypto::provider(ProviderName::Libsm).verify(&CAST.owner.public, message, &signature);
        assert!(one.is_err() && other.is_err(), "a signature out of the blue");
    }
    one.is_ok() || signature.is_ok() || raw.is_ok()
}

/// Valid encodings of every kind.
pub fn samples() -> Vec<Sample> {
    let (name, provider) = (name(), provider());
    let applicant =
        Applicant { name: &name, signing: &CAST.owner, envelope: CAST.reader.public, account: &CAST.account };
    let (_, request) = apply(&context(), &AGREED, &system_key(), &applicant).expect("applies");
    let dates = (Timestamp(1), Timestamp(1000));
    let list = SystemKeyList::sign(context(), &CAST.gateway, 7, dates, vec![system_key()]).expect("signs");
    let token = Token([1; 32]);
    let identity = prove(provider, &DOMAIN, &CAST.address(), &CAST.owner, &CAST.reader.public, token).expect("proves");
    let registration = [&CAST.address().0[..], &identity.encode()].concat();
    let parsed = AllocationRequest::parse(&request).expect("ours");
    let plain = provider.decrypt(&CAST.system.secret, &parsed.ciphertext).expect("opens");
    vec![
        sample("request", 0, &request),
        sample("request_masked", 1, &[0; 4]),
        sample("plaintext", 2, &plain),
        sample("list", 3, &list.encode()),
        sample("registration", 4, &registration),
        sample("registration_masked", 5, &[0; 4]),
        sample("ciphertext", 6, &parsed.ciphertext),
        sample("signature", 6, &signature_der(&parsed.signature)),
        sample("signature_raw", 6, &parsed.signature.0),
    ]
}
