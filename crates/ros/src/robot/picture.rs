//! The robots' camera: draws a scene on a small RGB raster, clipped at its edges, and encodes it as a JPEG of about 58
//! KB.

use super::Track;
use jpeg_encoder::{ColorType, Encoder, SamplingFactor};

/// Bytes; the next picture's quality is adjusted towards it.
const WANTED: std::ops::Range<usize> = 56_000..60_000;

/// Bytes.
const ALLOWED: std::ops::RangeInclusive<usize> = 50_000..=66_000;

const ATTEMPTS: usize = 8;

const HORIZON: i32 = 170;

/// Rows below the horizon of a point 1 m away, at the camera's feet.
const NEAR: f64 = 330.0;

/// The distance between two markers and the farthest one visible, metres.
const MARKERS: (f64, i32) = (1.7, 5);

pub(super) struct Camera {
    robot: u16,
    track: Track,
    canvas: Canvas,
    /// JPEG quality, adjusted to the size of the last picture.
    quality: u8,
}

impl Camera {
    pub fn new(robot: u16, track: Track) -> Self {
        Self { robot, track, canvas: Canvas::new(), quality: 76 }
    }

    /// Picture `seq`, `age` seconds after the start, as a JPEG file.
    pub fn shoot(&mut self, seq: u32, age: f64) -> Option<Vec<u8>> {
        self.draw(seq, age);
        let mut jpeg = self.encode()?;
        for _ in 0..ATTEMPTS {
            if ALLOWED.contains(&jpeg.len()) {
                break;
            }
            self.correct(jpeg.len());
            jpeg = self.encode()?;
        }
        self.correct(jpeg.len());
        Some(jpeg)
    }

    fn encode(&self) -> Option<Vec<u8>> {
        let mut jpeg = Vec::with_capacity(*ALLOWED.end());
        let (width, height) = (u16::try_from(WIDTH).ok()?, u16::try_from(HEIGHT).ok()?);
        let mut encoder = Encoder::new(&mut jpeg, self.quality);
        // As cameras do: colour at half the resolution is half the work.
        encoder.set_sampling_factor(SamplingFactor::F_2_2);
        encoder.encode(&self.canvas.pixels, width, height, ColorType::Rgb).ok()?;
        Some(jpeg)
    }

    fn correct(&mut self, size: usize) {
        let step = if ALLOWED.contains(&size) { 1 } else { 4 };
        if size < WANTED.start {
            self.quality = (self.quality + step).min(98);
        } else if size >= WANTED.end {
            self.quality = (self.quality - step).max(20);
        }
    }

    fn draw(&mut self, seq: u32, age: f64) {
        let motion = self.track.at(age);
        let travelled = age * 0.6;
        let pan = whole(motion.heading * 90.0);
        self.canvas.sky(HORIZON, pan);
        self.canvas.ground(HORIZON, whole(travelled * 64.0), pan, i32::from(self.robot), seq);
        self.markers(travelled);
        self.other_robot(age);
        self.gripper(age);
        self.caption(seq);
    }

    /// Numbered yellow tents, as investigators place beside evidence; they come nearer.
    fn markers(&mut self, travelled: f64) {
        let (spacing, seen) = MARKERS;
        let passed = (travelled / spacing).floor();
        for index in (1..=seen).rev() {
            let distance = f64::from(index) * spacing - (travelled - passed * spacing);
            let number = (whole(passed) + index - 1).rem_euclid(9) + 1;
            let side = f64::from((number * 37 + i32::from(self.robot) * 11) % 41 - 20) / 20.0;
            let foot = HORIZON + whole(NEAR / distance / 1.2);
            let centre = WIDTH / 2 + whole(side * 240.0 / distance.max(0.6));
            let size = whole(95.0 / distance.max(0.5));
            self.canvas.tent(centre, foot, size, number);
        }
    }

    fn other_robot(&mut self, age: f64) {
        let x = WIDTH / 2 + whole((age * 0.35 + f64::from(self.robot)).sin() * 260.0);
        let y = HORIZON + 46;
        self.canvas.rectangle(x - 34, y - 26, 68, 22, [58, 92, 132]);
        self.canvas.rectangle(x - 12, y - 40, 24, 14, [80, 120, 160]);
        for wheel in [-22, 0, 22] {
            self.canvas.disc(x + wheel, y, 9, [28, 28, 30]);
            let (sin, cos) = (age * 4.0).sin_cos();
            self.canvas.disc(x + wheel + whole(cos * 5.0), y + whole(sin * 5.0), 2, [200, 200, 200]);
        }
        let lit = (age * 2.0).fract() < 0.5;
        self.canvas.disc(x, y - 44, 4, if lit { [255, 60, 40] } else { [90, 20, 20] });
    }

