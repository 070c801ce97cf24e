//! Multiples of points by secret numbers. Every look-up reads its whole row, zero digits are added and discarded, and
//! no branch and no address depends on the number.

use std::sync::OnceLock;

use zeroize::{Zeroize as _, Zeroizing};

use super::complete::{self, Point};
use super::field::Element;
use super::limbs;
use super::point::{Affine, GENERATOR, Jacobian, rows};
use super::scalar::{Digit, Scalar, digit, digits};

/// Bits per digit of the generator's factor.
const COMB_WIDTH: usize = 6;
/// Multiples in a row of the comb.
const COMB_ROW: usize = 1 << (COMB_WIDTH - 1);
const COMB_DIGITS: usize = digits(256, COMB_WIDTH);
/// Bits per digit of any other point's factor.
const WIDTH: usize = 5;
const ROW: usize = 1 << (WIDTH - 1);
const DIGITS: usize = digits(256, WIDTH);

/// 1 to 32 times 2^(6 i) G for each i.
fn comb() -> &'static [Affine] {
    static COMB: OnceLock<Vec<Affine>> = OnceLock::new();
    COMB.get_or_init(|| rows(&GENERATOR, COMB_DIGITS, COMB_WIDTH, COMB_ROW))
}

/// k G, in the same time for every k.
fn times_generator(k: &Scalar) -> Point {
    let mut sum = Point::INFINITY;
    for (place, row) in comb().chunks_exact(COMB_ROW).enumerate() {
        let digit = digit::<COMB_WIDTH>(k.limbs(), place);
        let entry = pick(row, digit);
        let with = sum.plus_affine(&entry);
        sum = Point::select(limbs::mask_of_zero(digit.size), &sum, &with);
    }
    sum
}

/// The multiple that a digit selects; (0, 0) for zero.
#[inline(always)]
fn pick(row: &[Affine], digit: Digit) -> Affine {
    let (mut x, mut y) = ([0; 4], [0; 4]);
    let mut number = 0;
    for entry in row {
        number += 1;
        let mask = limbs::mask_of_zero(number ^ digit.size);
        gather(&mut x, &entry.x, mask);
        gather(&mut y, &entry.y, mask);
    }
    let y = Element::from_montgomery(y).negate_if(digit.negative);
    Affine { x: Element::from_montgomery(x), y }
}

#[inline(always)]
fn gather(sum: &mut limbs::Limbs, element: &Element, mask: u64) {
    let limbs = element.montgomery();
    sum[0] |= limbs[0] & mask;
    sum[1] |= limbs[1] & mask;
    sum[2] |= limbs[2] & mask;
    sum[3] |= limbs[3] & mask;
}

/// The multiple of any point that a digit selects; z is 0 for zero.
#[inline(always)]
fn pick_jacobian(row: &[Jacobian; ROW], digit: Digit) -> Jacobian {
    let (mut x, mut y, mut z) = ([0; 4], [0; 4], [0; 4]);
    let mut number = 0;
    for entry in row {
        number += 1;
        let mask = limbs::mask_of_zero(number ^ digit.size);
        gather(&mut x, &entry.x, mask);
        gather(&mut y, &entry.y, mask);
        gather(&mut z, &entry.z, mask);
    }
    let y = Element::from_montgomery(y).negate_if(digit.negative);
    Jacobian { x: Element::from_montgomery(x), y, z: Element::from_montgomery(z) }
}

fn select(mask: u64, a: &Jacobian, b: &Jacobian) -> Jacobian {
    Jacobian {
        x: Element::select(mask, &a.x, &b.x),
        y: Element::select(mask, &a.y, &b.y),
        z: Element::select(mask, &a.z, &b.z),
    }
}

/// The sum of two points, neither of which is infinity, nor are they equal or opposite.
#[inline(always)]
fn sum_of_different(one: &Jacobian, other: &Jacobian) -> Jacobian {
    let (z2, other_z2) = (one.z.square(), other.z.square());
    let own_x = one.x * other_z2;
    let own_y = one.y * (other_z2 * other.z);
    let difference = other.x * z2 - own_x;
    let slope = other.y * (z2 * one.z) - own_y;
    Jacobian::third((own_x, own_y), difference, slope, one.z * other.z)
}

/// k times a point, in the same time for every k; k is 1 to n - 1.
///
/// The digits of k are taken from the highest; before each the sum is 2^5 M times the point, where M is what the digits
/// so far make, and not negative. Before the last digit, 2^5 M + 16 is below n: the sum is the digit's multiple or its
/// opposite only if it is infinity (M = 0), and selection handles that. At the last digit this does not hold (k = n - 2
/// has the digit -1 there, which doubles): it is added by a formula without special cases.
fn times_point(k: &Scalar, point: &Affine) -> Point {
    let row = Zeroizing::new(first_multiples(point));
    let mut sum = Jacobian::INFINITY;
    for place in (1..DIGITS).rev() {
        sum = five_times_doubled(&sum);
        let digit = digit::<WIDTH>(k.limbs(), place);
        let entry = pick_jacobian(&row, digit);
        let both = sum_of_different(&sum, &entry);
        let either = select(sum.z.is_zero(), &entry, &both);
        sum = select(limbs::mask_of_zero(digit.size), &sum, &either);
    }
    let last = Zeroizing::new(pick_jacobian(&row, digit::<WIDTH>(k.limbs(), 0)));
    let result = Point::from_jacobian(&five_times_doubled(&sum)).plus(&Point::from_jacobian(&last));
    sum.zeroize();
    result
}

#[inline(always)]
fn five_times_doubled(point: &Jacobian) -> Jacobian {
    let mut point = *point;
    for _ in 0..WIDTH {
        point = point.double();
    }
    point
}

/// 1 to 16 times a point: none of them is infinity, and no point is added to itself.
fn first_multiples(point: &Affine) -> [Jacobian; ROW] {
    let mut row = [Jacobian::from(*point); ROW];
    for at in 1..ROW {
        row[at] = if at % 2 == 1 { row[at / 2].double() } else { row[at - 1].plus_affine(point) };
    }
    row
}

pub(crate) fn multiply_generator(k: &Scalar) -> Affine {
    let mut product = times_generator(k);
    let point = product.normalized();
    product.zeroize();
    point
}

pub(crate) fn multiply(k: &Scalar, point: &Affine) -> Affine {
    let mut product = times_point(k, point);
    let out = product.normalized();
    product.zeroize();
    out
}

pub(crate) fn multiply_both(k: &Scalar, point: &Affine) -> [Affine; 2] {
    let (mut one, mut other) = (times_generator(k), times_point(k, point));
    let out = complete::normalized(&one, &other);
    one.zeroize();
    other.zeroize();
    out
}

pub(super) fn warm_up() {
    comb();
}
