//! What differs between proof of authority and proof of work: the recipient of the fees, the shape of a header, and
//! what makes a block of the file valid. Blocks run the same way under both.

use std::collections::VecDeque;
use std::time::Duration;

use ethers::utils::keccak256;
use k256::ecdsa::SigningKey;
use zeroize::Zeroizing;

use super::block::{Header, unsealed_extra};
use super::file::{ChainFile, Founding, keys_of};
use super::machine::Environment;
use super::proof;
use crate::model::steady_clock::steady_now;
use crate::model::{Address, Hash, Timestamp};
use crate::{ChainError, Consensus};

/// How the blocks of a chain are sealed.
pub enum Sealing {
    /// By signers.
    Authority(Authority),
    /// By work.
    Work {
        /// Hashes per block on average. It never changes: with a single miner there is no network to adjust to.
        difficulty: u64,
        /// The recipient of the fees.
        miner: Address,
    },
}

impl Sealing {
    /// For a chain founded with `consensus` and these keys.
    pub fn new(consensus: &Consensus, keys: Vec<SigningKey>) -> Self {
        match *consensus {
            Consensus::Poa { period, .. } => Self::Authority(Authority::new(keys, period)),
            Consensus::Pow { difficulty } => {
                Self::Work { difficulty, miner: keys.first().map_or(Address([0; 20]), address_of) }
            }
        }
    }

    /// The signers of a proof-of-authority chain.
    pub fn authority(&self) -> Option<&Authority> {
        if let Self::Authority(authority) = self { Some(authority) } else { None }
    }

    /// The signers, or the miner.
    pub fn addresses(&self) -> Vec<Address> {
        match self {
            Self::Authority(authority) => authority.addresses(),
            Self::Work { miner, .. } => vec![*miner],
        }
    }

    /// The least time between two blocks.
    pub fn period(&self) -> Duration {
        match self {
            Self::Authority(authority) => authority.period(),
            Self::Work { .. } => Duration::ZERO,
        }
    }

    /// The genesis block, before its seal.
    pub fn genesis(&self, unique: Hash, timestamp: u64) -> Header {
        match self {
            Self::Authority(authority) => {
                Header::genesis(&authority.addresses(), Address([0; 20]), 1, unique, timestamp)
            }
            Self::Work { difficulty, miner } => Header::genesis(&[], *miner, *difficulty, unique, timestamp),
        }
    }

    /// The first part of the genesis block's extra data.
    pub fn unique(genesis: &Header) -> Option<Hash> {
        genesis.extra.get(..32).and_then(Hash::from_slice)
    }

    /// Whether a header is the genesis block of this chain.
    pub fn founded(&self, genesis: &Header) -> bool {
        let Some(unique) = Self::unique(genesis) else { return false };
        let expected = self.genesis(unique, genesis.timestamp);
        match self {
            Self::Authority(authority) => {
                let unsealed = expected.extra.len() - 65;
                let same = Header { extra: genesis.extra.clone(), ..expected.clone() } == *genesis;
                same && genesis.extra.starts_with(&expected.extra[..unsealed]) && authority.sealer(genesis) == Ok(0)
            }
            Self::Work { .. } => expected == *genesis,
        }
    }

    /// The context of the block above `head`, sealed by `signer` if there are several.
    pub fn place(&self, number: u64, head_time: u64, signer: Option<usize>) -> Environment {
        // Block times never go back: after the clock jumps back, blocks keep their time until it has caught up.
        let timestamp = steady_now().seconds().max(head_time + self.period().as_secs());
        let (difficulty, beneficiary) = match self {
            Self::Authority(authority) => {
                let in_turn = authority.in_turn(number);
                let signer = signer.unwrap_or(in_turn);
                (authority.difficulty(number, signer), authority.address(signer))
            }
            Self::Work { difficulty, miner } => (*difficulty, *miner),
        };
        Environment { number, timestamp, difficulty, beneficiary }
    }

    /// The consensus fields of a block's header before its seal: coinbase and extra data.
    pub fn dress(&self) -> (Address, Vec<u8>) {
        match self {
            Self::Authority(_) => (Address([0; 20]), unsealed_extra()),
            Self::Work { miner, .. } => (*miner, proof::EXTRA.to_vec()),
        }
    }

