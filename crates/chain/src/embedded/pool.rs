//! Pending transactions: bounded per sender and overall, in nonce order. Between senders smaller ones go first, because
//! accounts are free; waiting makes a transaction smaller.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap, HashMap, HashSet};

use revm::context_interface::{Cfg, ContextTr};
use revm::handler::{EthPrecompiles, PrecompileProvider};
use revm::interpreter::{CallInputs, InterpreterResult};
use revm::precompile::modexp::{byzantium_gas_calc, osaka_gas_calc};
use revm::primitives::hardfork::SpecId;
use revm::primitives::{Address as EvmAddress, AddressSet, U256};

use crate::model::{Address, Hash};
use crate::transaction::Transaction;

const MOST: usize = 16_384;
const MOST_BYTES: usize = 32 * 1024 * 1024;
const MOST_GAS: u64 = 1_000_000_000;
/// Per sender; more than a lane of this program keeps open.
const MOST_OF_ONE: usize = 1_280;
/// Nonces accepted beyond the first gap.
const FARTHEST: u64 = 128;
/// Mined gas that makes a waiting transaction smaller by one.
const AGE: u64 = 100;

struct Waiting {
    /// The clock at its arrival, its gas, and the gas before it in its lane.
    rank: u128,
    arrival: u64,
    transaction: Transaction,
}

struct Lane {
    /// Next nonce on chain.
    next: u64,
    waiting: BTreeMap<u64, Waiting>,
    gas: u64,
    /// Of the last arrival.
    rank: u128,
}

impl Lane {
    /// The nonce after the last one without a gap.
    fn free(&self) -> u64 {
        let nonces = self.waiting.range(self.next..).map(|(nonce, _)| *nonce);
        nonces
            .zip(self.next..)
            .take_while(|(nonce, free)| nonce == free)
            .map(|(nonce, _)| nonce + 1)
            .last()
            .unwrap_or(self.next)
    }
}

#[derive(Default)]
pub struct Pool {
    lanes: HashMap<Address, Lane>,
    /// Senders whose next transaction is pending.
    ready: HashSet<Address>,
    hashes: HashSet<Hash>,
    bytes: usize,
    gas: u64,
    arrivals: u64,
    /// All gas mined, by [`AGE`].
    clock: u128,
}

impl Pool {
    /// `next` is the sender's next nonce on chain.
    pub fn add(&mut self, transaction: Transaction, next: u64) -> Result<(), String> {
        if self.hashes.contains(&transaction.hash) {
            return Err("already known".into());
        }
        let (sender, nonce) = (transaction.sender, transaction.nonce);
        if nonce < next {
            return Err(format!("nonce too low: next nonce {next}, tx nonce {nonce}"));
        }
        let free = self.next_nonce(sender, next);
        if nonce > free.saturating_add(FARTHEST) {
            return Err(format!("nonce too high: next nonce {free}, tx nonce {nonce}, at most {FARTHEST} ahead"));
        }
        let lane = self.lanes.get(&sender);
        let old = lane.and_then(|lane| lane.waiting.get(&nonce)).map(|old| &old.transaction);
        if old.is_some_and(|old| transaction.gas_price <= old.gas_price + old.gas_price / 10) {
            return Err("replacement transaction underpriced".into());
        }
        if old.is_none() && lane.is_some_and(|lane| lane.waiting.len() >= MOST_OF_ONE) {
            return Err(format!("txpool is full: {MOST_OF_ONE} transactions of this account wait already"));
        }
        self.make_room(&transaction)?;
        self.remove(sender, nonce);
        self.insert(transaction, next);
        Ok(())
    }

    /// Drops the last transactions of the sender with the most pending gas, while that exceeds the newcomer's.
    fn make_room(&mut self, newcomer: &Transaction) -> Result<(), String> {
        let own = self.lanes.get(&newcomer.sender).map_or(0, |lane| lane.gas).saturating_add(newcomer.gas_limit);
        while self.hashes.len() >= MOST
            || self.bytes + newcomer.raw.len() > MOST_BYTES
            || self.gas.saturating_add(newcomer.gas_limit) > MOST_GAS
        {
            let heaviest = self.lanes.iter().max_by_key(|(_, lane)| lane.gas);
            let last = heaviest
                .filter(|(_, lane)| lane.gas > own)
                .and_then(|(sender, lane)| lane.waiting.last_key_value().map(|(nonce, _)| (*sender, *nonce)));
            let Some((sender, nonce)) = last else { return Err("txpool is full".into()) };
            self.remove(sender, nonce);
        }
        Ok(())
    }

