//! Where a message has numbers worth coding as a matrix: pictures, depth, clouds, scans.

use super::decode::Limits;
use super::definition::Definition;
use super::value::Value;
use crate::crypto::compression::{MOST_CHANNELS, Matrix};

/// Arrays of numbers shorter than this are not treated as a matrix, bytes.
const SHORTEST: usize = 512;

/// Expands nothing and visits little: this runs for every message that is sealed.
const LIMITS: Limits = Limits { elements: 0, steps: 20_000 };

impl Definition {
    /// The matrix in `body`, if any: that of an Image or a PointCloud2, otherwise its longest array of floats.
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

fn number(value: &Value, field: &str) -> Option<usize> {
    match value.get(field)? {
        Value::Unsigned(number) => usize::try_from(*number).ok(),
        Value::Bool(flag) => Some(usize::from(*flag)),
        _ => None,
    }
}

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
    let (rows, columns, step) = (number(value, "height")?, number(value, "width")?, number(value, "step")?);
    let whole = columns.checked_mul(channels * sample)? == step && rows.checked_mul(step)? == length;
    let big_endian = number(value, "is_bigendian")? != 0 && sample > 1;
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
    let (rows, columns) = (number(value, "height")?, number(value, "width")?);
    let point = number(value, "point_step")?;
    let (channels, sample) = if point % 4 == 0 { (point / 4, 4) } else { (point, 1) };
    let whole = rows.checked_mul(columns)?.checked_mul(point)? == length;
    let big_endian = number(value, "is_bigendian")? != 0 && sample > 1;
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