    /// Checks everything about a block of the file that its transactions do not show, and records it; returns its
    /// context.
    ///
    /// # Errors
    /// What is wrong, in plain words.
    pub fn accept(&mut self, header: &Header, parent_time: u64) -> Result<Environment, &'static str> {
        let (number, timestamp) = (header.number, header.timestamp);
        let beneficiary = match self {
            Self::Authority(authority) => {
                let signer = authority.check(header, parent_time)?;
                authority.sealed(number, signer);
                authority.address(signer)
            }
            Self::Work { difficulty, miner } => {
                if header.difficulty != *difficulty {
                    return Err("its difficulty is not that of the chain");
                }
                if timestamp < parent_time {
                    return Err("it is earlier than the block before it");
                }
                if !proof::seals(header.work_hash(), header.nonce, *difficulty) {
                    return Err("its nonce does not prove the work");
                }
                *miner
            }
        };
        Ok(Environment { number, timestamp, difficulty: header.difficulty, beneficiary })
    }

    /// Checks the newest block's seal, which vouches for all blocks below it.
    ///
    /// # Errors
    /// What is wrong, in plain words.
    pub fn vouches(&self, head: &Header) -> Result<(), &'static str> {
        match self {
            Self::Authority(authority) => authority.sealer(head).map(drop),
            Self::Work { .. } => Ok(()),
        }
    }

    /// The sum of the difficulties of blocks 0 to `number`.
    pub fn total_difficulty(&self, number: u64) -> u128 {
        match self {
            Self::Authority(authority) => authority.total_difficulty(number).into(),
            Self::Work { difficulty, .. } => u128::from(*difficulty) * (u128::from(number) + 1),
        }
    }
}

// Proof of authority as in Clique (EIP-225): signers take turns, and another one steps in if one is away.
//
// All signers' keys are in the chain's file, so all of them seal in this process. The genesis block fixes the set:
// there are no votes.

/// Difficulty of a block sealed in turn.
pub const IN_TURN: u64 = 2;
/// Difficulty of a block sealed out of turn.
pub const OUT_OF_TURN: u64 = 1;
/// The longest wait of a signer out of turn, for every second signer of the set.
const WIGGLE: Duration = Duration::from_millis(500);

/// The signers of a chain, and which of them sealed last.
pub struct Authority {
    signers: Vec<(Address, SigningKey)>,
    period: Duration,
    recent: VecDeque<usize>,
    out_of_turn: Vec<u64>,
    /// Signers that do not seal, one bit each; outside tests, none.
    away: u16,
}

/// The signer that may seal a block first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Turn {
    /// Index in the set.
    pub signer: usize,
    /// The block's difficulty.
    pub difficulty: u64,
    /// The delay after the block is due.
    pub delay: Duration,
}

impl Authority {
    /// The set, ordered by address as in Clique.
    pub fn new(keys: Vec<SigningKey>, period: Duration) -> Self {
        let mut signers: Vec<(Address, SigningKey)> = keys.into_iter().map(|key| (address_of(&key), key)).collect();
        signers.sort_by_key(|(address, _)| *address);
        Self { signers, period, recent: VecDeque::new(), out_of_turn: Vec::new(), away: 0 }
    }

    /// The signers' addresses in the order of their turns.
    pub fn addresses(&self) -> Vec<Address> {
        self.signers.iter().map(|(address, _)| *address).collect()
    }

    /// The least time between two blocks.
    pub fn period(&self) -> Duration {
        self.period
    }

    /// A signer's address.
    pub fn address(&self, signer: usize) -> Address {
        self.signers.get(signer).map_or(Address([0; 20]), |(address, _)| *address)
    }

    /// The signer whose turn a block is.
    pub fn in_turn(&self, number: u64) -> usize {
        usize::try_from(number % self.signers.len().max(1) as u64).unwrap_or(0)
    }

    /// The difficulty of a block by that signer.
    pub fn difficulty(&self, number: u64, signer: usize) -> u64 {
        if self.in_turn(number) == signer { IN_TURN } else { OUT_OF_TURN }
    }

    /// Whether a signer sealed one of the last ⌊n/2⌋ blocks and must let others seal.
    fn rests(&self, signer: usize) -> bool {
        self.recent.contains(&signer)
    }

    fn is_away(&self, signer: usize) -> bool {
        self.away >> signer & 1 == 1
    }

    /// Marks signers as away, one bit each.
    #[cfg(test)]
    pub fn send_away(&mut self, signers: u16) {
        self.away = signers;
    }

    /// The signer that seals the block above `parent` first; `None` if all that may are away.
    pub fn turn(&self, number: u64, parent: Hash) -> Option<Turn> {
        let present = (0..self.signers.len()).filter(|signer| !self.rests(*signer) && !self.is_away(*signer));
        let turn = |signer| {
            let difficulty = self.difficulty(number, signer);
            let delay = if difficulty == IN_TURN { Duration::ZERO } else { self.wiggle(signer, parent) };
            Turn { signer, difficulty, delay }
        };
        present.map(turn).min_by_key(|turn| (turn.delay, turn.signer))
    }

