//! Proof of work: a nonce whose Keccak-256 with the block's hash is at most 2^256 / difficulty.
//!
//! It is real work, but not ethash: no memory-hard data set, a far cheaper hash. Difficulties mean the same (hashes per
//! block on average), but a hash takes a different time.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use ethers::types::U256;
use sha3::{Digest as _, Keccak256};

use crate::model::Hash;

/// The extra data of every block after the first, so that no reader mistakes it for ethash.
pub const EXTRA: [u8; 32] = *b"AuthROS Keccak-256, not ethash\0\0";

/// Hashes between checks whether to stop.
const STRIDE: u64 = 1024;

/// The highest hash that seals a block: ⌊2^256 / difficulty⌋, and 2^256 - 1 for difficulty 1.
pub fn target(difficulty: u64) -> [u8; 32] {
    let difficulty = U256::from(difficulty.max(1));
    let (quotient, rest) = U256::MAX.div_mod(difficulty);
    // 2^256 does not fit: its quotient is one higher if the remainder of 2^256 - 1 is the largest.
    let carry = U256::from(u8::from(rest == difficulty - 1));
    let mut bytes = [0; 32];
    quotient.saturating_add(carry).to_big_endian(&mut bytes);
    bytes
}

/// Whether `nonce` seals a block with that work hash.
pub fn seals(work_hash: Hash, nonce: u64, difficulty: u64) -> bool {
    let begun = Keccak256::new_with_prefix(work_hash.as_bytes());
    meets(&begun, nonce, &target(difficulty))
}

fn meets(begun: &Keccak256, nonce: u64, target: &[u8; 32]) -> bool {
    let hash: [u8; 32] = begun.clone().chain_update(nonce.to_be_bytes()).finalize().into();
    hash <= *target
}

/// A search for a nonce, on a thread of its own. Dropping it ends it.
pub struct Search {
    cancelled: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Search {
    /// Searches from `first` on, and reports the first nonce that seals the block.
    ///
    /// # Errors
    /// If no thread can be started.
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

#[cfg(test)]
mod tests {
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
