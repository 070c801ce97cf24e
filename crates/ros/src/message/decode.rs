//! Decodes a body by its definition, within limits, into a tree that keeps the order of fields. Texts are untrusted and
//! cleaned on output.

use std::{borrow::Cow, fmt::Write as _, ops::Range, sync::Arc};

use serde::ser::{Serialize, SerializeMap as _, Serializer};

use super::definition::{Arity, Definition, Field, Kind, Layout, Primitive, element_size};
use crate::{Result, RosError, model::clean, model::wire::WireError};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Longer arrays are not expanded.
    pub elements: usize,
    /// Total fields visited, expanded or not.
    pub steps: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self { elements: 1024, steps: 1_000_000 }
    }
}

/// The picture in a `sensor_msgs/CompressedImage`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Picture {
    /// Unchanged: `jpeg`, `png`, `rgb8; jpeg compressed bgr8`.
    pub format: String,
    pub data: Range<usize>,
}

impl Definition {
    /// Fails if the body ends early, has bytes left over, or exceeds `limits`.
    pub fn decode(&self, body: &[u8], mut limits: Limits) -> Result<Value> {
        self.decode_from(body, &mut limits)
    }

    /// Subtracts the steps from `limits`, so that several bodies share them.
    pub fn decode_from(&self, body: &[u8], limits: &mut Limits) -> Result<Value> {
        let failed = |failure: Failure| RosError::body(self.type_name(), failure.to_string());
        let mut walk = self.walk(body, *limits).map_err(failed)?;
        let root = self.root().ok_or_else(|| RosError::body("", "the definition is empty"))?;
        let value = walk.message(root).and_then(|value| walk.end().map(|()| value));
        limits.steps = walk.steps;
        value.map_err(failed)
    }

    /// A walk over `body`, with its layout determined.
    pub(super) fn walk<'a>(&'a self, body: &'a [u8], limits: Limits) -> Result<Walk<'a>, Failure> {
        if !self.cdr {
            return Ok(Walk::new(&self.layouts, Cursor::new(body, None), limits));
        }
        let mut cdr = Cdr::of(body)?;
        if self.has_wide_texts() {
            cdr = self.fitting(body, cdr, limits).first().copied().unwrap_or(cdr);
        }
        Ok(Walk::new(&self.layouts, Cursor::new(body, Some(cdr)), limits))
    }

    fn has_wide_texts(&self) -> bool {
        let wide = |field: &Field| field.kind == Kind::Primitive(Primitive::Wide);
        self.layouts.iter().any(|layout| layout.fields.iter().any(wide))
    }

    /// The layouts of wide texts that fit the whole body; if a writer could have written some of them, only those.
    fn fitting(&self, body: &[u8], cdr: Cdr, limits: Limits) -> Vec<Cdr> {
        let fit = |cdr: Cdr| {
            let limits = Limits { elements: 0, ..limits };
            let mut walk = Walk::new(&self.layouts, Cursor::new(body, Some(cdr)), limits);
            let fits = self.root().is_some_and(|root| walk.message(root).is_ok()) && walk.cursor.is_at_end();
            fits.then_some((cdr, walk.cursor.odd))
        };
        let ways = [Wide::Bytes, Wide::Pairs, Wide::Quads].map(|wide| Cdr { wide, ..cdr });
        let found: Vec<(Cdr, bool)> = ways.into_iter().filter_map(fit).collect();
        let any_sound = found.iter().any(|(_, odd)| !odd);
        found.into_iter().filter(|(_, odd)| !(any_sound && *odd)).map(|(cdr, _)| cdr).collect()
    }

    /// Whether a body fits in more than one way: middlewares write wide texts differently.
    pub fn is_ambiguous(&self, body: &[u8]) -> bool {
        if !self.cdr || !self.has_wide_texts() {
            return false;
        }
        Cdr::of(body).is_ok_and(|cdr| self.fitting(body, cdr, Limits::default()).len() > 1)
    }

    pub fn compressed_image(&self, body: &[u8]) -> Option<Picture> {
        if self.short_name() != "sensor_msgs/CompressedImage" {
            return None;
        }
        let value = self.decode(body, Limits { elements: 0, ..Limits::default() }).ok()?;
        let Value::Text(format) = value.get("format")? else { return None };
        let Value::Large { bytes, .. } = value.get("data")? else { return None };
        Some(Picture { format: format.clone(), data: bytes.clone() })
    }
}

