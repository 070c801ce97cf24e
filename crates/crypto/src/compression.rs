//! Lossless compression of each message before it is sealed, and bounded decompression.

use crate::model::head::Compression;
use crate::model::wire::{Reader, WireError};
use fdeflate::{Compressor, Decompressor};

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
    if let Some(bytes) = matrix.and_then(|matrix| pack_matrix(body, matrix)).filter(|bytes| pays(bytes, body)) {
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
/// # Errors
/// [`WireError`] if `packed` is not what [`pack`] produces for a message of that length.
pub fn unpack(compression: Compression, packed: &[u8], length: usize) -> Result<Vec<u8>, WireError> {
    let damaged = WireError::Value("compressed body");
    match compression {
        Compression::None if packed.len() == length => Ok(packed.to_vec()),
        Compression::None => Err(damaged),
        Compression::Matrix => unpack_matrix(packed, length),
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

struct Rows {
    shape: Shape,
    bytes: Above<u8>,
    numbers: Above<u32>,
    wide: Vec<u32>,
}

impl Rows {
    fn new(matrix: &Matrix, green: bool) -> Self {
        let shape = Shape::new(matrix, green);
        let (bytes, numbers) = shape.widths(matrix.row());
        Self {
            bytes: Above::new(bytes, shape.apart),
            numbers: Above::new(numbers, shape.apart),
            wide: vec![0; numbers],
            shape,
        }
    }
}

struct Filter {
    rows: Rows,
    now: Vec<u8>,
    best: Vec<u8>,
    tried: Vec<u8>,
}

impl Filter {
    pub fn new(matrix: &Matrix, green: bool) -> Self {
        let row = matrix.row();
        Self { rows: Rows::new(matrix, green), now: vec![0; row], best: vec![0; row + 1], tried: vec![0; row + 1] }
    }

    /// The filtered row: one byte more than `row`.
    pub fn row(&mut self, row: &[u8]) -> &[u8] {
        if self.rows.shape.sample == 1 {
            self.row_of_bytes(row)
        } else {
            self.row_of_numbers(row)
        }
        &self.best
    }

    fn row_of_bytes(&mut self, row: &[u8]) {
        let shape = &self.rows.shape;
        self.now.copy_from_slice(row);
        turn_green(&mut self.now, shape.colours, u8::wrapping_sub);
        let mut least = u64::MAX;
        for kind in [ABOVE, LEFT, PAETH, AVERAGE, PLAIN] {
            self.tried[0] = kind;
            filter_bytes(kind, shape.back, &self.now, self.rows.bytes.row(), &mut self.tried[1..]);
            let cost = self.tried[1..].iter().map(|byte| u64::from(byte.cast_signed().unsigned_abs())).sum();
            if cost < least {
                least = cost;
                std::mem::swap(&mut self.best, &mut self.tried);
            }
        }
        self.rows.bytes.turn().copy_from_slice(&self.now);
    }

    fn row_of_numbers(&mut self, row: &[u8]) {
        let Rows { shape, numbers, wide, .. } = &mut self.rows;
        load(row, shape, wide);
        let mut least = u64::MAX;
        for kind in [ABOVE, LEFT] {
            let cost = (0..wide.len()).map(|at| cost(shape.coded(kind, at, wide, numbers.row()))).sum();
            if cost < least {
                least = cost;
                self.best[0] = kind;
            }
        }
        let (kind, planes) = (self.best[0], wide.len());
        for at in 0..planes {
            let coded = shape.coded(kind, at, wide, numbers.row());
            for (plane, byte) in coded.to_le_bytes().into_iter().take(shape.sample).enumerate() {
                self.best[1 + plane * planes + at] = byte;
            }
        }
        numbers.turn().copy_from_slice(wide);
    }
}

fn cost(number: u32) -> u64 {
    u64::from(32 - number.leading_zeros())
}

impl Shape {
    #[inline]
    fn predicted(&self, kind: u8, at: usize, now: &[u32], above: &[u32]) -> u32 {
        if kind == ABOVE { above[at] } else { at.checked_sub(self.back).map_or(0, |left| now[left]) }
    }

    /// Bits of 32 that a number does not have.
    #[inline]
    fn free(&self) -> u32 {
        32 - 8 * u32::try_from(self.sample).unwrap_or(4)
    }

    /// A difference as an unsigned number, small differences first.
    #[inline]
    fn coded(&self, kind: u8, at: usize, now: &[u32], above: &[u32]) -> u32 {
        let high = now[at].wrapping_sub(self.predicted(kind, at, now, above)) << self.free();
        (high << 1 ^ 0u32.wrapping_sub(high >> 31)) >> self.free()
    }

    #[inline]
    fn decoded(&self, kind: u8, coded: u32, at: usize, now: &[u32], above: &[u32]) -> u32 {
        let difference = coded >> 1 ^ 0u32.wrapping_sub(coded & 1);
        self.predicted(kind, at, now, above).wrapping_add(difference) & (u32::MAX >> self.free())
    }
}

fn filter_bytes(kind: u8, back: usize, now: &[u8], above: &[u8], out: &mut [u8]) {
    match kind {
        ABOVE => filter_by(back, now, above, out, |_, above, _| above),
        LEFT => filter_by(back, now, above, out, |left, _, _| left),
        AVERAGE => filter_by(back, now, above, out, |left, above, _| left.midpoint(above)),
        PAETH => filter_by(back, now, above, out, paeth),
        _ => out.copy_from_slice(now),
    }
}

/// Subtracts what is predicted from the bytes to the left, above, and above on the left.
#[inline]
fn filter_by(back: usize, now: &[u8], above: &[u8], out: &mut [u8], predicted: impl Fn(u8, u8, u8) -> u8) {
    let begin = back.min(now.len());
    for at in 0..begin {
        out[at] = now[at].wrapping_sub(predicted(0, above[at], 0));
    }
    let around = now.iter().zip(above.iter().zip(&above[begin..]));
    let pairs = now[begin..].iter().zip(around);
    out[begin..].iter_mut().zip(pairs).for_each(|(out, (now, (left, (corner, above))))| {
        *out = now.wrapping_sub(predicted(*left, *above, *corner));
    });
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

fn turn_green(row: &mut [u8], channels: usize, turn: impl Fn(u8, u8) -> u8) {
    if channels > 0 {
        for pixel in row.chunks_exact_mut(channels) {
            pixel[0] = turn(pixel[0], pixel[1]);
            pixel[2] = turn(pixel[2], pixel[1]);
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

impl Rows {
    /// Undoes filter `kind` on a row; `None` if there is no such filter.
    fn row(&mut self, kind: u8, row: &mut [u8]) -> Option<()> {
        if self.shape.sample == 1 { self.row_of_bytes(kind, row) } else { self.row_of_numbers(kind, row) }
    }

    fn row_of_bytes(&mut self, kind: u8, row: &mut [u8]) -> Option<()> {
        let back = self.shape.back.min(row.len());
        restore_bytes(kind, back, row, self.bytes.row())?;
        self.bytes.turn().copy_from_slice(row);
        turn_green(row, self.shape.colours, u8::wrapping_add);
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
        LEFT => restore_by(back, row, above, |left, _, _| left),
        AVERAGE => restore_by(back, row, above, |left, above, _| left.midpoint(above)),
        PAETH => restore_by(back, row, above, paeth),
        _ => return None,
    }
    Some(())
}

#[inline]
fn restore_by(back: usize, row: &mut [u8], above: &[u8], predicted: impl Fn(u8, u8, u8) -> u8) {
    for at in 0..back {
        row[at] = row[at].wrapping_add(predicted(0, above[at], 0));
    }
    for at in back..row.len() {
        row[at] = row[at].wrapping_add(predicted(row[at - back], above[at], above[at - back]));
    }
}

/// The most numbers in one pixel or point.
pub const MOST_CHANNELS: usize = 64;

/// Rows shorter than this are not treated as a matrix, bytes.
const SHORTEST_ROW: usize = 16;

const BIG_ENDIAN: u8 = 0x80;
const GREEN: u8 = 0x40;

const LOOKED_AT: usize = 16;

/// The most bytes that Deflate expands one byte to.
const MOST_PER_MATRIX_BYTE: usize = 1100;

/// Where a matrix lies in a message, and its layout.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Matrix {
    /// Offset of its first byte.
    pub start: usize,
    /// Number of rows.
    pub rows: usize,
    /// Pixels in a row; rows follow one another without a gap.
    pub columns: usize,
    /// Numbers in a pixel.
    pub channels: usize,
    /// Bytes in a number: 1, 2 or 4.
    pub sample: usize,
    /// Whether numbers are big endian.
    pub big_endian: bool,
    /// Distance of comparable neighbours: 1, or 2 for Bayer patterns.
    pub apart: usize,
}

impl Matrix {
    /// Bytes of the matrix; `None` if it cannot be coded.
    pub fn length(&self) -> Option<usize> {
        let allowed = matches!(self.sample, 1 | 2 | 4)
            && (1..=MOST_CHANNELS).contains(&self.channels)
            && (1..=2).contains(&self.apart)
            && self.columns > 0;
        let row = self.columns.checked_mul(self.channels)?.checked_mul(self.sample)?;
        self.rows.checked_mul(row).filter(|_| allowed && row >= SHORTEST_ROW)
    }

    fn end(&self) -> Option<usize> {
        self.length()?.checked_add(self.start)
    }

    fn row(&self) -> usize {
        self.columns * self.channels * self.sample
    }

    fn head(&self, green: bool) -> Option<[u8; 15]> {
        let mut head = [0; 15];
        for (place, number) in [self.start, self.rows, self.columns].into_iter().enumerate() {
            head[place * 4..place * 4 + 4].copy_from_slice(&u32::try_from(number).ok()?.to_be_bytes());
        }
        head[12] = u8::try_from(self.channels).ok()?;
        head[13] = u8::try_from(self.sample).ok()?
            | if self.big_endian { BIG_ENDIAN } else { 0 }
            | if green { GREEN } else { 0 };
        head[14] = u8::try_from(self.apart).ok()?;
        Some(head)
    }

    /// Reads the layout; also returns whether green was subtracted from the other colours.
    fn read(reader: &mut Reader<'_>) -> Result<(Self, bool), WireError> {
        let number = |reader: &mut Reader<'_>| -> Result<usize, WireError> {
            usize::try_from(reader.u32("matrix")?).map_err(|_| WireError::Value("matrix"))
        };
        let (start, rows, columns) = (number(reader)?, number(reader)?, number(reader)?);
        let channels = usize::from(reader.u8("channels")?);
        let sample = reader.u8("sample")?;
        let apart = usize::from(reader.u8("distance")?);
        let (big_endian, green) = (sample & BIG_ENDIAN != 0, sample & GREEN != 0);
        let sample = usize::from(sample & !(BIG_ENDIAN | GREEN));
        if green && (sample != 1 || channels < 3) {
            return Err(DAMAGED);
        }
        Ok((Self { start, rows, columns, channels, sample, big_endian, apart }, green))
    }
}

const DAMAGED: WireError = WireError::Value("matrix");

/// Codes `body` with its matrix; `None` if it has no matrix of that shape, or as soon as coding proves not worth it.
fn pack_matrix(body: &[u8], matrix: &Matrix) -> Option<Vec<u8>> {
    let end = matrix.end()?;
    let (before, numbers, behind) = (body.get(..matrix.start)?, body.get(matrix.start..end)?, body.get(end..)?);
    let mut out = Vec::with_capacity(body.len() / 2);
    let green = matches!(matrix.channels, 3 | 4) && matrix.sample == 1 && is_grey(numbers, matrix);
    out.extend_from_slice(&matrix.head(green)?);
    out.extend_from_slice(before);
    out.extend_from_slice(behind);
    let mut coder = Compressor::new(out).ok()?;
    let mut filter = Filter::new(matrix, green);
    for row in numbers.chunks_exact(matrix.row()) {
        coder.write_data(filter.row(row)).ok()?;
    }
    coder.finish().ok()
}

/// Whether red and blue vary with green, judged by some of the rows.
fn is_grey(numbers: &[u8], matrix: &Matrix) -> bool {
    let change = |left: u8, right: u8| right.wrapping_sub(left).cast_signed();
    let (mut plain, mut taken) = (0u64, 0u64);
    for row in numbers.chunks_exact(matrix.row()).step_by((matrix.rows / LOOKED_AT).max(1)) {
        for (one, other) in row.chunks_exact(matrix.channels).zip(row.chunks_exact(matrix.channels).skip(1)) {
            let green = change(one[1], other[1]);
            for colour in [0, 2] {
                let change = change(one[colour], other[colour]);
                plain += u64::from(change.unsigned_abs());
                taken += u64::from(change.wrapping_sub(green).unsigned_abs());
            }
        }
    }
    taken < plain
}

fn unpack_matrix(packed: &[u8], length: usize) -> Result<Vec<u8>, WireError> {
    let mut reader = Reader::new(packed);
    let (matrix, green) = Matrix::read(&mut reader)?;
    let end = matrix.end().filter(|end| *end <= length).ok_or(DAMAGED)?;
    let before = reader.take(matrix.start, "matrix")?;
    let behind = reader.take(length - end, "matrix")?;
    if length / MOST_PER_MATRIX_BYTE > packed.len() {
        return Err(DAMAGED);
    }
    let mut out = vec![0; matrix.start + matrix.rows * (matrix.row() + 1)];
    out[..matrix.start].copy_from_slice(before);
    inflate(reader.rest(), &mut out[matrix.start..])?;
    restore(&matrix, green, &mut out)?;
    out.truncate(end);
    out.extend_from_slice(behind);
    Ok(out)
}

fn inflate(stream: &[u8], out: &mut [u8]) -> Result<(), WireError> {
    let mut coder = Decompressor::new();
    let (mut rest, mut filled) = (stream, 0);
    loop {
        let (used, made) = coder.read(rest, out, filled, true).map_err(|_| DAMAGED)?;
        rest = rest.get(used..).ok_or(DAMAGED)?;
        filled += made;
        if coder.is_done() {
            break;
        }
        if used == 0 && made == 0 {
            return Err(DAMAGED);
        }
    }
    if rest.is_empty() && filled == out.len() { Ok(()) } else { Err(DAMAGED) }
}

/// Restores the rows in place, moving each to its final position.
fn restore(matrix: &Matrix, green: bool, out: &mut [u8]) -> Result<(), WireError> {
    let row = matrix.row();
    let mut rows = Rows::new(matrix, green);
    for number in 0..matrix.rows {
        let from = matrix.start + number * (row + 1);
        let kind = out[from];
        let place = matrix.start + number * row;
        out.copy_within(from + 1..from + 1 + row, place);
        rows.row(kind, &mut out[place..place + row]).ok_or(DAMAGED)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests;