    /// A random wait for a signer out of turn, from 1 ms to 500 ms for every second signer, plus one.
    fn wiggle(&self, signer: usize, parent: Hash) -> Duration {
        let lot = keccak256([parent.as_bytes(), self.address(signer).as_bytes()].concat());
        let lot = lot[..8].iter().fold(0u64, |lot, byte| lot << 8 | u64::from(*byte));
        let most = WIGGLE * u32::try_from(self.signers.len() / 2 + 1).unwrap_or(1);
        Duration::from_millis(1 + lot % u64::try_from(most.as_millis()).unwrap_or(1))
    }

    /// Seals a block for a signer.
    pub fn seal(&self, header: &mut Header, signer: usize) -> Option<()> {
        header.seal(&self.signers.get(signer)?.1)
    }

    /// Checks difficulty, turn, rest and time of a block of the file; returns its signer. With a single signer it is
    /// not recovered from every seal: the newest seal vouches for all blocks below it.
    ///
    /// # Errors
    /// What is wrong, in plain words.
    pub fn check(&self, header: &Header, parent_time: u64) -> Result<usize, &'static str> {
        let signer = if self.signers.len() == 1 { 0 } else { self.sealer(header)? };
        if header.difficulty != self.difficulty(header.number, signer) {
            return Err("its difficulty does not match its signer's turn");
        }
        if self.rests(signer) {
            return Err("its signer sealed one of the preceding blocks and had to wait");
        }
        if header.timestamp < parent_time + self.period.as_secs() {
            return Err("it comes sooner than the period allows");
        }
        Ok(signer)
    }

    /// The signer whose seal is on the block.
    ///
    /// # Errors
    /// If it is not one of the set.
    pub fn sealer(&self, header: &Header) -> Result<usize, &'static str> {
        let sealer = header.sealer();
        let found = self.signers.iter().position(|(address, _)| Some(*address) == sealer);
        found.ok_or("it is not sealed by a signer of the chain")
    }

    /// Notes a block that is on the chain.
    pub fn sealed(&mut self, number: u64, signer: usize) {
        if self.difficulty(number, signer) == OUT_OF_TURN {
            self.out_of_turn.push(number);
        }
        self.recent.push_back(signer);
        while self.recent.len() > self.signers.len() / 2 {
            self.recent.pop_front();
        }
    }

    /// Continues a stored chain: the blocks sealed out of turn, and the signers of the newest ones, in order.
    pub fn resume(&mut self, out_of_turn: Vec<u64>, newest: impl IntoIterator<Item = usize>) {
        self.out_of_turn = out_of_turn;
        self.recent.extend(newest);
        while self.recent.len() > self.signers.len() / 2 {
            self.recent.pop_front();
        }
    }

    /// For how many blocks a signer rests after sealing one.
    pub fn rest(&self) -> u64 {
        self.signers.len() as u64 / 2
    }

    /// The sum of the difficulties of blocks 0 to `number`.
    pub fn total_difficulty(&self, number: u64) -> u64 {
        1 + IN_TURN * number - self.out_of_turn.partition_point(|block| *block <= number) as u64
    }
}

/// The address of a key.
pub fn address_of(key: &SigningKey) -> Address {
    let point = key.verifying_key().to_encoded_point(false);
    let mut xy = [0; 64];
    xy.copy_from_slice(&point.as_bytes()[1..65]);
    Address::from_public_key(&xy)
}

// Founding a new chain, and recognising an existing one: chain id, keys, genesis block.

/// Length of the random part of a genesis block, which also commits to the consensus.
const RANDOM: usize = 16;

/// The founding data of a chain.
pub struct Founded {
    /// Its chain id.
    pub chain_id: u64,
    /// How its blocks are sealed.
    pub consensus: Consensus,
    /// The same, with its keys.
    pub sealing: Sealing,
    /// Its first block.
    pub genesis: Header,
}

/// The chain in the file, or a new one.
///
/// # Errors
/// [`ChainError::OtherConsensus`] if a different consensus is requested from the one the chain was founded with,
/// [`ChainError::Tampered`] if the founding data do not match the genesis block.
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
    if let Sealing::Authority(authority) = &sealing {
        let sealed = authority.seal(&mut genesis, 0);
        sealed.ok_or_else(|| ChainError::Internal("the genesis block could not be sealed".into()))?;
    }
    let founding = Founding { chain_id: (1 << 40) + id % (1 << 47), consensus, keys };
    file.found(&founding, &genesis)?;
    Ok(founding)
}

