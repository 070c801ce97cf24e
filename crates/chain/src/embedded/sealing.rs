//! Seals of blocks, and validity of those in a file. Under proof of authority, as in Clique (EIP-225), signers take
//! turns; under proof of work one sealer searches for a nonce. All keys are in the chain's file, so nobody ever steps
//! in for another signer, and there are no votes.

use std::sync::atomic::{AtomicBool, Ordering};
use std::{sync::Arc, thread::JoinHandle, time::Duration};

use alloy_primitives::{U256, keccak256};
use k256::ecdsa::SigningKey;
use sha3::{Digest as _, Keccak256};
use zeroize::Zeroizing;

use super::block::{Header, MARK, SEAL};
use super::file::{ChainFile, Founding, keys_of};
use super::machine::Environment;
use crate::model::{Address, Hash, Timestamp, steady_clock::steady_now};
use crate::{ChainError, Consensus, genesis::noise};

/// Clique's difficulty of a block sealed in turn, as all are here.
const IN_TURN: u64 = 2;

pub struct Sealing {
    /// In the order of their turns (by address); under proof of work, the recipient of the fees.
    sealers: Vec<(Address, SigningKey)>,
    pub period: Duration,
    /// Hashes per block on average under proof of work; constant, as a single miner has no network to adjust to.
    pub work: Option<u64>,
}

impl Sealing {
    pub fn new(consensus: &Consensus, keys: Vec<SigningKey>) -> Self {
        let (period, work) = match *consensus {
            Consensus::Poa { period, .. } => (period, None),
            Consensus::Pow { difficulty } => (Duration::ZERO, Some(difficulty)),
        };
        let mut sealers: Vec<_> = keys.into_iter().map(|key| (address_of(&key), key)).collect();
        sealers.sort_by_key(|(address, _)| *address);
        Self { sealers, period, work }
    }

    pub fn addresses(&self) -> Vec<Address> {
        self.sealers.iter().map(|(address, _)| *address).collect()
    }

    fn in_turn(&self, number: u64) -> Option<&(Address, SigningKey)> {
        self.sealers.get(usize::try_from(number % self.sealers.len().max(1) as u64).ok()?)
    }

    fn sealer(&self, number: u64) -> Address {
        self.in_turn(number).map_or(Address([0; 20]), |(address, _)| *address)
    }

    fn difficulty(&self) -> u64 {
        self.work.unwrap_or(IN_TURN)
    }

    /// Unsealed.
    fn genesis(&self, unique: Hash, timestamp: u64) -> Header {
        match self.work {
            Some(difficulty) => Header::genesis(&[], self.sealer(0), difficulty, unique, timestamp),
            None => Header::genesis(&self.addresses(), Address([0; 20]), 1, unique, timestamp),
        }
    }

    fn founded(&self, genesis: &Header) -> bool {
        let Some(unique) = unique(genesis) else { return false };
        let own = self.genesis(unique, genesis.timestamp);
        let unsealed = own.extra.len() - if self.work.is_some() { 0 } else { SEAL };
        let listed = genesis.extra.len() == own.extra.len() && genesis.extra.starts_with(&own.extra[..unsealed]);
        listed && Header { extra: genesis.extra.clone(), ..own } == *genesis && self.vouch(genesis).is_ok()
    }

    pub fn place(&self, number: u64, head_time: u64) -> Environment {
        // Block times never go back: after the clock jumps back, blocks keep their time until it has caught up.
        let timestamp = steady_now().seconds().max(head_time + self.period.as_secs());
        Environment { number, timestamp, difficulty: self.difficulty(), beneficiary: self.sealer(number) }
    }

    /// Coinbase and extra data before the seal.
    pub fn dress(&self) -> (Address, Vec<u8>) {
        match self.work {
            Some(_) => (self.sealer(0), EXTRA.to_vec()),
            None => (Address([0; 20]), [&MARK[..], &[0; SEAL]].concat()),
        }
    }

    pub fn seal(&self, header: &mut Header) -> Option<()> {
        header.seal(&self.in_turn(header.number)?.1)
    }

