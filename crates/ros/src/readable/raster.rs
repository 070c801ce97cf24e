//! Thumbnails for screens: any picture averaged down to a bounded number of pixels.

use png::{BitDepth, ColorType};
use serde::{Deserialize, Serialize};

use super::PictureError;
use super::codec::png_file;
use crate::model::base64_text;

/// The largest raster, pixels: enough for half-blocks on a screen of 240 columns and 80 rows.
pub const LARGEST: (usize, usize) = (240, 160);

/// The most source pixels averaged into one, in each direction.
const AVERAGED: usize = 4;

/// A thumbnail.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Raster {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Red, green, blue of each pixel, row by row.
    #[serde(with = "base64_text")]
    pub rgb: Vec<u8>,
}

impl Raster {
    /// A picture of `width` x `height`, averaged down to at most `largest`; never enlarged.
    pub fn of(size: (usize, usize), largest: (usize, usize), pixel: &dyn Fn(usize, usize) -> [u8; 3]) -> Self {
        let (columns, rows) = fitted(size, largest);
        let mut rgb = Vec::with_capacity(columns * rows * 3);
        for row in 0..rows {
            for column in 0..columns {
                let across = (column * size.0 / columns, (column + 1) * size.0 / columns);
                let down = (row * size.1 / rows, (row + 1) * size.1 / rows);
                rgb.extend(average(across, down, pixel));
            }
        }
        Self { width: columns, height: rows, rgb }
    }

    /// This raster averaged down again.
    pub fn fit(&self, largest: (usize, usize)) -> Self {
        Self::of((self.width, self.height), largest, &|x, y| self.pixel(x, y))
    }

    /// Its size when fitted into `largest` with its aspect ratio kept; never enlarged.
    pub fn size_within(&self, largest: (usize, usize)) -> (usize, usize) {
        fitted((self.width, self.height), largest)
    }

    /// As a PNG.
    ///
    /// # Errors
    /// [`PictureError`] if it has no pixels.
    pub fn png(&self) -> Result<Vec<u8>, PictureError> {
        png_file(&self.rgb, (self.width, self.height), ColorType::Rgb, BitDepth::Eight)
    }

    /// A pixel; black outside the picture.
    pub fn pixel(&self, x: usize, y: usize) -> [u8; 3] {
        let at = (y * self.width + x) * 3;
        self.rgb.get(at..at + 3).and_then(|rgb| rgb.try_into().ok()).unwrap_or_default()
    }
}

/// The size of a picture fitted into `largest` with its aspect ratio kept.
pub fn fitted(size: (usize, usize), largest: (usize, usize)) -> (usize, usize) {
    let (width, height) = size;
    if width == 0 || height == 0 || largest.0 == 0 || largest.1 == 0 {
        return (0, 0);
    }
    if width <= largest.0 && height <= largest.1 {
        return size;
    }
    if width.saturating_mul(largest.1) >= height.saturating_mul(largest.0) {
        (largest.0, (height.saturating_mul(largest.0) / width).max(1))
    } else {
        ((width.saturating_mul(largest.1) / height).max(1), largest.1)
    }
}

fn average(across: (usize, usize), down: (usize, usize), pixel: &dyn Fn(usize, usize) -> [u8; 3]) -> [u8; 3] {
    let steps = |(from, to): (usize, usize)| {
        let end = to.max(from + 1);
        (from..end).step_by((end - from).div_ceil(AVERAGED))
    };
    let mut sums = [0u32; 3];
    let mut count = 0;
    for y in steps(down) {
        for x in steps(across) {
            for (sum, part) in sums.iter_mut().zip(pixel(x, y)) {
                *sum += u32::from(part);
            }
            count += 1;
        }
    }
    sums.map(|sum| u8::try_from(sum / count.max(1)).unwrap_or(u8::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_keep_their_shape_and_are_never_made_larger() {
        assert_eq!(fitted((640, 480), (240, 160)), (213, 160));
        assert_eq!(fitted((100, 50), (240, 160)), (100, 50));
        assert_eq!(fitted((1_000_000, 1), (240, 160)), (240, 1));
        assert_eq!(fitted((0, 5), (240, 160)), (0, 0));
    }

    #[test]
    fn pixels_are_averaged() {
        let chequered = |x: usize, y: usize| if (x + y).is_multiple_of(2) { [200, 0, 100] } else { [0, 0, 0] };
        let raster = Raster::of((8, 8), (2, 2), &chequered);
        assert_eq!((raster.width, raster.height, raster.rgb.len()), (2, 2, 12));
        assert_eq!(raster.pixel(1, 1), [100, 0, 50]);
        assert_eq!(raster.fit((1, 1)).pixel(0, 0), [100, 0, 50]);
        assert_eq!(raster.pixel(9, 9), [0, 0, 0]);
    }
}
