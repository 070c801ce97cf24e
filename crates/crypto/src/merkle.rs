//! Merkle batches: RFC 6962's tree with SM3 (docs/format.md, section 6); seq is 8 bytes, big endian.
//! leaf = SM3(0x00 || owner || signer || recorder || topic id || seq || D), node = SM3(0x01 || left || right).

use std::collections::HashMap;
use std::sync::{PoisonError, RwLock};

use super::sm3::{sm3, sm3_many};
use crate::model::{Address, Digest, Hash, Header, RecorderId, SignerId, TopicId};

/// The most leaves in a batch.
pub const MOST_LEAVES: usize = 16_384;
/// The longest path in such a batch, hashes.
pub const LONGEST_PATH: usize = 14;

const LEAF: &[u8] = &[0];
const NODE: &[u8] = &[1];
const HEIGHT: &[u8] = b"AuthROS/height/1";
const STAMP: &[u8] = b"AuthROS/stamp/1";

/// One record as bound by its batch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Leaf {
    /// The owner of the record.
    pub owner: Address,
    /// SM3 of the key that signed it.
    pub signer: SignerId,
    /// The recorder that numbered it.
    pub recorder: RecorderId,
    /// Its topic's pseudonym.
    pub topic_id: TopicId,
    /// Its seq.
    pub seq: u64,
    /// SM3 of the stored bytes.
    pub digest: Digest,
}

impl Leaf {
    /// Of the record with this public header and digest.
    pub fn of(header: &Header, digest: Digest) -> Self {
        let Header { owner, signer, recorder, topic_id, seq, .. } = *header;
        Self { owner, signer, recorder, topic_id, seq, digest }
    }

    /// Its hash in the tree.
    pub fn hash(&self) -> Hash {
        Hash(sm3(&[&self.hashed()]))
    }

    /// The hashes of many leaves, in order; several at once if the processor can.
    pub fn hashes(leaves: &[Self]) -> Vec<Hash> {
        hashes(leaves.iter().map(Self::hashed))
    }

    fn hashed(&self) -> Vec<u8> {
        let seq = self.seq.to_be_bytes();
        [LEAF, &self.owner.0, &self.signer.0, &self.recorder.0, &self.topic_id.0, &seq, &self.digest.0].concat()
    }
}

fn hashes(inputs: impl Iterator<Item = Vec<u8>>) -> Vec<Hash> {
    let inputs: Vec<Vec<u8>> = inputs.collect();
    let inputs: Vec<&[u8]> = inputs.iter().map(Vec::as_slice).collect();
    sm3_many(&inputs).into_iter().map(Hash).collect()
}

/// The node above two others.
pub fn node(left: &Hash, right: &Hash) -> Hash {
    Hash(sm3(&[NODE, &left.0, &right.0]))
}

/// A topic's leaf in a recorder's head: SM3(0x00 || `AuthROS/height/1` || topic id || number).
pub fn height_hash(topic: &TopicId, number: u64) -> Hash {
    Hash(sm3(&[LEAF, HEIGHT, &topic.0, &number.to_be_bytes()]))
}

/// A batch root's leaf in the tree that authorities stamp: SM3(0x00 || `AuthROS/stamp/1` || root).
pub fn stamp_hash(root: &Hash) -> Hash {
    Hash(sm3(&[LEAF, STAMP, &root.0]))
}

/// A tree over the leaves of one batch.
#[derive(Debug, Clone)]
pub struct Tree {
    /// From the leaves up to the root; a node without a sibling moves up unchanged.
    levels: Vec<Vec<Hash>>,
}

impl Tree {
    /// The tree over these leaf hashes; `None` if there are none or more than [`MOST_LEAVES`].
    pub fn new(leaves: Vec<Hash>) -> Option<Self> {
        if leaves.is_empty() || leaves.len() > MOST_LEAVES {
            return None;
        }
        let mut levels = vec![leaves];
        while let Some(below) = levels.last().filter(|level| level.len() > 1) {
            let (pairs, alone) = below.as_chunks::<2>();
            let mut above = hashes(pairs.iter().map(|[left, right]| [NODE, &left.0, &right.0].concat()));
            above.extend_from_slice(alone);
            levels.push(above);
        }
        Some(Self { levels })
    }

