//! The position of a walk in a body, and the layout of numbers there: packed as in ROS 1, or aligned as in CDR.

use super::decode::Failure;
use crate::model::wire::WireError;

/// Bytes of the encapsulation header, which gives the layout of the rest.
const ENCAPSULATION: usize = 4;

/// The most bytes of padding after a CDR body.
const MOST_PADDING: usize = 3;

/// How a wide text states its length; middlewares do not agree.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Wide {
    /// Bytes, two for each unit (Fast CDR 2, XTypes).
    Bytes,
    /// Units of two bytes (Cyclone DDS).
    Pairs,
    /// Units of four bytes (Fast CDR 1).
    Quads,
}

/// The layout of a CDR body, from its first bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Cdr {
    big_endian: bool,
    /// The second version: eight-byte values are aligned to four, sequences of non-primitive elements state their
    /// length in bytes.
    second: bool,
    /// Whether every message states its length in bytes too.
    delimited: bool,
    wide: Wide,
}

impl Cdr {
    /// Reads the encapsulation header.
    pub fn of(body: &[u8]) -> Result<Self, Failure> {
        let Some([0, kind, _, _]) = body.first_chunk::<ENCAPSULATION>() else { return Err(Failure::NoCdr) };
        let (second, delimited) = match kind {
            0 | 1 => (false, false),
            6 | 7 => (true, false),
            8 | 9 => (true, true),
            2 | 3 | 10 | 11 => return Err(Failure::ByNumber),
            _ => return Err(Failure::NoCdr),
        };
        Ok(Self { big_endian: kind & 1 == 0, second, delimited, wide: Wide::Bytes })
    }

    /// Every possible layout of its wide texts.
    pub fn ways(self) -> [Self; 3] {
        [Wide::Bytes, Wide::Pairs, Wide::Quads].map(|wide| Self { wide, ..self })
    }
}

/// A place in a body.
#[derive(Debug, Clone)]
pub(super) struct Cursor<'a> {
    body: &'a [u8],
    at: usize,
    /// `None` if numbers are packed.
    cdr: Option<Cdr>,
    /// Whether something was read that no writer writes: padding that is not zero, a wide text that is not UTF-16.
    odd: bool,
}

/// A part of a body that stated its length in bytes: its end.
#[derive(Debug, Clone, Copy)]
#[must_use]
pub(super) struct Part(Option<usize>);

impl<'a> Cursor<'a> {
    pub fn new(body: &'a [u8], cdr: Option<Cdr>) -> Self {
        Self { body, at: if cdr.is_some() { ENCAPSULATION } else { 0 }, cdr, odd: false }
    }

    /// Bytes read so far.
    pub fn at(&self) -> usize {
        self.at
    }

    /// Bytes not read yet.
    pub fn left(&self) -> usize {
        self.body.len().saturating_sub(self.at)
    }

    pub fn is_cdr(&self) -> bool {
        self.cdr.is_some()
    }

    pub fn is_big_endian(&self) -> bool {
        self.cdr.is_some_and(|cdr| cdr.big_endian)
    }

    pub fn take(&mut self, count: usize, what: &'static str) -> Result<&'a [u8], WireError> {
        let end = self.at.checked_add(count).ok_or(WireError::Short(what))?;
        let bytes = self.body.get(self.at..end).ok_or(WireError::Short(what))?;
        self.at = end;
        Ok(bytes)
    }

    /// Skips the padding before a number of that many bytes.
    pub fn align(&mut self, size: usize) -> Result<(), WireError> {
        let Some(cdr) = self.cdr else { return Ok(()) };
        let size = size.min(if cdr.second { 4 } else { 8 });
        let over = (self.at - ENCAPSULATION) % size;
        if over > 0 {
            let padding = self.take(size - over, "number")?;
            self.odd |= padding.iter().any(|byte| *byte != 0);
        }
        Ok(())
    }

    /// The bytes of a number, least significant first.
    pub fn number<const N: usize>(&mut self, what: &'static str) -> Result<[u8; N], WireError> {
        self.align(N)?;
        let mut bytes = *self.take(N, what)?.first_chunk().ok_or(WireError::Short(what))?;
        if self.is_big_endian() {
            bytes.reverse();
        }
        Ok(bytes)
    }

    /// A length of four bytes.
    pub fn length(&mut self) -> Result<usize, WireError> {
        let length = u32::from_le_bytes(self.number("length")?);
        Ok(usize::try_from(length).unwrap_or(usize::MAX))
    }

    /// The bytes of a text; in CDR its length includes the trailing zero.
    pub fn text(&mut self) -> Result<&'a [u8], WireError> {
        let length = self.length()?;
        let bytes = self.take(length, "text")?;
        Ok(if self.is_cdr() { bytes.strip_suffix(&[0]).unwrap_or(bytes) } else { bytes })
    }

    /// A wide text.
    pub fn wide_text(&mut self) -> Result<String, WireError> {
        let length = self.length()?;
        let (size, count) = match self.cdr.map_or(Wide::Bytes, |cdr| cdr.wide) {
            Wide::Bytes if length % 2 == 1 => return Err(WireError::Value("wide text")),
            Wide::Bytes => (2, length / 2),
            Wide::Pairs => (2, length),
            Wide::Quads => (4, length),
        };
        let bytes = self.take(count.saturating_mul(size), "wide text")?;
        let big_endian = self.is_big_endian();
        let unit = |bytes: &[u8]| {
            let whole = bytes.iter().rev().fold(0_u32, |sum, byte| (sum << 8) | u32::from(*byte));
            let whole = if big_endian { whole.swap_bytes() >> (32 - 8 * size) } else { whole };
            u16::try_from(whole).map_err(|_| WireError::Value("wide text"))
        };
        let units = bytes.chunks_exact(size).map(unit).collect::<Result<Vec<u16>, _>>()?;
        let text = String::from_utf16_lossy(&units);
        self.odd |= text.contains('\u{fffd}');
        Ok(text)
    }

    /// Whether something was read that no writer writes.
    pub fn is_odd(&self) -> bool {
        self.odd
    }

    /// Begins a message.
    pub fn begin_message(&mut self) -> Result<Part, Failure> {
        self.begin(self.cdr.is_some_and(|cdr| cdr.delimited))
    }

    /// Begins an array, before its count.
    pub fn begin_array(&mut self, of_numbers: bool) -> Result<Part, Failure> {
        self.begin(!of_numbers && self.cdr.is_some_and(|cdr| cdr.second))
    }

    fn begin(&mut self, tells_length: bool) -> Result<Part, Failure> {
        if !tells_length {
            return Ok(Part(None));
        }
        let length = self.length()?;
        if length > self.left() {
            return Err(WireError::Short("part").into());
        }
        Ok(Part(Some(self.at + length)))
    }

    /// Ends a part; any rest of it was written by a newer definition and is skipped.
    pub fn end_part(&mut self, part: Part) -> Result<(), Failure> {
        match part.0 {
            Some(end) if end < self.at => Err(WireError::Short("part").into()),
            Some(end) => {
                self.at = end;
                Ok(())
            }
            None => Ok(()),
        }
    }

    /// Nothing may be left but the padding of a CDR body.
    pub fn end(&self) -> Result<(), WireError> {
        let most = if self.is_cdr() { MOST_PADDING } else { 0 };
        if self.left() > most { Err(WireError::Long(self.left())) } else { Ok(()) }
    }

    /// Whether only zeros are left, and few of them.
    pub fn is_at_end(&self) -> bool {
        self.end().is_ok() && self.body.get(self.at..).is_some_and(|rest| rest.iter().all(|byte| *byte == 0))
    }
}
