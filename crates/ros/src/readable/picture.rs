//! Pictures: their properties, thumbnails for screens, and picture files.

use png::{BitDepth, ColorType};
use serde::{Deserialize, Serialize};

use super::codec::{MOST_PIXELS, PNG_MAGIC, decode, jpeg_file, png_file};
use super::matrix::Matrix;
use super::numbers::{Body, number, stamp, text};
use super::points::bytes;
use super::raster::{LARGEST, Raster};
use super::{Readable, Table};
use crate::model::ErrorKind;
use crate::ros::message::{Definition, Limits, Value};

/// Quality of exported JPEGs.
const QUALITY: u8 = 92;

/// Why a picture cannot be shown or written.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PictureError {
    /// The message is not a picture.
    #[error("{0} is not a picture; write it as .json or .bin")]
    NoPicture(String),
    /// Its encoding is unknown.
    #[error("the encoding '{0}' is not supported; write the message as .bin or .json")]
    Encoding(String),
    /// It is larger than the decoder allows.
    #[error("the picture has {0} x {1} pixels, more than the limit of {most}; write it as .bin", most = MOST_PIXELS)]
    Large(u32, u32),
    /// It is damaged.
    #[error("the picture is damaged: {0}; write the message as .bin")]
    Broken(String),
    /// The message does not match its definition.
    #[error("{0}; write it as .bin")]
    Message(String),
}

impl PictureError {
    /// Determines the exit code.
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::NoPicture(_) | Self::Encoding(_) => ErrorKind::Usage,
            Self::Large(..) | Self::Broken(_) | Self::Message(_) => ErrorKind::Input,
        }
    }
}

/// A file format that a message can be written in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Exported {
    /// PNG; 8-bit colours and greys and 16-bit depths are exact.
    Png,
    /// JPEG; a JPEG message's own bytes.
    Jpeg,
    /// NumPy's array file: the matrix itself.
    Npy,
    /// The whole message as JSON.
    Json,
    /// The message's bytes as they were captured.
    Bin,
}

/// The format requested by a file name's extension.
pub fn file_of(name: &str) -> Option<Exported> {
    let end = name.rsplit_once('.')?.1.to_ascii_lowercase();
    Some(match end.as_str() {
        "png" => Exported::Png,
        "jpg" | "jpeg" => Exported::Jpeg,
        "npy" => Exported::Npy,
        "json" => Exported::Json,
        "bin" => Exported::Bin,
        _ => return None,
    })
}

/// The message as a file of that format.
///
/// # Errors
/// [`PictureError`] if it is not such a picture, or cannot be decoded.
pub fn export(kind: Exported, definition: &Definition, body: &[u8]) -> Result<Vec<u8>, PictureError> {
    match kind {
        Exported::Bin => return Ok(body.to_vec()),
        Exported::Json => {
            let mut out = Vec::new();
            definition.write_json(body, &mut out).map_err(|error| PictureError::Message(error.to_string()))?;
            return Ok(out);
        }
        Exported::Png | Exported::Jpeg | Exported::Npy => {}
    }
    let broken = |error: crate::ros::RosError| PictureError::Broken(error.to_string());
    let limits = Limits { elements: 0, ..Limits::default() };
    let value = definition.decode(body, limits).map_err(broken)?;
    match definition.short_name().as_str() {
        "sensor_msgs/CompressedImage" => {
            let data = value.get("data").and_then(|data| bytes(data, &Body(body)).map(|data| data.into_owned()));
            from_file(kind, &data.ok_or_else(|| PictureError::Broken("it has no data".into()))?)
        }
        "sensor_msgs/Image" => from_matrix(kind, &Matrix::of(&value, &Body(body))?),
        other => Err(PictureError::NoPicture(other.to_owned())),
    }
}

fn from_file(kind: Exported, data: &[u8]) -> Result<Vec<u8>, PictureError> {
    let is_png = data.starts_with(PNG_MAGIC);
    match kind {
        Exported::Png if is_png => Ok(data.to_vec()),
        Exported::Jpeg if !is_png => Ok(data.to_vec()),
        Exported::Npy => {
            let rgb = decode(data)?;
            let row = std::iter::once(rgb.pixels.as_slice());
            Ok(npy("|u1", &[rgb.height, rgb.width, 3], rgb.pixels.len(), row))
        }
        _ => {
            let rgb = decode(data)?;
            encode(kind, &rgb.pixels, (rgb.width, rgb.height))
        }
    }
}

fn from_matrix(kind: Exported, matrix: &Matrix) -> Result<Vec<u8>, PictureError> {
    let size = (matrix.width, matrix.height);
    if kind == Exported::Npy {
        let shape = if matrix.channels == 1 { vec![size.1, size.0] } else { vec![size.1, size.0, matrix.channels] };
        let length = size.0 * size.1 * matrix.channels * matrix.sample;
        return Ok(npy(dtype(matrix), &shape, length, (0..size.1).map(|row| matrix.row(row))));
    }
    if kind == Exported::Png && matrix.channels == 1 && matrix.sample == 2 {
        let swap = |row: usize| {
            let pairs = matrix.row(row).as_chunks::<2>().0.iter();
            pairs.flat_map(|[first, second]| if matrix.big_endian { [*first, *second] } else { [*second, *first] })
        };
        let greys: Vec<u8> = (0..size.1).flat_map(swap).collect();
        return png_file(&greys, size, ColorType::Grayscale, BitDepth::Sixteen);
    }
    let eye = matrix.eye();
    let rgb: Vec<u8> =
        (0..size.1).flat_map(|y| (0..size.0).map(move |x| (x, y))).flat_map(|(x, y)| eye(x, y)).collect();
    encode(kind, &rgb, size)
}