    /// The root.
    pub fn root(&self) -> Hash {
        self.levels.last().and_then(|level| level.first()).copied().unwrap_or(Hash([0; 32]))
    }

    /// Siblings from leaf `index` up to the root.
    pub fn path(&self, index: usize) -> Vec<Hash> {
        let below_root = self.levels.iter().take(self.levels.len() - 1);
        let siblings = below_root.enumerate().map(|(height, level)| level.get((index >> height) ^ 1));
        siblings.flatten().copied().collect()
    }
}

/// A node on the way from a leaf to the root (RFC 9162, 2.1.3.2): what further siblings make of it depends on nothing else.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Climber {
    /// The place of the node, and of the last node, at its height.
    place: u64,
    last: u64,
    hash: Hash,
}

impl Climber {
    /// At leaf `index` of a tree of `count` leaves; `None` if there is no such leaf.
    pub fn at(leaf: Hash, index: u64, count: u64) -> Option<Self> {
        (index < count).then(|| Self { place: index, last: count - 1, hash: leaf })
    }

    /// Goes up past a sibling; `false` if it is at the root already.
    pub fn pass(&mut self, sibling: &Hash) -> bool {
        if self.last == 0 {
            return false;
        }
        if self.place & 1 == 1 || self.place == self.last {
            self.hash = node(sibling, &self.hash);
            // A node without a sibling was moved up unchanged.
            while self.place & 1 == 0 && self.place != 0 {
                (self.place, self.last) = (self.place >> 1, self.last >> 1);
            }
        } else {
            self.hash = node(&self.hash, sibling);
        }
        (self.place, self.last) = (self.place >> 1, self.last >> 1);
        true
    }

    /// The root, if it is there.
    pub fn root(&self) -> Option<Hash> {
        (self.last == 0).then_some(self.hash)
    }
}

/// The root that a leaf's path leads to in a tree of `count` leaves; `None` if `index` is not in such a tree or the
/// path does not have exactly the length that (index, count) demand (RFC 9162, 2.1.3.2).
pub fn root_of(leaf: Hash, index: u64, count: u64, path: &[Hash]) -> Option<Hash> {
    let mut climber = Climber::at(leaf, index, count).filter(|_| path.len() <= LONGEST_PATH)?;
    path.iter().all(|sibling| climber.pass(sibling)).then(|| climber.root())?
}

/// Paths that lead to their roots. Those of one tree meet, and a rest already known is not hashed again.
#[derive(Debug, Default)]
pub struct KnownPaths<'a>(RwLock<HashMap<(Hash, Climber), &'a [Hash]>>);

impl<'a> KnownPaths<'a> {
    /// Whether [`root_of`] of this leaf, (index, count) and path is this root.
    pub fn lead(&self, leaf: Hash, (index, count): (u64, u64), path: &'a [Hash], root: Hash) -> bool {
        let Some(mut climber) = Climber::at(leaf, index, count).filter(|_| path.len() <= LONGEST_PATH) else {
            return false;
        };
        let (mut rest, mut passed) = (path, Vec::with_capacity(path.len()));
        while let Some((sibling, above)) = rest.split_first() {
            if !climber.pass(sibling) {
                return false;
            }
            rest = above;
            let known = self.0.read().unwrap_or_else(PoisonError::into_inner);
            if known.get(&(root, climber)).is_some_and(|known| *known == rest) {
                break;
            }
            drop(known);
            passed.push((climber, rest));
        }
        // Left early: the rest is known to lead there.
        let leads = passed.len() < path.len() || climber.root() == Some(root);
        if leads {
            let mut known = self.0.write().unwrap_or_else(PoisonError::into_inner);
            known.extend(passed.into_iter().map(|(climber, rest)| ((root, climber), rest)));
        }
        leads
    }
}

/// A record's proof of membership in a batch.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Inclusion {
    /// The leaf's index, from 0.
    pub index: u64,
    /// Leaves in the batch.
    pub count: u64,
    /// Siblings from the leaf up.
    pub path: Vec<Hash>,
    /// The batch's root.
    pub root: Hash,
}

