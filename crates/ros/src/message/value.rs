//! A decoded message: a tree that keeps the order of its fields, and its output to screen and JSON. Its texts are
//! untrusted and cleaned on output.

use std::fmt::Write as _;
use std::ops::Range;
use std::sync::Arc;

use serde::ser::{Serialize, SerializeMap as _, Serializer};

use crate::model::clean;

/// The longest text shown, characters.
const WIDEST: usize = 4096;

/// A decoded value.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// A truth value.
    Bool(bool),
    /// A signed number.
    Integer(i64),
    /// An unsigned number.
    Unsigned(u64),
    /// A floating-point number (a float32 widened).
    Float(f64),
    /// A text, unchanged; invalid UTF-8 is replaced.
    Text(String),
    /// A point in time: seconds and nanoseconds since 1970.
    Time(u32, u32),
    /// A span of time: seconds and nanoseconds.
    Duration(i32, i32),
    /// An array.
    Array(Vec<Value>),
    /// An array too large to expand.
    Large {
        /// The element type.
        element: String,
        /// The number of elements.
        count: usize,
        /// The position of their bytes in the body.
        bytes: Range<usize>,
        /// Whether the numbers are big endian.
        big_endian: bool,
    },
    /// A message: its fields by name, in order.
    Message(Vec<(Arc<str>, Value)>),
}

impl Value {
    /// A field of a message; `path` may go deeper with dots, as in `header.seq`.
    pub fn get(&self, path: &str) -> Option<&Value> {
        path.split('.').try_fold(self, |value, name| match value {
            Self::Message(fields) => fields.iter().find(|(field, _)| **field == *name).map(|(_, value)| value),
            _ => None,
        })
    }

    /// As JSON: texts cleaned, large arrays as `uint8[58000]`, numbers that JSON lacks as text (`NaN`, `inf`), times as
    /// `{secs, nsecs}`. The order of fields is kept if the JSON map keeps it; serialising the value itself always keeps
    /// it.
    pub fn to_json(&self) -> serde_json::Value {
        serde_json::to_value(self).unwrap_or(serde_json::Value::Null)
    }

    /// One row per field, `(path, text)`, in order, the first `most` of them; texts cleaned, arrays of plain values on
    /// one row.
    pub fn flatten(&self, most: usize) -> Vec<(String, String)> {
        let mut rows = Vec::new();
        self.flatten_into("", most, &mut rows);
        rows
    }

    fn flatten_into(&self, path: &str, most: usize, rows: &mut Vec<(String, String)>) {
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
            Self::Array(items) if items.iter().any(Self::is_nested) => {
                for (index, value) in items.iter().enumerate().take_while(|(index, _)| *index <= most) {
                    value.flatten_into(&format!("{path}[{index}]"), most, rows);
                }
            }
            plain => rows.push((path.to_owned(), plain.to_text())),
        }
    }

    fn is_nested(&self) -> bool {
        matches!(self, Self::Message(_) | Self::Array(_) | Self::Large { .. })
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
