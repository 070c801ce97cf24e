//! Numbers of 256 bits in four limbs, lowest first. Everything here takes the same time for all values: carries and
//! masks, no branches and no indexing.

use std::hint::black_box;

/// A number below 2^256.
pub(super) type Limbs = [u64; 4];

/// `a + b` and the carry.
#[inline(always)]
pub(super) fn add(a: &Limbs, b: &Limbs) -> (Limbs, bool) {
    let (first, carry) = a[0].carrying_add(b[0], false);
    let (second, carry) = a[1].carrying_add(b[1], carry);
    let (third, carry) = a[2].carrying_add(b[2], carry);
    let (fourth, carry) = a[3].carrying_add(b[3], carry);
    ([first, second, third, fourth], carry)
}

/// `a - b` and the borrow.
#[inline(always)]
pub(super) fn subtract(a: &Limbs, b: &Limbs) -> (Limbs, bool) {
    let (first, borrow) = a[0].borrowing_sub(b[0], false);
    let (second, borrow) = a[1].borrowing_sub(b[1], borrow);
    let (third, borrow) = a[2].borrowing_sub(b[2], borrow);
    let (fourth, borrow) = a[3].borrowing_sub(b[3], borrow);
    ([first, second, third, fourth], borrow)
}

/// All ones if `bit` is set, otherwise zero. The compiler must not learn that it is one of the two, or it may branch.
#[inline(always)]
pub(super) fn mask(bit: bool) -> u64 {
    black_box(0u64.wrapping_sub(u64::from(bit)))
}

/// `a` if all bits of `mask` are set, `b` if none is.
#[inline(always)]
pub(super) fn select(mask: u64, a: &Limbs, b: &Limbs) -> Limbs {
    let one = |at: usize| b[at] ^ (mask & (a[at] ^ b[at]));
    [one(0), one(1), one(2), one(3)]
}

/// All ones if `number` is zero, otherwise zero; hidden from the compiler as above.
#[inline(always)]
pub(super) fn mask_of_zero(number: u64) -> u64 {
    let nonzero = (number | number.wrapping_neg()) >> 63;
    black_box(nonzero.wrapping_sub(1))
}

/// All ones if the number is zero, otherwise zero.
#[inline(always)]
pub(super) fn is_zero(number: &Limbs) -> u64 {
    mask_of_zero(number[0] | number[1] | number[2] | number[3])
}

/// `a - modulus` if that is not negative, with `carry` counting as 2^256, otherwise `a`. The result is below the
/// modulus if `a` with its carry was below twice the modulus.
#[inline(always)]
pub(super) fn reduce_once(a: &Limbs, carry: bool, modulus: &Limbs) -> Limbs {
    let (less, borrow) = subtract(a, modulus);
    // Negative only if a was below the modulus and had no carry.
    select(mask(borrow) & !mask(carry), a, &less)
}

/// `a + b` modulo `modulus`, for numbers below it.
#[inline(always)]
pub(super) fn add_modulo(a: &Limbs, b: &Limbs, modulus: &Limbs) -> Limbs {
    let (sum, carry) = add(a, b);
    reduce_once(&sum, carry, modulus)
}

/// `a - b` modulo `modulus`, for numbers below it.
#[inline(always)]
pub(super) fn subtract_modulo(a: &Limbs, b: &Limbs, modulus: &Limbs) -> Limbs {
    let (difference, borrow) = subtract(a, b);
    let mask = mask(borrow);
    add(&difference, &[modulus[0] & mask, modulus[1] & mask, modulus[2] & mask, modulus[3] & mask]).0
}

/// The product, eight limbs.
#[inline(always)]
pub(super) fn product(a: &Limbs, b: &Limbs) -> [u64; 8] {
    let mut out = [0; 8];
    let mut row = 0;
    while row < 4 {
        let (low, carry) = a[0].carrying_mul_add(b[row], out[row], 0);
        out[row] = low;
        let (low, carry) = a[1].carrying_mul_add(b[row], out[row + 1], carry);
        out[row + 1] = low;
        let (low, carry) = a[2].carrying_mul_add(b[row], out[row + 2], carry);
        out[row + 2] = low;
        let (low, carry) = a[3].carrying_mul_add(b[row], out[row + 3], carry);
        out[row + 3] = low;
        out[row + 4] = carry;
        row += 1;
    }
    out
}

/// From 32 bytes, big endian.
pub(super) fn from_bytes(bytes: &[u8; 32]) -> Limbs {
    let mut limbs = [0; 4];
    for (limb, chunk) in limbs.iter_mut().rev().zip(bytes.as_chunks::<8>().0) {
        *limb = u64::from_be_bytes(*chunk);
    }
    limbs
}

/// 32 bytes, big endian.
pub(super) fn to_bytes(limbs: &Limbs) -> [u8; 32] {
    let mut bytes = [0; 32];
    for (limb, chunk) in limbs.iter().rev().zip(bytes.as_chunks_mut::<8>().0) {
        *chunk = limb.to_be_bytes();
    }
    bytes
}
