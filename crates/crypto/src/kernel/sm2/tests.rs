//! The arithmetic compared with num-bigint and the crate sm2, on random numbers and on those that cause carries and
//! special cases.

use num_bigint::{BigInt, BigUint};
use sm2::elliptic_curve::sec1::{FromSec1Point as _, ToSec1Point as _};
use sm2::elliptic_curve::{Group as _, PrimeField as _};
use sm2::{AffinePoint, ProjectivePoint, Sec1Point};

use super::field::{self, Element, MODULUS};
use super::limbs::{self, Limbs};
use super::point::{GENERATOR, Jacobian};
use super::scalar::{HALF, ORDER, digit, digits};
use super::*;
use crate::kernel::tests::Noise;

fn cases(short: usize, long: usize) -> usize {
    if std::env::var_os("AUTHROS_LONG").is_some() { long } else { short }
}

fn big(limbs: &Limbs) -> BigUint {
    BigUint::from_bytes_be(&limbs::to_bytes(limbs))
}

fn limbs_of(number: &BigUint) -> Limbs {
    let bytes = number.to_bytes_be();
    let mut padded = [0; 32];
    padded[32 - bytes.len()..].copy_from_slice(&bytes);
    limbs::from_bytes(&padded)
}

/// A number below the modulus, often with limbs of zeros or ones, or close to the modulus.
fn below(noise: &mut Noise, modulus: &Limbs) -> Limbs {
    loop {
        let mut number = [0; 4].map(|_: u64| match noise.below(8) {
            0 => 0,
            1 => u64::MAX,
            _ => noise.number(),
        });
        match noise.below(16) {
            0 => number = limbs::subtract(modulus, &[1 + noise.number() % 64, 0, 0, 0]).0,
            1 => number = [noise.number() % 64, 0, 0, 0],
            _ => {}
        }
        if limbs::subtract(&number, modulus).1 {
            return number;
        }
    }
}

#[test]
fn the_constants_are_those_of_the_standard() {
    let hex = |text: &str| BigUint::parse_bytes(text.as_bytes(), 16).expect("hex");
    assert_eq!(big(&MODULUS), hex("fffffffeffffffffffffffffffffffffffffffff00000000ffffffffffffffff"));
    assert_eq!(big(&ORDER), hex("fffffffeffffffffffffffffffffffff7203df6b21c6052b53bbf40939d54123"));
    assert_eq!(big(&HALF), (big(&ORDER) - 1u8) / 2u8);
    let b = hex("28e9fa9e9d9f5e344d5a9e4bcf6509a7f39789f515ab8f92ddbcbd414d940e93");
    assert_eq!(big(&point::B.to_limbs()), b);
    let x = hex("32c4ae2c1f1981195f9904466a39c9948fe30bbff2660be1715a4589334c74c7");
    let y = hex("bc3736a2f4f6779c59bdcee36b692153d0a9877cc62a474002df32e52139f0a0");
    assert_eq!((big(&GENERATOR.x.to_limbs()), big(&GENERATOR.y.to_limbs())), (x, y));
    assert_eq!(Element::ONE.to_limbs(), [1, 0, 0, 0]);
}

#[test]
fn the_field_is_that_of_num_bigint() {
    let (mut noise, modulus) = (Noise(21), big(&MODULUS));
    let radix = (BigUint::from(1u8) << 256u32) % &modulus;
    for case in 0..cases(4_000, 1_000_000) {
        let (one, other) = (below(&mut noise, &MODULUS), below(&mut noise, &MODULUS));
        let (a, b) = (Element::from_limbs(&one).expect("below"), Element::from_limbs(&other).expect("below"));
        let (one, other) = (big(&one), big(&other));
        assert_eq!(big(a.montgomery()), &one * &radix % &modulus, "case {case}");
        assert_eq!(big(&(a + b).to_limbs()), (&one + &other) % &modulus, "case {case}");
        assert_eq!(big(&(a - b).to_limbs()), (&modulus + &one - &other) % &modulus, "case {case}");
        assert_eq!(big(&(a * b).to_limbs()), &one * &other % &modulus, "case {case}");
        assert_eq!(big(&a.square().to_limbs()), &one * &one % &modulus, "case {case}");
        assert_eq!(big(&(-a).to_limbs()), (&modulus - &one) % &modulus, "case {case}");
        assert_eq!(big(&a.half().to_limbs()) * 2u8 % &modulus, one, "case {case}");
        if case % 64 == 0 {
            let inverse = one.modpow(&(&modulus - 2u8), &modulus);
            assert_eq!(big(&a.invert().to_limbs()), inverse, "case {case}");
        }
        assert_eq!((a.is_zero() != 0, (a - a).is_zero()), (one == BigUint::ZERO, u64::MAX));
    }
}