/// 16 random bytes, and 16 bytes of the Keccak-256 of them and the consensus, which therefore cannot be changed later.
fn commitment(random: [u8; RANDOM], consensus: &Consensus) -> Hash {
    let mut unique = keccak256([&random[..], consensus.to_string().as_bytes()].concat());
    unique[..RANDOM].copy_from_slice(&random);
    Hash(unique)
}

fn noise<const N: usize>() -> Result<[u8; N], ChainError> {
    let mut noise = [0; N];
    getrandom::fill(&mut noise).map_err(|error| ChainError::Internal(format!("no randomness: {error}")))?;
    Ok(noise)
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
    let committed = Sealing::unique(&header).is_some_and(|unique| {
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

    fn authority(signers: u8) -> Authority {
        let keys = (1..=signers).map(|number| SigningKey::from_slice(&[number; 32]).expect("key"));
        Authority::new(keys.collect(), Duration::from_secs(2))
    }

    #[test]
    fn signers_take_turns_in_the_order_of_their_addresses() {
        let mut authority = authority(3);
        assert!(authority.addresses().is_sorted());
        for number in 1..10 {
            let turn = authority.turn(number, Hash([1; 32])).expect("somebody");
            let expected =
                Turn { signer: usize::try_from(number % 3).expect("small"), difficulty: 2, delay: Duration::ZERO };
            assert_eq!(turn, expected);
            authority.sealed(number, turn.signer);
        }
        assert_eq!(authority.total_difficulty(9), 19);
    }

    #[test]
    fn another_steps_in_and_nobody_seals_twice_within_half_the_set_and_one() {
        for signers in 3..=16u8 {
            let mut authority = authority(signers);
            authority.send_away(1 << 1);
            let rest = usize::from(signers) / 2;
            let mut order = Vec::new();
            for number in 1..100 {
                let turn = authority.turn(number, Hash([u8::try_from(number).expect("small"); 32])).expect("somebody");
                assert_ne!(turn.signer, 1, "that one is away");
                assert!(!order.iter().rev().take(rest).any(|earlier| *earlier == turn.signer), "{order:?}");
                let in_turn = authority.in_turn(number) == turn.signer;
                assert_eq!(turn.difficulty, if in_turn { 2 } else { 1 });
                assert_eq!(in_turn, turn.delay.is_zero());
                assert!(turn.delay <= WIGGLE * u32::from(signers / 2 + 1));
                authority.sealed(number, turn.signer);
                order.push(turn.signer);
            }
            let blocks = 1..=99;
            let sum: u64 = blocks
                .map(|number| authority.difficulty(number, order[usize::try_from(number - 1).expect("small")]))
                .sum();
            assert_eq!(authority.total_difficulty(99), 1 + sum);
        }
    }

    #[test]
    fn too_many_away_stop_the_chain() {
        let mut authority = authority(2);
        authority.send_away(1);
        let turn = authority.turn(2, Hash([1; 32])).expect("the other one");
        assert_eq!((turn.signer, turn.difficulty), (1, 1));
        authority.sealed(2, 1);
        assert_eq!(authority.turn(3, Hash([1; 32])), None, "it has to rest");
    }

    #[test]
    fn checks_of_a_block() {
        let mut authority = authority(3);
        let block = |number, signer, difficulty| {
            let zero = Address([0; 20]);
            let mut header = Header { number, ..Header::genesis(&[zero], zero, difficulty, Hash([2; 32]), 100) };
            authority.seal(&mut header, signer).expect("seals");
            header
        };
        let (good, shifted, lazy) = (block(4, 1, 2), block(4, 2, 1), block(4, 1, 1));
        let mut strange = good.clone();
        strange.seal(&SigningKey::from_slice(&[99; 32]).expect("key")).expect("seals");
        assert_eq!(authority.check(&good, 98), Ok(1));
        assert_eq!(authority.check(&shifted, 98), Ok(2));
        assert!(authority.check(&good, 99).expect_err("early").contains("period"));
        assert!(authority.check(&lazy, 98).expect_err("difficulty").contains("difficulty"));
        assert!(authority.check(&block(4, 2, 2), 98).expect_err("difficulty").contains("difficulty"));
        assert!(authority.check(&strange, 98).expect_err("stranger").contains("not sealed by a signer"));
        authority.sealed(3, 1);
        assert!(authority.check(&good, 98).expect_err("rest").contains("wait"));
        assert_eq!(authority.check(&shifted, 98), Ok(2));
    }
}
