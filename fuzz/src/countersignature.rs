//! Countersignatures of witnesses and statements of owners, as a stranger sends them.

use authros::crypto::{ProviderName, SmKeyPair, SmSecret, provider};
use authros::evidence::witness::{check_countersignature, check_position, countersign, state};
use authros::model::{
    Address, Countersignature, Digest, Hash, Position, PublicKey, RecorderId, SignedPosition, Timestamp,
};

use crate::{Sample, masked, sample, way};

const WAYS: u8 = 3;
/// One that was made once: signatures differ each time.
const GENUINE: &[u8] = include_bytes!("../corpus/countersignature/countersignature");

/// Whatever claims to be one.
pub fn run(data: &[u8]) -> bool {
    match way(data, WAYS) {
        Some((0, bytes)) => whole(bytes),
        Some((1, bytes)) => stated(bytes),
        Some((2, mask)) => altered(mask),
        _ => false,
    }
}

/// It has one spelling, and one length.
fn whole(bytes: &[u8]) -> bool {
    let Ok(found) = Countersignature::parse(bytes) else { return false };
    assert!(found.encode() == bytes && bytes.len() == Countersignature::LENGTH, "another spelling is read");
    check_countersignature(&found, provider(ProviderName::RustCrypto)).is_ok()
}

fn stated(bytes: &[u8]) -> bool {
    let Ok(found) = SignedPosition::parse(bytes) else { return false };
    assert!(found.encode() == bytes && bytes.len() == SignedPosition::LENGTH, "another spelling is read");
    check_position(&found, provider(ProviderName::RustCrypto)).is_ok()
}

/// Nothing but the kept one is signed by its two keys.
fn altered(mask: &[u8]) -> bool {
    let (bytes, changed) = masked(GENUINE.get(1..).expect("the kept one"), mask);
    let taken = whole(&bytes);
    assert!(!(taken && changed), "an altered one is taken");
    taken
}

fn pair(byte: u8) -> SmKeyPair {
    let secret = SmSecret::from_slice(&[byte; 32]).expect("in range");
    SmKeyPair::from_secret(provider(ProviderName::RustCrypto), secret).expect("a pair")
}

/// Those that are kept.
pub fn samples() -> Vec<Sample> {
    let provider = provider(ProviderName::RustCrypto);
    let position = Position {
        chain_id: 7,
        genesis: Hash([1; 32]),
        contract: Address([2; 20]),
        owner: Address([3; 20]),
        key: PublicKey([0; 64]),
        recorder: RecorderId([5; 16]),
        block: 6,
        block_hash: Hash([7; 32]),
        earlier: Some((5, Hash([8; 32]))),
        top: Hash([9; 32]),
        count: 10,
        head: Some((11, Digest([12; 32]))),
    };
    let signed = state(position, &pair(0x41), provider).expect("signs");
    let witness = (Address([13; 20]), &pair(0x42));
    let given = countersign(signed, Timestamp(14), witness, provider).expect("signs");
    vec![
        sample("countersignature", 0, &given.encode()),
        sample("position", 1, &signed.encode()),
        sample("masked", 2, &[]),
    ]
}
