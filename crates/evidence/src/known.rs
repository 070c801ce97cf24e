//! Results computed once and used for many records, so that a stranger's file costs no more than its length.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;

use authros_model::{Address, Hash, Identity};

use crate::disclosure::MOST_PLAIN;
use crate::header::{BlockHeader, Seals, seals};
use crate::state::{Storage, Unproven};
use crate::verify::Check;

/// The results of one check so far.
pub(crate) struct Known<'a> {
    storages: RefCell<BTreeMap<u64, Result<Storage<'a>, Unproven>>>,
    seals: RefCell<BTreeMap<u64, Seals>>,
    identities: RefCell<BTreeMap<(Hash, Address), bool>>,
    /// How many bytes of messages may still be produced.
    pub plain_left: Cell<u64>,
}

impl Default for Known<'_> {
    fn default() -> Self {
        let (storages, seals, identities) = (RefCell::default(), RefCell::default(), RefCell::default());
        Self { storages, seals, identities, plain_left: Cell::new(MOST_PLAIN) }
    }
}

impl<'a> Known<'a> {
    /// The contract's storage after a block of the bundle.
    pub fn storage(&self, check: &Check<'a>, shown_at: &BlockHeader) -> Result<Storage<'a>, Unproven> {
        let find = || Storage::of(&check.bundle.nodes, shown_at.state_root, check.contract);
        *self.storages.borrow_mut().entry(shown_at.number).or_insert_with(find)
    }

    /// The seals on a block of the bundle, by these signers, who are the same at each call.
    pub fn seals(&self, check: &Check<'_>, shown_at: &BlockHeader, pinned: &[Address]) -> Seals {
        let find = || seals(&check.bundle.headers, shown_at.number, pinned);
        self.seals.borrow_mut().entry(shown_at.number).or_insert_with(find).clone()
    }

    /// Whether an identity of the bundle proves itself for this account.
    pub fn is_of(&self, check: &Check<'_>, (hash, identity): (Hash, &Identity), account: Address) -> bool {
        let prove = || authros_crypto::check_identity(check.provider, &check.domain, &account, identity).is_ok();
        *self.identities.borrow_mut().entry((hash, account)).or_insert_with(prove)
    }
}
