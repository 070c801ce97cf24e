//! The bounded walk over a message body. Counts are checked against the remaining bytes before anything is built, and
//! every visited field is charged to one budget.

use std::borrow::Cow;
use std::ops::Range;
use std::sync::Arc;

use super::cursor::{Cdr, Cursor, Part};
use super::definition::{Definition, Field, Kind, Layout, element_size};
use super::line::{Arity, Primitive};
use super::value::Value;
use crate::model::wire::WireError;
use crate::ros::RosError;

/// The limits of decoding.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Arrays with more elements than this are not expanded.
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
    /// The publisher's name for its format, unchanged: `jpeg`, `png`, `rgb8; jpeg compressed bgr8`.
    pub format: String,
    /// Where the picture's file is in the body.
    pub data: Range<usize>,
}

impl Definition {
    /// Decodes a message body for display.
    ///
    /// # Errors
    /// [`RosError::Body`] if the body ends early, has bytes left over, or exceeds `limits`.
    pub fn decode(&self, body: &[u8], limits: Limits) -> Result<Value, RosError> {
        let mut limits = limits;
        self.decode_from(body, &mut limits)
    }

    /// Like [`Definition::decode`]; its steps are subtracted from `limits`, so that several bodies share them.
    ///
    /// # Errors
    /// See [`Definition::decode`].
    pub fn decode_from(&self, body: &[u8], limits: &mut Limits) -> Result<Value, RosError> {
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
        let walk = |cdr| Walk::new(&self.layouts, Cursor::new(body, Some(cdr)), limits);
        let cdr = Cdr::of(body)?;
        if !self.has_wide_texts() {
            return Ok(walk(cdr));
        }
        Ok(walk(self.fitting(body, cdr, limits).first().copied().unwrap_or(cdr)))
    }

    fn has_wide_texts(&self) -> bool {
        let wide = |field: &Field| field.kind == Kind::Primitive(Primitive::Wide);
        self.layouts.iter().any(|layout| layout.fields.iter().any(wide))
    }

    /// The layouts of wide texts that fit the body to its end. If in some of them everything is as a writer writes it,
    /// only those.
    fn fitting(&self, body: &[u8], cdr: Cdr, limits: Limits) -> Vec<Cdr> {
        let fit = |cdr: Cdr| {
            let limits = Limits { elements: 0, ..limits };
            let mut walk = Walk::new(&self.layouts, Cursor::new(body, Some(cdr)), limits);
            let fits = self.root().is_some_and(|root| walk.message(root).is_ok()) && walk.cursor.is_at_end();
            fits.then(|| (cdr, walk.cursor.is_odd()))
        };
        let found: Vec<(Cdr, bool)> = cdr.ways().into_iter().filter_map(fit).collect();
        let any_sound = found.iter().any(|(_, odd)| !odd);
        found.into_iter().filter(|(_, odd)| !(any_sound && *odd)).map(|(cdr, _)| cdr).collect()
    }

    /// Whether a body can be read in more than one way that fits, because middlewares write wide texts differently.
    pub fn is_ambiguous(&self, body: &[u8]) -> bool {
        if !self.cdr || !self.has_wide_texts() {
            return false;
        }
        Cdr::of(body).is_ok_and(|cdr| self.fitting(body, cdr, Limits::default()).len() > 1)
    }

    /// The picture in `body`, if this is `sensor_msgs/CompressedImage`.
    pub fn compressed_image(&self, body: &[u8]) -> Option<Picture> {
        if self.short_name() != "sensor_msgs/CompressedImage" {
            return None;
        }
        let value = self.decode(body, Limits { elements: 0, ..Limits::default() }).ok()?;
        match (value.get("format")?, value.get("data")?) {
            (Value::Text(format), Value::Large { bytes, .. }) => {
                Some(Picture { format: format.clone(), data: bytes.clone() })
            }
            _ => None,
        }
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

/// A walk over a body.
pub(super) struct Walk<'a> {
    layouts: &'a [Layout],
    cursor: Cursor<'a>,
    limits: Limits,
    steps: usize,
}

impl<'a> Walk<'a> {
    fn new(layouts: &'a [Layout], cursor: Cursor<'a>, limits: Limits) -> Self {
        Self { layouts, cursor, limits, steps: limits.steps }
    }

    pub fn layouts(&self) -> &'a [Layout] {
        self.layouts
    }

    /// Nothing may be left.
    pub fn end(&self) -> Result<(), Failure> {
        Ok(self.cursor.end()?)
    }