#[derive(Debug, thiserror::Error)]
pub(super) enum Failure {
    #[error("{0}")]
    Wire(#[from] WireError),
    #[error("it claims {0} elements of {1}, more than fit into its bytes")]
    Claim(usize, String),
    #[error("it has more fields than can be shown")]
    Costly,
    #[error("as JSON it would be more than 64 times its size; write its bytes to a .bin file instead")]
    Long,
    #[error("the decoded fields could not be written")]
    Written,
    #[error("it does not start like CDR")]
    NoCdr,
    #[error("it lists its members by number (PL_CDR), which is not supported")]
    ByNumber,
}

pub(super) struct Walk<'a> {
    layouts: &'a [Layout],
    pub cursor: Cursor<'a>,
    limits: Limits,
    steps: usize,
}

impl<'a> Walk<'a> {
    fn new(layouts: &'a [Layout], cursor: Cursor<'a>, limits: Limits) -> Self {
        Self { layouts, cursor, limits, steps: limits.steps }
    }

    pub fn layout(&self, index: usize) -> Result<&'a Layout, Failure> {
        self.layouts.get(index).ok_or(Failure::Costly)
    }

    /// Empty arrays (`uint8[0]`) have no bytes to bound them, so each array is a step.
    pub fn array<T>(
        &mut self,
        field: &Field,
        take: impl FnOnce(&mut Self, usize) -> Result<T, Failure>,
    ) -> Result<T, Failure> {
        self.spend()?;
        let of_numbers = matches!(field.kind, Kind::Primitive(primitive) if !primitive.is_text());
        let part = self.cursor.begin(!of_numbers && self.cursor.cdr.is_some_and(|cdr| cdr.second))?;
        let count = match field.arity {
            Arity::One => 1,
            Arity::Fixed(count) => count,
            Arity::Bounded(_) | Arity::Variable => self.cursor.length()?,
        };
        self.claim(element_size(self.layouts, field.kind).0, count, &field.written)?;
        let taken = take(self, count)?;
        self.cursor.end_part(part)?;
        Ok(taken)
    }

    pub fn end(&self) -> Result<(), Failure> {
        Ok(self.cursor.end()?)
    }

    /// Refuses a count of elements, each of at least `size` bytes, that exceeds the rest of the body.
    pub fn claim(&self, size: usize, count: usize, element: &str) -> Result<(), Failure> {
        if size.saturating_mul(count) > self.cursor.left() {
            return Err(Failure::Claim(count, element.split('[').next().unwrap_or_default().to_owned()));
        }
        Ok(())
    }

    fn message(&mut self, layout: &'a Layout) -> Result<Value, Failure> {
        let mut fields = Vec::with_capacity(layout.fields.len().min(self.steps));
        let part = self.begin_message(layout)?;
        for field in &layout.fields {
            fields.push((Arc::clone(&field.name), self.field(field)?));
        }
        self.cursor.end_part(part)?;
        Ok(Value::Message(fields))
    }

    /// In CDR a message without fields has a placeholder byte.
    pub fn begin_message(&mut self, layout: &Layout) -> Result<Part, Failure> {
        let part = self.cursor.begin(self.cursor.cdr.is_some_and(|cdr| cdr.delimited))?;
        if self.cursor.is_cdr() && layout.fields.is_empty() {
            self.cursor.take(1, "byte of an empty message")?;
        }
        Ok(part)
    }

    fn field(&mut self, field: &'a Field) -> Result<Value, Failure> {
        if field.arity == Arity::One {
            self.element(field.kind)
        } else {
            self.array(field, |walk, count| walk.elements(field, count))
        }
    }

    fn elements(&mut self, field: &'a Field, count: usize) -> Result<Value, Failure> {
        let (size, _) = element_size(self.layouts, field.kind);
        if count <= self.limits.elements && size > 0 {
            return (0..count).map(|_| self.element(field.kind)).collect::<Result<_, _>>().map(Value::Array);
        }
        let start = self.skip_all(field.kind, count)?;
        let element = field.written.split('[').next().unwrap_or_default().to_owned();
        let (bytes, big_endian) = (start..self.cursor.at, self.cursor.is_big_endian());
        Ok(Value::Large { element, count, bytes, big_endian })
    }

    fn element(&mut self, kind: Kind) -> Result<Value, Failure> {
        self.spend()?;
        match kind {
            Kind::Primitive(primitive) => self.primitive(primitive),
            Kind::Message(index) => self.message(self.layout(index)?),
        }
    }

    /// Returns where the skipped elements begin.
    fn skip_all(&mut self, kind: Kind, count: usize) -> Result<usize, Failure> {
        let (size, fixed) = element_size(self.layouts, kind);
        if fixed && count > 0 {
            self.cursor.align(size)?;
        }
        let start = self.cursor.at;
        if fixed {
            self.cursor.take(size.saturating_mul(count), "array")?;
        } else {
            (0..count).try_for_each(|_| self.skip(kind))?;
        }
        Ok(start)
    }

    /// Of a type without fixed size.
    fn skip(&mut self, kind: Kind) -> Result<(), Failure> {
        self.spend()?;
        match kind {
            Kind::Primitive(primitive) if primitive.is_text() => self.text(primitive).map(drop),
            Kind::Primitive(_) => self.skip_all(kind, 1).map(drop),
            Kind::Message(index) => match self.layout(index)? {
                layout if layout.fixed => Ok(self.cursor.take(layout.minimum, "message").map(drop)?),
                layout => {
                    let part = self.begin_message(layout)?;
                    layout.fields.iter().try_for_each(|field| self.skip_field(field))?;
                    self.cursor.end_part(part)
                }
            },
        }
    }

    fn skip_field(&mut self, field: &'a Field) -> Result<(), Failure> {
        if field.arity == Arity::One {
            return self.skip(field.kind);
        }
        self.array(field, |walk, count| walk.skip_all(field.kind, count).map(drop))
    }

    pub fn primitive(&mut self, primitive: Primitive) -> Result<Value, Failure> {
        let cursor = &mut self.cursor;
        Ok(match primitive {
            Primitive::Bool => Value::Bool(cursor.number("bool")? != [0]),
            Primitive::Int8 => Value::Integer(i8::from_le_bytes(cursor.number("int8")?).into()),
            Primitive::Uint8 => Value::Unsigned(u8::from_le_bytes(cursor.number("uint8")?).into()),
            Primitive::Int16 => Value::Integer(i16::from_le_bytes(cursor.number("int16")?).into()),
            Primitive::Uint16 => Value::Unsigned(u16::from_le_bytes(cursor.number("uint16")?).into()),
            Primitive::Int32 => Value::Integer(i32::from_le_bytes(cursor.number("int32")?).into()),
            Primitive::Uint32 => Value::Unsigned(u32::from_le_bytes(cursor.number("uint32")?).into()),
            Primitive::Int64 => Value::Integer(i64::from_le_bytes(cursor.number("int64")?)),
            Primitive::Uint64 => Value::Unsigned(u64::from_le_bytes(cursor.number("uint64")?)),
            Primitive::Float32 => Value::Float(f32::from_le_bytes(cursor.number("float32")?).into()),
            Primitive::Float64 => Value::Float(f64::from_le_bytes(cursor.number("float64")?)),
            Primitive::Time => {
                Value::Time(u32::from_le_bytes(cursor.number("time")?), u32::from_le_bytes(cursor.number("time")?))
            }
            Primitive::Duration => Value::Duration(
                i32::from_le_bytes(cursor.number("duration")?),
                i32::from_le_bytes(cursor.number("duration")?),
            ),
            Primitive::Text | Primitive::Wide => Value::Text(self.text(primitive)?.into_owned()),
        })
    }

    /// Replaces invalid UTF-8.
    pub fn text(&mut self, primitive: Primitive) -> Result<Cow<'a, str>, Failure> {
        if primitive == Primitive::Wide {
            return Ok(self.cursor.wide_text().map(Cow::Owned)?);
        }
        Ok(String::from_utf8_lossy(self.cursor.text()?))
    }

    /// Its bytes if they are not UTF-8.
    pub fn text_or_bytes(&mut self, primitive: Primitive) -> Result<Result<Cow<'a, str>, &'a [u8]>, Failure> {
        if primitive == Primitive::Wide {
            return self.text(primitive).map(Ok);
        }
        let bytes = self.cursor.text()?;
        Ok(std::str::from_utf8(bytes).map(Cow::Borrowed).map_err(|_| bytes))
    }

    pub fn spend(&mut self) -> Result<(), Failure> {
        self.steps = self.steps.checked_sub(1).ok_or(Failure::Costly)?;
        Ok(())
    }
}

