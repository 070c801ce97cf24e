//! The compression function of SM3 (GB/T 32905-2016, 5.3) on 16 messages side by side, with AVX-512.
//! Safety: the features are checked before [`super`] calls; loads and stores are unaligned and cover whole arrays.
#![allow(unsafe_code, reason = "vector loads and stores, see above")]
#![allow(clippy::many_single_char_names, reason = "the standard's names: A to H")]

use std::arch::x86_64::*;

use super::sm3::{BLOCK, CONSTANTS};
use super::sm3_lanes::States;
use super::sm3_single::{self, MIXED, Rows, sm3_vectors};

pub(super) const LANES: usize = 16;
/// Functions of three operands: the XOR, the majority, and the choice (the second where the first is set, else the
/// third).
const XOR: i32 = 0x96;
const MAJORITY: i32 = 0xe8;
const CHOICE: i32 = 0xca;

#[inline]
#[target_feature(enable = "avx512f")]
fn load(array: &[u32; LANES]) -> __m512i {
    // SAFETY: 64 bytes, all of them initialised, unaligned.
    unsafe { _mm512_loadu_si512(array.as_ptr().cast()) }
}

#[inline]
#[target_feature(enable = "avx512f")]
fn load_block(array: &[u8; BLOCK]) -> __m512i {
    // SAFETY: 64 bytes, unaligned.
    unsafe { _mm512_loadu_si512(array.as_ptr().cast()) }
}

#[inline]
#[target_feature(enable = "avx512f")]
fn store(array: &mut [u32; LANES], vector: __m512i) {
    // SAFETY: 64 bytes, exclusively borrowed, unaligned.
    unsafe { _mm512_storeu_si512(array.as_mut_ptr().cast(), vector) }
}

/// Rows to columns.
#[inline]
#[target_feature(enable = "avx512f")]
fn transposed(rows: &[__m512i; LANES]) -> [__m512i; LANES] {
    let mut pairs = *rows;
    for at in (0..16).step_by(2) {
        pairs[at] = _mm512_unpacklo_epi32(rows[at], rows[at + 1]);
        pairs[at + 1] = _mm512_unpackhi_epi32(rows[at], rows[at + 1]);
    }
    let mut fours = pairs;
    for at in (0..16).step_by(4) {
        fours[at] = _mm512_unpacklo_epi64(pairs[at], pairs[at + 2]);
        fours[at + 1] = _mm512_unpackhi_epi64(pairs[at], pairs[at + 2]);
        fours[at + 2] = _mm512_unpacklo_epi64(pairs[at + 1], pairs[at + 3]);
        fours[at + 3] = _mm512_unpackhi_epi64(pairs[at + 1], pairs[at + 3]);
    }
    let mut columns = fours;
    for at in 0..4 {
        let (one, other) = (
            [
                _mm512_shuffle_i32x4::<0x88>(fours[at], fours[at + 4]),
                _mm512_shuffle_i32x4::<0xdd>(fours[at], fours[at + 4]),
            ],
            [
                _mm512_shuffle_i32x4::<0x88>(fours[at + 8], fours[at + 12]),
                _mm512_shuffle_i32x4::<0xdd>(fours[at + 8], fours[at + 12]),
            ],
        );
        columns[at] = _mm512_shuffle_i32x4::<0x88>(one[0], other[0]);
        columns[at + 4] = _mm512_shuffle_i32x4::<0x88>(one[1], other[1]);
        columns[at + 8] = _mm512_shuffle_i32x4::<0xdd>(one[0], other[0]);
        columns[at + 12] = _mm512_shuffle_i32x4::<0xdd>(one[1], other[1]);
    }
    columns
}

/// The first 16 words of each block, a block to a lane.
#[inline]
#[target_feature(enable = "avx512f,avx512bw")]
fn words<'a>(blocks: impl Iterator<Item = &'a [u8; BLOCK]>) -> [__m512i; LANES] {
    let swap = _mm512_broadcast_i32x4(_mm_set_epi64x(0x0c0d_0e0f_0809_0a0b, 0x0405_0607_0001_0203));
    let mut rows = [_mm512_setzero_si512(); LANES];
    for (row, block) in rows.iter_mut().zip(blocks) {
        *row = _mm512_shuffle_epi8(load_block(block), swap);
    }
    transposed(&rows)
}

#[inline]
#[target_feature(enable = "avx512f")]
fn turned<const BY: i32>(words: __m512i) -> __m512i {
    _mm512_rol_epi32::<BY>(words)
}

#[inline]
#[target_feature(enable = "avx512f")]
fn sum(one: __m512i, two: __m512i, three: __m512i) -> __m512i {
    _mm512_ternarylogic_epi32::<XOR>(one, two, three)
}

/// FF and GG of a round (5.3.4): before round 16 both are the XOR.
#[inline]
#[target_feature(enable = "avx512f")]
fn chosen(round: usize, [a, b, c]: [__m512i; 3], [e, f, g]: [__m512i; 3]) -> (__m512i, __m512i) {
    if round < 16 {
        return (sum(a, b, c), sum(e, f, g));
    }
    (_mm512_ternarylogic_epi32::<MAJORITY>(a, b, c), _mm512_ternarylogic_epi32::<CHOICE>(e, f, g))
}

sm3_vectors!("avx512f,avx512bw", __m512i, _mm512_setzero_si512, _mm512_set1_epi32, _mm512_add_epi32, _mm512_xor_si512);

/// Compresses groups of 16 blocks of one message into its state.
#[target_feature(enable = "avx512f,avx512bw,bmi1,bmi2")]
pub(super) fn compress_one(state: &mut [u32; 8], groups: &[[[u8; BLOCK]; LANES]]) {
    sm3_single::groups(state, groups, |rows, group| begin(rows, group), |rows, at| row(rows, at));
}
