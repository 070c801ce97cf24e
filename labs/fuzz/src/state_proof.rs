//! Block headers, the seals on them and state nodes, from evidence bundles.

use std::collections::BTreeMap;

use authros::evidence::{BlockHeader, Nodes, Storage, seals};
use authros::model::{Address, Hash};

use crate::{Sample, way};

const WAYS: u8 = 3;
/// A sealed header of an embedded chain.
const HEADER: &[u8] = include_bytes!("../corpus/state_proof/header");
/// A header of a network of Besu, with the seals of three of its four validators (QBFT).
const COMMITTED: &[u8] = include_bytes!("../corpus/state_proof/committed");
/// The nodes of the states after it and after the next.
const NODES: &[u8] = include_bytes!("../corpus/state_proof/nodes");

/// The first as one of several, each with its length, two bytes, before it.
const SEALS: &[u8] = include_bytes!("../corpus/state_proof/seals");

/// Any claimed proof.
pub fn run(data: &[u8]) -> bool {
    match way(data, WAYS) {
        Some((0, bytes)) => header(bytes),
        Some((1, bytes)) => nodes(bytes),
        Some((2, bytes)) => sealed(bytes),
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

/// However many headers follow one another: a signer is counted for a block only if one of them has its genuine seal, and
/// nobody is counted twice.
fn sealed(mut bytes: &[u8]) -> bool {
    let genuine = HEADER.get(1..).and_then(BlockHeader::parse).expect("the kept one");
    let signer = genuine.sealer().expect("sealed");
    let mut headers = BTreeMap::new();
    while let Some((length, rest)) = bytes.split_first_chunk::<2>() {
        let Some((header, rest)) = rest.split_at_checked(usize::from(u16::from_be_bytes(*length))) else { break };
        headers.extend(BlockHeader::parse(header).map(|header| (header.number, header)));
        bytes = rest;
    }
    let Some(first) = headers.keys().next().copied() else { return false };
    let pinned = [signer, Address([7; 20])];
    let found = seals(&headers, first, &pinned);
    assert!(found.pinned.is_empty() || found.pinned.contains(&signer), "nobody has the other's key");
    if !found.pinned.contains(&signer) {
        return false;
    }
    let is_genuine = |header: &BlockHeader| (header.number, header.state_root) == (genuine.number, genuine.state_root);
    assert!(headers.values().any(is_genuine), "a seal that its signer never made");
    found.pinned.len() == 1
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
    vec![
        ("header", HEADER.to_vec()),
        ("committed", COMMITTED.to_vec()),
        ("nodes", NODES.to_vec()),
        ("seals", SEALS.to_vec()),
    ]
}
