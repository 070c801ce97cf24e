//! Results computed once and used for many records, by all threads of a check, so that a stranger's file costs no more
//! than its length.

use std::collections::{BTreeMap, HashMap};
use std::sync::{PoisonError, RwLock};

use authros_crypto::merkle::{Climber, LONGEST_PATH, Leaf};
use authros_model::{Address, Hash, Identity, SignerId};

use crate::anchoring::Anchored;
use crate::bundle::{AnchorClaim, Anchoring};
use crate::header::{BlockHeader, Seals, seals};
use crate::report::Level;
use crate::signing::Signed;
use crate::state::{AnchorWord, KeysWord, Storage, Unproven};
use crate::verify::Check;

/// Results by what was asked. Two threads that ask the same at once both compute it, and get the same.
struct Memo<Asked, Found>(RwLock<BTreeMap<Asked, Found>>);

impl<Asked, Found> Default for Memo<Asked, Found> {
    fn default() -> Self {
        Self(RwLock::default())
    }
}

impl<Asked: Ord, Found: Clone> Memo<Asked, Found> {
    /// No lock is held while `find` works.
    fn get(&self, asked: Asked, find: impl FnOnce() -> Found) -> Found {
        let known = self.0.read().unwrap_or_else(PoisonError::into_inner).get(&asked).cloned();
        known.unwrap_or_else(|| {
            let found = find();
            self.0.write().unwrap_or_else(PoisonError::into_inner).entry(asked).or_insert(found).clone()
        })
    }
}

/// The results of one check so far. Blocks are those after which the state is asked.
#[derive(Default)]
pub(crate) struct Known<'a> {
    storages: Memo<u64, Result<Storage<'a>, Unproven>>,
    seals: Memo<u64, Seals>,
    identities: Memo<(Hash, Address), bool>,
    anchors: Memo<(u64, Address, Hash), Result<Option<AnchorWord>, Unproven>>,
    keys: Memo<(u64, Address, u64), Result<Option<KeysWord>, Unproven>>,
    suspensions: Memo<(u64, Address), Result<bool, Unproven>>,
    rights: Memo<(Address, SignerId, Place), Signed>,
    sealings: Memo<(u64, u64, Option<u64>), Level>,
    paths: RwLock<HashMap<(Hash, Climber), &'a [Hash]>>,
}

/// What there is to know of an anchor.
type Place = (u64, u64, Option<u64>, Address, Option<u64>, u64);

