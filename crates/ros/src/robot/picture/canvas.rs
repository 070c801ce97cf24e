//! A small RGB raster and the shapes the scene is made of. Anything outside is clipped.

use super::super::letters::{ADVANCE, rows};

/// Picture width, pixels.
pub(super) const WIDTH: i32 = 640;

/// Picture height, pixels.
pub(super) const HEIGHT: i32 = 480;

type Colour = [u8; 3];

/// A picture being drawn.
pub(super) struct Canvas {
    pixels: Vec<u8>,
}

/// The integer part, saturating.
#[expect(clippy::cast_possible_truncation, reason = "`as` saturates, and off-screen is off-screen")]
pub(super) fn whole(number: f64) -> i32 {
    number as i32
}

/// A brightness, clamped to its range.
fn shade(level: i32) -> u8 {
    u8::try_from(level.clamp(0, 255)).unwrap_or(255)
}

/// Repeatable noise, 0..=255.
fn grain(x: i32, y: i32) -> i32 {
    let mut mixed = x.wrapping_mul(0x1f12_3bb5) ^ y.wrapping_mul(0x5f35_6495);
    mixed = (mixed ^ (mixed >> 13)).wrapping_mul(0x2c1b_3c6d);
    (mixed >> 15) & 255
}

impl Canvas {
    pub fn new() -> Self {
        let size = usize::try_from(WIDTH * HEIGHT * 3).unwrap_or_default();
        Self { pixels: vec![0; size] }
    }

    /// RGB bytes, row by row.
    pub fn pixels(&self) -> &[u8] {
        &self.pixels
    }

    /// Rows with their numbers.
    fn rows(&mut self) -> impl Iterator<Item = (i32, &mut [u8])> {
        let stride = usize::try_from(WIDTH * 3).unwrap_or(1);
        (0..).zip(self.pixels.chunks_exact_mut(stride))
    }

    fn dot(&mut self, x: i32, y: i32, colour: Colour) {
        if (0..WIDTH).contains(&x) && (0..HEIGHT).contains(&y) {
            let place = usize::try_from((y * WIDTH + x) * 3).unwrap_or_default();
            if let Some(pixel) = self.pixels.get_mut(place..place + 3) {
                pixel.copy_from_slice(&colour);
            }
        }
    }

    /// Evening sky with a line of hills that turns with the robot.
    pub fn sky(&mut self, horizon: i32, pan: i32) {
        let hill = |along: i32| horizon - 26 - (along.rem_euclid(310) - 155).abs() / 6 - grain(along / 3, 1) / 40;
        let hills: Vec<i32> = (pan..pan + WIDTH).map(hill).collect();
        for (y, row) in self.rows().take(usize::try_from(horizon).unwrap_or_default()) {
            let light = 96 + y / 2;
            let air = [shade(light + 30), shade(light + 24), shade(light + 62 - y / 4)];
            for ((along, hill), pixel) in (pan..).zip(&hills).zip(row.as_chunks_mut::<3>().0) {
                *pixel = if y > *hill {
                    let tone = 52 + grain(along / 2, y / 2) / 16;
                    [shade(tone - 8), shade(tone + 16), shade(tone)]
                } else {
                    air
                };
            }
        }
    }

    /// Paved ground in perspective, moving towards the camera.
    pub fn ground(&mut self, horizon: i32, travelled: i32, pan: i32, seed: i32, seq: u32) {
        let flicker = i32::try_from(seq % 4096).unwrap_or_default();
        for (y, row) in self.rows().skip(usize::try_from(horizon).unwrap_or_default()) {
            let depth = 64 * 330 / (y - horizon + 4);
            let ahead = depth + travelled;
            let (slab, gap, haze) = (ahead.div_euclid(96), ahead.rem_euclid(96) < 4, depth / 220);
            for (x, pixel) in (0..).zip(row.as_chunks_mut::<3>().0) {
                let across = (x - WIDTH / 2) * depth / 330 + pan / 4;
                let tile = if (slab + across.div_euclid(96)) % 2 == 0 { 14 } else { -6 };
                let joint = if gap || across.rem_euclid(96) < 4 { -34 } else { 0 };
                let stone = grain(across / 2 + seed * 977, ahead / 2) / 9;
                let sensor = grain(x + flicker * 131, y + flicker * 17) / 18;
                let tone = 84 + tile + joint + stone + sensor - haze;
                *pixel = [shade(tone + 10), shade(tone + 4), shade(tone - 8)];
            }
        }
    }

    /// A filled rectangle.
    pub fn rectangle(&mut self, left: i32, top: i32, width: i32, height: i32, colour: Colour) {
        for y in top.max(0)..(top + height).min(HEIGHT) {
            for x in left.max(0)..(left + width).min(WIDTH) {
                self.dot(x, y, colour);
            }
        }
    }

    /// A filled circle.
    pub fn disc(&mut self, x: i32, y: i32, radius: i32, colour: Colour) {
        for down in -radius..=radius {
            for right in -radius..=radius {
                if down * down + right * right <= radius * radius {
                    self.dot(x + right, y + down, colour);
                }
            }
        }
    }

    /// A yellow tent with a number, its foot at (`centre`, `foot`).
    pub fn tent(&mut self, centre: i32, foot: i32, size: i32, number: i32) {
        for up in 0..size {
            let half = (size - up) * 2 / 3;
            let shadow = if up < 2 { 60 } else { 0 };
            for right in -half..=half {
                let side = if right > half / 2 { 40 } else { 0 };
                self.dot(centre + right, foot - up, [shade(240 - side - shadow), shade(196 - side - shadow), 30]);
            }
        }
        let scale = size / 14;
        if scale > 0 {
            self.text(centre - 3 * scale, foot - 9 * scale, scale, &number.to_string(), [10, 10, 10]);
        }
    }

    /// A line of letters, `scale` pixels per dot.
    pub fn text(&mut self, left: i32, top: i32, scale: i32, text: &str, colour: Colour) {
        for (place, letter) in (0..).zip(text.chars()) {
            for (down, bits) in (0..).zip(rows(letter)) {
                for right in (0..5).filter(|right| bits >> (4 - right) & 1 == 1) {
                    let x = left + (place * ADVANCE + right) * scale;
                    self.rectangle(x, top + down * scale, scale, scale, colour);
                }
            }
        }
    }
}
