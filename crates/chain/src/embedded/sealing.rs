//! What differs between proof of authority and proof of work: the recipient of the fees, the shape of a header, and
//! what makes a block of the file valid. Blocks run the same way under both.

use std::time::Duration;

use k256::ecdsa::SigningKey;

use super::authority::{Authority, address_of};
use super::block::{Header, unsealed_extra};
use super::machine::Environment;
use super::proof;
use crate::chain::Consensus;
use crate::model::steady_clock::steady_now;
use crate::model::{Address, Hash};

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
