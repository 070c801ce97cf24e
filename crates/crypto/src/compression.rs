//! Lossless compression of each message before it is sealed, and bounded decompression. `pipeline` decides which
//! messages are worth compressing; `ros` says where the matrix of a message lies.

mod matrix;
#[cfg(test)]
mod tests;

pub use self::matrix::{MOST_CHANNELS, Matrix};

use crate::model::head::Compression;
use crate::model::wire::WireError;

/// Messages shorter than this are not compressed, bytes.
pub const SHORTEST: usize = 128;

/// The most bytes that LZ4 expands one byte to.
const MOST_PER_BYTE: usize = 255;

/// Bytes sampled to see whether a long message is worth compressing.
const PROBE: usize = 16 * 1024;

/// A compressed message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Packed {
    /// The method.
    pub compression: Compression,
    /// The bytes to seal.
    pub bytes: Vec<u8>,
}

/// Compresses `body` if that saves at least an eighth of it.
pub fn pack(body: &[u8], matrix: Option<&Matrix>) -> Option<Packed> {
    if body.len() < SHORTEST {
        return None;
    }
    if let Some(bytes) = matrix.and_then(|matrix| matrix::pack_matrix(body, matrix)).filter(|bytes| pays(bytes, body)) {
        return Some(Packed { compression: Compression::Matrix, bytes });
    }
    if body.len() > 4 * PROBE && !pays(&lz4_flex::block::compress(middle(body)), middle(body)) {
        return None;
    }
    let bytes = lz4_flex::block::compress(body);
    pays(&bytes, body).then_some(Packed { compression: Compression::Lz4, bytes })
}

fn middle(body: &[u8]) -> &[u8] {
    let start = (body.len() - PROBE) / 2;
    &body[start..start + PROBE]
}

fn pays(packed: &[u8], body: &[u8]) -> bool {
    packed.len() <= body.len() - body.len() / 8
}

/// Restores a message of `length` bytes; the caller has bounded `length`. Allocates no more than that.
///
/// # Errors
/// [`WireError`] if `packed` is not what [`pack`] produces for a message of that length.
pub fn unpack(compression: Compression, packed: &[u8], length: usize) -> Result<Vec<u8>, WireError> {
    let damaged = WireError::Value("compressed body");
    match compression {
        Compression::None if packed.len() == length => Ok(packed.to_vec()),
        Compression::None => Err(damaged),
        Compression::Matrix => matrix::unpack_matrix(packed, length),
        Compression::Lz4 if length / MOST_PER_BYTE > packed.len() => Err(damaged),
        Compression::Lz4 => {
            let plain = lz4_flex::block::decompress(packed, length).map_err(|_| damaged)?;
            if plain.len() == length { Ok(plain) } else { Err(damaged) }
        }
    }
}

// Filters that make the numbers of a row small: bytes as in PNG (ISO/IEC 15948, clause 9), after subtracting green
// from the other colours; wider numbers as differences, folded and split into byte planes.

const PLAIN: u8 = 0;
const LEFT: u8 = 1;
const ABOVE: u8 = 2;
const AVERAGE: u8 = 3;
const PAETH: u8 = 4;

/// What both directions need.
struct Shape {
    /// Distance between comparable neighbours in a row, in bytes or numbers.
    back: usize,
    sample: usize,
    big_endian: bool,
    /// Channels of a pixel whose second channel is green; 0 = not a colour picture.
    colours: usize,
    /// How many rows up the comparable neighbour is.
    apart: usize,
}

impl Shape {
    fn new(matrix: &Matrix, green: bool) -> Self {
        Self {
            back: matrix.apart * matrix.channels,
            sample: matrix.sample,
            big_endian: matrix.big_endian,
            colours: if green { matrix.channels } else { 0 },
            apart: matrix.apart,
        }
    }

    /// How many bytes, or else wider numbers, there are in a row of the given length.
    fn widths(&self, row: usize) -> (usize, usize) {
        if self.sample == 1 { (row, 0) } else { (0, row / self.sample) }
    }
}

/// The rows above, the nearest first.
struct Above<T> {
    rows: [Vec<T>; 2],
    apart: usize,
}

impl<T: Copy + Default> Above<T> {
    fn new(width: usize, apart: usize) -> Self {
        Self { rows: [vec![T::default(); width], vec![T::default(); width]], apart }
    }

    fn row(&self) -> &[T] {
        &self.rows[self.apart - 1]
    }

    /// Moves on to the next row; the caller fills the returned buffer with the row just done.
    fn turn(&mut self) -> &mut [T] {
        self.rows.rotate_right(1);
        &mut self.rows[0]
    }
}

/// Filters row after row.
struct Filter {
    shape: Shape,
    bytes: Above<u8>,
    numbers: Above<u32>,
    now: Vec<u8>,
    wide: Vec<u32>,
    best: Vec<u8>,
    tried: Vec<u8>,
}