    fn gripper(&mut self, age: f64) {
        let opening = 46 + whole((age * 1.3).sin() * 22.0);
        for side in [-1, 1] {
            let x = WIDTH / 2 + side * opening;
            self.canvas.rectangle(x - 9, HEIGHT - 92, 18, 92, [96, 98, 104]);
            self.canvas.rectangle(x - 9 - side * 8, HEIGHT - 104, 18, 26, [210, 120, 30]);
        }
        self.canvas.rectangle(WIDTH / 2 - 80, HEIGHT - 24, 160, 24, [70, 72, 78]);
    }

    fn caption(&mut self, seq: u32) {
        self.canvas.rectangle(8, 8, 330, 34, [16, 18, 24]);
        self.canvas.text(16, 14, 3, &format!("ROBOT {}", self.robot), [250, 220, 90]);
        self.canvas.text(196, 14, 3, &format!("{seq:06}"), [220, 220, 220]);
        self.canvas.rectangle(WIDTH - 190, 8, 182, 34, [120, 20, 24]);
        self.canvas.text(WIDTH - 180, 14, 3, "SIMULATED", [255, 255, 255]);
    }
}

const WIDTH: i32 = 640;

const HEIGHT: i32 = 480;

type Colour = [u8; 3];

/// Looked up by masked sums.
const GRAINS_MASK: i32 = 0x3fff;

struct Canvas {
    pixels: Vec<u8>,
    /// 0 to 255, without a pattern.
    grains: Vec<i32>,
}

#[expect(clippy::cast_possible_truncation, reason = "`as` saturates, and off-screen is off-screen")]
fn whole(number: f64) -> i32 {
    number as i32
}

fn shade(level: i32) -> u8 {
    u8::try_from(level.clamp(0, 255)).unwrap_or(255)
}

fn grain(x: i32, y: i32) -> i32 {
    let mut mixed = x.wrapping_mul(0x1f12_3bb5) ^ y.wrapping_mul(0x5f35_6495);
    mixed = (mixed ^ (mixed >> 13)).wrapping_mul(0x2c1b_3c6d);
    (mixed >> 15) & 255
}

impl Canvas {
    pub fn new() -> Self {
        let size = usize::try_from(WIDTH * HEIGHT * 3).unwrap_or_default();
        Self { pixels: vec![0; size], grains: (0..=GRAINS_MASK).map(|place| grain(place, 7)).collect() }
    }

    /// The rows from the top, and the grains.
    fn rows(&mut self) -> (impl Iterator<Item = (i32, &mut [u8])>, &[i32]) {
        let stride = usize::try_from(WIDTH * 3).unwrap_or(1);
        ((0..).zip(self.pixels.chunks_exact_mut(stride)), &self.grains)
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
        for (y, row) in self.rows().0.take(usize::try_from(horizon).unwrap_or_default()) {
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

    /// Paved ground in perspective, moving towards the camera. Four robots draw this thirty times a second, in builds
    /// without optimisation too: no calls for a pixel.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "places are masked, and tones stay between 12 and 150"
    )]
    pub fn ground(&mut self, horizon: i32, travelled: i32, pan: i32, seed: i32, seq: u32) {
        let (rows, grains) = self.rows();
        let flicker = i32::try_from(seq % 4096).unwrap_or_default() * 1361;
        for (y, row) in rows.skip(usize::try_from(horizon).unwrap_or_default()) {
            let depth = 64 * 330 / (y - horizon + 4);
            let ahead = depth + travelled;
            let (slab, gap, haze) = (ahead >> 7, ahead & 127 < 5, depth / 220);
            let (stones, noise) = ((ahead >> 1 & GRAINS_MASK) * 577 + seed * 977, flicker + y * 1009);
            for (x, pixel) in (0..).zip(row.as_chunks_mut::<3>().0) {
                let across = (x - WIDTH / 2) * depth / 330 + pan / 4;
                let tile = if (slab + (across >> 7)) & 1 == 0 { 14 } else { -6 };
                let joint = if gap || across & 127 < 5 { -34 } else { 0 };
                let stone = grains[((stones + (across >> 1)) & GRAINS_MASK) as usize] / 9;
                let sensor = grains[((noise + x) & GRAINS_MASK) as usize] / 18;
                let tone = 84 + tile + joint + stone + sensor - haze;
                *pixel = [(tone + 10) as u8, (tone + 4) as u8, (tone - 8) as u8];
            }
        }
    }

