//! The compression function of SM3 (GB/T 32905-2016, 5.3) on 16 messages side by side, with AVX-512.
//! Safety: the features are checked before [`super`] calls; loads and stores are unaligned and cover whole arrays.
#![allow(unsafe_code, reason = "vector loads and stores, see above")]
#![allow(clippy::many_single_char_names, reason = "the standard's names: A to H")]

use std::arch::x86_64::{
    __m512i, _mm_set_epi64x, _mm512_add_epi32, _mm512_broadcast_i32x4, _mm512_loadu_si512, _mm512_rol_epi32,
    _mm512_set1_epi32, _mm512_setzero_si512, _mm512_shuffle_epi8, _mm512_shuffle_i32x4, _mm512_storeu_si512,
    _mm512_ternarylogic_epi32, _mm512_unpackhi_epi32, _mm512_unpackhi_epi64, _mm512_unpacklo_epi32,
    _mm512_unpacklo_epi64, _mm512_xor_si512,
};

use super::sm3::{BLOCK, CONSTANTS};
use super::sm3_lanes::States;
use super::sm3_single::{self, MIXED, Rows};

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

/// The word that follows 16 words, given `w(0)`, the oldest, to `w(15)` (5.3.2).
#[inline]
#[target_feature(enable = "avx512f")]
fn next(w: impl Fn(usize) -> __m512i) -> __m512i {
    let sum = _mm512_ternarylogic_epi32::<XOR>(w(0), w(7), _mm512_rol_epi32::<15>(w(13)));
    let mixed = _mm512_ternarylogic_epi32::<XOR>(sum, _mm512_rol_epi32::<15>(sum), _mm512_rol_epi32::<23>(sum));
    _mm512_ternarylogic_epi32::<XOR>(mixed, _mm512_rol_epi32::<7>(w(3)), w(10))
}

/// Compresses one block of each of 16 messages into their states.
#[target_feature(enable = "avx512f,avx512bw")]
pub(super) fn compress(state: &mut States<LANES>, blocks: &[&[u8; BLOCK]; LANES]) {
    let mut w = words(blocks.iter().copied());
    let mut before = [_mm512_setzero_si512(); 8];
    for (vector, words) in before.iter_mut().zip(state.iter()) {
        *vector = load(words);
    }
    let [mut a, mut b, mut c, mut d, mut e, mut f, mut g, mut h] = before;
    for round in 0..64 {
        let eldest = w[round % 16];
        if round >= 12 {
            w[(round + 4) % 16] = next(|at| w[(round + 4 + at) % 16]);
        }
        let mixed = _mm512_xor_si512(eldest, w[(round + 4) % 16]);
        let turned = _mm512_rol_epi32::<12>(a);
        let key = _mm512_add_epi32(_mm512_set1_epi32(CONSTANTS[round].cast_signed()), e);
        let one = _mm512_rol_epi32::<7>(_mm512_add_epi32(turned, key));
        let two = _mm512_xor_si512(one, turned);
        let (ff, gg) = if round < 16 {
            (_mm512_ternarylogic_epi32::<XOR>(a, b, c), _mm512_ternarylogic_epi32::<XOR>(e, f, g))
        } else {
            (_mm512_ternarylogic_epi32::<MAJORITY>(a, b, c), _mm512_ternarylogic_epi32::<CHOICE>(e, f, g))
        };
        let first = _mm512_add_epi32(_mm512_add_epi32(ff, d), _mm512_add_epi32(two, mixed));
        let second = _mm512_add_epi32(_mm512_add_epi32(gg, h), _mm512_add_epi32(one, eldest));
        let second =
            _mm512_ternarylogic_epi32::<XOR>(second, _mm512_rol_epi32::<9>(second), _mm512_rol_epi32::<17>(second));
        (a, b, c, d) = (first, a, _mm512_rol_epi32::<9>(b), c);
        (e, f, g, h) = (second, e, _mm512_rol_epi32::<19>(f), g);
    }
    for ((words, old), new) in state.iter_mut().zip(before).zip([a, b, c, d, e, f, g, h]) {
        store(words, _mm512_xor_si512(old, new));
    }
}

/// Compresses groups of 16 blocks of one message into its state.
#[target_feature(enable = "avx512f,avx512bw,bmi1,bmi2")]
pub(super) fn compress_one(state: &mut [u32; 8], groups: &[[[u8; BLOCK]; LANES]]) {
    sm3_single::groups(state, groups, |rows, group| begin(rows, group), |rows, at| row(rows, at));
}

#[inline]
#[target_feature(enable = "avx512f,avx512bw")]
fn begin(rows: &mut Rows<LANES>, group: &[[u8; BLOCK]; LANES]) {
    for (row, words) in rows.0.iter_mut().zip(words(group.iter())) {
        store(row, words);
    }
}

#[inline]
#[target_feature(enable = "avx512f")]
fn row(Rows(rows): &mut Rows<LANES>, at: usize) {
    assert!(at < 64, "a block has 64 rounds");
    let next = next(|after| load(&rows[at + after]));
    let mixed = _mm512_xor_si512(load(&rows[at]), load(&rows[at + 4]));
    store(&mut rows[at + 16], next);
    store(&mut rows[at + MIXED], mixed);
}
