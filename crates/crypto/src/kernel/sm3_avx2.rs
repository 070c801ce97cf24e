//! The compression function of SM3 (GB/T 32905-2016, 5.3) on 8 messages side by side, with AVX2.
//! Safety: the features are checked before [`super`] calls; loads and stores are unaligned and cover whole arrays.
#![allow(unsafe_code, reason = "vector loads and stores, see above")]
#![allow(clippy::many_single_char_names, reason = "the standard's names: A to H")]

use std::arch::x86_64::{
    __m256i, _mm_cvtsi32_si128, _mm256_add_epi32, _mm256_and_si256, _mm256_loadu_si256, _mm256_or_si256,
    _mm256_set1_epi32, _mm256_setzero_si256, _mm256_sll_epi32, _mm256_srl_epi32, _mm256_storeu_si256, _mm256_xor_si256,
};

use super::sm3::{BLOCK, CONSTANTS};
use super::sm3_lanes::States;
use super::sm3_single::{self, MIXED, Rows};

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

/// Word `at` of each block.
#[inline]
#[target_feature(enable = "avx2")]
fn words<'a>(blocks: impl Iterator<Item = &'a [u8; BLOCK]>, at: usize) -> __m256i {
    let mut words = [0; LANES];
    for (word, block) in words.iter_mut().zip(blocks) {
        *word = u32::from_be_bytes(block.as_chunks::<4>().0[at]);
    }
    load(&words)
}

/// The word that follows 16 words, given `w(0)`, the oldest, to `w(15)` (5.3.2).
#[inline]
#[target_feature(enable = "avx2")]
fn next(w: impl Fn(usize) -> __m256i) -> __m256i {
    let mixed = sum(w(0), w(7), turned::<15>(w(13)));
    let mixed = sum(mixed, turned::<15>(mixed), turned::<23>(mixed));
    sum(mixed, turned::<7>(w(3)), w(10))
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

/// Compresses one block of each of 8 messages into their states.
#[target_feature(enable = "avx2")]
pub(super) fn compress(states: &mut States<LANES>, blocks: &[&[u8; BLOCK]; LANES]) {
    let mut w = [_mm256_setzero_si256(); 16];
    for (at, word) in w.iter_mut().enumerate() {
        *word = words(blocks.iter().copied(), at);
    }
    let mut before = [_mm256_setzero_si256(); 8];
    for (vector, words) in before.iter_mut().zip(states.iter()) {
        *vector = load(words);
    }
    let [mut a, mut b, mut c, mut d, mut e, mut f, mut g, mut h] = before;
    for round in 0..64 {
        let word = w[round % 16];
        if round >= 12 {
            w[(round + 4) % 16] = next(|at| w[(round + 4 + at) % 16]);
        }
        let mixed = _mm256_xor_si256(word, w[(round + 4) % 16]);
        let twelve = turned::<12>(a);
        let key = _mm256_add_epi32(_mm256_set1_epi32(CONSTANTS[round].cast_signed()), e);
        let one = turned::<7>(_mm256_add_epi32(twelve, key));
        let two = _mm256_xor_si256(one, twelve);
        let (ff, gg) = chosen(round, [a, b, c], [e, f, g]);
        let first = _mm256_add_epi32(_mm256_add_epi32(ff, d), _mm256_add_epi32(two, mixed));
        let second = _mm256_add_epi32(_mm256_add_epi32(gg, h), _mm256_add_epi32(one, word));
        let second = sum(second, turned::<9>(second), turned::<17>(second));
        (a, b, c, d) = (first, a, turned::<9>(b), c);
        (e, f, g, h) = (second, e, turned::<19>(f), g);
    }
    for ((words, old), new) in states.iter_mut().zip(before).zip([a, b, c, d, e, f, g, h]) {
        store(words, _mm256_xor_si256(old, new));
    }
}

/// Compresses groups of 8 blocks of one message into its state.
#[target_feature(enable = "avx2,bmi1,bmi2")]
pub(super) fn compress_one(state: &mut [u32; 8], groups: &[[[u8; BLOCK]; LANES]]) {
    sm3_single::groups(state, groups, |rows, group| begin(rows, group), |rows, at| row(rows, at));
}

#[inline]
#[target_feature(enable = "avx2")]
fn begin(rows: &mut Rows<LANES>, group: &[[u8; BLOCK]; LANES]) {
    for (at, row) in rows.0.iter_mut().enumerate().take(16) {
        store(row, words(group.iter(), at));
    }
}

#[inline]
#[target_feature(enable = "avx2")]
fn row(Rows(rows): &mut Rows<LANES>, at: usize) {
    assert!(at < 64, "a block has 64 rounds");
    let next = next(|after| load(&rows[at + after]));
    let mixed = _mm256_xor_si256(load(&rows[at]), load(&rows[at + 4]));
    store(&mut rows[at + 16], next);
    store(&mut rows[at + MIXED], mixed);
}