/// The results with and without the processor's own instructions.
#[test]
fn both_ways_of_the_field_agree() {
    let mut noise = Noise(22);
    for case in 0..cases(20_000, 10_000_000) {
        // In internal form, so that every pattern of limbs comes up.
        let (one, other) = (below(&mut noise, &MODULUS), below(&mut noise, &MODULUS));
        let (a, b) = (Element::from_montgomery(one), Element::from_montgomery(other));
        assert_eq!(*(a * b).montgomery(), field::by_multiplying(&one, &other), "case {case}");
        assert_eq!(*a.square().montgomery(), field::by_squaring(&one), "case {case}");
        assert_eq!(*(a + b).montgomery(), field::by_adding(&one, &other), "case {case}");
        assert_eq!(*(a - b).montgomery(), field::by_subtracting(&one, &other), "case {case}");
        assert_eq!(*a.half().montgomery(), field::by_halving(&one), "case {case}");
    }
}

#[test]
fn numbers_past_the_modulus_are_no_elements() {
    for beyond in [0u64, 1, 2, 1 << 40] {
        let (number, carry) = limbs::add(&MODULUS, &[beyond, 0, 0, 0]);
        assert!(!carry && Element::from_limbs(&number).is_none());
    }
    assert!(Element::from_limbs(&[u64::MAX; 4]).is_none());
    let last = limbs::subtract(&MODULUS, &[1, 0, 0, 0]).0;
    assert_eq!(Element::from_limbs(&last).expect("below").to_limbs(), last);
}

#[test]
fn scalars_are_those_of_num_bigint() {
    let (mut noise, order) = (Noise(23), big(&ORDER));
    for case in 0..cases(2_000, 500_000) {
        let (one, other) = (below(&mut noise, &ORDER), below(&mut noise, &ORDER));
        let (a, b) = (Scalar::reduced_limbs(&one), Scalar::reduced_limbs(&other));
        let (one, other) = (big(&one), big(&other));
        assert_eq!(big(a.plus(&b).limbs()), (&one + &other) % &order, "case {case}");
        assert_eq!(big(a.minus(&b).limbs()), (&order + &one - &other) % &order, "case {case}");
        assert_eq!(big(a.times(&b).limbs()), &one * &other % &order, "case {case}");
        if case % 64 == 0 {
            assert_eq!(big(a.invert().limbs()), one.modpow(&(&order - 2u8), &order), "case {case}");
        }
        let any: [u8; 32] = noise.array();
        assert_eq!(big(Scalar::reduced(&any).limbs()), BigUint::from_bytes_be(&any) % &order, "case {case}");
    }
}

#[test]
fn scalars_are_read_from_one_to_n_minus_one() {
    let bytes = |number: &Limbs| limbs::to_bytes(number);
    let near = |add: u64| bytes(&limbs::add(&ORDER, &[add, 0, 0, 0]).0);
    for bad in [[0; 32], near(0), near(1), near(2), [0xff; 32]] {
        assert!(Scalar::from_bytes(&bad).is_none(), "{bad:02x?}");
    }
    for good in [bytes(&[1, 0, 0, 0]), bytes(&limbs::subtract(&ORDER, &[1, 0, 0, 0]).0)] {
        assert_eq!(Scalar::from_bytes(&good).expect("in range").to_bytes(), good);
    }
    assert!(Scalar::reduced(&near(0)).is_zero());
    assert_eq!(Scalar::reduced(&near(1)), Scalar::ONE);
}