    fn insert(&mut self, transaction: Transaction, next: u64) {
        self.arrivals += 1;
        self.hashes.insert(transaction.hash);
        self.bytes += transaction.raw.len();
        self.gas += transaction.gas_limit;
        let (sender, nonce, clock) = (transaction.sender, transaction.nonce, self.clock);
        let empty = || Lane { next, waiting: BTreeMap::new(), gas: 0, rank: clock };
        let lane = self.lanes.entry(sender).or_insert_with(empty);
        lane.next = next;
        lane.gas += transaction.gas_limit;
        lane.rank = lane.rank.max(clock) + u128::from(transaction.gas_limit);
        lane.waiting.insert(nonce, Waiting { rank: lane.rank, arrival: self.arrivals, transaction });
        self.look(sender);
    }

    fn remove(&mut self, sender: Address, nonce: u64) -> Option<Waiting> {
        let lane = self.lanes.get_mut(&sender)?;
        let old = lane.waiting.remove(&nonce)?;
        lane.gas -= old.transaction.gas_limit;
        self.gas -= old.transaction.gas_limit;
        self.hashes.remove(&old.transaction.hash);
        self.bytes -= old.transaction.raw.len();
        self.look(sender);
        Some(old)
    }

    fn look(&mut self, sender: Address) {
        let ready = self.lanes.get(&sender).is_some_and(|lane| lane.waiting.contains_key(&lane.next));
        if ready {
            self.ready.insert(sender)
        } else {
            self.ready.remove(&sender)
        };
        if self.lanes.get(&sender).is_some_and(|lane| lane.waiting.is_empty()) {
            self.lanes.remove(&sender);
        }
    }

    pub fn forget<'a>(&mut self, transactions: impl IntoIterator<Item = &'a Transaction>) {
        for transaction in transactions {
            self.remove(transaction.sender, transaction.nonce);
        }
    }

    pub fn mined<'a>(&mut self, transactions: impl IntoIterator<Item = &'a Transaction>) {
        for transaction in transactions {
            if let Some(lane) = self.lanes.get_mut(&transaction.sender) {
                lane.next = transaction.nonce + 1;
            }
            if let Some(old) = self.remove(transaction.sender, transaction.nonce) {
                self.clock += u128::from(old.transaction.gas_limit / AGE);
            }
            self.look(transaction.sender);
        }
    }

    /// At most `most` transactions, whose gas limits fit into `gas`.
    pub fn ready(&self, most: usize, gas: u64) -> Vec<Transaction> {
        let mut heads: BinaryHeap<Reverse<(u128, u64, Address, u64)>> = BinaryHeap::new();
        let waiting = |sender: &Address, nonce: u64| self.lanes.get(sender).and_then(|lane| lane.waiting.get(&nonce));
        let head = |sender: Address, nonce: u64| {
            waiting(&sender, nonce).map(|head| Reverse((head.rank, head.arrival, sender, nonce)))
        };
        for sender in &self.ready {
            heads.extend(self.lanes.get(sender).and_then(|lane| head(*sender, lane.next)));
        }
        let (mut chosen, mut left) = (Vec::new(), gas);
        while let Some(Reverse((_, _, sender, nonce))) = heads.pop() {
            let Some(next) = waiting(&sender, nonce) else { continue };
            if chosen.len() == most {
                break;
            }
            // A transaction that does not fit waits; smaller ones of others may still fit.
            if next.transaction.gas_limit <= left {
                left -= next.transaction.gas_limit;
                chosen.push(next.transaction.clone());
                heads.extend(head(sender, nonce + 1));
            }
        }
        chosen
    }

    pub fn next_nonce(&self, sender: Address, next: u64) -> u64 {
        self.lanes.get(&sender).map_or(next, |lane| lane.free().max(next))
    }

    pub fn get(&self, hash: Hash) -> Option<&Transaction> {
        if !self.hashes.contains(&hash) {
            return None;
        }
        let mut all = self.lanes.values().flat_map(|lane| lane.waiting.values());
        all.find(|waiting| waiting.transaction.hash == hash).map(|waiting| &waiting.transaction)
    }

    pub fn is_ready(&self) -> bool {
        !self.ready.is_empty()
    }
}

// Rules of admission, so that no caller stalls the chain's thread. Replaying the file ignores them.
//
// Istanbul's prices are wrong for MODEXP with a long exponent (a hundred times too low) and ecrecover (three times).
// What such a call should cost above its price is its surplus.

/// Per transaction, call or estimate.
pub const TRANSACTION_GAS: u64 = 10_000_000;
pub const BLOCK_GAS: u64 = 20_000_000;
/// For all runs of one estimate.
pub const ESTIMATE_GAS: u64 = 40_000_000;
/// Per transaction or call.
pub const TRANSACTION_SURPLUS: u64 = 10_000_000;
/// A block with this much takes no further transaction.
pub const BLOCK_SURPLUS: u64 = 10_000_000;
pub const TOO_MUCH_WORK: &str = "too much work for its gas";

