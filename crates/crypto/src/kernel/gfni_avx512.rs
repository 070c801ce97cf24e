//! SM4 on 64 blocks at once: GFNI and AVX-512. Four groups of 16 blocks hide the latency of the S-box.
//! Safety: the intrinsics need only the features that [`super::Kernel`] has checked before it calls; the only memory
//! access goes through references to whole arrays of 64 bytes, unaligned.
#![allow(unsafe_code, reason = "vector loads and stores, see above")]

use std::arch::x86_64::*;

use zeroize::Zeroizing;

use super::avx2::sm4_vectors;
use super::sbox::{CONSTANT_AFTER, CONSTANT_BEFORE, MATRIX_AFTER, MATRIX_BEFORE, round_keys};
use super::{Counter, FIRST};

/// The XOR of three operands.
const XOR: i32 = 0x96;
/// Bytes in one group: 16 blocks.
const GROUP: usize = 256;

/// Words of 16 blocks, word by word.
type Group = [__m512i; 4];

#[inline]
#[target_feature(enable = "avx512f,avx512bw,gfni")]
fn substituted(bytes: __m512i) -> __m512i {
    let before = _mm512_set1_epi64(MATRIX_BEFORE.cast_signed());
    let after = _mm512_set1_epi64(MATRIX_AFTER.cast_signed());
    let mapped = _mm512_gf2p8affine_epi64_epi8::<{ CONSTANT_BEFORE as i32 }>(bytes, before);
    _mm512_gf2p8affineinv_epi64_epi8::<{ CONSTANT_AFTER as i32 }>(mapped, after)
}

/// The sum that goes through the S-box.
#[inline]
#[target_feature(enable = "avx512f")]
fn mixed([one, two, three]: [__m512i; 3], key: __m512i) -> __m512i {
    _mm512_xor_si512(_mm512_ternarylogic_epi32::<XOR>(one, two, three), key)
}

/// The substituted bytes before they are added: L of GB/T 32907, 6.2.2.
#[inline]
#[target_feature(enable = "avx512f")]
fn diffused(word: __m512i, bytes: __m512i) -> __m512i {
    let two = _mm512_ternarylogic_epi32::<XOR>(word, bytes, _mm512_rol_epi32::<2>(bytes));
    let four = _mm512_ternarylogic_epi32::<XOR>(
        _mm512_rol_epi32::<10>(bytes),
        _mm512_rol_epi32::<18>(bytes),
        _mm512_rol_epi32::<24>(bytes),
    );
    _mm512_xor_si512(two, four)
}

/// The blocks of a group in order, big endian; the counters were laid out so that this transposition within lanes is
/// enough.
#[inline]
#[target_feature(enable = "avx512f,avx512bw")]
fn blocks(group: &Group) -> [__m512i; 4] {
    let swap = _mm512_broadcast_i32x4(_mm_setr_epi32(0x0001_0203, 0x0405_0607, 0x0809_0a0b, 0x0c0d_0e0f));
    // The last word of the state is the first of the block.
    let (first, second) = (_mm512_unpacklo_epi32(group[3], group[2]), _mm512_unpacklo_epi32(group[1], group[0]));
    let (third, fourth) = (_mm512_unpackhi_epi32(group[3], group[2]), _mm512_unpackhi_epi32(group[1], group[0]));
    [
        _mm512_shuffle_epi8(_mm512_unpacklo_epi64(first, second), swap),
        _mm512_shuffle_epi8(_mm512_unpackhi_epi64(first, second), swap),
        _mm512_shuffle_epi8(_mm512_unpacklo_epi64(third, fourth), swap),
        _mm512_shuffle_epi8(_mm512_unpackhi_epi64(third, fourth), swap),
    ]
}

/// 16 counter blocks from `number` on.
#[inline]
#[target_feature(enable = "avx512f")]
fn counters(Counter { nonce, number }: Counter) -> Group {
    let dealt = _mm512_setr_epi32(0, 4, 8, 12, 1, 5, 9, 13, 2, 6, 10, 14, 3, 7, 11, 15);
    let [first, second, third] = nonce.map(|word| _mm512_set1_epi32(word.cast_signed()));
    [first, second, third, _mm512_add_epi32(_mm512_set1_epi32(number.cast_signed()), dealt)]
}

#[inline]
#[target_feature(enable = "avx512f")]
fn add(vector: __m512i, part: &mut [u8; 64]) {
    let place = part.as_mut_ptr();
    // SAFETY: `part` is 64 bytes, borrowed alone; both accesses are unaligned ones.
    unsafe {
        let text = _mm512_loadu_si512(place.cast_const().cast());
        _mm512_storeu_si512(place.cast(), _mm512_xor_si512(text, vector));
    }
}

#[inline]
#[target_feature(enable = "avx512f,avx512bw")]
fn add_group(group: &Group, text: &mut [u8; GROUP]) {
    let stream = blocks(group);
    for (vector, part) in stream.into_iter().zip(text.as_chunks_mut::<64>().0) {
        add(vector, part);
    }
}

/// Sets the first block to zero.
#[inline]
#[target_feature(enable = "avx512f")]
fn without_first(group: &mut Group) {
    for word in &mut group[..3] {
        *word = _mm512_mask_set1_epi32(*word, 1, 0);
    }
}

sm4_vectors!("avx512f,avx512bw,gfni", 16, _mm512_setzero_si512, _mm512_set1_epi32, _mm512_cvtsi512_si32);
