//! Block headers and state nodes, from evidence bundles.

use authros::evidence::{BlockHeader, Nodes, Storage};
use authros::model::{Address, Hash};

use crate::{Sample, way};

const WAYS: u8 = 2;
/// A sealed header of an embedded chain.
const HEADER: &[u8] = include_bytes!("../corpus/state_proof/header");
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
    vec![("header", HEADER.to_vec()), ("nodes", NODES.to_vec())]
}