    pub fn rectangle(&mut self, left: i32, top: i32, width: i32, height: i32, colour: Colour) {
        for y in top.max(0)..(top + height).min(HEIGHT) {
            for x in left.max(0)..(left + width).min(WIDTH) {
                self.dot(x, y, colour);
            }
        }
    }

    pub fn disc(&mut self, x: i32, y: i32, radius: i32, colour: Colour) {
        for down in -radius..=radius {
            for right in -radius..=radius {
                if down * down + right * right <= radius * radius {
                    self.dot(x + right, y + down, colour);
                }
            }
        }
    }

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

/// Columns of a letter, with its gap.
const ADVANCE: i32 = 6;

/// Top first; bit 4 is the left column. Unknown characters are blank.
pub(super) fn rows(letter: char) -> [u8; 7] {
    match letter {
        '0' => [0x0e, 0x11, 0x13, 0x15, 0x19, 0x11, 0x0e],
        '1' => [0x04, 0x0c, 0x04, 0x04, 0x04, 0x04, 0x0e],
        '2' => [0x0e, 0x11, 0x01, 0x02, 0x04, 0x08, 0x1f],
        '3' => [0x1f, 0x02, 0x04, 0x02, 0x01, 0x11, 0x0e],
        '4' => [0x02, 0x06, 0x0a, 0x12, 0x1f, 0x02, 0x02],
        '5' => [0x1f, 0x10, 0x1e, 0x01, 0x01, 0x11, 0x0e],
        '6' => [0x06, 0x08, 0x10, 0x1e, 0x11, 0x11, 0x0e],
        '7' => [0x1f, 0x01, 0x02, 0x04, 0x08, 0x08, 0x08],
        '8' => [0x0e, 0x11, 0x11, 0x0e, 0x11, 0x11, 0x0e],
        '9' => [0x0e, 0x11, 0x11, 0x0f, 0x01, 0x02, 0x0c],
        'A' => [0x0e, 0x11, 0x11, 0x1f, 0x11, 0x11, 0x11],
        'B' => [0x1e, 0x11, 0x11, 0x1e, 0x11, 0x11, 0x1e],
        'D' => [0x1e, 0x11, 0x11, 0x11, 0x11, 0x11, 0x1e],
        'E' => [0x1f, 0x10, 0x10, 0x1e, 0x10, 0x10, 0x1f],
        'I' => [0x0e, 0x04, 0x04, 0x04, 0x04, 0x04, 0x0e],
        'L' => [0x10, 0x10, 0x10, 0x10, 0x10, 0x10, 0x1f],
        'M' => [0x11, 0x1b, 0x15, 0x15, 0x11, 0x11, 0x11],
        'O' => [0x0e, 0x11, 0x11, 0x11, 0x11, 0x11, 0x0e],
        'R' => [0x1e, 0x11, 0x11, 0x1e, 0x14, 0x12, 0x11],
        'S' => [0x0f, 0x10, 0x10, 0x0e, 0x01, 0x01, 0x1e],
        'T' => [0x1f, 0x04, 0x04, 0x04, 0x04, 0x04, 0x04],
        'U' => [0x11, 0x11, 0x11, 0x11, 0x11, 0x11, 0x0e],
        _ => [0; 7],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ros::readable::decode;

    #[test]
    fn pictures_are_real_of_the_right_size_and_never_the_same() {
        for robot in [1, 2, 3, 4, 17, 64] {
            let mut camera = Camera::new(robot, Track::of_robot(robot));
            let mut last = Vec::new();
            for seq in 0..40 {
                let jpeg = camera.shoot(seq, f64::from(seq) * 0.5).expect("encodes");
                assert!(ALLOWED.contains(&jpeg.len()), "robot {robot} picture {seq}: {} bytes", jpeg.len());
                assert_ne!(jpeg, last);
                last = jpeg;
            }
            let decoded = decode(&last).expect("decodes");
            assert_eq!((decoded.width, decoded.height), (640, 480));
        }
    }

    #[test]
    fn quality_goes_back_when_pictures_are_too_big() {
        let mut camera = Camera::new(1, Track::of_robot(1));
        camera.quality = 98;
        assert!(ALLOWED.contains(&camera.shoot(0, 0.0).expect("encodes").len()));
        assert!(camera.quality < 98);
    }
}
