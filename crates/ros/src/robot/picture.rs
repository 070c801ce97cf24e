//! The robots' camera: draws a scene (sky, ground, numbered evidence markers, another robot, the
//! gripper, a caption) and encodes it as a JPEG of about 58 KB. The drawing itself is in `canvas`.

mod canvas;

use jpeg_encoder::{ColorType, Encoder, SamplingFactor};

use super::track::Track;
use canvas::{Canvas, HEIGHT, WIDTH, whole};

/// The target size, bytes: the quality of the next picture is adjusted towards it.
const WANTED: std::ops::Range<usize> = 56_000..60_000;

/// The sizes allowed, bytes.
const ALLOWED: std::ops::RangeInclusive<usize> = 50_000..=66_000;

/// How often a picture is re-encoded to get within the allowed sizes.
const ATTEMPTS: usize = 8;

/// The row of the horizon.
const HORIZON: i32 = 170;

/// Rows below the horizon of a point 1 m away, at the camera's feet.
const NEAR: f64 = 330.0;

/// The distance between two markers and the farthest one visible, metres.
const MARKERS: (f64, i32) = (1.7, 5);

/// A robot's camera.
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
        encoder.encode(self.canvas.pixels(), width, height, ColorType::Rgb).ok()?;
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
