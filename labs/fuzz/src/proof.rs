//! Proofs: as carried with a record, paths to a batch's root, trees of any width.

use std::sync::LazyLock;

use authros::chain::AnchorProof;
use authros::chain::merkle::{Inclusion, LONGEST_PATH, Leaf, Tree, root_of};
use authros::model::wire::Reader;
use authros::model::{Address, Digest, Hash, RecorderId, SignerId, TopicId};

use crate::cast::provider;
use crate::{Sample, masked, sample, way};

const WAYS: u8 = 5;
/// Leaves of the batch that proofs are tested against.
const COUNT: u64 = 11;
/// The widest tree built from an input.
const WIDEST: usize = 300;

/// Any claimed proof of a record.
pub fn run(data: &[u8]) -> bool {
    match way(data, WAYS) {
        Some((0, bytes)) => inclusion(bytes),
        Some((1, bytes)) => altered(bytes),
        Some((2, bytes)) => any_path(bytes),
        Some((3, bytes)) => any_tree(bytes),
        Some((4, bytes)) => travelling(bytes),
        _ => false,
    }
}

fn leaf(number: u64) -> Leaf {
    Leaf {
        owner: Address([1; 20]),
        signer: SignerId([4; 32]),
        recorder: RecorderId([2; 16]),
        topic_id: TopicId([3; 16]),
        seq: number + 1,
        digest: Digest(provider().sm3(&[&number.to_be_bytes()])),
    }
}

/// The batch whose root is on the chain.
static BATCH: LazyLock<Tree> =
    LazyLock::new(|| Tree::new((0..COUNT).map(|number| leaf(number).hash()).collect()).expect("within bounds"));

/// Leaf (124), index (8), count (8), path.
fn encode(leaf: &Leaf, index: u64, count: u64, path: &[Hash]) -> Vec<u8> {
    let mut out = [
        &leaf.owner.0[..],
        &leaf.signer.0,
        &leaf.recorder.0,
        &leaf.topic_id.0,
        &leaf.seq.to_be_bytes(),
        &leaf.digest.0,
    ]
    .concat();
    out.extend_from_slice(&index.to_be_bytes());
    out.extend_from_slice(&count.to_be_bytes());
    out.extend(path.iter().flat_map(|hash| hash.0));
    out
}

fn decode(bytes: &[u8]) -> Option<(Leaf, u64, u64, Vec<Hash>)> {
    let mut reader = Reader::new(bytes);
    let leaf = Leaf {
        owner: Address(reader.array("owner").ok()?),
        signer: SignerId(reader.array("signer").ok()?),
        recorder: RecorderId(reader.array("recorder").ok()?),
        topic_id: TopicId(reader.array("topic id").ok()?),
        seq: reader.u64("seq").ok()?,
        digest: Digest(reader.array("digest").ok()?),
    };
    let (index, count) = (reader.u64("index").ok()?, reader.u64("count").ok()?);
    let path = reader.rest().chunks_exact(Hash::LENGTH).filter_map(Hash::from_slice).collect();
    Some((leaf, index, count, path))
}

fn genuine(index: u64) -> Vec<u8> {
    let place = usize::try_from(index).expect("small");
    encode(&leaf(index), index, COUNT, &BATCH.path(place))
}

/// A proof against the chain's root and count: only the batch's own leaves are accepted, at their places.
fn inclusion(bytes: &[u8]) -> bool {
    let Some((leaf, index, count, path)) = decode(bytes) else { return false };
    let proof = Inclusion { index, count, path, root: BATCH.root() };
    let proven = proof.proves(&leaf) && count == COUNT;
    if proven {
        assert!(index < COUNT && leaf == self::leaf(index), "proved what is not in the batch");
        assert_eq!(proof.path, BATCH.path(usize::try_from(index).expect("small")), "by another path");
    }
    assert!(proven || index >= COUNT || bytes != genuine(index), "a good proof was refused");
    proven
}