    /// Checks what the transactions do not show. A single signer's seals are not recovered: the newest vouches for all
    /// below.
    pub fn accept(&self, header: &Header, parent_time: u64) -> Result<Environment, &'static str> {
        let Header { number, timestamp, difficulty, .. } = *header;
        let (other, early) = match self.work {
            Some(_) => ("its difficulty is not that of the chain", "it is earlier than the block before it"),
            None => ("its difficulty does not match its signer's turn", "it comes sooner than the period allows"),
        };
        if self.sealers.len() > 1 {
            self.vouch(header)?;
        }
        if difficulty != self.difficulty() {
            return Err(other);
        }
        if timestamp < parent_time + self.period.as_secs() {
            return Err(early);
        }
        if self.work.is_some_and(|difficulty| !seals(header.work_hash(), header.nonce, difficulty)) {
            return Err("its nonce does not prove the work");
        }
        Ok(Environment { number, timestamp, difficulty, beneficiary: self.sealer(number) })
    }

    /// The seal must be that of the signer whose turn it is.
    pub fn vouch(&self, header: &Header) -> Result<(), &'static str> {
        match header.sealer() {
            _ if self.work.is_some() => Ok(()),
            Some(sealer) if sealer == self.sealer(header.number) => Ok(()),
            Some(sealer) if self.addresses().contains(&sealer) => Err("its seal does not match its signer's turn"),
            _ => Err("it is not sealed by a signer of the chain"),
        }
    }

    /// Sum over blocks 0 to `number`.
    pub fn total_difficulty(&self, number: u64) -> u128 {
        let genesis = self.work.unwrap_or(1);
        u128::from(self.difficulty()) * u128::from(number) + u128::from(genesis)
    }
}

pub fn address_of(key: &SigningKey) -> Address {
    Address(alloy_primitives::Address::from_private_key(key).into_array())
}

// Proof of work: Keccak-256 of the block's hash and a nonce is at most 2^256 / difficulty. It is not ethash: no data
// set, a far cheaper hash, so a hash takes a different time.

/// Marks every block after the first, so that no reader mistakes it for ethash.
pub const EXTRA: [u8; 32] = *b"AuthROS Keccak-256, not ethash\0\0";

/// Hashes between checks whether to stop.
const STRIDE: u64 = 1024;

/// The highest hash that seals a block: ⌊2^256 / difficulty⌋, and 2^256 - 1 for difficulty 1.
fn target(difficulty: u64) -> [u8; 32] {
    let difficulty = U256::from(difficulty.max(1));
    let (quotient, rest) = U256::MAX.div_rem(difficulty);
    // 2^256 does not fit: its quotient is one higher if the remainder of 2^256 - 1 is the largest.
    let carry = U256::from(rest == difficulty - U256::ONE);
    quotient.saturating_add(carry).to_be_bytes()
}

pub fn seals(work_hash: Hash, nonce: u64, difficulty: u64) -> bool {
    let begun = Keccak256::new_with_prefix(work_hash.as_bytes());
    meets(&begun, nonce, &target(difficulty))
}

fn meets(begun: &Keccak256, nonce: u64, target: &[u8; 32]) -> bool {
    let hash: [u8; 32] = begun.clone().chain_update(nonce.to_be_bytes()).finalize().into();
    hash <= *target
}