impl Inclusion {
    /// Whether the path leads from this leaf to the root.
    pub fn proves(&self, leaf: &Leaf) -> bool {
        root_of(leaf.hash(), self.index, self.count, &self.path) == Some(self.root)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use proptest::sample::Index;
    use proptest::strategy::ValueTree as _;

    use super::*;

    fn leaf(number: u64) -> Leaf {
        Leaf {
            owner: Address([1; 20]),
            signer: SignerId([8; 32]),
            recorder: RecorderId([2; 16]),
            topic_id: TopicId([3; 16]),
            seq: number + 1,
            digest: Digest(sm3(&[&number.to_be_bytes()])),
        }
    }

    fn tree(count: usize) -> Tree {
        Tree::new((0..count as u64).map(|number| leaf(number).hash()).collect()).expect("within bounds")
    }

    /// The definition of RFC 6962, section 2.1, word for word.
    fn by_definition(leaves: &[Hash]) -> Hash {
        if let [only] = leaves {
            return *only;
        }
        let split = (leaves.len() - 1).next_power_of_two() >> usize::from(!(leaves.len() - 1).is_power_of_two());
        let split = if split >= leaves.len() { split / 2 } else { split };
        node(&by_definition(&leaves[..split]), &by_definition(&leaves[split..]))
    }

    #[test]
    fn the_tree_is_that_of_rfc_6962() {
        for count in 1..=130usize {
            let leaves: Vec<Hash> = (0..count as u64).map(|number| leaf(number).hash()).collect();
            let tree = tree(count);
            assert_eq!(tree.root(), by_definition(&leaves), "{count} leaves");
            for (index, hash) in leaves.iter().enumerate() {
                let root = root_of(*hash, index as u64, count as u64, &tree.path(index));
                assert_eq!(root, Some(tree.root()), "leaf {index} of {count}");
            }
        }
        assert!(Tree::new(Vec::new()).is_none() && Tree::new(vec![Hash([0; 32]); MOST_LEAVES + 1]).is_none());
    }

    #[test]
    fn a_known_rest_of_a_path_changes_no_answer() {
        for count in [1_usize, 2, 5, 16, 33] {
            let (tree, other) = (tree(count), tree(count + 1));
            let paths: Vec<Vec<Hash>> = (0..count).map(|index| tree.path(index)).collect();
            let altered: Vec<Vec<Hash>> = paths.iter().flat_map(|path| damaged(path)).collect();
            let known = KnownPaths::default();
            for (index, path) in paths.iter().chain(&paths).enumerate().map(|(at, path)| (at % count, path)) {
                let (leaf, place) = (leaf(index as u64).hash(), (index as u64, count as u64));
                assert!(known.lead(leaf, place, path, tree.root()), "{index} of {count}");
                assert!(!known.lead(leaf, place, path, other.root()), "another root");
                assert!(!known.lead(other.root(), place, path, tree.root()), "another leaf");
                for path in &altered {
                    let alone = root_of(leaf, place.0, place.1, path) == Some(tree.root());
                    assert_eq!(known.lead(leaf, place, path, tree.root()), alone, "{index} of {count}: {path:?}");
                }
            }
        }
    }

    /// Each step altered, the last left out, and one too many.
    fn damaged(path: &[Hash]) -> Vec<Vec<Hash>> {
        let alter = |at: usize| {
            let mut path = path.to_vec();
            path[at].0[7] ^= 1;
            path
        };
        let ends = [path[..path.len().saturating_sub(1)].to_vec(), [path, &[Hash([0; 32])]].concat()];
        (0..path.len()).map(alter).chain(ends).collect()
    }

    #[test]
    fn the_longest_path_is_that_of_the_widest_tree() {
        let tree = tree(MOST_LEAVES);
        assert_eq!(tree.path(0).len(), LONGEST_PATH);
        let last = MOST_LEAVES as u64 - 1;
        assert_eq!(root_of(leaf(last).hash(), last, last + 1, &tree.path(MOST_LEAVES - 1)), Some(tree.root()));
    }

    #[test]
    fn a_leaf_binds_all_it_says() {
        let one = leaf(5);
        let others = [
            Leaf { owner: Address([9; 20]), ..one },
            Leaf { signer: SignerId([9; 32]), ..one },
            Leaf { recorder: RecorderId([9; 16]), ..one },
            Leaf { topic_id: TopicId([9; 16]), ..one },
            Leaf { seq: 9, ..one },
            Leaf { digest: Digest([9; 32]), ..one },
        ];
        for other in others {
            assert_ne!(other.hash(), one.hash());
        }
        assert_ne!(node(&one.hash(), &one.hash()), one.hash(), "leaves and nodes hash apart");
    }

    /// What an attacker may change in a proof.
    #[derive(Debug, Clone)]
    enum Change {
        Leaf(u8, Index),
        Sibling(Index, u8, Index),
        SwapSiblings(Index, Index),
        Index(u64),
        Count(u64),
        Truncate(Index),
        Extend(u8),
        Root(u8, Index),
    }

    fn change() -> impl Strategy<Value = Change> {
        prop_oneof![
            (1u8.., any::<Index>()).prop_map(|(bits, at)| Change::Leaf(bits, at)),
            (any::<Index>(), 1u8.., any::<Index>()).prop_map(|(which, bits, at)| Change::Sibling(which, bits, at)),
            (any::<Index>(), any::<Index>()).prop_map(|(one, other)| Change::SwapSiblings(one, other)),
            (0u64..40_000).prop_map(Change::Index),
            (0u64..40_000).prop_map(Change::Count),
            any::<Index>().prop_map(Change::Truncate),
            any::<u8>().prop_map(Change::Extend),
            (1u8.., any::<Index>()).prop_map(|(bits, at)| Change::Root(bits, at)),
        ]
    }

    fn apply(change: &Change, leaf: &mut Leaf, proof: &mut Inclusion) {
        match change {
            Change::Leaf(bits, at) => leaf.digest.0[at.index(32)] ^= bits,
            Change::Sibling(which, bits, at) if !proof.path.is_empty() => {
                let which = which.index(proof.path.len());
                proof.path[which].0[at.index(32)] ^= bits;
            }
            Change::SwapSiblings(one, other) if !proof.path.is_empty() => {
                let (one, other) = (one.index(proof.path.len()), other.index(proof.path.len()));
                proof.path.swap(one, other);
            }
            Change::Index(index) => proof.index = *index,
            Change::Count(count) => proof.count = *count,
            Change::Truncate(at) if !proof.path.is_empty() => proof.path.truncate(at.index(proof.path.len())),
            Change::Extend(byte) => proof.path.push(Hash([*byte; 32])),
            Change::Root(bits, at) => proof.root.0[at.index(32)] ^= bits,
            Change::Sibling(..) | Change::SwapSiblings(..) | Change::Truncate(_) => {}
        }
    }

    /// Whether leaf `index` has the same path shape (turns and length) in trees of both sizes: then the count alone
    /// changes nothing, and it is the chain that states the count.
    fn same_shape(index: u64, one: u64, other: u64) -> bool {
        let turns = |count: u64| {
            let (mut place, mut last, mut turns) = (index, count.wrapping_sub(1), Vec::new());
            while last > 0 && index < count {
                if place & 1 == 1 || place < last {
                    turns.push(place & 1 == 1);
                }
                (place, last) = (place >> 1, last >> 1);
            }
            turns
        };
        index < other && turns(one) == turns(other)
    }

    #[test]
    fn a_hundred_thousand_changed_proofs_are_refused() {
        let trees: Vec<(usize, Tree)> = [1, 2, 3, 7, 255, 256, 257, 1000, 4096].map(|n| (n, tree(n))).into();
        let mut runner = proptest::test_runner::TestRunner::deterministic();
        let strategy = (any::<Index>(), any::<Index>(), change());
        let mut refused = 0;
        while refused < 100_000 {
            let (which, at, change) = strategy.new_tree(&mut runner).expect("a case").current();
            let (count, tree) = &trees[which.index(trees.len())];
            let index = at.index(*count);
            let good_leaf = leaf(index as u64);
            let path = tree.path(index);
            let good = Inclusion { index: index as u64, count: *count as u64, path, root: tree.root() };
            assert!(good.proves(&good_leaf));
            let (mut leaf, mut proof) = (good_leaf, good.clone());
            apply(&change, &mut leaf, &mut proof);
            if (leaf, &proof) == (good_leaf, &good) {
                continue;
            }
            if proof.count != good.count && same_shape(good.index, good.count, proof.count) {
                assert!(proof.proves(&leaf), "the same path in a tree of another size");
                continue;
            }
            assert!(!proof.proves(&leaf), "{change:?} of leaf {index} of {count}");
            refused += 1;
        }
    }
}
