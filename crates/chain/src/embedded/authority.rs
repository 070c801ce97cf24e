//! Proof of authority as in Clique (EIP-225): signers take turns, and another one steps in if one is away.
//!
//! All signers' keys are in the chain's file, so all of them seal in this process. The genesis block fixes the set:
//! there are no votes.

use std::collections::VecDeque;
use std::time::Duration;

use ethers::utils::keccak256;
use k256::ecdsa::SigningKey;

use super::block::Header;
use crate::model::{Address, Hash};

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

#[cfg(test)]
mod tests {
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
