//! Points of the SM2 curve y^2 = x^3 - 3 x + b in affine and in Jacobian coordinates. Additions here take a time that
//! depends on their input: they get only public points and numbers, except `double` and `third`, which have no special
//! cases.

use zeroize::Zeroize;

use super::field::Element;
use super::limbs::{self, Limbs};

pub(super) const B: Element = Element::from_montgomery([
    0x90d2_3063_2bc0_dd42,
    0x71cf_379a_e9b5_37ab,
    0x5279_8150_5ea5_1c3c,
    0x240f_e188_ba20_e2c8,
]);

pub(super) const GENERATOR: Affine = Affine {
    x: Element::from_montgomery([
        0x6132_8990_f418_029e,
        0x3e79_81ed_dca6_c050,
        0xd6a1_ed99_ac24_c3c3,
        0x9116_7a5e_e1c1_3b05,
    ]),
    y: Element::from_montgomery([
        0xc135_4e59_3c2d_0ddd,
        0xc1f5_e578_8d32_95fa,
        0x8d4c_fb06_6e2a_48f8,
        0x63cd_65d4_81d7_35bd,
    ]),
};

/// A point that is not infinity.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Zeroize)]
pub(crate) struct Affine {
    pub(super) x: Element,
    pub(super) y: Element,
}

impl Affine {
    pub(super) const ZERO: Self = Self { x: Element::ZERO, y: Element::ZERO };

    /// x || y, each below p, of a point of the curve; otherwise nothing.
    pub fn from_bytes(bytes: &[u8; 64]) -> Option<Self> {
        let (halves, _) = bytes.as_chunks::<32>();
        let point = Self { x: Element::from_bytes(&halves[0])?, y: Element::from_bytes(&halves[1])? };
        point.is_on_curve().then_some(point)
    }

    pub fn to_bytes(self) -> [u8; 64] {
        let mut bytes = [0; 64];
        bytes[..32].copy_from_slice(&self.x.to_bytes());
        bytes[32..].copy_from_slice(&self.y.to_bytes());
        bytes
    }

    pub fn x_bytes(&self) -> [u8; 32] {
        self.x.to_bytes()
    }

    fn is_on_curve(&self) -> bool {
        let right = (self.x.square() * self.x) - self.x.triple() + B;
        self.y.square() == right
    }

    pub(super) fn negated(&self) -> Self {
        Self { x: self.x, y: -self.y }
    }

    /// Twice the point, and the point itself with the same z.
    pub(super) fn doubled_beside(&self) -> (Jacobian, Jacobian) {
        let z = self.y.double();
        let four_y2 = z.square();
        let slope = ((self.x - Element::ONE) * (self.x + Element::ONE)).triple();
        let (x, y) = (self.x * four_y2, four_y2.square().half());
        let twice_x = slope.square() - x.double();
        (Jacobian { x: twice_x, y: slope * (x - twice_x) - y, z }, Jacobian { x, y, z })
    }
}

/// The point (x / z^2, y / z^3); infinity where z is zero.
#[derive(Debug, Clone, Copy, Zeroize)]
pub(super) struct Jacobian {
    pub x: Element,
    pub y: Element,
    pub z: Element,
}

impl From<Affine> for Jacobian {
    fn from(point: Affine) -> Self {
        Self { x: point.x, y: point.y, z: Element::ONE }
    }
}

/// A point that is not infinity, to be added several times.
#[derive(Clone, Copy)]
pub(super) struct Summand {
    point: Jacobian,
    z2: Element,
    z3: Element,
}

impl From<Jacobian> for Summand {
    #[inline(always)]
    fn from(point: Jacobian) -> Self {
        let z2 = point.z.square();
        Self { point, z2, z3: z2 * point.z }
    }
}

impl Summand {
    #[inline(always)]
    pub fn negated(&self) -> Self {
        Self { point: self.point.negated(), ..*self }
    }
}

impl Jacobian {
    pub const INFINITY: Self = Self { x: Element::ONE, y: Element::ONE, z: Element::ZERO };

    pub fn is_infinity(&self) -> bool {
        self.z == Element::ZERO
    }

    pub fn negated(&self) -> Self {
        Self { y: -self.y, ..*self }
    }

    /// Twice the point, for a = -3, with 2 y taken first: that makes z a product and saves four of the sums that
    /// dbl-2001-b has. No special cases: infinity stays infinity, and since the order of the group is odd no other point
    /// has y = 0.
    #[inline(always)]
    pub fn double(&self) -> Self {
        let twice_y = self.y.double();
        let z2 = self.z.square();
        let four_y2 = twice_y.square();
        let z = twice_y * self.z;
        let slope = ((self.x - z2) * (self.x + z2)).triple();
        let middle = self.x * four_y2;
        let eight_y4 = four_y2.square().half();
        let x = slope.square() - middle.double();
        Self { x, y: slope * (middle - x) - eight_y4, z }
    }