/// 0 to 40, n - 40 to n - 1, and powers of two with their neighbours.
fn edges() -> Vec<Limbs> {
    let small = (0..=40u64).map(|number| [number, 0, 0, 0]);
    let large = (1..=40u64).map(|number| limbs::subtract(&ORDER, &[number, 0, 0, 0]).0);
    let powers = (0..256u32).flat_map(|power| {
        let power = BigUint::from(1u8) << power;
        [limbs_of(&(&power - 1u8)), limbs_of(&power), limbs_of(&(power + 1u8))]
    });
    let half = (0..4u64).map(|add| limbs::add(&HALF, &[add, 0, 0, 0]).0);
    small.chain(large).chain(powers).chain(half).filter(|number| limbs::subtract(number, &ORDER).1).collect()
}

fn sum_of_digits<const WIDTH: usize>(number: &Limbs, bits: usize) -> BigInt {
    let count = digits(bits, WIDTH);
    let all: Vec<BigInt> = (0..count)
        .map(|place| {
            let digit = digit::<WIDTH>(number, place);
            assert!(digit.size <= 1 << (WIDTH - 1) && (digit.negative == 0 || place + 1 < count));
            let size = BigInt::from(digit.size) << (place * WIDTH);
            if digit.negative == 0 { size } else { -size }
        })
        .collect();
    all.into_iter().sum()
}

#[test]
fn digits_make_up_their_number() {
    let mut noise = Noise(24);
    let random: Vec<Limbs> = (0..500).map(|_| below(&mut noise, &ORDER)).collect();
    for number in edges().into_iter().chain(random) {
        let expected = BigInt::from(big(&number));
        assert_eq!(sum_of_digits::<5>(&number, 256), expected);
        assert_eq!(sum_of_digits::<6>(&number, 256), expected);
        let sparse = public::sparse_digits(&number);
        let sum: BigInt = sparse.iter().enumerate().map(|(place, digit)| BigInt::from(*digit) << place).sum();
        assert_eq!(sum, expected);
        assert!(sparse.iter().all(|digit| *digit == 0 || (digit % 2 != 0 && digit.abs() < 16)));
        if limbs::subtract(&HALF, &number).1 {
            continue;
        }
        assert_eq!(sum_of_digits::<6>(&number, 255), expected);
        assert_eq!(sum_of_digits::<8>(&number, 255), expected);
    }
}

fn of_crate(number: &Limbs) -> sm2::Scalar {
    Option::from(sm2::Scalar::from_repr(limbs::to_bytes(number).into())).expect("below n")
}

/// x || y of one of the crate's points; nothing for infinity.
fn bytes_of_crate(point: &ProjectivePoint) -> Option<[u8; 64]> {
    let encoded = point.to_affine().to_sec1_point(false);
    encoded.as_bytes().get(1..)?.try_into().ok()
}

fn to_crate(point: &Affine) -> ProjectivePoint {
    let encoded = Sec1Point::from_bytes([&[4][..], &point.to_bytes()].concat()).expect("65 bytes");
    Option::<AffinePoint>::from(AffinePoint::from_sec1_point(&encoded)).expect("on the curve").into()
}

fn bytes_of(point: &Jacobian) -> Option<[u8; 64]> {
    (!point.is_infinity()).then(|| point::normalized(&[*point])[0].to_bytes())
}

#[test]
fn multiples_are_those_of_the_crate() {
    let mut noise = Noise(25);
    let random: Vec<Limbs> = (0..cases(200, 100_000)).map(|_| below(&mut noise, &ORDER)).collect();
    let mut base = multiply_generator(&Scalar::reduced(&noise.array()));
    let mut table = SignerTable::new(&base);
    for (case, number) in edges().into_iter().chain(random).enumerate() {
        if case % 128 == 0 {
            base = multiply_generator(&Scalar::reduced(&noise.array()));
            table = SignerTable::new(&base);
        }
        let (k, theirs) = (Scalar::reduced_limbs(&number), of_crate(&number));
        let of_base = bytes_of_crate(&(to_crate(&base) * theirs));
        assert_eq!(bytes_of(&base.times(&k).0), of_base, "{number:x?}");
        assert_eq!(bytes_of(&table.times(&k).0), of_base, "{number:x?}");
        if k.is_zero() {
            continue;
        }
        let of_generator = bytes_of_crate(&ProjectivePoint::mul_by_generator(&theirs));
        assert_eq!(Some(multiply_generator(&k).to_bytes()), of_generator, "{number:x?}");
        assert_eq!(Some(multiply(&k, &base).to_bytes()), of_base, "{number:x?}");
        assert_eq!(multiply_both(&k, &base).map(|point| Some(point.to_bytes())), [of_generator, of_base]);
    }
}

