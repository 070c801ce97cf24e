//! Blocks from the file, checked when read: a header by its hash and by the block above it, transactions and receipts
//! by the header.

use std::cell::RefCell;
use std::rc::Rc;

use ethers::utils::rlp;

use super::block::{Header, Receipt, Rules};
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

/// The block whose transactions were read last: callers ask for one after another.
#[derive(Default)]
pub struct Looked(RefCell<Option<(u64, Rc<Vec<Done>>)>>);

/// A block's header, its transactions with their results, and the index of one of them.
pub type Place = (Header, Rc<Vec<Done>>, usize);

impl Looked {
    /// A block that was just written.
    pub fn at(number: u64, sent: Vec<Transaction>, receipts: Vec<Receipt>) -> Self {
        let done = sent.into_iter().zip(receipts).map(|(transaction, receipt)| Done { transaction, receipt });
        Self(RefCell::new(Some((number, Rc::new(done.collect())))))
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
        if let Some((_, done)) = self.looked.0.borrow().as_ref().filter(|(looked, _)| *looked == number) {
            return Ok(Rc::clone(done));
        }
        let mined = self.file.block_transactions(number)?;
        let done = mined.iter().map(|one| self.decoded(header, one)).collect::<Result<Vec<_>, _>>()?;
        let sent =
            done.iter().map(|Done { transaction, .. }| (transaction.hash, transaction.sender, &transaction.raw[..]));
        let receipts: Vec<Receipt> = done.iter().map(|done| done.receipt.clone()).collect();
        let same = transactions_root(header.rules(), sent)? == header.transactions_root
            && receipts_root(header.rules(), &receipts)? == header.receipts_root;
        if !same {
            return Err(self.file.tampered(number, "its transactions or receipts were changed"));
        }
        let done = Rc::new(done);
        *self.looked.0.borrow_mut() = Some((number, Rc::clone(&done)));
        Ok(done)
    }

    fn decoded(&self, header: &Header, mined: &Mined) -> Result<Done, ChainError> {
        let blame = |what: &str| self.file.tampered(header.number, what);
        // Only the rules before version 3 commit to the sender as well as the transaction; otherwise the signature
        // gives it.
        let sender = (header.rules() == Rules::Chained).then_some(mined.sender);
        let transaction = Transaction::decode(&mined.raw, self.chain_id, sender).map_err(|what| blame(&what))?;
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