    /// The sum with a point that is not infinity (madd), all special cases handled.
    #[inline(always)]
    pub fn plus_affine(&self, other: &Affine) -> Self {
        if self.is_infinity() {
            return (*other).into();
        }
        let z2 = self.z.square();
        let difference = other.x * z2 - self.x;
        let slope = other.y * (z2 * self.z) - self.y;
        if difference == Element::ZERO {
            return self.meeting(slope);
        }
        Self::third((self.x, self.y), difference, slope, self.z)
    }

    /// The sum of two points with a common denominator `z`, by the first one's x and y, and how far the other's are away.
    #[inline(always)]
    pub fn third((own_x, own_y): (Element, Element), difference: Element, slope: Element, z: Element) -> Self {
        let square = difference.square();
        let cube = square * difference;
        let middle = own_x * square;
        let x = slope.square() - cube - middle.double();
        Self { x, y: slope * (middle - x) - own_y * cube, z: z * difference }
    }

    /// The sum with any point, all special cases handled.
    #[cfg(test)]
    pub fn plus(&self, other: &Self) -> Self {
        if other.is_infinity() {
            return *self;
        }
        self.plus_summand(&Summand::from(*other))
    }

    /// The sum (add-1998-cmo), all special cases handled.
    #[inline(always)]
    pub fn plus_summand(&self, Summand { point: other, z2: other_z2, z3: other_z3 }: &Summand) -> Self {
        if self.is_infinity() {
            return *other;
        }
        let z2 = self.z.square();
        let own_x = self.x * *other_z2;
        let own_y = self.y * *other_z3;
        let difference = other.x * z2 - own_x;
        let slope = other.y * (z2 * self.z) - own_y;
        if difference == Element::ZERO {
            return self.meeting(slope);
        }
        Self::third((own_x, own_y), difference, slope, self.z * other.z)
    }

    /// The sum with a point of the same z but another x, and this point with the sum's z (Meloni 2007).
    pub fn plus_beside(&self, other: &Self) -> (Self, Self) {
        let difference = self.x - other.x;
        let square = difference.square();
        let (own_x, other_x) = (self.x * square, other.x * square);
        let own_y = self.y * (own_x - other_x);
        let slope = self.y - other.y;
        let x = slope.square() - own_x - other_x;
        let z = self.z * difference;
        (Self { x, y: slope * (own_x - x) - own_y, z }, Self { x: own_x, y: own_y, z })
    }

    /// The sum with a point of the same x: the same point if the ys are equal, otherwise its opposite.
    #[cold]
    #[inline(never)]
    fn meeting(&self, slope: Element) -> Self {
        if slope == Element::ZERO { self.double() } else { Self::INFINITY }
    }

    /// Whether the point's x, taken modulo p, equals the number.
    pub fn has_x(&self, number: &Limbs) -> bool {
        Element::from_limbs(number).is_some_and(|x| x * self.z.square() == self.x)
    }
}

/// Several points, none of them infinity, in affine coordinates, with one inversion for all.
pub(super) fn normalized(points: &[Jacobian]) -> Vec<Affine> {
    // before[i] is the product of all z before i.
    let mut before = Vec::with_capacity(points.len());
    let mut product = Element::ONE;
    for point in points {
        before.push(product);
        product = product * point.z;
    }
    let mut inverse = product.invert();
    let mut out = vec![Affine::ZERO; points.len()];
    for ((point, before), out) in points.iter().zip(before).zip(&mut out).rev() {
        let own = inverse * before;
        inverse = inverse * point.z;
        let square = own.square();
        *out = Affine { x: point.x * square, y: point.y * (square * own) };
    }
    out
}

/// For each i below `places`: 1 to `most` times 2^(`apart` i) times the point, one row after the other.
pub(super) fn rows(point: &Affine, places: usize, apart: usize, most: usize) -> Vec<Affine> {
    let mut first = Vec::with_capacity(places);
    let mut base = Jacobian::from(*point);
    for _ in 0..places {
        first.push(base);
        for _ in 0..apart {
            base = base.double();
        }
    }
    let mut all = Vec::with_capacity(places * most);
    for base in normalized(&first) {
        let mut multiple = Jacobian::from(base);
        for _ in 0..most {
            all.push(multiple);
            multiple = multiple.plus_affine(&base);
        }
    }
    normalized(&all)
}

/// Whether `number` is greater than `limit`; both are public.
pub(super) fn is_above(number: &Limbs, limit: &Limbs) -> bool {
    limbs::subtract(limit, number).1
}
