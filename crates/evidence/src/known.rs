//! Results computed once and used for many records, by all threads of a check, so that a stranger's file costs no more
//! than its length.

use std::collections::BTreeMap;
use std::sync::{PoisonError, RwLock};

use authros_model::{Address, Hash, Identity};

use crate::header::{BlockHeader, Seals, seals};
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
}

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
}