/// Dropping it ends it.
pub struct Search {
    cancelled: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Search {
    /// Reports the first nonce from `first` on that seals the block.
    pub fn start(
        work_hash: Hash,
        difficulty: u64,
        first: u64,
        found: impl FnOnce(u64) + Send + 'static,
    ) -> std::io::Result<Self> {
        let cancelled = Arc::new(AtomicBool::new(false));
        let seen = Arc::clone(&cancelled);
        let run = move || {
            if let Some(nonce) = search(work_hash, difficulty, first, &seen) {
                found(nonce);
            }
        };
        let thread = std::thread::Builder::new().name("authros-work".into()).spawn(run)?;
        Ok(Self { cancelled, thread: Some(thread) })
    }
}

impl Drop for Search {
    fn drop(&mut self) {
        self.cancelled.store(true, Ordering::Relaxed);
        // A search that panicked has also ended.
        drop(self.thread.take().map(JoinHandle::join));
    }
}

fn search(work_hash: Hash, difficulty: u64, first: u64, cancelled: &AtomicBool) -> Option<u64> {
    let begun = Keccak256::new_with_prefix(work_hash.as_bytes());
    let target = target(difficulty);
    let mut nonce = first;
    while !cancelled.load(Ordering::Relaxed) {
        for _ in 0..STRIDE {
            if meets(&begun, nonce, &target) {
                return Some(nonce);
            }
            nonce = nonce.wrapping_add(1);
        }
    }
    None
}

// Founding a new chain, and recognising an existing one: chain id, keys, genesis block.

/// Random bytes of a genesis block.
const RANDOM: usize = 16;

pub struct Founded {
    pub chain_id: u64,
    pub consensus: Consensus,
    pub sealing: Sealing,
    pub genesis: Header,
}

pub fn open(file: &ChainFile, asked: Option<Consensus>) -> Result<Founded, ChainError> {
    let Founding { chain_id, consensus, keys } = match file.founding()? {
        Some(founding) => founding,
        None => found(file, asked.unwrap_or_default())?,
    };
    if let Some(asked) = asked.filter(|asked| *asked != consensus) {
        return Err(ChainError::OtherConsensus { path: file.path().to_owned(), founded: consensus, asked });
    }
    let sealing = Sealing::new(&consensus, keys);
    let genesis = genesis(file, &consensus, &sealing)?;
    Ok(Founded { chain_id, consensus, sealing, genesis })
}

fn found(file: &ChainFile, consensus: Consensus) -> Result<Founding, ChainError> {
    if !consensus.is_usable() {
        return Err(ChainError::Input(format!("'{consensus}' is not a usable consensus; see `chain.consensus`")));
    }
    let id = u64::from_be_bytes(noise()?);
    let keys = (0..keys_of(&consensus)).map(|_| draw_key()).collect::<Result<Vec<_>, _>>()?;
    let sealing = Sealing::new(&consensus, keys.clone());
    let mut genesis = sealing.genesis(commitment(noise()?, &consensus), Timestamp::now().seconds());
    if sealing.work.is_none() {
        let sealed = sealing.seal(&mut genesis);
        sealed.ok_or_else(|| ChainError::Internal("the genesis block could not be sealed".into()))?;
    }
    let founding = Founding { chain_id: (1 << 40) + id % (1 << 47), consensus, keys };
    file.found(&founding, &genesis)?;
    Ok(founding)
}

/// Random bytes, and a hash of them and the consensus, which therefore cannot be changed later.
fn commitment(random: [u8; RANDOM], consensus: &Consensus) -> Hash {
    let mut unique = keccak256([&random[..], consensus.to_string().as_bytes()].concat()).0;
    unique[..RANDOM].copy_from_slice(&random);
    Hash(unique)
}

fn unique(genesis: &Header) -> Option<Hash> {
    genesis.extra.get(..32).and_then(Hash::from_slice)
}

fn draw_key() -> Result<SigningKey, ChainError> {
    let mut scalar = Zeroizing::new([0; 32]);
    loop {
        getrandom::fill(&mut scalar[..]).map_err(|error| ChainError::Internal(format!("no randomness: {error}")))?;
        if let Ok(key) = SigningKey::from_slice(&scalar[..]) {
            return Ok(key);
        }
    }
}

fn genesis(file: &ChainFile, consensus: &Consensus, sealing: &Sealing) -> Result<Header, ChainError> {
    let blame = |what: &str| file.tampered(0, what);
    let (hash, header) = file.block(0)?.ok_or_else(|| blame("the genesis block is missing"))?;
    let header = Header::decode(&header).map_err(|_| blame("its header is not a header"))?;
    if header.hash() != hash || !sealing.founded(&header) {
        return Err(blame("its hash or its signers were changed"));
    }
    let committed = unique(&header).is_some_and(|unique| {
        let random = unique.0.first_chunk().copied().unwrap_or_default();
        commitment(random, consensus) == unique
    });
    if !committed {
        return Err(blame("its consensus was changed"));
    }
    Ok(header)
}

#[cfg(test)]
mod authority_tests {
    use super::*;

    fn authority(signers: u8) -> Sealing {
        let keys = (1..=signers).map(|number| SigningKey::from_slice(&[number; 32]).expect("key"));
        Sealing::new(&Consensus::Poa { signers, period: Duration::from_secs(2) }, keys.collect())
    }

    #[test]
    fn signers_take_turns_in_the_order_of_their_addresses() {
        let authority = authority(3);
        assert!(authority.addresses().is_sorted());
        for number in 1..10 {
            let turn = authority.addresses()[usize::try_from(number % 3).expect("small")];
            let place = authority.place(number, 5);
            assert_eq!((place.beneficiary, place.difficulty), (turn, 2));
        }
        assert_eq!(authority.total_difficulty(9), 19);
    }