/// Bytes of the encapsulation header, which gives the layout of the rest.
const ENCAPSULATION: usize = 4;

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

/// From the body's first bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Cdr {
    big_endian: bool,
    /// The second version: eight-byte values are aligned to four, and sequences of other elements state their length in
    /// bytes.
    second: bool,
    /// Whether every message states its length in bytes too.
    delimited: bool,
    wide: Wide,
}

impl Cdr {
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
}

#[derive(Debug, Clone)]
pub(super) struct Cursor<'a> {
    body: &'a [u8],
    at: usize,
    /// `None` if numbers are packed.
    cdr: Option<Cdr>,
    /// Whether a part was read that no writer writes: non-zero padding, a wide text that is not UTF-16.
    odd: bool,
}

/// The end of a part that stated its length in bytes.
#[derive(Debug, Clone, Copy)]
#[must_use]
pub(super) struct Part(Option<usize>);

impl<'a> Cursor<'a> {
    pub fn new(body: &'a [u8], cdr: Option<Cdr>) -> Self {
        Self { body, at: if cdr.is_some() { ENCAPSULATION } else { 0 }, cdr, odd: false }
    }

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

    /// Skips the padding before a number of `size` bytes.
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

    /// Least significant byte first.
    pub fn number<const N: usize>(&mut self, what: &'static str) -> Result<[u8; N], WireError> {
        self.align(N)?;
        let mut bytes = *self.take(N, what)?.first_chunk().ok_or(WireError::Short(what))?;
        if self.is_big_endian() {
            bytes.reverse();
        }
        Ok(bytes)
    }

