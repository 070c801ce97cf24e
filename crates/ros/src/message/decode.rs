//! The bounded walk over a message body. Counts are checked against the bytes that are left
//! before anything is built, and every visited field costs from one budget.

use std::ops::Range;
use std::sync::Arc;

use super::definition::{Definition, Field, Kind, Layout, element_size};
use super::line::{Arity, Primitive};
use super::value::Value;
use crate::model::wire::{Reader, WireError};
use crate::ros::RosError;

/// What decoding may cost.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Arrays with more elements than this are not spelled out.
    pub elements: usize,
    /// Fields visited in all, spelled out or not.
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
    /// What the publisher calls its format, as it came: `jpeg`, `png`, `rgb8; jpeg compressed bgr8`.
    pub format: String,
    /// Where the picture's file is in the body.
    pub data: Range<usize>,
}

impl Definition {
    /// Decodes a message body for display.
    ///
    /// # Errors
    /// [`RosError::Body`] where the body ends early, has bytes left over, or costs more than `limits`.
    pub fn decode(&self, body: &[u8], limits: Limits) -> Result<Value, RosError> {
        let mut walk = Walk { limits, ..Walk::new(&self.layouts, body, limits.steps) };
        let failed = |failure: Failure| RosError::body(self.type_name(), failure.to_string());
        let root = self.root().ok_or_else(|| RosError::body("", "the definition is empty"))?;
        let value = walk.message(root).map_err(failed)?;
        walk.end().map_err(failed)?;
        Ok(value)
    }

    /// The picture in `body`, where this is `sensor_msgs/CompressedImage`.
    pub fn compressed_image(&self, body: &[u8]) -> Option<Picture> {
        if self.type_name() != "sensor_msgs/CompressedImage" {
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
    #[error("it claims {0} elements of {1}, more than its bytes can hold")]
    Claim(usize, String),
    #[error("it has more fields than can be shown")]
    Costly,
    #[error("what was read of it could not be written")]
    Written,
}

/// A walk over a body.
pub(super) struct Walk<'a> {
    layouts: &'a [Layout],
    reader: Reader<'a>,
    length: usize,
    limits: Limits,
    steps: usize,
}

impl<'a> Walk<'a> {
    pub fn new(layouts: &'a [Layout], body: &'a [u8], steps: usize) -> Self {
        Self { layouts, reader: Reader::new(body), length: body.len(), limits: Limits::default(), steps }
    }

    pub fn layouts(&self) -> &'a [Layout] {
        self.layouts
    }

    /// Nothing may be left.
    pub fn end(&self) -> Result<(), Failure> {
        Ok(self.reader.end()?)
    }

    /// Refuses a count of elements, each of at least `size` bytes, that the rest of the body cannot hold.
    pub fn claim(&self, size: usize, count: usize, element: &str) -> Result<(), Failure> {
        if size.saturating_mul(count) > self.reader.rest().len() {
            return Err(Failure::Claim(count, element.split('[').next().unwrap_or_default().to_owned()));
        }
        Ok(())
    }

    fn message(&mut self, layout: &'a Layout) -> Result<Value, Failure> {
        let mut fields = Vec::with_capacity(layout.fields.len().min(self.steps));
        for field in &layout.fields {
            fields.push((Arc::from(field.name.as_str()), self.field(field)?));
        }
        Ok(Value::Message(fields))
    }

    fn field(&mut self, field: &'a Field) -> Result<Value, Failure> {
        match field.arity {
            Arity::One => self.element(field.kind),
            Arity::Fixed(count) => self.array(field, count),
            Arity::Variable => {
                let count = self.count()?;
                self.array(field, count)
            }
        }
    }