impl Filter {
    pub fn new(matrix: &Matrix, green: bool) -> Self {
        let (shape, row) = (Shape::new(matrix, green), matrix.row());
        let (bytes, numbers) = shape.widths(row);
        Self {
            bytes: Above::new(bytes, shape.apart),
            numbers: Above::new(numbers, shape.apart),
            now: vec![0; bytes],
            wide: vec![0; numbers],
            best: vec![0; row + 1],
            tried: vec![0; row + 1],
            shape,
        }
    }

    /// The filtered row: one byte more than `row`.
    pub fn row(&mut self, row: &[u8]) -> &[u8] {
        if self.shape.sample == 1 {
            self.row_of_bytes(row)
        } else {
            self.row_of_numbers(row)
        }
        &self.best
    }

    fn row_of_bytes(&mut self, row: &[u8]) {
        self.now.copy_from_slice(row);
        take_green(&mut self.now, self.shape.colours);
        let mut least = u64::MAX;
        for kind in [ABOVE, LEFT, PAETH, AVERAGE, PLAIN] {
            self.tried[0] = kind;
            filter_bytes(kind, self.shape.back, &self.now, self.bytes.row(), &mut self.tried[1..]);
            let cost = self.tried[1..].iter().map(|byte| u64::from(byte.cast_signed().unsigned_abs())).sum();
            if cost < least {
                least = cost;
                std::mem::swap(&mut self.best, &mut self.tried);
            }
        }
        self.bytes.turn().copy_from_slice(&self.now);
    }

    fn row_of_numbers(&mut self, row: &[u8]) {
        load(row, &self.shape, &mut self.wide);
        let mut least = u64::MAX;
        for kind in [ABOVE, LEFT] {
            let above = self.numbers.row();
            let cost = (0..self.wide.len()).map(|at| cost(self.shape.coded(kind, at, &self.wide, above))).sum();
            if cost < least {
                least = cost;
                self.best[0] = kind;
            }
        }
        let (kind, planes) = (self.best[0], self.wide.len());
        for at in 0..planes {
            let coded = self.shape.coded(kind, at, &self.wide, self.numbers.row());
            for (plane, byte) in coded.to_le_bytes().into_iter().take(self.shape.sample).enumerate() {
                self.best[1 + plane * planes + at] = byte;
            }
        }
        self.numbers.turn().copy_from_slice(&self.wide);
    }
}

/// Bits per number.
fn cost(number: u32) -> u64 {
    u64::from(32 - number.leading_zeros())
}

impl Shape {
    /// A difference as an unsigned number, small differences first.
    #[inline]
    fn coded(&self, kind: u8, at: usize, now: &[u32], above: &[u32]) -> u32 {
        let predicted = if kind == ABOVE { above[at] } else { at.checked_sub(self.back).map_or(0, |left| now[left]) };
        let free = 32 - 8 * u32::try_from(self.sample).unwrap_or(4);
        let high = now[at].wrapping_sub(predicted) << free;
        (high << 1 ^ 0u32.wrapping_sub(high >> 31)) >> free
    }

    #[inline]
    fn decoded(&self, kind: u8, coded: u32, at: usize, now: &[u32], above: &[u32]) -> u32 {
        let predicted = if kind == ABOVE { above[at] } else { at.checked_sub(self.back).map_or(0, |left| now[left]) };
        let difference = coded >> 1 ^ 0u32.wrapping_sub(coded & 1);
        predicted.wrapping_add(difference) & (u32::MAX >> (32 - 8 * u32::try_from(self.sample).unwrap_or(4)))
    }
}

fn filter_bytes(kind: u8, back: usize, now: &[u8], above: &[u8], out: &mut [u8]) {
    match kind {
        ABOVE => {
            out.iter_mut().zip(now.iter().zip(above)).for_each(|(out, (now, above))| *out = now.wrapping_sub(*above))
        }
        LEFT => {
            let begin = back.min(now.len());
            out[..begin].copy_from_slice(&now[..begin]);
            let pairs = now[begin..].iter().zip(now);
            out[begin..].iter_mut().zip(pairs).for_each(|(out, (now, left))| *out = now.wrapping_sub(*left));
        }
        AVERAGE | PAETH => {
            let begin = back.min(now.len());
            for at in 0..begin {
                out[at] = now[at].wrapping_sub(if kind == PAETH { above[at] } else { above[at] / 2 });
            }
            let around = now.iter().zip(above.iter().zip(&above[begin..]));
            let pairs = now[begin..].iter().zip(around);
            if kind == PAETH {
                out[begin..].iter_mut().zip(pairs).for_each(|(out, (now, (left, (corner, above))))| {
                    *out = now.wrapping_sub(paeth(*left, *above, *corner));
                });
            } else {
                out[begin..].iter_mut().zip(pairs).for_each(|(out, (now, (left, (_, above))))| {
                    *out = now.wrapping_sub(left.midpoint(*above));
                });
            }
        }
        _ => out.copy_from_slice(now),
    }
}

