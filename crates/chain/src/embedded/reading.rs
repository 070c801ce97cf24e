//! Blocks from the file, checked when read: a header by its hash and by the block above it, transactions and receipts
//! by the header.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;

use ethers::utils::rlp;

use super::block::{Header, Receipt};
use super::file::Mined;
use super::node::Node;
use super::replay::header;
use super::roots::{receipts_root, transactions_root};
use super::transaction::Transaction;
use crate::chain::ChainError;
use crate::model::Hash;

/// A mined transaction, with its receipt.
pub struct Done {
    /// The transaction.
    pub transaction: Transaction,
    /// Its result.
    pub receipt: Receipt,
}

/// The most blocks that are remembered, and the most bytes of transactions in them, each with so many beside its own.
const MOST_BLOCKS: usize = 32;
const MOST_BYTES: usize = 2 * 1024 * 1024;
const BESIDE: usize = 1024;

/// The blocks whose transactions were read or written last: callers ask for one after another, and several callers for the
/// same ones. Their senders need not be recovered again.
#[derive(Default)]
pub struct Looked(RefCell<VecDeque<Block>>);

/// A block's number and its transactions.
type Block = (u64, Rc<Vec<Done>>);

/// A block's header, its transactions with their results, and the index of one of them.
pub type Place = (Header, Rc<Vec<Done>>, usize);

impl Looked {
    /// Remembers a block that was just written.
    pub fn wrote(&self, number: u64, sent: Vec<Transaction>, receipts: Vec<Receipt>) {
        let done = sent.into_iter().zip(receipts).map(|(transaction, receipt)| Done { transaction, receipt });
        self.remember(number, Rc::new(done.collect()));
    }

    fn find(&self, number: u64) -> Option<Rc<Vec<Done>>> {
        self.0.borrow().iter().find(|(known, _)| *known == number).map(|(_, done)| Rc::clone(done))
    }

    /// The ones remembered for longest make room; one block is remembered however long it is.
    fn remember(&self, number: u64, done: Rc<Vec<Done>>) {
        let mut blocks = self.0.borrow_mut();
        blocks.retain(|(known, _)| *known != number);
        blocks.push_back((number, done));
        let sum = |blocks: &VecDeque<Block>| {
            let all = blocks.iter().flat_map(|(_, done)| done.iter());
            all.map(|done| done.transaction.raw.len() + BESIDE).sum::<usize>()
        };
        while blocks.len() > MOST_BLOCKS || blocks.len() > 1 && sum(&blocks) > MOST_BYTES {
            blocks.pop_front();
        }
    }
}

impl Node {
    /// A block's header; `None` above the newest.
    ///
    /// # Errors
    /// [`ChainError::Tampered`] if it was altered.
    pub fn header(&self, number: u64) -> Result<Option<Header>, ChainError> {
        if number > self.head.number {
            return Ok(None);
        }
        let found = header(&self.file, number)?;
        if number < self.head.number {
            let above = self.file.block(number + 1)?.and_then(|(_, bytes)| rlp::Rlp::new(&bytes).val_at(0).ok());
            if above != Some(found.hash().0.to_vec()) {
                return Err(self.file.tampered(number, "it is not the parent that the next block names"));
            }
        } else if found.hash() != self.head.hash {
            return Err(self.file.tampered(number, "its hash was changed"));
        }
        Ok(Some(found))
    }

    /// A block's transactions with their receipts, in order.
    ///
    /// # Errors
    /// [`ChainError::Tampered`] if they differ from what the header commits to.
    pub fn done(&self, header: &Header) -> Result<Rc<Vec<Done>>, ChainError> {
        let number = header.number;
        if let Some(done) = self.looked.find(number) {
            return Ok(done);
        }
        let mined = self.file.block_transactions(number)?;
        let done = mined.iter().map(|one| self.decoded(header, one)).collect::<Result<Vec<_>, _>>()?;
        let sent = done.iter().map(|done| &done.transaction.raw[..]);
        let receipts: Vec<Receipt> = done.iter().map(|done| done.receipt.clone()).collect();
        let same =
            transactions_root(sent)? == header.transactions_root && receipts_root(&receipts)? == header.receipts_root;
        if !same {
            return Err(self.file.tampered(number, "its transactions or receipts were changed"));
        }
        let done = Rc::new(done);
        self.looked.remember(number, Rc::clone(&done));
        Ok(done)
    }

    fn decoded(&self, header: &Header, mined: &Mined) -> Result<Done, ChainError> {
        let blame = |what: &str| self.file.tampered(header.number, what);
        let transaction = Transaction::decode(&mined.raw, self.chain_id).map_err(|what| blame(&what))?;
        let receipt = rlp::decode(&mined.receipt).map_err(|_| blame("a receipt is malformed"))?;
        Ok(Done { transaction, receipt })
    }

    /// Where a transaction was mined: the block's header and the index in it.
    ///
    /// # Errors
    /// [`ChainError::Tampered`] if the block was altered, or does not hold it.
    pub fn mined(&self, hash: Hash) -> Result<Option<Place>, ChainError> {
        let Some((number, position)) = self.file.place_of(hash)? else { return Ok(None) };
        let gone = || self.file.tampered(number, "a transaction was moved");
        let header = self.header(number)?.ok_or_else(gone)?;
        let done = self.done(&header)?;
        let place = usize::try_from(position).map_err(|_| gone())?;
        if done.get(place).is_none_or(|done| done.transaction.hash != hash) {
            return Err(gone());
        }
        Ok(Some((header, done, place)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_blocks_are_remembered_and_not_more() {
        let looked = Looked::default();
        for number in 1..=100 {
            looked.wrote(number, Vec::new(), Vec::new());
        }
        let remembered: Vec<u64> = (1..=100).filter(|number| looked.find(*number).is_some()).collect();
        assert_eq!(remembered, (100 - MOST_BLOCKS as u64 + 1..=100).collect::<Vec<_>>());
        let first = looked.find(70).expect("remembered");
        looked.remember(70, Rc::clone(&first));
        looked.wrote(101, Vec::new(), Vec::new());
        assert!(looked.find(69).is_none() && looked.find(70).is_some(), "the one that was read last stays");
    }
}
