//! SM4 with AES-NI and AVX2: the field inversion comes from AES's last round (AESENCLAST); the affine maps around it
//! are nibble look-ups within a register.
//! Safety: nothing but the intrinsics of features that are checked before [`super`] calls.

use std::arch::x86_64::*;

use zeroize::Zeroizing;

use super::avx2::{GROUP, Group, add_group, counters, diffused, mixed, shuffled, sm4_vectors, without_first};
use super::sbox::{CONSTANT_AFTER, CONSTANT_BEFORE, MATRIX_AFTER, MATRIX_BEFORE, product, round_keys};
use super::{Counter, FIRST};

/// An affine map as two sums: one for the lower half of a byte, one for the upper.
struct Halves {
    low: [u8; 16],
    high: [u8; 16],
}

/// Before AESENCLAST: SM4's map into the field.
const BEFORE: Halves = halves(false);
/// After it: undoes AES's own affine map, whose inverse is z<<<1 ^ z<<<3 ^ z<<<6 ^ 05, then applies SM4's.
const AFTER: Halves = halves(true);

const fn image(byte: u8, after: bool) -> u8 {
    if after {
        let inverse = byte.rotate_left(1) ^ byte.rotate_left(3) ^ byte.rotate_left(6);
        product(MATRIX_AFTER, inverse)
    } else {
        product(MATRIX_BEFORE, byte)
    }
}

const fn halves(after: bool) -> Halves {
    let constant = if after { product(MATRIX_AFTER, 0x05) ^ CONSTANT_AFTER } else { CONSTANT_BEFORE };
    let (mut low, mut high, mut half) = ([0; 16], [0; 16], 0u8);
    while half < 16 {
        low[half as usize] = image(half, after) ^ constant;
        high[half as usize] = image(half << 4, after);
        half += 1;
    }
    Halves { low, high }
}

#[inline]
#[target_feature(enable = "avx2")]
fn table(bytes: [u8; 16]) -> __m128i {
    let halves = bytes.as_chunks::<8>().0;
    _mm_set_epi64x(i64::from_le_bytes(halves[1]), i64::from_le_bytes(halves[0]))
}

#[inline]
#[target_feature(enable = "avx2")]
fn mapped(bytes: __m256i, map: &Halves) -> __m256i {
    let mask = _mm256_set1_epi8(0x0f);
    let (low, high) = (_mm256_and_si256(bytes, mask), _mm256_and_si256(_mm256_srli_epi16::<4>(bytes), mask));
    let tables = [table(map.low), table(map.high)].map(|table| _mm256_set_m128i(table, table));
    _mm256_xor_si256(_mm256_shuffle_epi8(tables[0], low), _mm256_shuffle_epi8(tables[1], high))
}

#[inline]
#[target_feature(enable = "avx2,aes")]
fn substituted(bytes: __m256i) -> __m256i {
    let bytes = mapped(bytes, &BEFORE);
    let zero = _mm_setzero_si128();
    let low = _mm_aesenclast_si128(_mm256_castsi256_si128(bytes), zero);
    let high = _mm_aesenclast_si128(_mm256_extracti128_si256::<1>(bytes), zero);
    let bytes = mapped(_mm256_set_m128i(high, low), &AFTER);
    // Undoes AES's ShiftRows.
    shuffled(bytes, _mm_setr_epi8(0, 13, 10, 7, 4, 1, 14, 11, 8, 5, 2, 15, 12, 9, 6, 3))
}

sm4_vectors!("avx2,aes", 8, _mm256_setzero_si256, _mm256_set1_epi32, _mm256_cvtsi256_si32);
