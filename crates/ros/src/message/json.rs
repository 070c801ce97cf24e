//! The whole message as JSON, written while it is parsed, without a copy in memory. Texts are complete; characters
//! unsafe for a terminal are escaped.

use std::io::{self, Write};

use super::decode::{Failure, Limits, Value, Walk};
use super::definition::{Arity, Definition, Field, Kind, Layout};
use crate::crypto::compression::{MOST_CHANNELS, Matrix};
use crate::{Result, RosError, model::bytes::hex, model::spelt_out};

impl Definition {
    /// Fields keep their order and numbers their value; numbers that JSON lacks become text (`NaN`, `inf`), texts that
    /// are not UTF-8 `{not_utf8: hex}`, times `{secs, nsecs}`, arrays of bytes arrays of numbers. A body of n bytes
    /// becomes at most `64 n` + 16 MiB of text, because field names are repeated for every element; a longer one fails.
    pub fn write_json(&self, body: &[u8], out: &mut dyn Write) -> Result<()> {
        let failed = |failure: Failure| RosError::body(self.type_name(), failure.to_string());
        let root = self.root().ok_or_else(|| RosError::body("", "the definition is empty"))?;
        let steps = body.len().saturating_mul(3).saturating_add(100_000);
        let mut walk = self.walk(body, Limits { steps, ..Limits::default() }).map_err(failed)?;
        let left = body.len().saturating_mul(GROWTH).saturating_add(LEAST);
        let mut out = Bounded { out, left, full: false };
        Export { walk: &mut walk, out: &mut out }.message(root).map_err(failed)?;
        walk.end().map_err(failed)
    }

    /// That of an Image or a PointCloud2, otherwise the longest array of floats.
    pub fn matrix(&self, body: &[u8]) -> Option<Matrix> {
        if body.len() < SHORTEST {
            return None;
        }
        let value = self.decode(body, LIMITS).ok()?;
        let matrix = match self.short_name().as_str() {
            "sensor_msgs/Image" => image(&value),
            "sensor_msgs/PointCloud2" => cloud(&value),
            _ => longest(&value),
        }?;
        matrix.length().filter(|length| *length >= SHORTEST).map(|_| matrix)
    }
}

/// Stands for a text that is not UTF-8: an object with its bytes in hex.
const NOT_UTF8: &str = "not_utf8";

/// The most bytes of text per byte of the body, and for any body.
const GROWTH: usize = 64;
const LEAST: usize = 16 << 20;

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

struct Export<'a, 'b> {
    walk: &'b mut Walk<'a>,
    out: &'b mut Bounded<'a>,
}

impl<'a> Export<'a, '_> {
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
        self.walk.cursor.end_part(part)?;
        self.text("}")
    }

    fn field(&mut self, field: &'a Field) -> Result<(), Failure> {
        if field.arity == Arity::One {
            return self.element(field.kind);
        }
        let Self { walk, out } = self;
        walk.array(field, |walk, count| {
            let mut inside = Export { walk, out };
            inside.text("[")?;
            for place in 0..count {
                if place > 0 {
                    inside.text(",")?;
                }
                inside.element(field.kind)?;
            }
            Ok(())
        })?;
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
                serde_json::to_writer(&mut *self.out, &value).map_err(|_| self.unwritten())
            }
            Kind::Message(index) => self.message(self.walk.layout(index)?),
        }
    }
}

/// Shorter arrays of numbers are no matrix, bytes.
const SHORTEST: usize = 512;

/// Expands nothing and visits little: this runs for every sealed message.
const LIMITS: Limits = Limits { elements: 0, steps: 20_000 };

fn data(value: &Value) -> Option<(usize, usize)> {
    match value.get("data")? {
        Value::Large { bytes, .. } => Some((bytes.start, bytes.len())),
        _ => None,
    }
}

fn image(value: &Value) -> Option<Matrix> {
    let Value::Text(encoding) = value.get("encoding")? else { return None };
    let (channels, sample) = layout(encoding)?;
    let (start, length) = data(value)?;
    let (rows, columns, step) = (value.count("height")?, value.count("width")?, value.count("step")?);
    let whole = columns.checked_mul(channels * sample)? == step && rows.checked_mul(step)? == length;
    let big_endian = value.count("is_bigendian")? != 0 && sample > 1;
    let apart = if encoding.starts_with("bayer") { 2 } else { 1 };
    whole.then_some(Matrix { start, rows, columns, channels, sample, big_endian, apart })
}

