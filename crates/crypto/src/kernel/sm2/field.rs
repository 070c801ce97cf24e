//! The field of the SM2 prime p = 2^256 - 2^224 - 2^96 + 2^64 - 1 (GB/T 32918.5-2017, 4). Numbers are kept in
//! Montgomery form: times 2^256, below p. As p is -1 modulo 2^64, reduction takes only shifts and additions.

use std::fmt;
use std::ops::{Add, Mul, Neg, Sub};

use zeroize::Zeroize;

use super::limbs::{self, Limbs};
#[cfg(target_arch = "x86_64")]
use super::way::{multiply, square};
#[cfg(target_arch = "x86_64")]
use super::x86_64::{add, halve, subtract};

pub(super) const MODULUS: Limbs = [u64::MAX, 0xffff_ffff_0000_0000, u64::MAX, 0xffff_fffe_ffff_ffff];
/// 2^512 modulo p.
const SQUARE: Limbs = [0x2_0000_0003, 0x2_ffff_ffff, 0x1_0000_0001, 0x4_0000_0002];

#[derive(Clone, Copy, PartialEq, Eq, Zeroize)]
pub(super) struct Element(Limbs);

/// Leaves out the number, which may belong to a secret point.
impl fmt::Debug for Element {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("Element")
    }
}

impl Element {
    pub const ZERO: Self = Self([0; 4]);
    pub const ONE: Self = Self([1, 0xffff_ffff, 0, 0x1_0000_0000]);

    /// In Montgomery form.
    pub const fn from_montgomery(limbs: Limbs) -> Self {
        Self(limbs)
    }

    #[inline(always)]
    pub fn montgomery(&self) -> &Limbs {
        &self.0
    }

    /// A number below p, otherwise nothing.
    pub fn from_limbs(number: &Limbs) -> Option<Self> {
        let (_, below) = limbs::subtract(number, &MODULUS);
        below.then(|| Self(multiply(number, &SQUARE)))
    }

    pub fn from_bytes(bytes: &[u8; 32]) -> Option<Self> {
        Self::from_limbs(&limbs::from_bytes(bytes))
    }

    /// The plain number, below p.
    pub fn to_limbs(self) -> Limbs {
        multiply(&self.0, &[1, 0, 0, 0])
    }

    pub fn to_bytes(self) -> [u8; 32] {
        limbs::to_bytes(&self.to_limbs())
    }

    #[inline(always)]
    pub fn square(&self) -> Self {
        Self(square(&self.0))
    }

    #[inline(always)]
    pub fn double(&self) -> Self {
        *self + *self
    }

    #[inline(always)]
    pub fn triple(&self) -> Self {
        self.double() + *self
    }

    #[inline(always)]
    pub fn half(&self) -> Self {
        Self(halve(&self.0))
    }

    /// All ones if it is zero, otherwise zero.
    #[inline(always)]
    pub fn is_zero(&self) -> u64 {
        limbs::is_zero(&self.0)
    }

    /// `a` if all bits of `mask` are set, `b` if none is.
    #[inline(always)]
    pub fn select(mask: u64, a: &Self, b: &Self) -> Self {
        Self(limbs::select(mask, &a.0, &b.0))
    }

    /// Negated if all bits of `mask` are set.
    #[inline(always)]
    pub fn negate_if(&self, mask: u64) -> Self {
        Self::select(mask, &-*self, self)
    }

    /// Raised to the power 2^times.
    #[inline(always)]
    fn squared(&self, times: u32) -> Self {
        let mut power = *self;
        let mut done = 0;
        while done < times {
            power = power.square();
            done += 1;
        }
        power
    }

    /// The inverse, and zero for zero: the power p - 2, by a chain that is the same for all numbers.
    pub fn invert(&self) -> Self {
        // onesN is the power 2^N - 1.
        let ones2 = self.square() * *self;
        let ones4 = ones2.squared(2) * ones2;
        let ones8 = ones4.squared(4) * ones4;
        let ones16 = ones8.squared(8) * ones8;
        let ones24 = ones16.squared(8) * ones8;
        let ones28 = ones24.squared(4) * ones4;
        let ones30 = ones28.squared(2) * ones2;
        let ones31 = ones30.square() * *self;
        let ones32 = ones31.square() * *self;
        // p - 2 is 31 ones, a zero, 128 ones, 32 zeros, 62 ones, a zero and a one.
        let mut power = ones31.squared(33) * ones32;
        power = power.squared(32) * ones32;
        power = power.squared(32) * ones32;
        power = power.squared(32) * ones32;
        power = power.squared(64) * ones32;
        power = power.squared(30) * ones30;
        power.squared(2) * *self
    }
}

impl Add for Element {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self(add(&self.0, &other.0))
    }
}

impl Sub for Element {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self(subtract(&self.0, &other.0))
    }
}

impl Neg for Element {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        Self::ZERO - self
    }
}

impl Mul for Element {
    type Output = Self;

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self(multiply(&self.0, &other.0))
    }
}

#[cfg(not(target_arch = "x86_64"))]
use self::{
    by_adding as add, by_halving as halve, by_multiplying as multiply, by_squaring as square,
    by_subtracting as subtract,
};

/// `a + b` modulo p on any processor, for numbers below p.
#[cfg(any(test, not(target_arch = "x86_64")))]
pub(super) fn by_adding(a: &Limbs, b: &Limbs) -> Limbs {
    limbs::add_modulo(a, b, &MODULUS)
}

/// `a - b` modulo p on any processor, for numbers below p.
#[cfg(any(test, not(target_arch = "x86_64")))]
pub(super) fn by_subtracting(a: &Limbs, b: &Limbs) -> Limbs {
    limbs::subtract_modulo(a, b, &MODULUS)
}

/// `a / 2` modulo p on any processor, for a number below p: if it is odd, p is added first.
#[cfg(any(test, not(target_arch = "x86_64")))]
pub(super) fn by_halving(a: &Limbs) -> Limbs {
    let odd = limbs::mask(a[0] & 1 == 1);
    let (even, carry) = limbs::add(a, &MODULUS.map(|limb| limb & odd));
    let next = [even[1], even[2], even[3], u64::from(carry)];
    [0, 1, 2, 3].map(|at| even[at] >> 1 | next[at] << 63)
}

/// `a a / 2^256` modulo p on any processor, for a number below p.
pub(super) fn by_squaring(a: &Limbs) -> Limbs {
    by_multiplying(a, a)
}

/// `a b / 2^256` modulo p on any processor, for numbers below p.
#[inline(never)]
pub(super) fn by_multiplying(a: &Limbs, b: &Limbs) -> Limbs {
    reduced(&limbs::product(a, b))
}

/// A number below p 2^256, divided by 2^256 modulo p.
#[inline]
fn reduced(product: &[u64; 8]) -> Limbs {
    let mut low = [product[0], product[1], product[2], product[3]];
    let mut step = 0;
    while step < 4 {
        low = step_down(&low);
        step += 1;
    }
    let (sum, carry) = limbs::add(&low, &[product[4], product[5], product[6], product[7]]);
    limbs::reduce_once(&sum, carry, &MODULUS)
}

/// With m its lowest limb: the number plus m p, shifted down one limb.
#[inline]
fn step_down(number: &Limbs) -> Limbs {
    let [factor, first, second, third] = *number;
    let (low, high) = (factor << 32, factor >> 32);
    let (raised, _) = limbs::add(&[first, second, third, factor], &[factor, 0, 0, 0]);
    limbs::subtract(&raised, &[low, high, low, high]).0
}
