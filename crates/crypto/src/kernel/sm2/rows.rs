//! Rows of multiples of a public point.

use super::point::{Affine, Jacobian, normalized};

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
