//! Transactions that wait for a block: bounded, in nonce order per sender, in order of arrival between senders.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap, HashMap, HashSet};

use super::transaction::Transaction;
use crate::model::{Address, Hash};

/// The most transactions that wait.
const MOST: usize = 65_536;
/// The most bytes that wait.
const MOST_BYTES: usize = 64 * 1024 * 1024;
/// How far ahead of the next nonce a transaction may wait.
const FARTHEST: u64 = 16_384;

struct Waiting {
    arrival: u64,
    transaction: Transaction,
}

/// The pool.
#[derive(Default)]
pub struct Pool {
    senders: HashMap<Address, BTreeMap<u64, Waiting>>,
    hashes: HashSet<Hash>,
    bytes: usize,
    arrivals: u64,
}

impl Pool {
    /// Takes a transaction whose sender's next nonce on chain is `next`.
    ///
    /// # Errors
    /// Why it is refused, in geth's words.
    pub fn add(&mut self, transaction: Transaction, next: u64) -> Result<(), String> {
        if self.hashes.contains(&transaction.hash) {
            return Err("already known".into());
        }
        let nonce = transaction.nonce;
        if nonce < next {
            return Err(format!("nonce too low: next nonce {next}, tx nonce {nonce}"));
        }
        let full = self.hashes.len() >= MOST || self.bytes + transaction.raw.len() > MOST_BYTES;
        if full || nonce - next > FARTHEST {
            return Err("txpool is full".into());
        }
        let old = self.senders.get(&transaction.sender).and_then(|lane| lane.get(&nonce));
        if old.is_some_and(|old| transaction.gas_price <= old.transaction.gas_price + old.transaction.gas_price / 10) {
            return Err("replacement transaction underpriced".into());
        }
        self.remove(transaction.sender, nonce);
        self.insert(transaction);
        Ok(())
    }

    fn insert(&mut self, transaction: Transaction) {
        self.arrivals += 1;
        self.hashes.insert(transaction.hash);
        self.bytes += transaction.raw.len();
        let lane = self.senders.entry(transaction.sender).or_default();
        lane.insert(transaction.nonce, Waiting { arrival: self.arrivals, transaction });
    }

    fn remove(&mut self, sender: Address, nonce: u64) {
        let Some(lane) = self.senders.get_mut(&sender) else { return };
        if let Some(old) = lane.remove(&nonce) {
            self.hashes.remove(&old.transaction.hash);
            self.bytes -= old.transaction.raw.len();
        }
        if lane.is_empty() {
            self.senders.remove(&sender);
        }
    }