    pub fn length(&mut self) -> Result<usize, WireError> {
        let length = u32::from_le_bytes(self.number("length")?);
        Ok(usize::try_from(length).unwrap_or(usize::MAX))
    }

    /// In CDR the length includes the trailing zero.
    pub fn text(&mut self) -> Result<&'a [u8], WireError> {
        let length = self.length()?;
        let bytes = self.take(length, "text")?;
        Ok(if self.is_cdr() { bytes.strip_suffix(&[0]).unwrap_or(bytes) } else { bytes })
    }

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

    pub fn begin(&mut self, tells_length: bool) -> Result<Part, Failure> {
        if !tells_length {
            return Ok(Part(None));
        }
        let length = self.length()?;
        if length > self.left() {
            return Err(WireError::Short("part").into());
        }
        Ok(Part(Some(self.at + length)))
    }

    /// Skips the rest of a part: a newer definition wrote it.
    pub fn end_part(&mut self, part: Part) -> Result<(), Failure> {
        let end = part.0.unwrap_or(self.at);
        if end < self.at {
            return Err(WireError::Short("part").into());
        }
        self.at = end;
        Ok(())
    }

    /// Only the padding of a CDR body may be left.
    pub fn end(&self) -> Result<(), WireError> {
        let most = if self.is_cdr() { MOST_PADDING } else { 0 };
        if self.left() > most { Err(WireError::Long(self.left())) } else { Ok(()) }
    }

    /// Whether only a few zeros are left.
    pub fn is_at_end(&self) -> bool {
        self.end().is_ok() && self.body.get(self.at..).is_some_and(|rest| rest.iter().all(|byte| *byte == 0))
    }
}

/// Characters of a shown text.
const WIDEST: usize = 4096;

/// Texts are unchanged, with invalid UTF-8 replaced; times and durations are seconds and nanoseconds. An array too large to
/// expand has its count of elements and their position in the body; a message has its fields in order.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    Bool(bool),
    Integer(i64),
    Unsigned(u64),
    Float(f64),
    Text(String),
    Time(u32, u32),
    Duration(i32, i32),
    Array(Vec<Value>),
    Large { element: String, count: usize, bytes: Range<usize>, big_endian: bool },
    Message(Vec<(Arc<str>, Value)>),
}

impl Value {
    /// `path` may go deeper with dots, as in `header.seq`.
    pub fn get(&self, path: &str) -> Option<&Value> {
        path.split('.').try_fold(self, |value, name| match value {
            Self::Message(fields) => fields.iter().find(|(field, _)| **field == *name).map(|(_, value)| value),
            _ => None,
        })
    }

