//! Numbers modulo the order n of the SM2 group (GB/T 32918.5-2017, 4), and the signed digits used to multiply points.
//! Everything here takes the same time for all numbers.

use std::fmt;

use zeroize::{Zeroize, Zeroizing};

use super::limbs::{self, Limbs};

pub(super) const ORDER: Limbs = [0x53bb_f409_39d5_4123, 0x7203_df6b_21c6_052b, u64::MAX, 0xffff_fffe_ffff_ffff];
/// (n - 1) / 2.
pub(super) const HALF: Limbs =
    [0xa9dd_fa04_9cea_a091, 0xb901_efb5_90e3_0295, 0xffff_ffff_ffff_ffff, 0x7fff_ffff_7fff_ffff];
/// 2^512 modulo n.
const SQUARE: Limbs = [0x9011_92af_7c11_4f20, 0x3464_504a_de6f_a2fa, 0x620f_c84c_3aff_e0d4, 0x1eb5_e412_a22b_3d3b];
/// 2^256 modulo n.
const RADIX: Limbs = [0xac44_0bf6_c62a_bedd, 0x8dfc_2094_de39_fad4, 0, 0x1_0000_0000];
/// -1 / n modulo 2^64.
const FACTOR: u64 = 0x327f_9e88_7235_0975;

/// A number modulo n.
#[derive(Clone, Copy, PartialEq, Eq, Zeroize)]
pub(crate) struct Scalar(Limbs);

/// Leaves out the number, which may be a secret.
impl fmt::Debug for Scalar {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("Scalar")
    }
}

impl Scalar {
    pub const ONE: Self = Self([1, 0, 0, 0]);

    /// A number from 1 to n - 1 in 32 bytes, big endian, otherwise nothing.
    pub fn from_bytes(bytes: &[u8; 32]) -> Option<Self> {
        let number = limbs::from_bytes(bytes);
        let (_, below) = limbs::subtract(&number, &ORDER);
        (below && limbs::is_zero(&number) == 0).then_some(Self(number))
    }

    /// Any number of 32 bytes, modulo n.
    pub fn reduced(bytes: &[u8; 32]) -> Self {
        Self::reduced_limbs(&limbs::from_bytes(bytes))
    }

    /// Any number below 2^256, which is below 2 n, modulo n.
    pub(super) fn reduced_limbs(number: &Limbs) -> Self {
        Self(limbs::reduce_once(number, false, &ORDER))
    }

    pub fn to_bytes(self) -> [u8; 32] {
        limbs::to_bytes(&self.0)
    }

    pub(super) fn limbs(&self) -> &Limbs {
        &self.0
    }

    pub fn is_zero(&self) -> bool {
        limbs::is_zero(&self.0) != 0
    }

    pub fn plus(&self, other: &Self) -> Self {
        Self(limbs::add_modulo(&self.0, &other.0, &ORDER))
    }

    pub fn minus(&self, other: &Self) -> Self {
        Self(limbs::subtract_modulo(&self.0, &other.0, &ORDER))
    }

    pub fn times(&self, other: &Self) -> Self {
        Self(multiply(&multiply(&self.0, &SQUARE), &other.0))
    }

    /// The inverse, and zero for zero: the power n - 2 in steps of four bits, the same for all numbers.
    pub fn invert(&self) -> Self {
        let base = Zeroizing::new(multiply(&self.0, &SQUARE));
        let mut powers = Zeroizing::new([RADIX; 16]);
        for at in 1..16 {
            powers[at] = multiply(&powers[at - 1], &base);
        }
        let (exponent, _) = limbs::subtract(&ORDER, &[2, 0, 0, 0]);
        let mut power = Zeroizing::new(RADIX);
        for at in (0..64).rev() {
            for _ in 0..4 {
                *power = multiply(&power, &power);
            }
            // The exponent is not secret.
            let digit = (exponent[at / 16] >> (4 * (at % 16))) & 15;
            *power = multiply(&power, &powers[digit as usize]);
        }
        Self(multiply(&power, &[1, 0, 0, 0]))
    }
}

/// `a b / 2^256` modulo n, for numbers below n.
fn multiply(a: &Limbs, b: &Limbs) -> Limbs {
    let product = limbs::product(a, b);
    let (mut low, high) =
        ([product[0], product[1], product[2], product[3]], [product[4], product[5], product[6], product[7]]);
    let mut step = 0;
    while step < 4 {
        let factor = low[0].wrapping_mul(FACTOR);
        // The lowest limb becomes zero.
        let (_, carry) = factor.carrying_mul_add(ORDER[0], low[0], 0);
        let (first, carry) = factor.carrying_mul_add(ORDER[1], low[1], carry);
        let (second, carry) = factor.carrying_mul_add(ORDER[2], low[2], carry);
        let (third, carry) = factor.carrying_mul_add(ORDER[3], low[3], carry);
        low = [first, second, third, carry];
        step += 1;
    }
    let (sum, carry) = limbs::add(&low, &high);
    limbs::reduce_once(&sum, carry, &ORDER)
}

/// A digit of a number written with digits from -2^(WIDTH - 1) to 2^(WIDTH - 1): its magnitude, and all ones if it is
/// negative.
#[derive(Clone, Copy)]
pub(super) struct Digit {
    pub size: u64,
    pub negative: u64,
}

/// How many digits of `width` bits a number of `bits` bits has; the highest is never negative.
pub(super) const fn digits(bits: usize, width: usize) -> usize {
    // The highest digit needs a zero above the number's bits, or a carry would be lost.
    bits / width + 1
}

/// The digit at `place` (Booth recoding), from its bits and the one below them.
#[inline(always)]
pub(super) fn digit<const WIDTH: usize>(number: &Limbs, place: usize) -> Digit {
    let bits = window(number, place * WIDTH, WIDTH);
    // For a secret it must stay a mask.
    let negative = limbs::mask(bits >> WIDTH != 0);
    let turned = (1u64 << (WIDTH + 1)) - 1 - bits;
    let size = (turned & negative) | (bits & !negative);
    Digit { size: (size >> 1) + (size & 1), negative }
}

/// The `width` bits from `start` on, followed by the bit below `start`.
#[inline(always)]
fn window(number: &Limbs, start: usize, width: usize) -> u64 {
    let mask = (1u64 << (width + 1)) - 1;
    if start == 0 {
        return (number[0] << 1) & mask;
    }
    let (limb, shift) = ((start - 1) / 64, (start - 1) % 64);
    let low = number[limb] >> shift;
    let high = if shift == 0 || limb == 3 { 0 } else { number[limb + 1] << (64 - shift) };
    (low | high) & mask
}
