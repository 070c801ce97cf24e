//! The model's batches, and their steps.

use super::*;
use crate::crypto::merkle::{Leaf, Tree};

#[derive(Debug, Clone)]
pub(super) struct Batch {
    pub root: Hash,
    pub members: Vec<usize>,
    pub transaction: Option<Hash>,
    pub block: Option<u64>,
}

fn leaf(new: &NewRecord) -> Leaf {
    let recorder = crate::model::RecorderId([0; 16]);
    Leaf { owner: new.owner, signer: new.signer, recorder, topic_id: new.topic_id, seq: new.seq, digest: new.digest }
}

impl Model {
    pub(super) fn submit_batch(&mut self, root: Hash, transaction: Hash) -> bool {
        let batch = self.batches.iter_mut().find(|batch| batch.root == root).expect("known");
        if batch.transaction.is_some() {
            return false;
        }
        batch.transaction = Some(transaction);
        for index in batch.members.clone() {
            let known = &mut self.records[index];
            if known.block.is_none() {
                known.transaction = Some(transaction);
                known.state = if known.state == Batched { Submitted } else { known.state };
            }
        }
        true
    }

    pub(super) fn release_batch(&mut self, root: Hash, transaction: Option<Hash>) {
        let batch = self.batches.iter_mut().find(|batch| batch.root == root).expect("known");
        if batch.transaction != transaction || batch.block.is_some() {
            return;
        }
        batch.transaction = None;
        for index in batch.members.clone() {
            let known = &mut self.records[index];
            if known.block.is_none() && known.transaction == transaction {
                known.transaction = None;
                known.state = if known.state == Submitted { Batched } else { known.state };
            }
        }
    }
}

impl Pair {
    pub(super) fn close_batch(&mut self, picked: &[Index]) {
        let picked = self.model.pick(picked);
        let tree = Tree::new(picked.iter().map(|i| leaf(&self.model.records[*i].new).hash()).collect()).expect("small");
        let digests = self.model.digests(&picked);
        let leaves = digests.into_iter().enumerate().map(|(place, digest)| (digest, tree.path(place))).collect();
        let root = tree.root();
        let owner = self.model.records[picked[0]].new.owner;
        let answer = self.ledger().batches.close(NewBatch { owner, root, leaves });
        if self.model.batches.iter().any(|batch| batch.root == root) {
            return assert_eq!(answer, Ok(()), "closing it again changes nothing");
        }
        let ready = picked.iter().all(|index| self.model.records[*index].state == Stored);
        assert_eq!(answer.is_ok(), ready, "{answer:?}");
        if ready {
            for index in &picked {
                let known = &mut self.model.records[*index];
                (known.state, known.batch) = (Batched, Some(self.model.batches.len()));
            }
            self.model.batches.push(Batch { root, members: picked, transaction: None, block: None });
        }
    }

    pub(super) fn see_batch(&mut self, index: usize, own: bool, block: u64) {
        let foreign = Hash([251; 32]);
        let block_hash = sighting(&self.model.records[0].new, block).block_hash;
        let batch = &mut self.model.batches[index];
        let transaction = if own { batch.transaction.unwrap_or(foreign) } else { foreign };
        let seen = RootSighting {
            account: Address([1; 20]),
            root: batch.root,
            count: batch.members.len() as u64,
            transaction,
            block,
            block_hash,
        };
        let mut changed = 0;
        if batch.block.is_none() {
            (batch.transaction, batch.block) = (Some(transaction), Some(block));
            for index in batch.members.clone() {
                let known = &mut self.model.records[index];
                // A record uploaded alone in the very block rests on its batch.
                if known.block.is_none_or(|own| own == block) {
                    (known.transaction, known.block) = (Some(transaction), Some(block));
                    known.state = if matches!(known.state, Batched | Submitted) { Mined } else { known.state };
                    changed += 1;
                }
            }
            self.model.place(transaction);
        }
        let of_another_size = RootSighting { count: seen.count + 1, ..seen };
        let ledger = self.ledger();
        assert_eq!(ledger.batches.anchored(&[of_another_size]), Ok(0), "the chain's count is another");
        assert_eq!(ledger.batches.anchored(&[seen]), Ok(changed));
        assert_eq!(ledger.batches.anchored(&[seen]), Ok(0), "seen again");
    }

    pub(super) fn compare_batches(&self) {
        for (number, batch) in self.model.batches.iter().enumerate() {
            for (place, index) in batch.members.iter().enumerate() {
                let known = &self.model.records[*index];
                assert_eq!(known.batch, Some(number));
                let found = self
                    .ledger()
                    .records
                    .placed(known.new.digest)
                    .expect("read")
                    .and_then(|placed| placed.place)
                    .expect("in a batch");
                assert_eq!((found.inclusion.root, found.block), (batch.root, batch.block));
                assert_eq!(found.inclusion.index, place as u64);
                assert!(found.inclusion.proves(&leaf(&known.new)), "its path leads to the root");
            }
        }
        let waiting = |owner: u8| {
            let of = |batch: &&Batch| {
                batch.transaction.is_none() && self.model.records[batch.members[0]].new.owner.0[0] == owner
            };
            self.model.batches.iter().filter(of).map(|batch| batch.root).collect::<Vec<_>>()
        };
        for owner in 1..3 {
            let address = Address([owner; 20]);
            let found = self.ledger().batches.waiting(address, 100).expect("read");
            assert_eq!(found.iter().map(|batch| batch.root).collect::<Vec<_>>(), waiting(owner));
            let stored = |known: &&Known| known.new.owner == address && known.state == Stored;
            let stored = self.model.records.iter().filter(stored).count() as u64;
            assert_eq!(self.ledger().batches.unbatched(address).expect("read").0, stored);
        }
    }
}
