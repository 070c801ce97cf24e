//! GHASH (NIST SP 800-38D, 6.4) with PCLMULQDQ: up to 16 blocks between reductions. Blocks are read big endian, so that
//! products are those of POLYVAL (RFC 8452, 3 and appendix A), each with a factor x^-128.
//! Safety: the features are checked before [`super`] calls; loads are unaligned and cover whole blocks.
#![allow(unsafe_code, reason = "vector loads, see above")]

use std::arch::x86_64::*;

/// The upper half of x^128 + x^127 + x^126 + x^121 + 1, without its first term.
const POLYNOMIAL: u64 = 0xc200_0000_0000_0000;

#[inline]
#[target_feature(enable = "sse2")]
pub(super) fn halves(number: u128) -> __m128i {
    let bytes = number.to_le_bytes();
    let halves = bytes.as_chunks::<8>().0;
    _mm_set_epi64x(i64::from_le_bytes(halves[1]), i64::from_le_bytes(halves[0]))
}

#[inline]
#[target_feature(enable = "sse2")]
pub(super) fn number(vector: __m128i) -> u128 {
    let (high, low) = (_mm_cvtsi128_si64(_mm_unpackhi_epi64(vector, vector)), _mm_cvtsi128_si64(vector));
    u128::from(high.cast_unsigned()) << 64 | u128::from(low.cast_unsigned())
}

/// high || low, times x^-128, modulo the polynomial.
#[inline]
#[target_feature(enable = "sse2,pclmulqdq")]
pub(super) fn reduced(low: __m128i, high: __m128i) -> __m128i {
    let polynomial = _mm_set_epi64x(0, POLYNOMIAL.cast_signed());
    let mut low = low;
    for _ in 0..2 {
        let product = _mm_clmulepi64_si128::<0x00>(low, polynomial);
        low = _mm_xor_si128(_mm_shuffle_epi32::<0x4e>(low), product);
    }
    _mm_xor_si128(low, high)
}

/// Products of 256 bits, summed but not yet reduced.
struct Sum {
    low: __m128i,
    middle: __m128i,
    high: __m128i,
}

impl Sum {
    #[inline]
    #[target_feature(enable = "sse2")]
    fn zero() -> Self {
        let zero = _mm_setzero_si128();
        Self { low: zero, middle: zero, high: zero }
    }

    #[inline]
    #[target_feature(enable = "sse2,pclmulqdq")]
    fn add(&mut self, left: __m128i, right: __m128i) {
        let one = _mm_clmulepi64_si128::<0x10>(left, right);
        let other = _mm_clmulepi64_si128::<0x01>(left, right);
        self.middle = _mm_xor_si128(self.middle, _mm_xor_si128(one, other));
        self.low = _mm_xor_si128(self.low, _mm_clmulepi64_si128::<0x00>(left, right));
        self.high = _mm_xor_si128(self.high, _mm_clmulepi64_si128::<0x11>(left, right));
    }

    #[inline]
    #[target_feature(enable = "sse2,pclmulqdq")]
    fn reduced(self) -> __m128i {
        let low = _mm_xor_si128(self.low, _mm_bslli_si128::<8>(self.middle));
        let high = _mm_xor_si128(self.high, _mm_bsrli_si128::<8>(self.middle));
        reduced(low, high)
    }
}

#[inline]
#[target_feature(enable = "sse2,ssse3")]
fn turned(block: &[u8; 16]) -> __m128i {
    // SAFETY: 16 bytes, unaligned.
    let block = unsafe { _mm_loadu_si128(block.as_ptr().cast()) };
    _mm_shuffle_epi8(block, _mm_set_epi64x(0x0001_0203_0405_0607, 0x0809_0a0b_0c0d_0e0f))
}

/// H^16 .. H^1, of which only the last `count` are computed. `key` is POLYVAL's.
#[target_feature(enable = "sse2,pclmulqdq")]
pub(super) fn powers(key: u128, count: usize) -> [u128; 16] {
    let mut powers = [0; 16];
    powers[15] = key;
    for exponent in 2..=count.min(16) {
        // The product of two powers as close as possible, which keeps the chain of products short.
        let (one, other) = (exponent / 2, exponent - exponent / 2);
        let mut product = Sum::zero();
        product.add(halves(powers[16 - one]), halves(powers[16 - other]));
        powers[16 - exponent] = number(product.reduced());
    }
    powers
}

/// Adds up to 16 blocks, by as many of the last powers, and reduces once.
#[inline]
#[target_feature(enable = "sse2,ssse3,pclmulqdq")]
fn added(mut hash: __m128i, blocks: &[[u8; 16]], powers: &[u128]) -> __m128i {
    let mut sum = Sum::zero();
    for (block, power) in blocks.iter().zip(powers) {
        sum.add(_mm_xor_si128(turned(block), hash), halves(*power));
        hash = _mm_setzero_si128();
    }
    sum.reduced()
}

#[target_feature(enable = "sse2,ssse3,pclmulqdq")]
pub(super) fn update(powers: &[u128; 16], hash: u128, blocks: &[[u8; 16]]) -> u128 {
    let (batches, rest) = blocks.as_chunks::<16>();
    let mut hash = halves(hash);
    for batch in batches {
        hash = added(hash, batch, powers);
    }
    if !rest.is_empty() {
        hash = added(hash, rest, &powers[16 - rest.len()..]);
    }
    number(hash)
}