    fn array(&mut self, field: &'a Field, count: usize) -> Result<Value, Failure> {
        self.spend()?;
        let element = || field.written.split('[').next().unwrap_or_default().to_owned();
        let (size, fixed) = element_size(self.layouts, field.kind);
        self.claim(size, count, &field.written)?;
        if count <= self.limits.elements && size > 0 {
            return (0..count).map(|_| self.element(field.kind)).collect::<Result<_, _>>().map(Value::Array);
        }
        let start = self.position();
        if fixed {
            self.reader.take(size * count, "array")?;
        } else {
            (0..count).try_for_each(|_| self.skip(field.kind))?;
        }
        Ok(Value::Large { element: element(), count, bytes: start..self.position() })
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

    /// Walks over one element of a type without fixed size.
    fn skip(&mut self, kind: Kind) -> Result<(), Failure> {
        self.spend()?;
        match kind {
            Kind::Primitive(Primitive::Text) => self.text().map(drop),
            Kind::Primitive(primitive) => self.reader.take(primitive.size(), "number").map(drop).map_err(Failure::from),
            Kind::Message(index) => match self.layouts.get(index) {
                Some(layout) if layout.fixed => {
                    self.reader.take(layout.minimum, "message").map(drop).map_err(Failure::from)
                }
                Some(layout) => layout.fields.iter().try_for_each(|field| self.skip_field(field)),
                None => Err(Failure::Costly),
            },
        }
    }

    fn skip_field(&mut self, field: &'a Field) -> Result<(), Failure> {
        self.spend()?;
        let count = match field.arity {
            Arity::One => 1,
            Arity::Fixed(count) => count,
            Arity::Variable => self.count()?,
        };
        let (size, fixed) = element_size(self.layouts, field.kind);
        self.claim(size, count, &field.written)?;
        if fixed {
            return self.reader.take(size * count, "array").map(drop).map_err(Failure::from);
        }
        (0..count).try_for_each(|_| self.skip(field.kind))
    }

    pub fn primitive(&mut self, primitive: Primitive) -> Result<Value, Failure> {
        let reader = &mut self.reader;
        Ok(match primitive {
            Primitive::Bool => Value::Bool(reader.u8("bool")? != 0),
            Primitive::Int8 => Value::Integer(i8::from_le_bytes(reader.array("int8")?).into()),
            Primitive::Uint8 => Value::Unsigned(reader.u8("uint8")?.into()),
            Primitive::Int16 => Value::Integer(i16::from_le_bytes(reader.array("int16")?).into()),
            Primitive::Uint16 => Value::Unsigned(u16::from_le_bytes(reader.array("uint16")?).into()),
            Primitive::Int32 => Value::Integer(i32::from_le_bytes(reader.array("int32")?).into()),
            Primitive::Uint32 => Value::Unsigned(u32::from_le_bytes(reader.array("uint32")?).into()),
            Primitive::Int64 => Value::Integer(i64::from_le_bytes(reader.array("int64")?)),
            Primitive::Uint64 => Value::Unsigned(u64::from_le_bytes(reader.array("uint64")?)),
            Primitive::Float32 => Value::Float(f32::from_le_bytes(reader.array("float32")?).into()),
            Primitive::Float64 => Value::Float(f64::from_le_bytes(reader.array("float64")?)),
            Primitive::Time => {
                Value::Time(u32::from_le_bytes(reader.array("time")?), u32::from_le_bytes(reader.array("time")?))
            }
            Primitive::Duration => Value::Duration(
                i32::from_le_bytes(reader.array("duration")?),
                i32::from_le_bytes(reader.array("duration")?),
            ),
            Primitive::Text => Value::Text(String::from_utf8_lossy(self.text()?).into_owned()),
        })
    }

    pub fn text(&mut self) -> Result<&'a [u8], Failure> {
        let length = self.count()?;
        Ok(self.reader.take(length, "text")?)
    }

    pub fn count(&mut self) -> Result<usize, Failure> {
        let count = u32::from_le_bytes(self.reader.array("length")?);
        Ok(usize::try_from(count).unwrap_or(usize::MAX))
    }

    fn position(&self) -> usize {
        self.length - self.reader.rest().len()
    }

    pub fn spend(&mut self) -> Result<(), Failure> {
        self.steps = self.steps.checked_sub(1).ok_or(Failure::Costly)?;
        Ok(())
    }
}