    /// Refuses a count of elements, each of at least `size` bytes, that does not fit into the rest of the body.
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
        self.end_part(part)?;
        Ok(Value::Message(fields))
    }

    /// Begins a message. In CDR one without fields has a placeholder byte.
    pub fn begin_message(&mut self, layout: &Layout) -> Result<Part, Failure> {
        let part = self.cursor.begin_message()?;
        if self.cursor.is_cdr() && layout.fields.is_empty() {
            self.cursor.take(1, "byte of an empty message")?;
        }
        Ok(part)
    }

    /// Begins an array: its position, and its number of elements, checked against the rest of the body.
    pub fn begin_array(&mut self, field: &Field) -> Result<(Part, usize), Failure> {
        let of_numbers = matches!(field.kind, Kind::Primitive(primitive) if !primitive.is_text());
        let part = self.cursor.begin_array(of_numbers)?;
        let count = match field.arity {
            Arity::One => 1,
            Arity::Fixed(count) => count,
            Arity::Variable => self.cursor.length()?,
        };
        self.claim(element_size(self.layouts, field.kind).0, count, &field.written)?;
        Ok((part, count))
    }

    pub fn end_part(&mut self, part: Part) -> Result<(), Failure> {
        self.cursor.end_part(part)
    }

    fn field(&mut self, field: &'a Field) -> Result<Value, Failure> {
        if field.arity == Arity::One {
            return self.element(field.kind);
        }
        self.spend()?;
        let (part, count) = self.begin_array(field)?;
        let value = self.array(field, count)?;
        self.end_part(part)?;
        Ok(value)
    }

    fn array(&mut self, field: &'a Field, count: usize) -> Result<Value, Failure> {
        let (size, _) = element_size(self.layouts, field.kind);
        if count <= self.limits.elements && size > 0 {
            return (0..count).map(|_| self.element(field.kind)).collect::<Result<_, _>>().map(Value::Array);
        }
        let start = self.skip_all(field.kind, count)?;
        let element = field.written.split('[').next().unwrap_or_default().to_owned();
        let (bytes, big_endian) = (start..self.cursor.at(), self.cursor.is_big_endian());
        Ok(Value::Large { element, count, bytes, big_endian })
    }

    fn element(&mut self, kind: Kind) -> Result<Value, Failure> {
        self.spend()?;
        match kind {
            Kind::Primitive(primitive) => self.primitive(primitive),
            Kind::Message(index) => match self.layouts.get(index) {
                Some(layout) => self.message(layout),
                None => Err(Failure::Costly),
            },
        }
    }

    /// Walks over elements; returns where they begin.
    fn skip_all(&mut self, kind: Kind, count: usize) -> Result<usize, Failure> {
        let (size, fixed) = element_size(self.layouts, kind);
        if fixed && count > 0 {
            self.cursor.align(size)?;
        }
        let start = self.cursor.at();
        if fixed {
            self.cursor.take(size.saturating_mul(count), "array")?;
        } else {
            (0..count).try_for_each(|_| self.skip(kind))?;
        }
        Ok(start)
    }

    /// Walks over one element of a type without fixed size.
    fn skip(&mut self, kind: Kind) -> Result<(), Failure> {
        self.spend()?;
        match kind {
            Kind::Primitive(primitive) if primitive.is_text() => self.text(primitive).map(drop),
            Kind::Primitive(_) => self.skip_all(kind, 1).map(drop),
            Kind::Message(index) => match self.layouts.get(index) {
                Some(layout) if layout.fixed => {
                    self.cursor.take(layout.minimum, "message").map(drop).map_err(Failure::from)
                }
                Some(layout) => {
                    let part = self.begin_message(layout)?;
                    layout.fields.iter().try_for_each(|field| self.skip_field(field))?;
                    self.end_part(part)
                }
                None => Err(Failure::Costly),
            },
        }
    }

    fn skip_field(&mut self, field: &'a Field) -> Result<(), Failure> {
        if field.arity == Arity::One {
            return self.skip(field.kind);
        }
        self.spend()?;
        let (part, count) = self.begin_array(field)?;
        self.skip_all(field.kind, count)?;
        self.end_part(part)
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

    /// A text; invalid UTF-8 is replaced.
    pub fn text(&mut self, primitive: Primitive) -> Result<Cow<'a, str>, Failure> {
        if primitive == Primitive::Wide {
            return Ok(self.cursor.wide_text().map(Cow::Owned)?);
        }
        Ok(String::from_utf8_lossy(self.cursor.text()?))
    }

    /// A text, or its bytes if these are not UTF-8.
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
