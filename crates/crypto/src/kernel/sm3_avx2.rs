//! The compression function of SM3 (GB/T 32905-2016, 5.3) on 8 messages side by side, with AVX2.
//! Safety: the features are checked before [`super`] calls; loads and stores are unaligned and cover whole arrays.
#![allow(unsafe_code, reason = "vector loads and stores, see above")]
#![allow(clippy::many_single_char_names, reason = "the standard's names: A to H")]

use std::arch::x86_64::*;

use super::sm3::{BLOCK, CONSTANTS};
use super::sm3_lanes::States;
use super::sm3_single::{self, MIXED, Rows, sm3_vectors};

pub(super) const LANES: usize = 8;

#[inline]
#[target_feature(enable = "avx2")]
fn load(array: &[u32; LANES]) -> __m256i {
    // SAFETY: 32 bytes, unaligned.
    unsafe { _mm256_loadu_si256(array.as_ptr().cast()) }
}

#[inline]
#[target_feature(enable = "avx2")]
fn store(array: &mut [u32; LANES], vector: __m256i) {
    // SAFETY: 32 bytes, exclusively borrowed, unaligned.
    unsafe { _mm256_storeu_si256(array.as_mut_ptr().cast(), vector) }
}

#[inline]
#[target_feature(enable = "avx2")]
fn turned<const BY: i32>(words: __m256i) -> __m256i {
    let (by, rest) = (_mm_cvtsi32_si128(BY), _mm_cvtsi32_si128(32 - BY));
    _mm256_or_si256(_mm256_sll_epi32(words, by), _mm256_srl_epi32(words, rest))
}

#[inline]
#[target_feature(enable = "avx2")]
fn sum(one: __m256i, two: __m256i, three: __m256i) -> __m256i {
    _mm256_xor_si256(_mm256_xor_si256(one, two), three)
}

/// The first 16 words of each block, a block to a lane.
#[inline]
#[target_feature(enable = "avx2")]
fn words<'a>(blocks: impl Iterator<Item = &'a [u8; BLOCK]> + Clone) -> [__m256i; 16] {
    let mut vectors = [_mm256_setzero_si256(); 16];
    for (at, vector) in vectors.iter_mut().enumerate() {
        let mut words = [0; LANES];
        for (word, block) in words.iter_mut().zip(blocks.clone()) {
            *word = u32::from_be_bytes(block.as_chunks::<4>().0[at]);
        }
        *vector = load(&words);
    }
    vectors
}

/// FF and GG of a round (5.3.4): before round 16 both are the XOR.
#[inline]
#[target_feature(enable = "avx2")]
fn chosen(round: usize, [a, b, c]: [__m256i; 3], [e, f, g]: [__m256i; 3]) -> (__m256i, __m256i) {
    if round < 16 {
        return (sum(a, b, c), sum(e, f, g));
    }
    let majority = _mm256_or_si256(_mm256_and_si256(a, b), _mm256_and_si256(c, _mm256_or_si256(a, b)));
    let choice = _mm256_xor_si256(_mm256_and_si256(_mm256_xor_si256(f, g), e), g);
    (majority, choice)
}

sm3_vectors!("avx2", __m256i, _mm256_setzero_si256, _mm256_set1_epi32, _mm256_add_epi32, _mm256_xor_si256);

/// Compresses groups of 8 blocks of one message into its state.
#[target_feature(enable = "avx2,bmi1,bmi2")]
pub(super) fn compress_one(state: &mut [u32; 8], groups: &[[[u8; BLOCK]; LANES]]) {
    sm3_single::groups(state, groups, |rows, group| begin(rows, group), |rows, at| row(rows, at));
}
