//! What all variants of SM3 (GB/T 32905-2016) share: constants, padding, and how a single message is hashed.
#![allow(unsafe_code, reason = "calls of functions that need features of the processor, which were asked for")]

use ::sm3::Sm3Core;
use ::sm3::digest::array::Array;
use ::sm3::digest::block_api::UpdateCore as _;
use ::sm3::digest::common::hazmat::SerializableState as _;

#[cfg(target_arch = "x86_64")]
use super::{sm3_avx2, sm3_avx512};

pub(crate) const BLOCK: usize = 64;

/// The state before the first block (4.1).
pub(crate) const INITIAL: [u32; 8] =
    [0x7380_166f, 0x4914_b2b9, 0x1724_42d7, 0xda8a_0600, 0xa96f_30bc, 0x1631_38aa, 0xe38d_ee4d, 0xb0fb_0e4e];

/// T_j rotated left by j (4.2, 5.3.3).
pub(super) const CONSTANTS: [u32; 64] = {
    let (mut constants, mut round) = ([0u32; 64], 0u32);
    while round < 64 {
        let constant: u32 = if round < 16 { 0x79cc_4519 } else { 0x7a87_9d8a };
        constants[round as usize] = constant.rotate_left(round % 32);
        round += 1;
    }
    constants
};

/// The fewest groups of blocks for which vectors pay.
#[cfg(target_arch = "x86_64")]
const FEWEST: usize = 2;

/// The rest of a message of `length` bytes after its whole blocks, with its padding (5.2), in one or two blocks.
pub(crate) fn ending(rest: &[u8], length: u64) -> ([[u8; BLOCK]; 2], usize) {
    let mut end = [[0; BLOCK]; 2];
    let count = if rest.len() < BLOCK - 8 { 1 } else { 2 };
    end[0][..rest.len()].copy_from_slice(rest);
    end[0][rest.len()] = 0x80;
    end[count - 1][BLOCK - 8..].copy_from_slice(&length.wrapping_mul(8).to_be_bytes());
    (end, count)
}

/// Compresses blocks of one message into its state (5.3).
pub(crate) fn compress(state: &mut [u32; 8], blocks: &[[u8; BLOCK]]) {
    let rest = by_vectors(state, blocks);
    if !rest.is_empty() {
        by_crate(state, rest);
    }
}

/// Compresses as many blocks as vectors pay for; returns the others.
#[cfg(target_arch = "x86_64")]
fn by_vectors<'a>(state: &mut [u32; 8], blocks: &'a [[u8; BLOCK]]) -> &'a [[u8; BLOCK]] {
    let turns = is_x86_feature_detected!("bmi1") && is_x86_feature_detected!("bmi2");
    let (groups, rest) = blocks.as_chunks();
    if groups.len() >= FEWEST && turns && is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512bw") {
        // SAFETY: the features were just detected.
        unsafe { sm3_avx512::compress_one(state, groups) };
        return rest;
    }
    let (groups, rest) = blocks.as_chunks();
    if groups.len() >= FEWEST && turns && is_x86_feature_detected!("avx2") {
        // SAFETY: the features were just detected.
        unsafe { sm3_avx2::compress_one(state, groups) };
        return rest;
    }
    blocks
}

#[cfg(not(target_arch = "x86_64"))]
fn by_vectors<'a>(_: &mut [u32; 8], blocks: &'a [[u8; BLOCK]]) -> &'a [[u8; BLOCK]] {
    blocks
}

/// Hands blocks to the crate starting from our state: its serialised form is the state's words, and a block count that
/// only its own padding needs.
pub(super) fn by_crate(state: &mut [u32; 8], blocks: &[[u8; BLOCK]]) {
    let mut form = [0; 40];
    for (bytes, word) in form.as_chunks_mut::<4>().0.iter_mut().zip(&*state) {
        *bytes = word.to_le_bytes();
    }
    let Ok(mut core) = Sm3Core::deserialize(&form.into()) else { unreachable!("every state is one") };
    core.update_blocks(Array::cast_slice_from_core(blocks));
    for (word, bytes) in state.iter_mut().zip(core.serialize().as_chunks::<4>().0) {
        *word = u32::from_le_bytes(*bytes);
    }
}
