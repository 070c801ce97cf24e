//! What a header commits to besides the state: its transactions and receipts. By the rules of version 3 these are
//! Ethereum's tries; before, plain commitments: transactions = Keccak-256 of the RLP list of \[hash, sender\], receipts
//! = of the RLP list of receipts, state = of the parent's state root and every account and slot that the block changed.

use std::collections::BTreeMap;
use std::sync::Arc;

use ethers::types::Bloom;
use ethers::utils::keccak256;
use ethers::utils::rlp::{self, RlpStream};
use revm::primitives::{Address as EvmAddress, B256, U256 as Word};
use revm::state::EvmState;

use super::block::{Receipt, Rules};
use super::trie::{Nodes, Trie};
use crate::chain::ChainError;
use crate::model::{Address, Hash};

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

/// Commitment to transactions: each one's hash, sender and bytes.
///
/// # Errors
/// Only for a fault of this program.
pub fn transactions_root<'a>(
    rules: Rules,
    sent: impl IntoIterator<Item = (Hash, Address, &'a [u8])>,
) -> Result<Hash, ChainError> {
    match rules {
        Rules::Tries => list_root(sent.into_iter().map(|(_, _, raw)| raw.to_vec())),
        Rules::Chained => {
            let mut list = RlpStream::new();
            list.begin_unbounded_list();
            for (hash, sender, _) in sent {
                list.begin_list(2).append(&&hash.0[..]).append(&&sender.0[..]);
            }
            list.finalize_unbounded_list();
            Ok(Hash(keccak256(list.out())))
        }
    }
}

/// Commitment to receipts.
///
/// # Errors
/// Only for a fault of this program.
pub fn receipts_root(rules: Rules, receipts: &[Receipt]) -> Result<Hash, ChainError> {
    match rules {
        Rules::Tries => list_root(receipts.iter().map(ethereums)),
        Rules::Chained => {
            let mut list = RlpStream::new();
            list.append_list(receipts);
            Ok(Hash(keccak256(list.out())))
        }
    }
}

/// A receipt as Ethereum commits to it since Byzantium (EIP-658): status, gas so far, bloom, logs.
fn ethereums(receipt: &Receipt) -> Vec<u8> {
    let mut bloom = Bloom::zero();
    receipt.accrue(&mut bloom);
    let mut list = RlpStream::new_list(4);
    list.append(&receipt.success).append(&receipt.cumulative_gas).append(&bloom).append_list(&receipt.logs);
    list.out().to_vec()
}

type Changed = BTreeMap<EvmAddress, (Word, u64, B256, BTreeMap<Word, Word>)>;

/// Keccak-256 over the parent's commitment and the block's changes, sorted by address and slot: the state root of the
/// rules before version 3.
pub fn chained_state(parent: Hash, changes: &[EvmState]) -> Hash {
    let mut all = Changed::new();
    for (address, account) in changes.iter().flatten().filter(|(_, account)| account.is_touched()) {
        let entry = all.entry(*address).or_default();
        entry.0 = account.info.balance;
        entry.1 = account.info.nonce;
        entry.2 = account.info.code_hash;
        entry.3.extend(account.changed_storage_slots().map(|(slot, value)| (*slot, value.present_value())));
    }
    let mut list = RlpStream::new_list(all.len() + 1);
    list.append(&&parent.0[..]);
    for (address, (balance, nonce, code, slots)) in &all {
        list.begin_list(4 + 2 * slots.len()).append(&&address[..]).append(&&balance.to_be_bytes::<32>()[..]);
        list.append(nonce).append(&&code[..]);
        for (slot, value) in slots {
            list.append(&&slot.to_be_bytes::<32>()[..]).append(&&value.to_be_bytes::<32>()[..]);
        }
    }
    Hash(keccak256(list.out()))
}
