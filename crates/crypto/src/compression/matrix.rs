//! Matrices of numbers (raw pictures, depth, clouds, scans): each row is filtered as described in `filter`, then all
//! rows go through one fast Deflate stream (RFC 1950, tuned for PNG). Bytes around the matrix are unchanged.

use fdeflate::{Compressor, Decompressor};

use super::{Filter, Restorer};
use crate::model::wire::{Reader, WireError};

/// The most numbers in one pixel or point.
pub const MOST_CHANNELS: usize = 64;

/// Rows shorter than this are not treated as a matrix, bytes.
const SHORTEST_ROW: usize = 16;

/// Flag bits stored with the sample size.
const BIG_ENDIAN: u8 = 0x80;
const GREEN: u8 = 0x40;

/// Rows sampled to see how the colours correlate.
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

    /// Offset just past its last byte.
    fn end(&self) -> Option<usize> {
        self.length()?.checked_add(self.start)
    }

    /// Bytes in a row.
    pub(super) fn row(&self) -> usize {
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
pub(super) fn pack_matrix(body: &[u8], matrix: &Matrix) -> Option<Vec<u8>> {
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

/// Restores what [`pack`] made of a message of `length` bytes, in place in the output buffer.
pub(super) fn unpack_matrix(packed: &[u8], length: usize) -> Result<Vec<u8>, WireError> {
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

/// Fills `out` exactly.
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
    let mut restorer = Restorer::new(matrix, green);
    for number in 0..matrix.rows {
        let from = matrix.start + number * (row + 1);
        let kind = out[from];
        let place = matrix.start + number * row;
        out.copy_within(from + 1..from + 1 + row, place);
        restorer.row(kind, &mut out[place..place + row]).ok_or(DAMAGED)?;
    }
    Ok(())
}