#[test]
fn sums_hold_where_formulas_have_exceptions() {
    let point = multiply_generator(&Scalar::reduced(&[9; 32]));
    let (one, opposite, infinity) = (Jacobian::from(point), point.negated(), Jacobian::INFINITY);
    let twice = bytes_of(&one.double());
    assert_eq!((bytes_of(&one.plus(&one)), bytes_of(&one.plus_affine(&point))), (twice, twice));
    assert!(one.plus(&one.negated()).is_infinity() && one.plus_affine(&opposite).is_infinity());
    assert!(infinity.double().is_infinity() && infinity.plus(&infinity).is_infinity());
    let same = Some(point.to_bytes());
    let sums = [infinity.plus(&one), one.plus(&infinity), infinity.plus_affine(&point)];
    assert!(sums.iter().all(|sum| bytes_of(sum) == same));
    let other = complete::Point::from_jacobian(&one);
    assert_eq!(Some(other.plus(&other).normalized().to_bytes()), twice);
    assert_eq!(Some(other.plus_affine(&point).normalized().to_bytes()), twice);
    assert_eq!(other.plus_affine(&opposite).normalized().to_bytes(), [0; 64]);
    let nothing = complete::Point::from_jacobian(&infinity);
    assert_eq!(Some(nothing.plus(&other).normalized().to_bytes()), same);
    assert_eq!(Some(other.plus(&nothing).normalized().to_bytes()), same);
    assert_eq!(nothing.plus(&nothing).normalized().to_bytes(), [0; 64]);
}

/// An x with n <= x < p is rare (probability about 2^-128): here the key is constructed to give one.
#[test]
#[allow(clippy::many_single_char_names, reason = "the standard's symbols")]
fn an_x_past_the_order_is_taken_modulo_the_order() {
    let (modulus, order) = (big(&MODULUS), big(&ORDER));
    let mut found = 0;
    for above in 0..40u32 {
        let x = Element::from_limbs(&limbs_of(&(&order + above))).expect("below p");
        let square = big(&(x.square() * x - x.triple() + point::B).to_limbs());
        // p is 3 modulo 4.
        let root = square.modpow(&((&modulus + 1u8) / 4u8), &modulus);
        let y = Element::from_limbs(&limbs_of(&root)).expect("below p");
        let Some(target) = Affine::from_bytes(&Affine { x, y }.to_bytes()) else { continue };
        let (s, t) = (Scalar::reduced(&[7; 32]), Scalar::reduced(&[11; 32]));
        // P = (R - s G) / t, so that s G + t P is R.
        let rest = Jacobian::from(target).plus_affine(&multiply_generator(&s).negated());
        let key = multiply(&t.invert(), &point::normalized(&[rest])[0]);
        let (r, x) = (t.minus(&s), Scalar::reduced_limbs(&limbs_of(&(BigUint::from(above) % &order))));
        assert!(verifies(&key, &r.minus(&x), &r, &s) && verifies(&SignerTable::new(&key), &r.minus(&x), &r, &s));
        assert!(!verifies(&key, &r.minus(&x).plus(&Scalar::ONE), &r, &s));
        found += 1;
    }
    assert!(found >= 10, "{found}");
}