    /// A number, or a flag as one.
    pub fn count(&self, path: &str) -> Option<usize> {
        match self.get(path)? {
            Self::Unsigned(number) => usize::try_from(*number).ok(),
            Self::Integer(number) => usize::try_from(*number).ok(),
            Self::Bool(flag) => Some(usize::from(*flag)),
            _ => None,
        }
    }

    /// Cleans texts, writes large arrays as `uint8[58000]`, numbers that JSON lacks as text (`NaN`, `inf`), times as
    /// `{secs, nsecs}`. Only serialising the value itself is sure to keep the order of fields.
    pub fn to_json(&self) -> serde_json::Value {
        serde_json::to_value(self).unwrap_or(serde_json::Value::Null)
    }

    /// The first `most` rows of `(path, text)`, one per field or array of plain values; texts are cleaned.
    pub fn flatten(&self, most: usize) -> Vec<(String, String)> {
        let mut rows = Vec::new();
        self.flatten_into("", most, &mut rows);
        rows
    }

    fn flatten_into(&self, path: &str, most: usize, rows: &mut Vec<(String, String)>) {
        let is_nested = |value: &Self| matches!(value, Self::Message(_) | Self::Array(_) | Self::Large { .. });
        if rows.len() >= most {
            return;
        }
        match self {
            Self::Message(fields) if !fields.is_empty() => {
                for (name, value) in fields {
                    let path = if path.is_empty() { name.to_string() } else { format!("{path}.{name}") };
                    value.flatten_into(&path, most, rows);
                }
            }
            Self::Array(items) if items.iter().any(is_nested) => {
                for (index, value) in items.iter().enumerate().take_while(|(index, _)| *index <= most) {
                    value.flatten_into(&format!("{path}[{index}]"), most, rows);
                }
            }
            plain => rows.push((path.to_owned(), plain.to_text())),
        }
    }

    fn to_text(&self) -> String {
        match self {
            Self::Bool(flag) => flag.to_string(),
            Self::Integer(number) => number.to_string(),
            Self::Unsigned(number) => number.to_string(),
            Self::Float(number) => format!("{number:?}"),
            Self::Text(text) => clean(text, WIDEST),
            Self::Time(seconds, nanoseconds) => format!("{seconds}.{nanoseconds:09}"),
            Self::Duration(seconds, nanoseconds) => duration_text(*seconds, *nanoseconds),
            Self::Array(items) => {
                format!("[{}]", items.iter().map(Self::to_text).collect::<Vec<_>>().join(", "))
            }
            Self::Large { element, count, .. } => format!("{element}[{count}]"),
            Self::Message(_) => String::from("{}"),
        }
    }
}

fn duration_text(seconds: i32, nanoseconds: i32) -> String {
    let total = i64::from(seconds) * 1_000_000_000 + i64::from(nanoseconds);
    let mut text = String::from(if total < 0 { "-" } else { "" });
    let total = total.unsigned_abs();
    // Writing to a String cannot fail.
    let _ = write!(text, "{}.{:09}", total / 1_000_000_000, total % 1_000_000_000);
    text
}

fn pair<S: Serializer>(serializer: S, seconds: i64, nanoseconds: i64) -> Result<S::Ok, S::Error> {
    let mut map = serializer.serialize_map(Some(2))?;
    map.serialize_entry("secs", &seconds)?;
    map.serialize_entry("nsecs", &nanoseconds)?;
    map.end()
}

impl Serialize for Value {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Bool(flag) => serializer.serialize_bool(*flag),
            Self::Integer(number) => serializer.serialize_i64(*number),
            Self::Unsigned(number) => serializer.serialize_u64(*number),
            Self::Float(number) if number.is_finite() => serializer.serialize_f64(*number),
            Self::Time(seconds, nanoseconds) => pair(serializer, (*seconds).into(), (*nanoseconds).into()),
            Self::Duration(seconds, nanoseconds) => pair(serializer, (*seconds).into(), (*nanoseconds).into()),
            Self::Array(items) => serializer.collect_seq(items),
            Self::Message(fields) => serializer.collect_map(fields.iter().map(|(name, value)| (&**name, value))),
            Self::Float(_) | Self::Text(_) | Self::Large { .. } => serializer.serialize_str(&self.to_text()),
        }
    }
}