/// Channels of an encoding of `sensor_msgs/image_encodings`, and bytes of each.
pub fn layout(encoding: &str) -> Option<(usize, usize)> {
    Some(match encoding {
        "rgb8" | "bgr8" => (3, 1),
        "rgba8" | "bgra8" => (4, 1),
        "rgb16" | "bgr16" => (3, 2),
        "rgba16" | "bgra16" => (4, 2),
        "mono8" => (1, 1),
        "mono16" => (1, 2),
        "yuv422" | "yuv422_yuy2" => (2, 1),
        _ if encoding.starts_with("bayer_") => (1, if encoding.ends_with("16") { 2 } else { 1 }),
        _ => return generic(encoding),
    })
}

/// As in `32FC1`: bits, kind, channels.
fn generic(encoding: &str) -> Option<(usize, usize)> {
    let (kind, channels) = encoding.split_once('C')?;
    let sample = match kind {
        "8U" | "8S" => 1,
        "16U" | "16S" => 2,
        "32S" | "32F" => 4,
        _ => return None,
    };
    let channels = if channels.is_empty() { 1 } else { channels.parse().ok()? };
    (1..=MOST_CHANNELS).contains(&channels).then_some((channels, sample))
}

fn cloud(value: &Value) -> Option<Matrix> {
    let (start, length) = data(value)?;
    let (rows, columns) = (value.count("height")?, value.count("width")?);
    let point = value.count("point_step")?;
    let (channels, sample) = if point % 4 == 0 { (point / 4, 4) } else { (point, 1) };
    let whole = rows.checked_mul(columns)?.checked_mul(point)? == length;
    let big_endian = value.count("is_bigendian")? != 0 && sample > 1;
    whole.then_some(Matrix { start, rows, columns, channels, sample, big_endian, apart: 1 })
}

fn longest(value: &Value) -> Option<Matrix> {
    let Value::Message(fields) = value else { return None };
    let floats = fields.iter().filter_map(|(_, value)| match value {
        Value::Large { element, count, bytes, big_endian } if element == "float32" => {
            Some((*count, bytes.start, *big_endian))
        }
        _ => None,
    });
    let (count, start, big_endian) = floats.max_by_key(|(count, ..)| *count)?;
    Some(Matrix { start, rows: 1, columns: count, channels: 1, sample: 4, big_endian, apart: 1 })
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

#[cfg(test)]
mod matrix_tests {
    use super::*;

    #[test]
    fn encodings() {
        for (encoding, expected) in [
            ("rgb8", Some((3, 1))),
            ("16UC1", Some((1, 2))),
            ("32FC1", Some((1, 4))),
            ("32FC", Some((1, 4))),
            ("8UC3", Some((3, 1))),
            ("bayer_rggb8", Some((1, 1))),
            ("bayer_gbrg16", Some((1, 2))),
            ("64FC1", None),
            ("8UC0", None),
            ("8UC99", None),
            ("nonsense", None),
        ] {
            assert_eq!(layout(encoding), expected, "{encoding}");
        }
    }

    #[test]
    fn an_image_is_found_where_it_lies() {
        let text = "uint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data";
        let definition = Definition::parse("sensor_msgs/Image", text).expect("definition");
        let mut body = Vec::new();
        body.extend(20u32.to_le_bytes());
        body.extend(30u32.to_le_bytes());
        body.extend([5, 0, 0, 0]);
        body.extend(b"16UC1");
        body.push(1);
        body.extend(60u32.to_le_bytes());
        body.extend(1200u32.to_le_bytes());
        body.extend(vec![3; 1200]);
        let expected = Matrix { start: 26, rows: 20, columns: 30, channels: 1, sample: 2, big_endian: true, apart: 1 };
        assert_eq!(definition.matrix(&body), Some(expected));
        body[4] = 29;
        assert_eq!(definition.matrix(&body), None);
    }
}
