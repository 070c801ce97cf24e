//! Points in homogeneous coordinates with the complete formulas of Renes, Costello and Batina (2015/1060, for a = -3):
//! they hold for all points, so nothing branches on a secret.

use zeroize::Zeroize;

use super::field::Element;
use super::point::{Affine, B, Jacobian};

/// The point (x / z, y / z); infinity where z is zero.
#[derive(Debug, Clone, Copy, Zeroize)]
pub(super) struct Point {
    x: Element,
    y: Element,
    z: Element,
}

impl Point {
    pub const INFINITY: Self = Self { x: Element::ZERO, y: Element::ONE, z: Element::ZERO };

    /// `a` if all bits of `mask` are set, `b` if none is.
    #[inline(always)]
    pub fn select(mask: u64, a: &Self, b: &Self) -> Self {
        Self {
            x: Element::select(mask, &a.x, &b.x),
            y: Element::select(mask, &a.y, &b.y),
            z: Element::select(mask, &a.z, &b.z),
        }
    }

    /// From Jacobian coordinates; infinity where z is zero.
    pub fn from_jacobian(point: &Jacobian) -> Self {
        let moved = Self { x: point.x * point.z, y: point.y, z: point.z.square() * point.z };
        Self::select(point.z.is_zero(), &Self::INFINITY, &moved)
    }

    /// The sum with a point that is not infinity (algorithm 5).
    #[inline(always)]
    pub fn plus_affine(&self, other: &Affine) -> Self {
        let xx = self.x * other.x;
        let yy = self.y * other.y;
        let xy = (other.x + other.y) * (self.x + self.y) - (xx + yy);
        let yz = other.y * self.z + self.y;
        let xz = other.x * self.z + self.x;
        Self::combined(xx, yy, self.z, xy, yz, xz)
    }

    /// The sum (algorithm 4).
    #[inline(always)]
    pub fn plus(&self, other: &Self) -> Self {
        let xx = self.x * other.x;
        let yy = self.y * other.y;
        let zz = self.z * other.z;
        let xy = (self.x + self.y) * (other.x + other.y) - (xx + yy);
        let yz = (self.y + self.z) * (other.y + other.z) - (yy + zz);
        let xz = (self.x + self.z) * (other.x + other.z) - (xx + zz);
        Self::combined(xx, yy, zz, xy, yz, xz)
    }

    /// The end of both sums: from x1 x2, y1 y2, z1 z2, x1 y2 + x2 y1, y1 z2 + y2 z1 and x1 z2 + x2 z1.
    #[inline(always)]
    fn combined(xx: Element, yy: Element, zz: Element, xy: Element, yz: Element, xz: Element) -> Self {
        let first = (xz - B * zz).triple();
        let minus = yy - first;
        let plus = yy + first;
        let zz3 = zz.triple();
        let second = (B * xz - zz3 - xx).triple();
        let third = xx.triple() - zz3;
        Self { x: xy * plus - yz * second, y: plus * minus + third * second, z: yz * minus + xy * third }
    }
}

/// Both points in affine coordinates, with one inversion. Neither may be infinity.
pub(super) fn normalized(one: &Point, other: &Point) -> [Affine; 2] {
    let inverse = (one.z * other.z).invert();
    let by_itself = |point: &Point, inverse: Element| Affine { x: point.x * inverse, y: point.y * inverse };
    [by_itself(one, inverse * other.z), by_itself(other, inverse * one.z)]
}

impl Point {
    /// The point in affine coordinates; (0, 0) for infinity.
    pub fn normalized(&self) -> Affine {
        let inverse = self.z.invert();
        Affine { x: self.x * inverse, y: self.y * inverse }
    }
}