impl<'a> Known<'a> {
    /// The contract's storage after a block of the bundle.
    pub fn storage(&self, check: &Check<'a>, shown_at: &BlockHeader) -> Result<Storage<'a>, Unproven> {
        self.storages.get(shown_at.number, || Storage::of(&check.bundle.nodes, shown_at.state_root, check.contract))
    }

    /// The seals on a block of the bundle, by these signers, who are the same at each call.
    pub fn seals(&self, check: &Check<'_>, shown_at: &BlockHeader, pinned: &[Address]) -> Seals {
        self.seals.get(shown_at.number, || seals(&check.bundle.headers, shown_at.number, pinned))
    }

    /// Whether an identity of the bundle proves itself for this account.
    pub fn is_of(&self, check: &Check<'_>, (hash, identity): (Hash, &Identity), account: Address) -> bool {
        let prove = || authros_crypto::check_identity(check.provider, &check.domain, &account, identity).is_ok();
        self.identities.get((hash, account), prove)
    }

    /// When an account first anchored a root, by the storage after a block.
    pub fn anchor(
        &self,
        (shown_at, storage): (u64, &Storage<'_>),
        account: Address,
        root: Hash,
    ) -> Result<Option<AnchorWord>, Unproven> {
        self.anchors.get((shown_at, account, root), || storage.anchor(account, root))
    }

    /// A version of an account's keys, by the storage after a block.
    pub fn keys(
        &self,
        (shown_at, storage): (u64, &Storage<'_>),
        account: Address,
        version: u64,
    ) -> Result<Option<KeysWord>, Unproven> {
        self.keys.get((shown_at, account, version), || storage.keys(account, version))
    }

    /// Whether an account is suspended, by the storage after a block.
    pub fn is_suspended(&self, (shown_at, storage): (u64, &Storage<'_>), account: Address) -> Result<bool, Unproven> {
        self.suspensions.get((shown_at, account), || storage.is_suspended(account))
    }

    /// Level (b) of the records that an owner's key signed and that were anchored alike.
    pub fn right(
        &self,
        owner: Address,
        signer: SignerId,
        anchored: &Anchored<'_>,
        judge: impl FnOnce() -> Signed,
    ) -> Signed {
        let Anchored { shown_at, block, time, account, keys, claimed_keys, .. } = *anchored;
        self.rights.get((owner, signer, (shown_at, block, time, account, keys, claimed_keys)), judge)
    }

    /// Level (c) of the records that were anchored alike.
    pub fn sealing(&self, anchored: &Anchored<'_>, judge: impl FnOnce() -> Level) -> Level {
        self.sealings.get((anchored.shown_at, anchored.block, anchored.time), judge)
    }

    /// Whether a claim's path leads from this leaf to the root it names; a claim without a path has nothing to show. Paths
    /// of one batch meet: from there on, one that is the same as a path that led to the root is not hashed again.
    pub fn leads(&self, leaf: &Leaf, claim: &'a AnchorClaim) -> bool {
        let Anchoring::Batch { root, index, count, path, .. } = &claim.anchor else { return true };
        let Some(mut climber) = Climber::at(leaf.hash(), *index, *count).filter(|_| path.len() <= LONGEST_PATH) else {
            return false;
        };
        let (mut rest, mut passed) = (path.as_slice(), Vec::with_capacity(path.len()));
        while let Some((sibling, above)) = rest.split_first() {
            if !climber.pass(sibling) {
                return false;
            }
            rest = above;
            let known = self.paths.read().unwrap_or_else(PoisonError::into_inner);
            if known.get(&(*root, climber)).is_some_and(|known| *known == rest) {
                break;
            }
            drop(known);
            passed.push((climber, rest));
        }
        // Left early: the rest is known to lead there.
        let leads = passed.len() < path.len() || climber.root() == Some(*root);
        if leads {
            let mut known = self.paths.write().unwrap_or_else(PoisonError::into_inner);
            known.extend(passed.into_iter().map(|(climber, rest)| ((*root, climber), rest)));
        }
        leads
    }
}

#[cfg(test)]
mod tests {
    use authros_crypto::merkle::Tree;
    use authros_model::{Digest, RecorderId, SignerId, TopicId};
    use proptest::prelude::*;

    use super::*;

    fn leaf(seq: u64) -> Leaf {
        let digest = Digest([u8::try_from(seq % 251).expect("small"); 32]);
        let (owner, signer) = (Address([1; 20]), SignerId([4; 32]));
        Leaf { owner, signer, recorder: RecorderId([2; 16]), topic_id: TopicId([3; 16]), seq, digest }
    }

    /// A claim of leaf `seq`, altered in one of eight ways or not at all.
    fn claim(tree: &Tree, leaves: u64, (seq, how, at): (u64, u8, usize)) -> AnchorClaim {
        let (mut root, mut index, mut count) = (tree.root(), seq, leaves);
        let mut path = tree.path(usize::try_from(seq).expect("small"));
        let place = at.checked_rem(path.len());
        match (how, place) {
            (0, _) => index = at as u64 % (leaves + 2),
            (1, _) => count = at as u64 % (leaves + 9),
            (2, _) => root.0[at % 32] ^= 1,
            (3, Some(place)) => path[place].0[at % 32] ^= 1,
            (4, Some(place)) => drop(path.remove(place)),
            (5, Some(place)) => path.insert(place, tree.root()),
            (6, _) => path.push(tree.root()),
            (7, Some(place)) => path.swap(place, 0),
            _ => {}
        }
        AnchorClaim::new(1, 1, 1, Anchoring::Batch { account: Address([1; 20]), root, index, count, path })
    }

    proptest! {
        #[test]
        fn a_path_that_meets_others_is_judged_as_it_is_by_itself(
            leaves in 1_u64..70,
            asked in proptest::collection::vec((any::<u64>(), 0_u8..24, any::<usize>()), 1..80),
        ) {
            let tree = Tree::new((0..leaves).map(|seq| leaf(seq).hash()).collect()).expect("within bounds");
            let asked: Vec<_> = asked.into_iter().map(|(seq, how, at)| (seq % leaves, how, at)).collect();
            let claims: Vec<AnchorClaim> = asked.iter().map(|asked| claim(&tree, leaves, *asked)).collect();
            let known = Known::default();
            for ((seq, how, _), claim) in asked.iter().zip(&claims) {
                let alone = claim.inclusion().expect("a batch").proves(&leaf(*seq));
                prop_assert_eq!(known.leads(&leaf(*seq), claim), alone, "way {}", how);
                prop_assert!(alone || *how < 8, "unaltered");
            }
        }
    }
}