const ECRECOVER: EvmAddress = revm::precompile::u64_to_address(1);
const ECRECOVER_GAS: u64 = 3_000;
/// Measured against the other instructions.
const ECRECOVER_SURPLUS: u64 = 6_000;
const MODEXP: EvmAddress = revm::precompile::u64_to_address(5);
const LENGTHS: usize = 96;

/// Istanbul's precompiled contracts, and the surplus of their calls.
#[derive(Debug)]
pub struct Weighed {
    precompiles: EthPrecompiles,
    pub surplus: u64,
    most: u64,
}

impl Weighed {
    pub fn new(most: u64) -> Self {
        Self { precompiles: EthPrecompiles::new(SpecId::ISTANBUL), surplus: 0, most }
    }
}

impl<C: ContextTr> PrecompileProvider<C> for Weighed {
    type Output = InterpreterResult;

    fn set_spec(&mut self, spec: <C::Cfg as Cfg>::Spec) -> bool {
        <EthPrecompiles as PrecompileProvider<C>>::set_spec(&mut self.precompiles, spec)
    }

    fn run(&mut self, context: &mut C, inputs: &CallInputs) -> Result<Option<InterpreterResult>, String> {
        let more = match inputs.bytecode_address {
            MODEXP => surplus(&inputs.input.as_bytes(context), inputs.gas_limit),
            ECRECOVER if inputs.gas_limit >= ECRECOVER_GAS => ECRECOVER_SURPLUS,
            _ => 0,
        };
        self.surplus = self.surplus.saturating_add(more);
        if self.surplus > self.most {
            return Err(format!(
                "{TOO_MUCH_WORK}: its MODEXP or ecrecover calls cost far less gas than the time they take"
            ));
        }
        self.precompiles.run(context, inputs)
    }

    fn warm_addresses(&self) -> &AddressSet {
        self.precompiles.warm_addresses()
    }
}