fn dtype(matrix: &Matrix) -> &'static str {
    let signed = matrix.encoding.contains('S');
    match (matrix.sample, matrix.encoding.starts_with("32F"), matrix.big_endian) {
        (1, _, _) if signed => "|i1",
        (1, _, _) => "|u1",
        (2, _, false) => {
            if signed {
                "<i2"
            } else {
                "<u2"
            }
        }
        (2, _, true) => {
            if signed {
                ">i2"
            } else {
                ">u2"
            }
        }
        (_, true, false) => "<f4",
        (_, true, true) => ">f4",
        (_, false, false) => "<i4",
        (_, false, true) => ">i4",
    }
}

/// NumPy's format, version 1.0: magic, length of a text, the text padded to 64 bytes, the numbers.
fn npy<'a>(dtype: &str, shape: &[usize], length: usize, rows: impl Iterator<Item = &'a [u8]>) -> Vec<u8> {
    let shape: Vec<String> = shape.iter().map(usize::to_string).collect();
    let mut text = format!("{{'descr': '{dtype}', 'fortran_order': False, 'shape': ({}), }}", shape.join(", "));
    while (text.len() + 11) % 64 != 0 {
        text.push(' ');
    }
    text.push('\n');
    let mut out = Vec::with_capacity(length + 128);
    out.extend_from_slice(b"\x93NUMPY\x01\x00");
    out.extend_from_slice(&u16::try_from(text.len()).unwrap_or(u16::MAX).to_le_bytes());
    out.extend_from_slice(text.as_bytes());
    rows.for_each(|row| out.extend_from_slice(row));
    out
}

fn encode(kind: Exported, rgb: &[u8], size: (usize, usize)) -> Result<Vec<u8>, PictureError> {
    match kind {
        Exported::Jpeg => jpeg_file(rgb, size, QUALITY),
        _ => png_file(rgb, size, ColorType::Rgb, BitDepth::Eight),
    }
}

pub(super) fn compressed(value: &Value, body: &Body) -> Readable {
    let mut out = Readable::default();
    out.line("Stamp (UTC)", stamp(value));
    out.line("Frame", text(value, "header.frame_id"));
    out.line("Format", text(value, "format"));
    let Some(data) = value.get("data").and_then(|data| bytes(data, body)) else { return out };
    out.line("Bytes", data.len().to_string());
    match decode(&data) {
        Ok(rgb) => {
            out.line("Size", format!("{} x {}", rgb.width, rgb.height));
            let pixel = |x: usize, y: usize| {
                let at = (y * rgb.width + x) * 3;
                rgb.pixels.get(at..at + 3).and_then(|rgb| rgb.try_into().ok()).unwrap_or_default()
            };
            out.picture = Some(Raster::of((rgb.width, rgb.height), LARGEST, &pixel));
        }
        Err(error) => out.line("Not shown", error.to_string()),
    }
    out
}

pub(super) fn raw(value: &Value, body: &Body) -> Readable {
    let mut out = Readable::default();
    out.line("Stamp (UTC)", stamp(value));
    out.line("Frame", text(value, "header.frame_id"));
    out.line("Encoding", text(value, "encoding"));
    out.line("Size", format!("{} x {}", text(value, "width"), text(value, "height")));
    match Matrix::of(value, body) {
        Ok(matrix) => {
            if let Some((low, high)) = matrix.is_depth().then(|| matrix.depths()).flatten() {
                let unit = if matrix.sample == 4 { "m" } else { "mm" };
                out.line("Measures", format!("{} to {} {unit}", number(low.into()), number(high.into())));
            }
            out.tables.extend(corner(&matrix));
            out.picture = Some(Raster::of((matrix.width, matrix.height), LARGEST, &*matrix.eye()));
        }
        Err(error) => out.line("Not shown", error.to_string()),
    }
    out
}

/// The first numbers of the matrix, as the paper shows pictures.
fn corner(matrix: &Matrix) -> Option<Table> {
    if matrix.channels > 4 {
        return None;
    }
    let columns = matrix.width.min(6);
    let cell = |x: usize, y: usize| {
        let size = matrix.channels * matrix.sample;
        let pixel = matrix.row(y).get(x * size..(x + 1) * size).unwrap_or_default();
        pixel.iter().map(|byte| format!("{byte:02x}")).collect::<String>()
    };
    let rows = (0..matrix.height.min(4)).map(|y| (0..columns).map(|x| cell(x, y)).collect()).collect();
    Some(Table { title: String::from("Matrix, upper left corner in hex"), head: Vec::new(), rows })
}
