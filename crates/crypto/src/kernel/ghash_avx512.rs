//! GHASH with VPCLMULQDQ and AVX-512: 16 blocks between reductions, four to a vector. The remainder and the powers of H
//! are left to [`super::ghash_pclmul`], which explains the mathematics.
//! Safety: the features are checked before [`super`] calls; loads are unaligned and cover whole borrowed arrays.
#![allow(unsafe_code, reason = "vector loads, see above")]

use std::arch::x86_64::*;

use super::ghash_pclmul::{halves, number, reduced};

const XOR: i32 = 0x96;
/// Bytes between reductions.
pub(super) const BATCH: usize = 256;

/// Four products of 256 bits, not yet reduced.
struct Sum {
    low: __m512i,
    middle: __m512i,
    high: __m512i,
}

impl Sum {
    #[inline]
    #[target_feature(enable = "avx512f,vpclmulqdq")]
    fn add(&mut self, left: __m512i, right: __m512i) {
        let (one, other) =
            (_mm512_clmulepi64_epi128::<0x10>(left, right), _mm512_clmulepi64_epi128::<0x01>(left, right));
        self.middle = _mm512_ternarylogic_epi64::<XOR>(self.middle, one, other);
        self.low = _mm512_xor_si512(self.low, _mm512_clmulepi64_epi128::<0x00>(left, right));
        self.high = _mm512_xor_si512(self.high, _mm512_clmulepi64_epi128::<0x11>(left, right));
    }

    #[inline]
    #[target_feature(enable = "avx512f,avx512bw,pclmulqdq,sse2")]
    fn reduced(self) -> __m128i {
        let low = _mm512_xor_si512(self.low, _mm512_bslli_epi128::<8>(self.middle));
        let high = _mm512_xor_si512(self.high, _mm512_bsrli_epi128::<8>(self.middle));
        reduced(folded(low), folded(high))
    }
}

#[inline]
#[target_feature(enable = "avx512f")]
fn folded(vector: __m512i) -> __m128i {
    let one = _mm_xor_si128(_mm512_extracti32x4_epi32::<0>(vector), _mm512_extracti32x4_epi32::<1>(vector));
    let other = _mm_xor_si128(_mm512_extracti32x4_epi32::<2>(vector), _mm512_extracti32x4_epi32::<3>(vector));
    _mm_xor_si128(one, other)
}

#[inline]
#[target_feature(enable = "avx512f")]
fn load(array: &[u8; 64]) -> __m512i {
    // SAFETY: 64 bytes, an unaligned load.
    unsafe { _mm512_loadu_si512(array.as_ptr().cast()) }
}

#[inline]
#[target_feature(enable = "avx512f")]
fn load_numbers(array: &[u128; 4]) -> __m512i {
    // SAFETY: 64 bytes, all of them initialised, an unaligned load.
    unsafe { _mm512_loadu_si512(array.as_ptr().cast()) }
}

/// Adds whole batches to the sum `hash`; `powers` are H^16 .. H^1.
#[target_feature(enable = "avx512f,avx512bw,vpclmulqdq,pclmulqdq,sse2")]
pub(super) fn update(powers: &[u128; 16], hash: u128, batches: &[[u8; BATCH]]) -> u128 {
    let turned = _mm512_broadcast_i32x4(_mm_set_epi64x(0x0001_0203_0405_0607, 0x0809_0a0b_0c0d_0e0f));
    let mut factors = [_mm512_setzero_si512(); 4];
    for (factor, four) in factors.iter_mut().zip(powers.as_chunks::<4>().0) {
        *factor = load_numbers(four);
    }
    let mut hash = halves(hash);
    for batch in batches {
        let zero = _mm512_setzero_si512();
        let mut sum = Sum { low: zero, middle: zero, high: zero };
        let mut carried = _mm512_zextsi128_si512(hash);
        for (factor, blocks) in factors.iter().zip(batch.as_chunks::<64>().0) {
            let blocks = _mm512_shuffle_epi8(load(blocks), turned);
            sum.add(_mm512_xor_si512(blocks, carried), *factor);
            carried = zero;
        }
        hash = sum.reduced();
    }
    number(hash)
}
