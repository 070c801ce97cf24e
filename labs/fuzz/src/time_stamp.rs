//! Answers, tokens and certificates of time stamp authorities (RFC 3161), as a stranger sends them.

use authros::evidence::time::{Certificate, check_token, token_of};

use crate::{Sample, masked, way};

const WAYS: u8 = 4;
/// An answer of openssl's, over [`IMPRINT`].
const ANSWER: &[u8] = include_bytes!("../corpus/time_stamp/answer");
/// The certificate that it leads to.
const ROOT: &[u8] = include_bytes!("../corpus/time_stamp/certificate");
/// What was stamped.
const IMPRINT: [u8; 32] = [0x5a; 32];

/// Whatever claims to be a stamp.
pub fn run(data: &[u8]) -> bool {
    match way(data, WAYS) {
        Some((0, bytes)) => token_of(bytes).is_ok_and(token),
        Some((1, bytes)) => Certificate::parse(bytes).is_ok(),
        Some((2, bytes)) => token(bytes),
        Some((3, mask)) => altered(mask),
        _ => false,
    }
}

/// Nothing leads to the authority's root but what it said itself.
fn token(bytes: &[u8]) -> bool {
    let root = ROOT.get(1..).and_then(|root| Certificate::parse(root).ok()).expect("the kept one");
    let check = |bytes: &[u8]| check_token(bytes, &IMPRINT, None, std::slice::from_ref(&root)).ok();
    let found = check(bytes).filter(|stamped| stamped.pinned.is_some());
    assert!(found.is_none() || found == genuine().and_then(check), "another time is taken");
    found.is_some()
}

fn genuine() -> Option<&'static [u8]> {
    ANSWER.get(1..).and_then(|answer| token_of(answer).ok())
}

fn altered(mask: &[u8]) -> bool {
    let (bytes, _) = masked(genuine().expect("the kept one"), mask);
    token(&bytes)
}

/// Those that are kept.
pub fn samples() -> Vec<Sample> {
    let own = genuine().expect("the kept one");
    let token = [&[2], own].concat();
    vec![("answer", ANSWER.to_vec()), ("certificate", ROOT.to_vec()), ("token", token), ("masked", vec![3])]
}