/// The neighbour closest to left + above - corner (Paeth).
#[inline]
fn paeth(left: u8, above: u8, corner: u8) -> u8 {
    let (a, b, c) = (i16::from(left), i16::from(above), i16::from(corner));
    let (to_left, to_above, to_corner) = ((b - c).abs(), (a - c).abs(), (a + b - c - c).abs());
    if to_left <= to_above && to_left <= to_corner {
        left
    } else if to_above <= to_corner {
        above
    } else {
        corner
    }
}

fn take_green(row: &mut [u8], channels: usize) {
    if channels > 0 {
        for pixel in row.chunks_exact_mut(channels) {
            pixel[0] = pixel[0].wrapping_sub(pixel[1]);
            pixel[2] = pixel[2].wrapping_sub(pixel[1]);
        }
    }
}

fn give_green(row: &mut [u8], channels: usize) {
    if channels > 0 {
        for pixel in row.chunks_exact_mut(channels) {
            pixel[0] = pixel[0].wrapping_add(pixel[1]);
            pixel[2] = pixel[2].wrapping_add(pixel[1]);
        }
    }
}

fn load(row: &[u8], shape: &Shape, numbers: &mut [u32]) {
    let big = shape.big_endian;
    if shape.sample == 2 {
        numbers.iter_mut().zip(row.as_chunks::<2>().0).for_each(|(number, bytes)| {
            *number = u32::from(if big { u16::from_be_bytes(*bytes) } else { u16::from_le_bytes(*bytes) });
        });
    } else {
        numbers.iter_mut().zip(row.as_chunks::<4>().0).for_each(|(number, bytes)| {
            *number = if big { u32::from_be_bytes(*bytes) } else { u32::from_le_bytes(*bytes) };
        });
    }
}

fn store(numbers: &[u32], shape: &Shape, row: &mut [u8]) {
    let big = shape.big_endian;
    for (number, bytes) in numbers.iter().zip(row.chunks_exact_mut(shape.sample)) {
        let four = if big { number.to_be_bytes() } else { number.to_le_bytes() };
        let part = if big { &four[4 - shape.sample..] } else { &four[..shape.sample] };
        bytes.copy_from_slice(part);
    }
}

/// Restores row after row.
struct Restorer {
    shape: Shape,
    bytes: Above<u8>,
    numbers: Above<u32>,
    wide: Vec<u32>,
}

impl Restorer {
    pub fn new(matrix: &Matrix, green: bool) -> Self {
        let (shape, row) = (Shape::new(matrix, green), matrix.row());
        let (bytes, numbers) = shape.widths(row);
        Self {
            bytes: Above::new(bytes, shape.apart),
            numbers: Above::new(numbers, shape.apart),
            wide: vec![0; numbers],
            shape,
        }
    }

    /// Undoes filter `kind` on a row; `None` if there is no such filter.
    pub fn row(&mut self, kind: u8, row: &mut [u8]) -> Option<()> {
        if self.shape.sample == 1 { self.row_of_bytes(kind, row) } else { self.row_of_numbers(kind, row) }
    }

    fn row_of_bytes(&mut self, kind: u8, row: &mut [u8]) -> Option<()> {
        let back = self.shape.back.min(row.len());
        restore_bytes(kind, back, row, self.bytes.row())?;
        self.bytes.turn().copy_from_slice(row);
        give_green(row, self.shape.colours);
        Some(())
    }

    fn row_of_numbers(&mut self, kind: u8, row: &mut [u8]) -> Option<()> {
        if !matches!(kind, LEFT | ABOVE) {
            return None;
        }
        let planes = self.wide.len();
        for at in 0..planes {
            let mut four = [0; 4];
            for (plane, byte) in four.iter_mut().take(self.shape.sample).enumerate() {
                *byte = row[plane * planes + at];
            }
            let coded = u32::from_le_bytes(four);
            self.wide[at] = self.shape.decoded(kind, coded, at, &self.wide, self.numbers.row());
        }
        store(&self.wide, &self.shape, row);
        self.numbers.turn().copy_from_slice(&self.wide);
        Some(())
    }
}

fn restore_bytes(kind: u8, back: usize, row: &mut [u8], above: &[u8]) -> Option<()> {
    match kind {
        PLAIN => {}
        ABOVE => row.iter_mut().zip(above).for_each(|(byte, above)| *byte = byte.wrapping_add(*above)),
        LEFT => {
            for at in back..row.len() {
                row[at] = row[at].wrapping_add(row[at - back]);
            }
        }
        AVERAGE => {
            for at in 0..row.len() {
                let left = at.checked_sub(back).map_or(0, |left| row[left]);
                row[at] = row[at].wrapping_add(left.midpoint(above[at]));
            }
        }
        PAETH => {
            for at in 0..back {
                row[at] = row[at].wrapping_add(above[at]);
            }
            for at in back..row.len() {
                row[at] = row[at].wrapping_add(paeth(row[at - back], above[at], above[at - back]));
            }
        }
        _ => return None,
    }
    Some(())
}
