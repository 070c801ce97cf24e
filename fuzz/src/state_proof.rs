//! Block headers and state nodes, from evidence bundles.

use authros::evidence::{BlockHeader, Nodes, Storage, seals};
use authros::model::{Address, Hash};

use crate::{Sample, way};

const WAYS: u8 = 2;
/// A sealed header of an embedded chain.
const HEADER: &[u8] = include_bytes!("../corpus/state_proof/header");
/// A header of a network of Besu, with the seals of three of its four validators (QBFT).
const COMMITTED: &[u8] = include_bytes!("../corpus/state_proof/committed");
/// The nodes of the states after it and after the next.
const NODES: &[u8] = include_bytes!("../corpus/state_proof/nodes");

/// Any claimed proof.
pub fn run(data: &[u8]) -> bool {
    match way(data, WAYS) {
        Some((0, bytes)) => header(bytes),
        Some((1, bytes)) => nodes(bytes),
        _ => false,
    }
}

/// A header that names the genuine signer is the genuine one.
fn header(bytes: &[u8]) -> bool {
    let Some(found) = BlockHeader::parse(bytes) else { return false };
    if found.committed().is_some() {
        return committed(found);
    }
    let genuine = HEADER.get(1..).and_then(BlockHeader::parse).expect("the kept one");
    if found.sealer() == genuine.sealer() {
        // The seal itself is not signed: r and s have one form; the vanity is.
        assert_eq!(
            (found.state_root, found.number, found.timestamp),
            (genuine.state_root, genuine.number, genuine.timestamp)
        );
        return true;
    }
    false
}

/// A header that three of the genuine validators sealed is the genuine one.
fn committed(found: BlockHeader) -> bool {
    let genuine = COMMITTED.get(1..).and_then(BlockHeader::parse).expect("the kept one");
    let validators = &genuine.committed().expect("has seals").validators;
    let (number, hash) = (found.number, found.hash);
    let judged = seals(&[(number, found)].into(), number, validators);
    assert!(judged.flaw.is_none() || judged.pinned.is_empty());
    if judged.pinned.len() < 3 {
        return false;
    }
    assert_eq!(hash, genuine.hash);
    true
}

/// Nodes have one form, and what they show below a root is the same whatever other nodes are present.
fn nodes(bytes: &[u8]) -> bool {
    let Some(found) = Nodes::parse(bytes) else { return false };
    assert_eq!(found.encode(), bytes);
    let genuine = NODES.get(1..).and_then(Nodes::parse).expect("the kept ones");
    let root = HEADER.get(1..).and_then(BlockHeader::parse).expect("the kept one").state_root;
    for key in [&bytes[..bytes.len().min(20)], &[1; 20]] {
        if let (Ok(here), Ok(there)) = (found.look_up(root, key), genuine.look_up(root, key)) {
            assert_eq!(here, there);
        }
    }
    let _ = Storage::of(&found, root, Address([1; 20])).map(|storage| storage.anchor(Address([2; 20]), Hash([3; 32])));
    !found.is_empty()
}

/// The stored ones.
pub fn samples() -> Vec<Sample> {
    vec![("header", HEADER.to_vec()), ("committed", COMMITTED.to_vec()), ("nodes", NODES.to_vec())]
}
