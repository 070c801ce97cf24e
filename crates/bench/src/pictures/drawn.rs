//! The messages measured: smooth surfaces with sensor noise, the same in every run.

use authros_crypto::compression::Matrix;

/// One message.
pub struct Message {
    pub name: &'static str,
    pub body: Vec<u8>,
    pub matrix: Option<Matrix>,
}

impl Message {
    /// The bytes of its matrix.
    pub fn pixels(&self) -> Option<&[u8]> {
        let matrix = self.matrix?;
        self.body.get(matrix.start..matrix.start + matrix.length()?)
    }
}

/// Bytes before the matrix: header, sizes, encoding.
const BEFORE: usize = 60;

/// Noise: a linear congruential generator.
struct Noise(u64);

impl Noise {
    /// -`most` to `most`.
    fn next(&mut self, most: i32) -> i32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        i32::try_from(self.0 >> 40).unwrap_or(0) % (2 * most + 1) - most
    }
}

/// Height of a hilly surface, -1000 to 1000.
#[allow(clippy::cast_possible_truncation, reason = "bounded by a sine")]
fn surface(x: i32, y: i32) -> i32 {
    ((f64::from(x) / 90.0).sin() * (f64::from(y) / 70.0).cos() * 1000.0) as i32
}

/// All messages.
pub fn all() -> Vec<Message> {
    vec![
        matrix("image rgb8 1280x720", (1280, 720), (3, 1), 1, &mut |x, y, channel, noise| {
            130 + surface(x, y) * 70 / 1000 + channel * 15 + noise.next(2)
        }),
        matrix("image bayer_rggb8 1280x720", (1280, 720), (1, 1), 2, &mut |x, y, _, noise| {
            let colour = [40, 0, 0, -30][usize::try_from((y % 2) * 2 + x % 2).unwrap_or(0)];
            120 + surface(x, y) * 60 / 1000 + colour + noise.next(2)
        }),
        matrix("image mono8 640x480", (640, 480), (1, 1), 1, &mut |x, y, _, noise| {
            120 + surface(x, y) * 80 / 1000 + noise.next(2)
        }),
        matrix("depth 16UC1 640x480", (640, 480), (1, 2), 1, &mut |x, y, _, noise| {
            if (x / 80 + y / 60) % 7 == 0 { 0 } else { 2500 + surface(x, y) + noise.next(3) }
        }),
        floats("depth 32FC1 640x480", (640, 480), 1),
        floats("cloud xyz+i 32768 points", (32_768, 1), 4),
        floats("scan of 1080 beams", (1080, 1), 1),
        Message { name: "odometry", body: odometry(), matrix: None },
    ]
}

fn shape(size: (i32, i32), pixel: (usize, usize), apart: usize) -> Matrix {
    let side = |length: i32| usize::try_from(length).unwrap_or(0);
    let (columns, rows) = (side(size.0), side(size.1));
    Matrix { start: BEFORE, rows, columns, channels: pixel.0, sample: pixel.1, big_endian: false, apart }
}

type Pixel<'a> = &'a mut dyn FnMut(i32, i32, i32, &mut Noise) -> i32;

fn matrix(name: &'static str, size: (i32, i32), pixel: (usize, usize), apart: usize, draw: Pixel) -> Message {
    let mut noise = Noise(1);
    let mut body = vec![7; BEFORE];
    let channels = i32::try_from(pixel.0).unwrap_or(1);
    for y in 0..size.1 {
        for x in 0..size.0 {
            for channel in 0..channels {
                let most = if pixel.1 == 1 { 255 } else { 65_535 };
                let number = draw(x, y, channel, &mut noise).clamp(0, most);
                body.extend_from_slice(&number.to_le_bytes()[..pixel.1]);
            }
        }
    }
    Message { name, body, matrix: Some(shape(size, pixel, apart)) }
}

fn floats(name: &'static str, size: (i32, i32), channels: usize) -> Message {
    let mut noise = Noise(2);
    let mut body = vec![7; BEFORE];
    for y in 0..size.1 {
        for x in 0..size.0 {
            for channel in 0..i32::try_from(channels).unwrap_or(1) {
                let millimetres = 4000 + surface(x + channel * 40, y) * 2 + noise.next(4);
                let metres = f32::from(i16::try_from(millimetres).unwrap_or(0)) / 1000.0;
                body.extend_from_slice(&metres.to_le_bytes());
            }
        }
    }
    Message { name, body, matrix: Some(shape(size, (channels, 4), 1)) }
}

/// Header, frame, pose, covariances: mostly zeros, as odometry is.
fn odometry() -> Vec<u8> {
    let mut body = vec![3, 1, 0, 0, 9, 200, 80, 101, 77, 1, 9, 33, 4, 0, 0, 0];
    body.extend_from_slice(b"odom\x09\x00\x00\x00base_link");
    for place in 0..85u8 {
        let number = if matches!(place, 0 | 1 | 5 | 6 | 43 | 48) { f64::from(place) / 7.0 } else { 0.0 };
        body.extend_from_slice(&number.to_le_bytes());
    }
    body
}
