//! What a header commits to besides the state: its transactions and receipts, as Ethereum's tries.

use std::sync::Arc;

use ethers::types::Bloom;
use ethers::utils::rlp::{self, RlpStream};

use super::block::Receipt;
use super::trie::{Nodes, Trie};
use crate::chain::ChainError;
use crate::model::Hash;

/// A trie built only in memory.
struct Nowhere;

impl Nodes for Nowhere {
    fn node(&self, hash: Hash) -> Result<Arc<[u8]>, ChainError> {
        Err(self.malformed(hash))
    }

    fn malformed(&self, hash: Hash) -> ChainError {
        ChainError::Internal(format!("node {hash} of a list was asked for"))
    }
}

/// Root of the trie of a list: RLP of the index to the item (Yellow Paper, 4.3.2).
fn list_root(items: impl IntoIterator<Item = Vec<u8>>) -> Result<Hash, ChainError> {
    let mut trie = Trie::new(&Nowhere, super::trie::EMPTY_ROOT);
    for (place, item) in (0u64..).zip(items) {
        trie.set(&rlp::encode(&place), Some(item))?;
    }
    Ok(trie.finish().0)
}

/// Root of the trie of transactions, given as their raw bytes.
///
/// # Errors
/// Only for a fault of this program.
pub fn transactions_root<'a>(sent: impl IntoIterator<Item = &'a [u8]>) -> Result<Hash, ChainError> {
    list_root(sent.into_iter().map(<[u8]>::to_vec))
}

/// Root of the trie of receipts.
///
/// # Errors
/// Only for a fault of this program.
pub fn receipts_root(receipts: &[Receipt]) -> Result<Hash, ChainError> {
    list_root(receipts.iter().map(ethereums))
}

/// A receipt as Ethereum commits to it since Byzantium (EIP-658): status, gas so far, bloom, logs.
fn ethereums(receipt: &Receipt) -> Vec<u8> {
    let mut bloom = Bloom::zero();
    receipt.accrue(&mut bloom);
    let mut list = RlpStream::new_list(4);
    list.append(&receipt.success).append(&receipt.cumulative_gas).append(&bloom).append_list(&receipt.logs);
    list.out().to_vec()
}
