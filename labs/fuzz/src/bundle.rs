//! Evidence bundles, as a stranger receives them.

use authros::evidence::{Bundle, archive, verify};

use crate::cast::provider;
use crate::{Sample, masked, way};

const WAYS: u8 = 3;
/// A valid bundle: salts and signatures differ each time, so it is stored.
const BUNDLE: &[u8] = include_bytes!("../corpus/bundle/bundle");

/// Any claimed bundle.
pub fn run(data: &[u8]) -> bool {
    match way(data, WAYS) {
        Some((0, bytes)) => whole(bytes),
        Some((1, mask)) => altered(mask),
        Some((2, bytes)) => packed(bytes),
        _ => false,
    }
}

/// Whatever can be read can be judged, with a result for every level.
fn whole(bytes: &[u8]) -> bool {
    let Ok(bundle) = Bundle::parse(bytes, provider()) else { return false };
    let report = verify(&bundle, None, provider());
    assert_eq!(report.records.len(), bundle.records.len());
    bundle.signed
}

/// Whatever is changed: it is not a bundle, or its exporter did not sign it.
fn altered(mask: &[u8]) -> bool {
    let (bytes, changed) = masked(BUNDLE.get(1..).unwrap_or_default(), mask);
    let signed = whole(&bytes);
    assert!(!(changed && signed), "an altered bundle holds");
    signed
}

/// An archive has exactly one form.
fn packed(bytes: &[u8]) -> bool {
    let Ok(members) = archive::read(bytes) else { return false };
    assert_eq!(archive::write(&members).as_deref(), Ok(bytes));
    true
}

/// The stored ones.
pub fn samples() -> Vec<Sample> {
    vec![("bundle", BUNDLE.to_vec())]
}
