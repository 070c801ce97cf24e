//! The whole message as JSON, written while it is parsed: nothing is left out and nothing is kept in memory. Texts are
//! complete; characters unsafe for a terminal are escaped.

use std::io::{self, Write};

use super::decode::{Failure, Limits, Walk};
use super::definition::{Definition, Field, Kind, Layout};
use super::line::Arity;
use super::value::Value;
use crate::model::bytes::hex;
use crate::model::spelt_out;
use crate::ros::RosError;

impl Definition {
    /// Writes the whole message as JSON, fields in order, numbers unchanged, numbers that JSON lacks as text (`NaN`,
    /// `inf`), texts that are not UTF-8 as `{not_utf8: hex}`, times as `{secs, nsecs}`, arrays of bytes as arrays of
    /// numbers. A body of n bytes becomes at most `64 n` + 16 MiB of text, because field names are repeated for every
    /// element; it uses no further memory.
    ///
    /// # Errors
    /// [`RosError::Body`] if the body does not match the definition, would become more text than that, or `out` cannot
    /// be written.
    pub fn write_json(&self, body: &[u8], out: &mut dyn Write) -> Result<(), RosError> {
        let failed = |failure: Failure| RosError::body(self.type_name(), failure.to_string());
        let root = self.root().ok_or_else(|| RosError::body("", "the definition is empty"))?;
        let steps = body.len().saturating_mul(3).saturating_add(100_000);
        let walk = self.walk(body, Limits { steps, ..Limits::default() }).map_err(failed)?;
        let left = body.len().saturating_mul(GROWTH).saturating_add(LEAST);
        let mut export = Export { walk, out: Bounded { out, left, full: false } };
        export.message(root).map_err(failed)?;
        export.walk.end().map_err(failed)
    }
}

/// Replaces a text whose bytes are not UTF-8: an object with these bytes in hex.
const NOT_UTF8: &str = "not_utf8";

/// The most bytes of text per byte of the body.
const GROWTH: usize = 64;
/// Bytes of text allowed for any body.
const LEAST: usize = 16 << 20;

/// Accepts this many bytes and no more.
struct Bounded<'a> {
    out: &'a mut dyn Write,
    left: usize,
    full: bool,
}

impl Write for Bounded<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let Some(left) = self.left.checked_sub(bytes.len()) else {
            self.full = true;
            return Err(io::ErrorKind::FileTooLarge.into());
        };
        let written = self.out.write(bytes)?;
        self.left = left + (bytes.len() - written);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

struct Export<'a> {
    walk: Walk<'a>,
    out: Bounded<'a>,
}

impl<'a> Export<'a> {
    fn unwritten(&self) -> Failure {
        if self.out.full { Failure::Long } else { Failure::Written }
    }

    fn text(&mut self, text: &str) -> Result<(), Failure> {
        self.out.write_all(text.as_bytes()).map_err(|_| self.unwritten())
    }

    fn message(&mut self, layout: &'a Layout) -> Result<(), Failure> {
        let part = self.walk.begin_message(layout)?;
        self.text("{")?;
        for (place, field) in layout.fields.iter().enumerate() {
            self.text(if place > 0 { ",\"" } else { "\"" })?;
            self.text(&field.name)?;
            self.text("\":")?;
            self.field(field)?;
        }
        self.walk.end_part(part)?;
        self.text("}")
    }

    fn field(&mut self, field: &'a Field) -> Result<(), Failure> {
        if field.arity == Arity::One {
            return self.element(field.kind);
        }
        // Empty arrays (`uint8[0]`) have no bytes to bound them.
        self.walk.spend()?;
        let (part, count) = self.walk.begin_array(field)?;
        self.text("[")?;
        for place in 0..count {
            if place > 0 {
                self.text(",")?;
            }
            self.element(field.kind)?;
        }
        self.walk.end_part(part)?;
        self.text("]")
    }

    fn element(&mut self, kind: Kind) -> Result<(), Failure> {
        self.walk.spend()?;
        match kind {
            Kind::Primitive(primitive) if primitive.is_text() => {
                let text = match self.walk.text_or_bytes(primitive)? {
                    Ok(text) => serde_json::Value::from(text).to_string(),
                    // Replacement characters would look like part of the message.
                    Err(bytes) => serde_json::json!({ NOT_UTF8: hex(bytes) }).to_string(),
                };
                self.text(&spelt_out(&text))
            }
            Kind::Primitive(primitive) => {
                let value = self.walk.primitive(primitive)?;
                self.plain(&value)
            }
            Kind::Message(index) => match self.walk.layouts().get(index) {
                Some(layout) => self.message(layout),
                None => Err(Failure::Costly),
            },
        }
    }

    fn plain(&mut self, value: &Value) -> Result<(), Failure> {
        serde_json::to_writer(&mut self.out, value).map_err(|_| self.unwritten())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn json(text: &str, body: &[u8]) -> Option<String> {
        let mut out = Vec::new();
        Definition::parse("a/Root", text).expect("definition").write_json(body, &mut out).ok()?;
        Some(String::from_utf8(out).expect("UTF-8"))
    }

    #[test]
    fn nothing_is_left_out_and_the_order_is_kept() {
        let mut body = 3000u32.to_le_bytes().to_vec();
        body.extend(vec![7; 3000]);
        body.extend(f32::NAN.to_le_bytes());
        body.extend([1, 0, 0, 0, 2, 0, 0, 0]);
        let whole = json("uint8[] z\nfloat32 b\ntime a", &body).expect("fits");
        assert!(whole.starts_with("{\"z\":[7,7,7"), "{whole}");
        assert!(whole.ends_with("7],\"b\":\"NaN\",\"a\":{\"secs\":1,\"nsecs\":2}}"), "{whole}");
        assert_eq!(whole.matches(",7").count(), 2999);
        assert_eq!(json("uint8[] z", &u32::MAX.to_le_bytes()), None);
        assert_eq!(json("uint8 z", &[1, 2]), None);
    }

    #[test]
    fn texts_are_whole_and_harmless() {
        let text = "a\u{1b}[2J\u{202e}b\u{e0041}\"é机";
        let mut body = u32::try_from(text.len()).expect("short").to_le_bytes().to_vec();
        body.extend(text.bytes());
        let json = json("string t", &body).expect("fits");
        assert!(!json.contains(['\u{1b}', '\u{202e}', '\u{e0041}']), "{json}");
        let back: serde_json::Value = serde_json::from_str(&json).expect("JSON");
        assert_eq!(back["t"], text);
    }

    #[test]
    fn bytes_that_are_no_text_are_marked() {
        assert_eq!(json("string t", b"\x05\0\0\0ab\xffcd").as_deref(), Some("{\"t\":{\"not_utf8\":\"6162ff6364\"}}"));
    }

    #[test]
    fn long_names_do_not_blow_a_body_up_without_end() {
        let name = "n".repeat(200);
        let text = format!("Small[] many\n{}\nMSG: a/Small\nuint8 {name}\n", "=".repeat(80));
        let body = |count: u32| [count.to_le_bytes().to_vec(), vec![1; count as usize]].concat();
        assert!(json(&text, &body(10_000)).is_some(), "two megabytes are taken");
        let mut out = Vec::new();
        let definition = Definition::parse("a/Root", &text).expect("definition");
        let error = definition.write_json(&body(400_000), &mut out).expect_err("80 MB of text");
        assert!(error.to_string().contains("as JSON"), "{error}");
        assert!(out.len() <= 64 * 400_004 + (16 << 20), "{}", out.len());
    }
}