#[test]
fn a_sum_at_infinity_verifies_nothing() {
    let d = Scalar::reduced(&[3; 32]);
    let key = multiply_generator(&d);
    let t = Scalar::reduced(&[5; 32]);
    let s = t.times(&d).minus(&t.times(&d).plus(&t.times(&d)));
    // s + t d = 0.
    assert!(s.plus(&t.times(&d)).is_zero());
    let r = t.minus(&s);
    for e in [r, r.plus(&Scalar::ONE), Scalar::ONE, r.minus(&Scalar::ONE)] {
        assert!(!verifies(&key, &e, &r, &s) && !verifies(&SignerTable::new(&key), &e, &r, &s));
    }
    let opposite = Scalar::reduced(&[0; 32]).minus(&r);
    assert!(!verifies(&key, &r, &r, &opposite), "r + s = n");
}

/// Keys that are small multiples of the generator, with signatures whose two parts are equal, opposite or close to each
/// other: sums that double, that pass through infinity, and that end there.
#[test]
#[allow(clippy::many_single_char_names, reason = "the standard's symbols")]
fn signatures_under_keys_related_to_the_generator_are_judged_as_by_the_crate() {
    let opposite = |number: &Scalar| Scalar::reduced(&[0; 32]).minus(number);
    let small = |number: u64| Scalar::reduced_limbs(&[number, 0, 0, 0]);
    let half = Scalar::reduced_limbs(&HALF);
    let related = (1..=64).flat_map(|number| [small(number), opposite(&small(number))]);
    let (mut sums, mut infinite) = (0, 0);
    for k in related.chain([half, opposite(&half)]) {
        let key = multiply_generator(&k);
        let theirs = ProjectivePoint::mul_by_generator(&of_crate(k.limbs()));
        assert_eq!(Some(key.to_bytes()), bytes_of_crate(&theirs));
        let table = SignerTable::new(&key);
        for t in [Scalar::ONE, small(3), Scalar::reduced(&[0x5a; 32])] {
            let own = t.times(&k);
            let near = [own, own.plus(&Scalar::ONE), opposite(&own), opposite(&own).minus(&Scalar::ONE), small(256)];
            for s in near {
                let r = t.minus(&s);
                if s.is_zero() || r.is_zero() {
                    continue;
                }
                let sum = theirs * of_crate(t.limbs()) + ProjectivePoint::mul_by_generator(&of_crate(s.limbs()));
                let Some(bytes) = bytes_of_crate(&sum) else {
                    for e in [r, Scalar::ONE, opposite(&r)] {
                        assert!(!verifies(&key, &e, &r, &s) && !verifies(&table, &e, &r, &s), "{:x?}", k.limbs());
                    }
                    infinite += 1;
                    continue;
                };
                let x = bytes.first_chunk::<32>().expect("x comes first");
                let e = r.minus(&Scalar::reduced(x));
                assert!(verifies(&key, &e, &r, &s) && verifies(&table, &e, &r, &s), "{:x?}", k.limbs());
                let other = e.plus(&Scalar::ONE);
                assert!(!verifies(&key, &other, &r, &s) && !verifies(&table, &other, &r, &s), "{:x?}", k.limbs());
                sums += 1;
            }
        }
    }
    assert!(sums > 1000 && infinite > 300, "{sums} {infinite}");
}

#[test]
fn points_off_the_curve_are_none() {
    let mut noise = Noise(26);
    for _ in 0..200 {
        let point = multiply_generator(&Scalar::reduced(&noise.array())).to_bytes();
        assert_eq!(Affine::from_bytes(&point).map(Affine::to_bytes), Some(point));
        let mut off = point;
        off[noise.below(64)] ^= 1 << noise.below(8);
        assert!(Affine::from_bytes(&off).is_none());
    }
    for bad in [[0; 64], [0xff; 64]] {
        assert!(Affine::from_bytes(&bad).is_none());
    }
}

/// Whole verifications without the instructions that this processor may have.
#[test]
#[cfg(target_arch = "x86_64")]
fn without_the_instructions_all_is_the_same() {
    let before: Vec<[u8; 64]> = edges().iter().skip(1).take(20).map(product).collect();
    let after = way::portably(|| edges().iter().skip(1).take(20).map(product).collect::<Vec<_>>());
    assert_eq!(before, after);
}

#[cfg(test)]
fn product(number: &Limbs) -> [u8; 64] {
    let k = Scalar::reduced_limbs(number);
    multiply(&k, &multiply_generator(&k)).to_bytes()
}
