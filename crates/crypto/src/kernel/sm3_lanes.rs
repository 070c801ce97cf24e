//! SM3 of many short messages: each gets a lane of the vectors, and a lane that finishes takes the next message.
#![allow(unsafe_code, reason = "calls of functions that need features of the processor, which were asked for")]

use super::super::sm3::sm3;
use super::sm3::{BLOCK, INITIAL, ending};
#[cfg(target_arch = "x86_64")]
use super::{sm3_avx2, sm3_avx512};

/// From this length on a message is hashed alone: a single lane is slower than the whole processor.
pub(crate) const LONG: usize = 16 * 1024;
/// The fewest messages for which lanes pay.
const FEWEST: usize = 3;

/// States of messages, word by word.
pub(super) type States<const LANES: usize> = [[u32; LANES]; 8];

/// The SM3 of each message, in order.
pub(crate) fn digest_many(messages: &[&[u8]]) -> Vec<[u8; 32]> {
    #[cfg(target_arch = "x86_64")]
    if messages.len() >= FEWEST {
        if is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512bw") {
            // SAFETY: the features were just detected.
            return in_lanes::<16>(messages, |states, blocks| unsafe { sm3_avx512::compress(states, blocks) });
        }
        if is_x86_feature_detected!("avx2") {
            // SAFETY: the feature was just detected.
            return in_lanes::<8>(messages, |states, blocks| unsafe { sm3_avx2::compress(states, blocks) });
        }
    }
    messages.iter().map(|message| sm3(&[message])).collect()
}

struct Lane<'a> {
    index: usize,
    whole: &'a [[u8; BLOCK]],
    /// The rest of the message with its padding.
    end: [[u8; BLOCK]; 2],
    /// How many blocks of `end` count.
    ends: usize,
    at: usize,
}

impl<'a> Lane<'a> {
    /// Pads a message (5.2).
    fn new(index: usize, message: &'a [u8]) -> Self {
        let (whole, rest) = message.as_chunks::<BLOCK>();
        let (end, ends) = ending(rest, message.len() as u64);
        Self { index, whole, end, ends, at: 0 }
    }

    fn block(&self) -> &[u8; BLOCK] {
        self.whole.get(self.at).unwrap_or_else(|| &self.end[(self.at - self.whole.len()).min(1)])
    }

    fn is_done(&self) -> bool {
        self.at == self.whole.len() + self.ends
    }
}

/// [`digest_many`] with a compression function for `LANES` messages.
pub(super) fn in_lanes<const LANES: usize>(
    messages: &[&[u8]],
    compress: impl Fn(&mut States<LANES>, &[&[u8; BLOCK]; LANES]),
) -> Vec<[u8; 32]> {
    let mut digests = vec![[0; 32]; messages.len()];
    let mut order: Vec<usize> = (0..messages.len()).filter(|&index| messages[index].len() < LONG).collect();
    for index in (0..messages.len()).filter(|&index| messages[index].len() >= LONG) {
        digests[index] = sm3(&[messages[index]]);
    }
    // Taken from the end, longest first, so that the lanes finish together.
    order.sort_by_key(|&index| messages[index].len());
    let mut states = [[0; LANES]; 8];
    let mut lanes: [Option<Lane<'_>>; LANES] = [const { None }; LANES];
    loop {
        for (place, lane) in lanes.iter_mut().enumerate().filter(|(_, lane)| lane.is_none()) {
            *lane = order.pop().map(|index| Lane::new(index, messages[index]));
            states.iter_mut().zip(INITIAL).for_each(|(words, initial)| words[place] = initial);
        }
        if lanes.iter().all(Option::is_none) {
            return digests;
        }
        let mut blocks = [&[0; BLOCK]; LANES];
        for (block, lane) in blocks.iter_mut().zip(&lanes) {
            *block = lane.as_ref().map_or(&[0; BLOCK], Lane::block);
        }
        compress(&mut states, &blocks);
        for (place, lane) in lanes.iter_mut().enumerate() {
            let Some(running) = lane else { continue };
            running.at += 1;
            if running.is_done() {
                digests[running.index] = digest(&states, place);
                *lane = None;
            }
        }
    }
}

fn digest<const LANES: usize>(states: &States<LANES>, place: usize) -> [u8; 32] {
    let mut digest = [0; 32];
    for (bytes, words) in digest.as_chunks_mut::<4>().0.iter_mut().zip(states) {
        *bytes = words[place].to_be_bytes();
    }
    digest
}
