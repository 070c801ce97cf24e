//! The steps of sender and watcher.

use super::*;

impl Pair {
    pub(super) fn take_chain(&mut self, step: Step) {
        match step {
            Step::Submit(picked) => {
                let digests = self.model.digests(&self.model.pick(&picked));
                let new = self.model.new_transaction(None, Anchors::Digests(digests));
                let kept = self.ledger().lanes.submit(new.clone());
                assert_eq!(kept.is_ok(), self.model.submit(&new), "{kept:?}");
            }
            Step::Close { picked, how, block } if !self.model.sent.is_empty() => {
                let index = picked.index(self.model.sent.len());
                let hash = self.model.sent[index].new.hash;
                let (outcome, state, block) = match how {
                    0 => (
                        TransactionOutcome::Mined { block, block_hash: hash, gas_used: Some(1) },
                        TransactionState::Mined,
                        Some(block),
                    ),
                    1 => (TransactionOutcome::Replaced, TransactionState::Replaced, None),
                    _ => {
                        let reason = "no".to_owned();
                        (TransactionOutcome::Reverted { reason }, TransactionState::Reverted, None)
                    }
                };
                assert_eq!(self.ledger().lanes.close_transactions(vec![(hash, outcome)]), Ok(()));
                self.model.close(index, state, block);
            }
            Step::CloseBatch(picked) => self.close_batch(&picked),
            Step::SubmitBatch(picked) if !self.model.batches.is_empty() => {
                let root = picked.get(&self.model.batches).root;
                let new = self.model.new_transaction(None, Anchors::Batch(root));
                let kept = self.ledger().lanes.submit(new.clone());
                assert_eq!(kept.is_ok(), self.model.submit(&new), "{kept:?}");
            }
            Step::SeeBatch { picked, own, block } if !self.model.batches.is_empty() => {
                self.see_batch(picked.index(self.model.batches.len()), own, block);
            }
            // One block has a record's own upload and its batch's anchor.
            Step::SeeBoth { picked, own, block } if !self.model.batches.is_empty() => {
                let index = picked.index(self.model.batches.len());
                let alone = self.sighting(self.model.batches[index].members[0], false, block);
                let changed = self.model.see(&alone);
                assert_eq!(self.ledger().batches.mined(&[alone]), Ok(changed));
                self.see_batch(index, own, block);
            }
            Step::Replace { picked, kept } if !self.model.sent.is_empty() => self.replace(&picked, kept),
            Step::See { picked, own, block } => {
                let seen: Vec<Sighting> =
                    self.model.pick(&picked).iter().map(|i| self.sighting(*i, own, block)).collect();
                let changed = seen.iter().map(|sighting| self.model.see(sighting)).sum();
                assert_eq!(self.ledger().batches.mined(&seen), Ok(changed));
            }
            Step::Confirm(block) => {
                let ready = |known: &&mut Known| known.state == Mined && known.block.is_some_and(|at| at <= block);
                let mut confirmed = 0;
                for known in self.model.records.iter_mut().filter(ready) {
                    known.state = Confirmed;
                    confirmed += 1;
                }
                assert_eq!(self.ledger().batches.confirm(block).map(|times| times.len()), Ok(confirmed));
            }
            Step::TakeBack(block) => {
                let verified = self.model.take_back(block, &[Verified]);
                let moved = verified + self.model.take_back(block, &[Mined, Confirmed]);
                assert_eq!(self.ledger().batches.take_back(block), Ok((moved, verified)));
            }
            _ => {}
        }
    }

    fn sighting(&self, index: usize, own: bool, block: u64) -> Sighting {
        let known = &self.model.records[index];
        let foreign = Hash([250; 32]);
        let transaction = if own { known.transaction.unwrap_or(foreign) } else { foreign };
        Sighting { transaction, ..sighting(&known.new, block) }
    }

    fn replace(&mut self, picked: &Index, kept: usize) {
        let index = picked.index(self.model.sent.len());
        let old = self.model.sent[index].clone();
        let anchors = match &old.new.anchors {
            Anchors::Digests(digests) => Anchors::Digests(digests.iter().take(kept).copied().collect()),
            _ if kept == 0 => Anchors::Nothing,
            other => other.clone(),
        };
        let new = self.model.new_transaction(Some(old.new.nonce), anchors);
        let answer = self.ledger().lanes.replace_transaction(old.new.hash, new.clone());
        let before = (self.model.records.clone(), self.model.sent.clone(), self.model.batches.clone());
        let possible = old.state == TransactionState::Open && {
            self.model.close(index, TransactionState::Replaced, None);
            self.model.submit(&new)
        };
        if !possible {
            (self.model.records, self.model.sent, self.model.batches) = before;
        }
        assert_eq!(answer.is_ok(), possible, "{answer:?}");
    }
}