/// The price under EIP-7883 above that under EIP-198; 0 if the call cannot pay.
fn surplus(input: &[u8], gas: u64) -> u64 {
    let mut head = [0; LENGTHS + 32];
    let word = |at: usize, head: &[u8]| U256::from_be_slice(&head[at..at + 32]);
    let known = input.len().min(LENGTHS);
    head[..known].copy_from_slice(&input[..known]);
    let [base, exponent, modulus] = [0, 32, 64].map(|at| word(at, &head).saturating_to::<u64>());
    let first = usize::try_from(base).ok().and_then(|base| input.get(LENGTHS.checked_add(base)?..)).unwrap_or_default();
    let (length, known) = (usize::try_from(exponent.min(32)).unwrap_or(32), first.len().min(32));
    // The highest 32 bytes of the exponent, as a number.
    let place = LENGTHS + 32 - length;
    head[LENGTHS..].fill(0);
    let known = known.min(length);
    head[place..place + known].copy_from_slice(&first[..known]);
    let highest = word(LENGTHS, &head);
    let price = byzantium_gas_calc(base, exponent, modulus, &highest);
    if price > gas { 0 } else { osaka_gas_calc(base, exponent, modulus, &highest).saturating_sub(price) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transaction::Unsigned;

    fn sized(sender: u8, nonce: u64, gas_price: u128, gas_limit: u64) -> Transaction {
        let mut hash = [sender; 32];
        hash[..8].copy_from_slice(&nonce.to_be_bytes());
        hash[8..24].copy_from_slice(&gas_price.to_be_bytes());
        let unsigned = Unsigned { nonce, gas_price, gas_limit, ..Unsigned::default() };
        let (sender, zero) = (Address([sender; 20]), U256::ZERO);
        Transaction { hash: Hash(hash), sender, unsigned, v: 0, r: zero, s: zero, raw: vec![0; 10] }
    }

    fn transaction(sender: u8, nonce: u64, gas_price: u128) -> Transaction {
        sized(sender, nonce, gas_price, 100)
    }

    fn order(pool: &Pool, most: usize, gas: u64) -> Vec<(u8, u64)> {
        pool.ready(most, gas).iter().map(|one| (one.sender.0[0], one.nonce)).collect()
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
        assert!(!pool.is_ready());
        assert_eq!(pool.next_nonce(Address([1; 20]), 5), 5);
        pool.add(transaction(1, 5, 0), 5).expect("taken");
        assert_eq!(order(&pool, 9, 1000), [(1, 5), (1, 6)]);
        pool.mined([&transaction(1, 5, 0)]);
        assert_eq!((order(&pool, 9, 1000), pool.is_ready()), (vec![(1, 6)], true));
    }

    #[test]
    fn refusals() {
        let mut pool = Pool::default();
        pool.add(transaction(1, 5, 100), 5).expect("taken");
        assert_eq!(pool.add(transaction(1, 5, 100), 5), Err("already known".into()));
        assert!(pool.add(transaction(1, 4, 100), 5).expect_err("low").starts_with("nonce too low"));
        assert!(pool.add(transaction(1, 5, 110), 5).expect_err("price").contains("underpriced"));
        assert!(pool.add(transaction(1, 6 + FARTHEST + 1, 0), 5).expect_err("far").starts_with("nonce too high"));
        pool.add(transaction(1, 5, 111), 5).expect("replaces");
        assert!(pool.get(transaction(1, 5, 111).hash).is_some());
        assert!(pool.get(transaction(1, 5, 100).hash).is_none());
        pool.forget([&transaction(1, 5, 111)]);
        assert_eq!((pool.bytes, pool.gas, pool.hashes.len(), pool.lanes.len(), pool.ready.len()), (0, 0, 0, 0, 0));
    }

    #[test]
    fn a_sender_has_so_many_and_a_gap_lets_few_in() {
        let mut pool = Pool::default();
        let taken = (1..1_500).filter(|nonce| pool.add(transaction(1, *nonce, 0), 0).is_ok()).count();
        assert_eq!(taken as u64, FARTHEST);
        let taken = (0..3_000).filter(|nonce| pool.add(transaction(2, *nonce, 0), 0).is_ok()).count();
        assert_eq!(taken, MOST_OF_ONE);
        pool.add(transaction(2, 7, 1), 0).expect("a better price is no further one");
    }

    #[test]
    fn a_small_one_does_not_wait_behind_large_ones() {
        let mut pool = Pool::default();
        for sender in 10..40 {
            pool.add(sized(sender, 0, 0, 10_000), 0).expect("taken");
        }
        pool.add(sized(1, 0, 0, 100), 0).expect("taken");
        pool.add(sized(1, 1, 0, 100), 0).expect("taken");
        assert_eq!(order(&pool, 9, 20_300), [(1, 0), (1, 1), (10, 0), (11, 0)]);
        // Large ones do not wait forever either.
        for nonce in 0..200 {
            drop(pool.add(sized(1, nonce, 0, 6_000), nonce));
            pool.mined([&sized(1, nonce, 0, 6_000)]);
        }
        pool.add(sized(1, 200, 0, 100), 200).expect("taken");
        assert_eq!(order(&pool, 2, 20_300), [(10, 0), (11, 0)]);
    }

    #[test]
    fn a_full_pool_drops_the_heaviest_senders_last() {
        let mut pool = Pool::default();
        for sender in 1..=4 {
            for nonce in 0..50 {
                pool.add(sized(sender, nonce, 0, MOST_GAS / 200), 0).expect("taken");
            }
        }
        assert_eq!(pool.gas, MOST_GAS);
        pool.add(sized(9, 0, 0, 1_000), 0).expect("taken");
        assert_eq!((pool.hashes.len(), pool.gas), (200, MOST_GAS - MOST_GAS / 200 + 1_000));
        assert_eq!(pool.add(sized(1, 50, 0, MOST_GAS / 200 + 1), 0), Err("txpool is full".into()));
    }
}

#[cfg(test)]
mod admission_tests {
    use super::*;

    fn call(lengths: [u64; 3], rest: &[u8]) -> Vec<u8> {
        let words = lengths.iter().flat_map(|length| U256::from(*length).to_be_bytes::<32>());
        words.chain(rest.iter().copied()).collect()
    }

    #[test]
    fn a_long_exponent_has_a_surplus_and_an_unpaid_one_none() {
        // EIP-198: 1 * (8 * (1000 - 32) + 7) / 20; EIP-7883: 16 * (16 * (1000 - 32) + 7).
        let long = call([1, 1000, 1], &[1, 0x80]);
        let exponent = 255;
        assert_eq!(surplus(&long, 1_000), 16 * (16 * 968 + exponent) - (8 * 968 + exponent) / 20);
        assert_eq!(surplus(&long, 100), 0);
        // An example of EIP-198: 3 ^ (2^256 - 2^32 - 978) mod (2^256 - 2^32 - 977) costs 13,056.
        let mut fermat = call([1, 32, 32], &[3]);
        fermat.extend([0xff; 27]);
        fermat.extend([0xfe, 0xff, 0xff, 0xfc, 0x2e]);
        assert_eq!(surplus(&fermat, 13_055), 0);
        assert_eq!(surplus(&fermat, 13_056), 0, "16 * 255 is less");
        for noise in [&[][..], &[0xff; 31], &[0xff; 200]] {
            assert_eq!(surplus(noise, 1_000_000), if noise.is_empty() { 500 } else { 0 }, "{}", noise.len());
        }
    }
}
