//! Records moved through their states, a batch at a time, by the pipeline's steps in the ledger: batched, submitted,
//! mined, confirmed, verified. Nothing is sent: the chain's answers are simulated.

use super::fill::OWNER;
use authros_chain::merkle::{Leaf, Tree};
use authros_model::{Address, Hash, RecordState};
use authros_service::Failure;
use authros_store::{Anchors, Ledger, NewBatch, NewTransaction, RootSighting, TransactionOutcome};

/// The anchoring account.
const ACCOUNT: Address = OWNER;
/// Bytes of a signed transaction that anchors a root.
const RAW: usize = 180;

/// The states of all records so far.
#[derive(Debug, Default)]
pub(crate) struct Life {
    /// Batches that were anchored, each in a block of its own.
    blocks: u64,
}

impl Life {
    /// Verifies all stored records, `most` in a batch.
    pub(crate) fn verify(&mut self, ledger: &Ledger, most: usize) -> Result<(), Failure> {
        loop {
            let leaves = ledger.stored_leaves(OWNER, most)?;
            let Some(tree) = Tree::new(Leaf::hashes(&leaves)) else { return Ok(()) };
            self.anchor(ledger, &leaves, &tree)?;
            if leaves.len() < most {
                return Ok(());
            }
        }
    }

    fn anchor(&mut self, ledger: &Ledger, leaves: &[Leaf], tree: &Tree) -> Result<(), Failure> {
        let (root, nonce) = (tree.root(), self.blocks);
        self.blocks += 1;
        let block = self.blocks;
        let (hash, block_hash) = (numbered(1, block), numbered(2, block));
        let digests: Vec<_> = leaves.iter().map(|leaf| leaf.digest).collect();
        let places = digests.iter().enumerate().map(|(index, digest)| (*digest, tree.path(index)));
        ledger.close_batch(NewBatch { owner: OWNER, root, leaves: places.collect() })?;
        ledger.submit(NewTransaction {
            hash,
            account: ACCOUNT,
            nonce,
            raw: vec![0; RAW],
            purpose: "anchor".to_owned(),
            anchors: Anchors::Batch(root),
        })?;
        let count = leaves.len() as u64;
        ledger.anchored(&[RootSighting { account: ACCOUNT, root, count, transaction: hash, block, block_hash }])?;
        ledger.close_transaction(hash, TransactionOutcome::Mined { block, block_hash, gas_used: None })?;
        ledger.confirm(block)?;
        ledger.advance(&digests, RecordState::Confirmed, RecordState::Verified)?;
        Ok(())
    }
}

fn numbered(kind: u8, number: u64) -> Hash {
    let mut hash = [kind; Hash::LENGTH];
    hash[..8].copy_from_slice(&number.to_be_bytes());
    Hash(hash)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::growth::fill;

    #[test]
    fn every_record_that_is_not_held_is_verified() {
        let directory = tempfile::tempdir().expect("a directory");
        let ledger = Ledger::open(&directory.path().join("ledger.db")).expect("a ledger");
        ledger.append((0..2_500).map(fill::record).collect()).expect("appended");
        let mut life = Life::default();
        life.verify(&ledger, 1_000).expect("verified");
        let counts = ledger.counts(Some(OWNER)).expect("counted");
        let (verified, held) = (counts.data_in(RecordState::Verified), counts.data_in(RecordState::Quarantined));
        assert_eq!((verified, held, counts.pending(), life.blocks), (2_497, 3, 0, 3));
        assert!(counts.is_conserved() && ledger.contradictions().expect("looked").is_empty());
        life.verify(&ledger, 1_000).expect("nothing left");
        assert_eq!(life.blocks, 3);
    }
}