    #[test]
    fn checks_of_a_block() {
        let authority = authority(3);
        let zero = Address([0; 20]);
        let of = |difficulty| Header { number: 4, ..Header::genesis(&[zero], zero, difficulty, Hash([2; 32]), 100) };
        let mut good = of(2);
        authority.seal(&mut good).expect("seals");
        let words = |header: &Header, time| authority.accept(header, time).map(drop).expect_err("refused");
        assert_eq!(authority.accept(&good, 98).map(|place| place.beneficiary), Ok(authority.addresses()[1]));
        assert!(words(&good, 99).contains("period"));
        let mut lazy = of(1);
        authority.seal(&mut lazy).expect("seals");
        assert!(words(&lazy, 98).contains("difficulty"));
        let mut shifted = of(2);
        shifted.seal(&authority.sealers[2].1).expect("seals");
        assert!(words(&shifted, 98).contains("signer's turn"));
        let mut strange = of(2);
        strange.seal(&SigningKey::from_slice(&[99; 32]).expect("key")).expect("seals");
        assert!(words(&strange, 98).contains("not sealed by a signer"));
    }
}

#[cfg(test)]
mod work_tests {
    use super::*;
    use crate::model::Consensus;
    use std::sync::mpsc::channel;

    #[test]
    fn targets() {
        assert_eq!(target(1), [0xff; 32]);
        let mut half = [0; 32];
        half[0] = 0x80;
        assert_eq!(target(2), half);
        half[0] = 0x40;
        assert_eq!(target(4), half);
        assert_eq!(target(3), [0x55; 32]);
        let paper = crate::model::bytes::hex(&target(Consensus::PAPER_DIFFICULTY));
        assert_eq!(paper, "00000355558aaaae0000355558aaaae0000355558aaaae0000355558aaaae000");
    }

    #[test]
    fn a_nonce_seals_its_block_alone() {
        let cancelled = AtomicBool::new(false);
        let block = Hash([7; 32]);
        let nonce = search(block, 5000, 3, &cancelled).expect("found");
        assert!(seals(block, nonce, 5000) && seals(block, nonce, 4999));
        assert!(!(3..nonce).any(|earlier| seals(block, earlier, 5000)), "it is the first one");
        let others = (0..100u8).filter(|number| seals(Hash([*number; 32]), nonce, 5000)).count();
        assert!(others <= 3, "{others} of 100 blocks share the nonce");
        assert!(search(block, 1, u64::MAX, &cancelled).is_some());
    }

    /// The number of hashes is geometric: mean = difficulty, standard deviation about the same. The mean of 2,000
    /// searches is off by more than 1/8 with a probability below 10^-7; the blocks searched are fixed, so the test
    /// always gives the same result.
    #[test]
    fn the_work_is_as_much_as_the_difficulty_says() {
        let cancelled = AtomicBool::new(false);
        for difficulty in [2u64, 64, 1000] {
            let blocks = 2000u64;
            let hashes = |block: u64| {
                let mut hash = [0; 32];
                hash[..8].copy_from_slice(&block.to_be_bytes());
                search(Hash(hash), difficulty, 0, &cancelled).expect("found") + 1
            };
            let all: Vec<u64> = (0..blocks).map(hashes).collect();
            let sum: u64 = all.iter().sum();
            assert!(sum.abs_diff(difficulty * blocks) * 8 < difficulty * blocks, "{difficulty}: {sum}");
            // Half of all searches take at most ln 2 = 0.693 of the mean.
            let quick = all.iter().filter(|hashes| **hashes * 1000 <= difficulty * 693).count();
            assert!(difficulty == 2 || (850..1150).contains(&quick), "{difficulty}: {quick}");
        }
    }

    #[test]
    fn a_search_tells_once_or_is_ended() {
        let (found, nonces) = channel();
        let tell = found.clone();
        let search =
            Search::start(Hash([1; 32]), 50, 9, move |nonce| tell.send(nonce).expect("heard")).expect("starts");
        assert!(seals(Hash([1; 32]), nonces.recv().expect("found"), 50));
        drop(search);
        let endless =
            Search::start(Hash([1; 32]), u64::MAX, 0, move |nonce| found.send(nonce).expect("heard")).expect("starts");
        drop(endless);
        assert!(nonces.recv().is_err(), "nothing was found, and the thread is gone");
    }
}
