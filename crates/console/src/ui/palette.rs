//! The sixteen ANSI colours as terminals show them, and which of two colours is nearer to a third.

/// Red, green, blue.
pub type Rgb = (u8, u8, u8);

/// The sixteen, in the order of their codes.
pub const SIXTEEN: [Rgb; 16] = [
    (0, 0, 0),
    (170, 0, 0),
    (0, 130, 0),
    (130, 90, 0),
    (0, 0, 170),
    (130, 0, 150),
    (0, 130, 130),
    (190, 190, 190),
    (100, 100, 100),
    (255, 120, 110),
    (110, 230, 110),
    (245, 220, 80),
    (100, 170, 255),
    (220, 170, 255),
    (110, 230, 255),
    (255, 255, 255),
];

/// The perceived distance of two colours.
pub fn distance(one: Rgb, other: Rgb) -> u32 {
    let part = |one: u8, other: u8, weight: u32| u32::from(one.abs_diff(other)).pow(2) * weight;
    part(one.0, other.0, 3) + part(one.1, other.1, 6) + part(one.2, other.2, 2)
}