/// A valid proof with a mask applied: which leaf (1), then the mask.
fn altered(bytes: &[u8]) -> bool {
    let Some((&which, mask)) = bytes.split_first() else { return false };
    let (bytes, changed) = masked(&genuine(u64::from(which) % COUNT), mask);
    assert_eq!(inclusion(&bytes), !changed);
    !changed
}

/// Numbers and paths of any size lead to a root or to nothing, always the same, and not from another leaf.
fn any_path(bytes: &[u8]) -> bool {
    let Some((leaf, index, count, path)) = decode(bytes) else { return false };
    let Some(root) = root_of(leaf.hash(), index, count, &path) else { return false };
    assert!(index < count && path.len() <= LONGEST_PATH);
    let longer = [&path[..], &[Hash([0; 32])]].concat();
    assert_eq!(root_of(leaf.hash(), index, count, &longer), None, "a path too long");
    if let Some((_, shorter)) = path.split_last() {
        assert_eq!(root_of(leaf.hash(), index, count, shorter), None, "a path too short");
    }
    let other = Leaf { seq: leaf.seq ^ 1, ..leaf };
    assert_ne!(root_of(other.hash(), index, count, &path), Some(root), "two leaves in one place");
    true
}

/// Every leaf of a tree of the input's width is proven, and at no other place: width (2), leaf (2), other place (2).
fn any_tree(bytes: &[u8]) -> bool {
    let mut reader = Reader::new(bytes);
    let mut number = |most: usize| reader.u16("number").map(|number| usize::from(number) % most);
    let Ok(width) = number(WIDEST).map(|width| width + 1) else { return false };
    let (Ok(index), Ok(other)) = (number(width), number(width)) else { return false };
    let leaves: Vec<Hash> = (0..width as u64).map(|number| Hash(provider().sm3(&[&number.to_be_bytes()]))).collect();
    let tree = Tree::new(leaves.clone()).expect("within bounds");
    let root = |leaf: usize, index: usize| root_of(leaves[leaf], index as u64, width as u64, &tree.path(index));
    assert_eq!(root(index, index), Some(tree.root()));
    assert_eq!(root(other, index) == Some(tree.root()), other == index);
    true
}

/// A proof as the gateway sends it with a record: which leaf (1), then the proof.
fn travelling(bytes: &[u8]) -> bool {
    let Some((&which, bytes)) = bytes.split_first() else { return false };
    let Ok(proof) = AnchorProof::parse(bytes) else { return false };
    assert_eq!(proof.encode(), bytes, "one encoding for one proof");
    let Some(inclusion) = proof.inclusion else { return true };
    let place = u64::from(which) % COUNT;
    let proven = inclusion.root == BATCH.root() && inclusion.count == COUNT && inclusion.proves(&leaf(place));
    assert!(
        !proven || (inclusion.index == place && inclusion.path == BATCH.path(usize::try_from(place).expect("small")))
    );
    proven
}

fn anchored(inclusion: Option<Inclusion>) -> Vec<u8> {
    let (transaction, block_hash) = (Hash([2; 32]), Hash([4; 32]));
    AnchorProof { account: Address([1; 20]), transaction, block: 3, block_hash, inclusion }.encode()
}

/// Valid encodings of every kind.
pub fn samples() -> Vec<Sample> {
    let inclusion = Inclusion { index: 6, count: COUNT, path: BATCH.path(6), root: BATCH.root() };
    vec![
        sample("first", 0, &genuine(0)),
        sample("middle", 0, &genuine(5)),
        sample("last", 0, &genuine(COUNT - 1)),
        sample("altered", 1, &[0; 8]),
        sample("any_path", 2, &genuine(7)),
        sample("alone", 2, &encode(&leaf(0), 0, 1, &[])),
        sample("travelling", 4, &[&[6][..], &anchored(Some(inclusion))].concat()),
        sample("travelling_alone", 4, &[&[6][..], &anchored(None)].concat()),
        sample("any_tree", 3, &[0, 200, 0, 130, 0, 7]),
    ]
}
