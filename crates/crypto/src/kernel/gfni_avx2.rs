//! SM4 with GFNI and AVX2: the S-box is two instructions.
//! Safety: nothing but the intrinsics of features that are checked before [`super`] calls.

use std::arch::x86_64::*;

use zeroize::Zeroizing;

use super::avx2::{GROUP, Group, add_group, counters, diffused, mixed, sm4_vectors, without_first};
use super::sbox::{CONSTANT_AFTER, CONSTANT_BEFORE, MATRIX_AFTER, MATRIX_BEFORE, round_keys};
use super::{Counter, FIRST};

#[inline]
#[target_feature(enable = "avx2,gfni")]
fn substituted(bytes: __m256i) -> __m256i {
    let before = _mm256_set1_epi64x(MATRIX_BEFORE.cast_signed());
    let after = _mm256_set1_epi64x(MATRIX_AFTER.cast_signed());
    let mapped = _mm256_gf2p8affine_epi64_epi8::<{ CONSTANT_BEFORE as i32 }>(bytes, before);
    _mm256_gf2p8affineinv_epi64_epi8::<{ CONSTANT_AFTER as i32 }>(mapped, after)
}

sm4_vectors!("avx2,gfni", 8, _mm256_setzero_si256, _mm256_set1_epi32, _mm256_cvtsi256_si32);
