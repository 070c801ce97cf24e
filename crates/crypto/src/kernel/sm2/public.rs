//! What verification needs: s G + t P for public numbers and points, in a time that depends on them, and the table that
//! makes it faster for known signers.

use std::sync::OnceLock;

use super::limbs::{self, Limbs};
use super::point::{Affine, GENERATOR, Jacobian, Summand, is_above, rows};
use super::scalar::{HALF, ORDER, Scalar, digit, digits};

/// Bits per digit of the generator's factor.
const COMB_WIDTH: usize = 8;
const COMB_ROW: usize = 1 << (COMB_WIDTH - 1);
const COMB_DIGITS: usize = digits(255, COMB_WIDTH);
/// Bits per digit of a known signer's factor.
const WIDTH: usize = 6;
const ROW: usize = 1 << (WIDTH - 1);
const DIGITS: usize = digits(255, WIDTH);
/// A known signer's table has a row for every fourth digit.
const APART: usize = 4;
const ROWS: usize = DIGITS.div_ceil(APART);
/// An unknown signer's factor has odd digits of this many bits, with zeros between.
const NAF_WIDTH: u32 = 5;
const NAF_ROW: usize = 1 << (NAF_WIDTH - 2);
const NAF_DIGITS: usize = 257;

/// 1 to 128 times 2^(8 i) G for each i.
fn comb() -> &'static [Affine] {
    static COMB: OnceLock<Vec<Affine>> = OnceLock::new();
    COMB.get_or_init(|| rows(&GENERATOR, COMB_DIGITS, COMB_WIDTH, COMB_ROW))
}

/// A signer's public key, checked, in the form verification takes.
pub(crate) trait Signer {
    /// t times the public key.
    fn times(&self, t: &Scalar) -> Multiple;
}

/// An intermediate point of a sum.
pub(crate) struct Multiple(pub(super) Jacobian);

/// A number below n as one of at most 255 bits, and whether it is the negative of that.
fn halved(number: &Scalar) -> (Limbs, bool) {
    if is_above(number.limbs(), &HALF) {
        (limbs::subtract(&ORDER, number.limbs()).0, true)
    } else {
        (*number.limbs(), false)
    }
}

/// Adds to `sum` the multiple in a row that a digit selects, negated if `turned`.
#[inline(always)]
fn plus_digit<const BITS: usize>(
    sum: &Jacobian,
    row: &[Affine],
    number: &Limbs,
    place: usize,
    turned: bool,
) -> Jacobian {
    let digit = digit::<BITS>(number, place);
    let entry = usize::try_from(digit.size).ok().and_then(|size| row.get(size.checked_sub(1)?));
    match entry {
        None => *sum,
        Some(entry) if (digit.negative != 0) == turned => sum.plus_affine(entry),
        Some(entry) => sum.plus_affine(&entry.negated()),
    }
}

/// A signer met for the first time.
impl Signer for Affine {
    fn times(&self, t: &Scalar) -> Multiple {
        let row = odd_multiples(self);
        let digits = sparse_digits(t.limbs());
        let length = digits.iter().rposition(|digit| *digit != 0).map_or(0, |last| last + 1);
        let mut sum = Jacobian::INFINITY;
        for digit in digits.into_iter().take(length).rev() {
            sum = sum.double();
            let entry = row.get(usize::from(digit.unsigned_abs() / 2));
            match entry {
                Some(entry) if digit > 0 => sum = sum.plus_summand(entry),
                Some(entry) if digit < 0 => sum = sum.plus_summand(&entry.negated()),
                _ => {}
            }
        }
        Multiple(sum)
    }
}

/// 1, 3, 5 to 15 times a point. Twice the point has another x than its odd multiples, as the group's order is prime.
fn odd_multiples(point: &Affine) -> [Summand; NAF_ROW] {
    let mut row = [Summand::from(Jacobian::from(*point)); NAF_ROW];
    let (mut two, mut multiple) = point.doubled_beside();
    for entry in row.iter_mut().skip(1) {
        (multiple, two) = two.plus_beside(&multiple);
        *entry = Summand::from(multiple);
    }
    row
}

/// The digits, lowest first: zero or odd, from -15 to 15, and at most one non-zero in any five.
pub(super) fn sparse_digits(number: &Limbs) -> [i8; NAF_DIGITS] {
    let mut digits = [0; NAF_DIGITS];
    let (mut place, mut carry) = (0, 0);
    while place < NAF_DIGITS {
        let bits = bits_from(number, place);
        if (bits ^ carry) & 1 == 0 {
            place += 1;
            continue;
        }
        let value = (bits & ((1 << NAF_WIDTH) - 1)) + carry;
        carry = value >> (NAF_WIDTH - 1);
        let size = i8::try_from(value).unwrap_or_default();
        digits[place] = if carry == 1 { size - (1 << NAF_WIDTH) } else { size };
        place += NAF_WIDTH as usize;
    }
    digits
}

/// 64 bits of a number, starting at a given bit.
fn bits_from(number: &Limbs, place: usize) -> u64 {
    let (limb, shift) = (place / 64, place % 64);
    let low = number.get(limb).map_or(0, |limb| limb >> shift);
    let high = number.get(limb + 1).filter(|_| shift > 0).map_or(0, |limb| limb << (64 - shift));
    low | high
}

/// A known signer: 11 rows of 32 multiples, 22 KiB.
pub(crate) struct SignerTable(Box<[Affine]>);

impl SignerTable {
    pub const BYTES: usize = ROWS * ROW * size_of::<Affine>();

    /// Of a public key.
    pub fn new(point: &Affine) -> Self {
        Self(rows(point, ROWS, APART * WIDTH, ROW).into())
    }
}

impl Signer for SignerTable {
    fn times(&self, t: &Scalar) -> Multiple {
        let (number, turned) = halved(t);
        let mut sum = Jacobian::INFINITY;
        for step in (0..APART).rev() {
            for _ in 0..WIDTH {
                sum = sum.double();
            }
            for (at, row) in self.0.chunks_exact(ROW).enumerate() {
                let place = at * APART + step;
                if place < DIGITS {
                    sum = plus_digit::<WIDTH>(&sum, row, &number, place, turned);
                }
            }
        }
        Multiple(sum)
    }
}

/// GB/T 32918.2-2016, 7.1, B5 to B7: whether (r, s) signs the hash e. No division: the sum's x is compared with r - e,
/// and with r - e + n if that is below p.
pub(crate) fn verifies(signer: &impl Signer, e: &Scalar, r: &Scalar, s: &Scalar) -> bool {
    let t = r.plus(s);
    if t.is_zero() {
        return false;
    }
    let Multiple(mut sum) = signer.times(&t);
    let (number, turned) = halved(s);
    for (place, row) in comb().chunks_exact(COMB_ROW).enumerate() {
        sum = plus_digit::<COMB_WIDTH>(&sum, row, &number, place, turned);
    }
    if sum.is_infinity() {
        return false;
    }
    let wanted = r.minus(e);
    let (beyond, carry) = limbs::add(wanted.limbs(), &ORDER);
    sum.has_x(wanted.limbs()) || (!carry && sum.has_x(&beyond))
}

pub(super) fn warm_up() {
    comb();
}
