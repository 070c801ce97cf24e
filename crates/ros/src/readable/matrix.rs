//! The matrix of a `sensor_msgs/Image`: its encoding, its pixels for display, its numbers for export.

use super::numbers::{Body, count};
use super::picture::PictureError;
use super::points::bytes;
use crate::ros::message::{Value, layout};

/// A raw picture, borrowed from its message.
pub(super) struct Matrix<'a> {
    pub width: usize,
    pub height: usize,
    pub encoding: String,
    pub channels: usize,
    pub sample: usize,
    pub big_endian: bool,
    step: usize,
    data: std::borrow::Cow<'a, [u8]>,
}

impl<'a> Matrix<'a> {
    /// Reads the matrix of a message.
    pub fn of(value: &Value, body: &'a Body) -> Result<Self, PictureError> {
        let broken = || PictureError::Broken("its size, step and data do not agree".into());
        let encoding = match value.get("encoding") {
            Some(Value::Text(encoding)) => crate::model::clean(encoding, 40),
            _ => return Err(broken()),
        };
        let (channels, sample) = layout(&encoding).ok_or_else(|| PictureError::Encoding(encoding.clone()))?;
        let number = |field: &str| count(value, field).ok_or_else(broken);
        let (width, height, step) = (number("width")?, number("height")?, number("step")?);
        let data = value.get("data").and_then(|data| bytes(data, body)).ok_or_else(broken)?;
        let row = width.checked_mul(channels * sample).ok_or_else(broken)?;
        let needed = step.checked_mul(height).ok_or_else(broken)?;
        if row > step || needed > data.len() || row == 0 || height == 0 {
            return Err(broken());
        }
        let big_endian = number("is_bigendian")? != 0;
        Ok(Self { width, height, encoding, channels, sample, big_endian, step, data })
    }

    /// The bytes of a row, without padding.
    pub fn row(&self, y: usize) -> &[u8] {
        let start = y * self.step;
        self.data.get(start..start + self.width * self.channels * self.sample).unwrap_or_default()
    }

    fn number(&self, x: usize, y: usize, channel: usize) -> u32 {
        let at = (x * self.channels + channel) * self.sample;
        let row = self.row(y);
        let byte = |offset: usize| u32::from(row.get(at + offset).copied().unwrap_or(0));
        let order = |offset: usize| if self.big_endian { self.sample - 1 - offset } else { offset };
        (0..self.sample).map(|offset| byte(order(offset)) << (8 * offset)).sum()
    }

    /// A number as a float, if the numbers are depths.
    fn depth(&self, x: usize, y: usize) -> f32 {
        let number = self.number(x, y, 0);
        if self.encoding.starts_with("32F") {
            f32::from_bits(number)
        } else if self.sample == 4 {
            // Integer depths never get this large; the difference would not be visible.
            f32::from(u16::try_from(number >> 16).unwrap_or(u16::MAX))
        } else {
            f32::from(u16::try_from(number).unwrap_or(u16::MAX))
        }
    }

    /// Whether numbers are measurements, to be spread over all greys.
    pub fn is_depth(&self) -> bool {
        self.channels == 1 && (self.sample == 4 || self.encoding.starts_with("16"))
    }

    /// The smallest and the largest measurement; missing ones (0, NaN, infinite) do not count.
    pub fn depths(&self) -> Option<(f32, f32)> {
        let mut range: Option<(f32, f32)> = None;
        for y in 0..self.height {
            for x in 0..self.width {
                let depth = self.depth(x, y);
                if depth.is_finite() && depth != 0.0 {
                    let (low, high) = range.unwrap_or((depth, depth));
                    range = Some((low.min(depth), high.max(depth)));
                }
            }
        }
        range
    }

    /// The pixels for display.
    pub fn eye(&self) -> Box<dyn Fn(usize, usize) -> [u8; 3] + '_> {
        if self.is_depth() {
            let (low, high) = self.depths().unwrap_or((0.0, 1.0));
            let scale = 255.0 / (high - low).max(f32::MIN_POSITIVE);
            return Box::new(move |x, y| {
                let depth = self.depth(x, y);
                if depth.is_finite() && depth != 0.0 { [grey((depth - low) * scale); 3] } else { [0; 3] }
            });
        }
        let places = self.places();
        match places {
            Places::Pixel(places) => Box::new(move |x, y| places.map(|channel| self.part(x, y, channel))),
            Places::Bayer(first) => Box::new(move |x, y| self.bayer(x, y, first)),
            Places::Yuv(luma) => Box::new(move |x, y| self.yuv(x, y, luma)),
        }
    }

    fn part(&self, x: usize, y: usize, channel: usize) -> u8 {
        let number = self.number(x, y, channel);
        u8::try_from(number >> (8 * (self.sample - 1))).unwrap_or(u8::MAX)
    }

    fn places(&self) -> Places {
        match self.encoding.as_str() {
            "bayer_rggb8" | "bayer_rggb16" => Places::Bayer((0, 0)),
            "bayer_bggr8" | "bayer_bggr16" => Places::Bayer((1, 1)),
            "bayer_gbrg8" | "bayer_gbrg16" => Places::Bayer((0, 1)),
            "bayer_grbg8" | "bayer_grbg16" => Places::Bayer((1, 0)),
            "yuv422" => Places::Yuv(1),
            "yuv422_yuy2" => Places::Yuv(0),
            encoding if encoding.starts_with("rgb") => Places::Pixel([0, 1, 2]),
            _ if self.channels >= 3 => Places::Pixel([2, 1, 0]),
            _ => Places::Pixel([0; 3]),
        }
    }

    /// Red, one green and blue of the pixel's 2x2 square; `red` = column and row of red in it.
    fn bayer(&self, x: usize, y: usize, red: (usize, usize)) -> [u8; 3] {
        let inside = |x: usize, y: usize| self.part(x.min(self.width - 1), y.min(self.height - 1), 0);
        let (left, top) = (x & !1, y & !1);
        [
            inside(left + red.0, top + red.1),
            inside(left + 1 - red.0, top + red.1),
            inside(left + 1 - red.0, top + 1 - red.1),
        ]
    }

    /// ITU-R BT.601, two pixels sharing their colour.
    fn yuv(&self, x: usize, y: usize, luma: usize) -> [u8; 3] {
        let byte = |at: usize| f32::from(self.row(y).get(at).copied().unwrap_or(128));
        let pair = (x & !1) * 2;
        let light = byte(x * 2 + luma);
        let (u, v) = (byte(pair + 1 - luma) - 128.0, byte(pair + 3 - luma) - 128.0);
        [grey(light + 1.402 * v), grey(light - 0.344 * u - 0.714 * v), grey(light + 1.772 * u)]
    }
}

/// The positions of a pixel's colours.
enum Places {
    Pixel([usize; 3]),
    Bayer((usize, usize)),
    Yuv(usize),
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped before")]
fn grey(value: f32) -> u8 {
    value.clamp(0.0, 255.0) as u8
}