    /// Takes transactions out that were mined or can never be.
    pub fn forget<'a>(&mut self, transactions: impl IntoIterator<Item = &'a Transaction>) {
        for transaction in transactions {
            self.remove(transaction.sender, transaction.nonce);
        }
    }

    /// Copies of up to `most` transactions that can go into the next block, whose gas limits
    /// sum up to no more than `gas`; `next` gives a sender's next nonce on chain.
    pub fn ready(&self, most: usize, gas: u64, next: impl Fn(Address) -> u64) -> Vec<Transaction> {
        let mut heads: BinaryHeap<Reverse<(u64, Address, u64)>> = BinaryHeap::new();
        let waiting = |sender: &Address, nonce: u64| self.senders.get(sender).and_then(|lane| lane.get(&nonce));
        for sender in self.senders.keys() {
            let nonce = next(*sender);
            heads.extend(waiting(sender, nonce).map(|head| Reverse((head.arrival, *sender, nonce))));
        }
        let (mut chosen, mut left) = (Vec::new(), gas);
        while let Some(Reverse((_, sender, nonce))) = heads.pop() {
            let Some(head) = waiting(&sender, nonce) else { continue };
            if chosen.len() == most || head.transaction.gas_limit > left {
                break;
            }
            left -= head.transaction.gas_limit;
            chosen.push(head.transaction.clone());
            heads.extend(waiting(&sender, nonce + 1).map(|head| Reverse((head.arrival, sender, nonce + 1))));
        }
        chosen
    }

    /// The nonce after the last one that waits without a gap from `next` on.
    pub fn next_nonce(&self, sender: Address, next: u64) -> u64 {
        let Some(lane) = self.senders.get(&sender) else { return next };
        lane.range(next..)
            .map(|(nonce, _)| *nonce)
            .fold(next, |free, nonce| if nonce == free { free + 1 } else { free })
    }

    /// A transaction that waits.
    pub fn get(&self, hash: Hash) -> Option<&Transaction> {
        if !self.hashes.contains(&hash) {
            return None;
        }
        let mut all = self.senders.values().flat_map(BTreeMap::values);
        all.find(|waiting| waiting.transaction.hash == hash).map(|waiting| &waiting.transaction)
    }

    /// Whether any sender's next transaction waits.
    pub fn is_ready(&self, next: impl Fn(Address) -> u64) -> bool {
        self.senders.iter().any(|(sender, lane)| lane.contains_key(&next(*sender)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ethers::types::U256;

    fn transaction(sender: u8, nonce: u64, gas_price: u128) -> Transaction {
        let mut hash = [sender; 32];
        hash[..8].copy_from_slice(&nonce.to_be_bytes());
        hash[8..24].copy_from_slice(&gas_price.to_be_bytes());
        Transaction {
            hash: Hash(hash),
            sender: Address([sender; 20]),
            nonce,
            gas_price,
            gas_limit: 100,
            to: None,
            value: U256::zero(),
            input: Vec::new(),
            v: 0,
            r: U256::zero(),
            s: U256::zero(),
            raw: vec![0; 10],
        }
    }

    fn order(pool: &Pool, most: usize, gas: u64) -> Vec<(u8, u64)> {
        pool.ready(most, gas, |_| 5).iter().map(|one| (one.sender.0[0], one.nonce)).collect()
    }

    #[test]
    fn nonce_order_within_and_arrival_order_between_senders() {
        let mut pool = Pool::default();
        for (sender, nonce) in [(1, 6), (2, 5), (1, 5), (2, 7), (2, 6)] {
            pool.add(transaction(sender, nonce, 0), 5).expect("taken");
        }
        assert_eq!(order(&pool, 9, 1000), [(2, 5), (1, 5), (1, 6), (2, 6), (2, 7)]);
        assert_eq!(order(&pool, 2, 1000), [(2, 5), (1, 5)]);
        assert_eq!(order(&pool, 9, 350), [(2, 5), (1, 5), (1, 6)]);
        assert_eq!(pool.next_nonce(Address([2; 20]), 5), 8);
        assert_eq!(pool.next_nonce(Address([3; 20]), 5), 5);
    }

    #[test]
    fn a_gap_waits() {
        let mut pool = Pool::default();
        pool.add(transaction(1, 6, 0), 5).expect("taken");
        assert!(!pool.is_ready(|_| 5));
        assert_eq!(pool.next_nonce(Address([1; 20]), 5), 5);
        pool.add(transaction(1, 5, 0), 5).expect("taken");
        assert_eq!(order(&pool, 9, 1000), [(1, 5), (1, 6)]);
    }

    #[test]
    fn refusals() {
        let mut pool = Pool::default();
        pool.add(transaction(1, 5, 100), 5).expect("taken");
        assert_eq!(pool.add(transaction(1, 5, 100), 5), Err("already known".into()));
        assert!(pool.add(transaction(1, 4, 100), 5).expect_err("low").starts_with("nonce too low"));
        assert!(pool.add(transaction(1, 5, 110), 5).expect_err("price").contains("underpriced"));
        assert_eq!(pool.add(transaction(1, 5 + FARTHEST + 1, 0), 5), Err("txpool is full".into()));
        pool.add(transaction(1, 5, 111), 5).expect("replaces");
        assert!(pool.get(transaction(1, 5, 111).hash).is_some());
        assert!(pool.get(transaction(1, 5, 100).hash).is_none());
        pool.forget([&transaction(1, 5, 111)]);
        assert_eq!((pool.bytes, pool.hashes.len(), pool.senders.len()), (0, 0, 0));
    }
}
