//! Pictures (PNG and JPEG within limits of pixels and memory), their thumbnails, and scans, clouds and paths from
//! above.

use std::io::Cursor;

use jpeg_encoder::{ColorType as JpegColour, Encoder as JpegEncoder, SamplingFactor};
use png::{BitDepth, ColorType, Transformations};
use serde::{Deserialize, Serialize};
use zune_jpeg::JpegDecoder;
use zune_jpeg::{
    zune_core::bytestream::ZCursor, zune_core::colorspace::ColorSpace, zune_core::options::DecoderOptions,
};

use super::{Body, MOST_POINTS, Matrix, Plot, Readable, Table, float, floats, metres, number, shown, text};
use crate::message::{Definition, Limits, Value};
use crate::model::{ErrorKind, base64_text, clean};

const QUALITY: u8 = 92;

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PictureError {
    #[error("{0} is not a picture; write it as .json or .bin")]
    NoPicture(String),
    #[error("the encoding '{0}' is not supported; write the message as .bin or .json")]
    Encoding(String),
    #[error("the picture has {0} x {1} pixels, more than the limit of {most}; write it as .bin", most = MOST_PIXELS)]
    Large(u32, u32),
    #[error("the picture is damaged: {0}; write the message as .bin")]
    Broken(String),
    #[error("{0}; write it as .bin")]
    Message(String),
}

impl PictureError {
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::NoPicture(_) | Self::Encoding(_) => ErrorKind::Usage,
            Self::Large(..) | Self::Broken(_) | Self::Message(_) => ErrorKind::Input,
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, strum::EnumString)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum Exported {
    /// 8-bit colours and greys and 16-bit depths are exact.
    Png,
    /// Of a JPEG message, its own bytes.
    #[strum(serialize = "jpg", serialize = "jpeg")]
    Jpeg,
    /// NumPy's array file: the matrix itself.
    Npy,
    Json,
    Bin,
}

pub fn file_of(name: &str) -> Option<Exported> {
    name.rsplit_once('.')?.1.to_ascii_lowercase().parse().ok()
}

pub fn export(kind: Exported, definition: &Definition, body: &[u8]) -> Result<Vec<u8>, PictureError> {
    if kind == Exported::Bin {
        return Ok(body.to_vec());
    }
    if kind == Exported::Json {
        let mut out = Vec::new();
        definition.write_json(body, &mut out).map_err(|error| PictureError::Message(error.to_string()))?;
        return Ok(out);
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
            let Raster { width, height, rgb } = decode(data)?;
            Ok(npy("|u1", &[height, width, 3], rgb.len(), std::iter::once(rgb.as_slice())))
        }
        _ => {
            let Raster { width, height, rgb } = decode(data)?;
            encode(kind, &rgb, (width, height))
        }
    }
}

fn from_matrix(kind: Exported, matrix: &Matrix) -> Result<Vec<u8>, PictureError> {
    let size = (matrix.width, matrix.height);
    if kind == Exported::Npy {
        let shape = if matrix.channels == 1 { vec![size.1, size.0] } else { vec![size.1, size.0, matrix.channels] };
        let length = size.0 * size.1 * matrix.channels * matrix.sample;
        return Ok(npy(&dtype(matrix), &shape, length, (0..size.1).map(|row| matrix.row(row))));
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

fn dtype(matrix: &Matrix) -> String {
    let order = match (matrix.sample, matrix.big_endian) {
        (1, _) => '|',
        (_, true) => '>',
        (_, false) => '<',
    };
    let kind = match &matrix.encoding {
        encoding if encoding.starts_with("32F") => 'f',
        encoding if encoding.contains('S') => 'i',
        _ => 'u',
    };
    format!("{order}{kind}{}", matrix.sample)
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
    let mut out = Readable::headed(value);
    out.line("Format", text(value, "format"));
    let Some(data) = value.get("data").and_then(|data| bytes(data, body)) else { return out };
    out.line("Bytes", data.len().to_string());
    match decode(&data) {
        Ok(picture) => {
            out.line("Size", format!("{} x {}", picture.width, picture.height));
            out.picture = Some(picture.fit(LARGEST));
        }
        Err(error) => out.line("Not shown", error.to_string()),
    }
    out
}

pub(super) fn raw(value: &Value, body: &Body) -> Readable {
    let mut out = Readable::headed(value);
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

/// Of a compressed picture: 4000 x 3000.
pub const MOST_PIXELS: u64 = 12_000_000;

/// For decoding one picture, bytes.
pub const DECODER_MEMORY: usize = 128 << 20;

const PNG_MAGIC: &[u8] = b"\x89PNG";

fn broken(error: impl std::fmt::Display) -> PictureError {
    PictureError::Broken(crate::model::clean(&error.to_string(), 200))
}

pub fn decode(data: &[u8]) -> Result<Raster, PictureError> {
    if data.starts_with(PNG_MAGIC) { decode_png(data) } else { decode_jpeg(data) }
}

fn within_bounds(width: u32, height: u32) -> Result<(), PictureError> {
    let is_large = u64::from(width) * u64::from(height) > MOST_PIXELS;
    if is_large { Err(PictureError::Large(width, height)) } else { Ok(()) }
}

fn decode_png(data: &[u8]) -> Result<Raster, PictureError> {
    let limits = png::Limits { bytes: DECODER_MEMORY };
    let mut decoder = png::Decoder::new_with_limits(Cursor::new(data), limits);
    decoder.set_ignore_text_chunk(true);
    decoder.set_ignore_iccp_chunk(true);
    // Expands palettes and samples below a byte to bytes.
    decoder.set_transformations(Transformations::EXPAND);
    let (width, height) = decoder.read_header_info().map_err(broken)?.size();
    within_bounds(width, height)?;
    let mut reader = decoder.read_info().map_err(broken)?;
    let size = reader.output_buffer_size().filter(|size| *size <= DECODER_MEMORY);
    let mut samples = vec![0; size.ok_or(PictureError::Large(width, height))?];
    reader.next_frame(&mut samples).map_err(broken)?;
    let (colour, depth) = reader.output_color_type();
    if depth == BitDepth::Sixteen {
        // Rounds sixteen bits to eight.
        let as_byte =
            |pair: &[u8; 2]| u8::try_from((u32::from(u16::from_be_bytes(*pair)) + 128) / 257).unwrap_or(u8::MAX);
        samples = samples.as_chunks().0.iter().map(as_byte).collect();
    }
    raster((width, height), colour.samples(), samples)
}

fn decode_jpeg(data: &[u8]) -> Result<Raster, PictureError> {
    let any_size = DecoderOptions::default().set_max_width(usize::MAX).set_max_height(usize::MAX);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(data), any_size.set_strict_mode(false));
    decoder.decode_headers().map_err(broken)?;
    let (width, height) = decoder.dimensions().ok_or_else(|| broken("it has no size"))?;
    let side = |length: usize| u32::try_from(length).unwrap_or(u32::MAX);
    let size = (side(width), side(height));
    within_bounds(size.0, size.1)?;
    let colours = match decoder.input_colorspace() {
        Some(grey @ (ColorSpace::Luma | ColorSpace::LumaA)) => grey,
        _ => ColorSpace::RGB,
    };
    decoder.set_options(decoder.options().jpeg_set_out_colorspace(colours));
    let samples = decoder.decode().map_err(broken)?;
    raster(size, colours.num_components(), samples)
}

/// Pixels of one to four samples, without transparency.
fn raster((width, height): (u32, u32), channels: usize, samples: Vec<u8>) -> Result<Raster, PictureError> {
    let (width, height) = (width as usize, height as usize);
    if samples.len() != width * height * channels {
        return Err(broken("its data does not have the length its size implies"));
    }
    let rgb = match channels {
        1 => samples.iter().flat_map(|grey| [*grey; 3]).collect(),
        2 => samples.as_chunks().0.iter().flat_map(|[grey, _]| [*grey; 3]).collect(),
        4 => samples.as_chunks().0.iter().flat_map(|[red, green, blue, _]| [*red, *green, *blue]).collect(),
        _ => samples,
    };
    Ok(Raster { width, height, rgb })
}

pub(super) fn png_file(
    data: &[u8],
    size: (usize, usize),
    colour: ColorType,
    depth: BitDepth,
) -> Result<Vec<u8>, PictureError> {
    let side = |length: usize| u32::try_from(length).map_err(|_| broken("it is too large"));
    let mut out = Vec::new();
    let mut encoder = png::Encoder::new(&mut out, side(size.0)?, side(size.1)?);
    encoder.set_color(colour);
    encoder.set_depth(depth);
    encoder.set_compression(png::Compression::Fast);
    encoder.set_filter(png::Filter::Adaptive);
    let mut writer = encoder.write_header().map_err(broken)?;
    writer.write_image_data(data).map_err(broken)?;
    writer.finish().map_err(broken)?;
    Ok(out)
}

fn jpeg_file(data: &[u8], size: (usize, usize), quality: u8) -> Result<Vec<u8>, PictureError> {
    let side = |length: usize| u16::try_from(length).map_err(|_| broken("it is too large"));
    let mut out = Vec::new();
    let mut encoder = JpegEncoder::new(&mut out, quality);
    encoder.set_sampling_factor(SamplingFactor::F_1_1);
    encoder.encode(data, side(size.0)?, side(size.1)?, JpegColour::Rgb).map_err(broken)?;
    Ok(out)
}

/// Pixels: enough for half-blocks on a screen of 240 columns and 80 rows.
pub const LARGEST: (usize, usize) = (240, 160);

/// Source pixels averaged into one, in each direction.
const AVERAGED: usize = 4;

#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Raster {
    pub width: usize,
    pub height: usize,
    /// Red, green, blue of each pixel, row by row.
    #[serde(with = "base64_text")]
    pub rgb: Vec<u8>,
}

impl Raster {
    /// Averaged down to at most `largest`; never enlarged.
    pub fn of(size: (usize, usize), largest: (usize, usize), pixel: &dyn Fn(usize, usize) -> [u8; 3]) -> Self {
        let (columns, rows) = fitted(size, largest);
        let mut rgb = Vec::with_capacity(columns * rows * 3);
        for row in 0..rows {
            for column in 0..columns {
                let across = (column * size.0 / columns, (column + 1) * size.0 / columns);
                let down = (row * size.1 / rows, (row + 1) * size.1 / rows);
                rgb.extend(average(across, down, pixel));
            }
        }
        Self { width: columns, height: rows, rgb }
    }

    /// Averages this raster down again.
    pub fn fit(&self, largest: (usize, usize)) -> Self {
        Self::of((self.width, self.height), largest, &|x, y| self.pixel(x, y))
    }

    /// Its size when fitted into `largest`, with its aspect ratio; never enlarged.
    pub fn size_within(&self, largest: (usize, usize)) -> (usize, usize) {
        fitted((self.width, self.height), largest)
    }

    pub fn png(&self) -> Result<Vec<u8>, PictureError> {
        png_file(&self.rgb, (self.width, self.height), ColorType::Rgb, BitDepth::Eight)
    }

    pub fn pixel(&self, x: usize, y: usize) -> [u8; 3] {
        let at = (y * self.width + x) * 3;
        self.rgb.get(at..at + 3).and_then(|rgb| rgb.try_into().ok()).unwrap_or_default()
    }
}

/// Fits a picture into `largest` with its aspect ratio; never enlarges.
pub fn fitted(size: (usize, usize), largest: (usize, usize)) -> (usize, usize) {
    let (width, height) = size;
    if width == 0 || height == 0 || largest.0 == 0 || largest.1 == 0 {
        return (0, 0);
    }
    if width <= largest.0 && height <= largest.1 {
        return size;
    }
    if width.saturating_mul(largest.1) >= height.saturating_mul(largest.0) {
        (largest.0, (height.saturating_mul(largest.0) / width).max(1))
    } else {
        ((width.saturating_mul(largest.1) / height).max(1), largest.1)
    }
}

fn average(across: (usize, usize), down: (usize, usize), pixel: &dyn Fn(usize, usize) -> [u8; 3]) -> [u8; 3] {
    let steps = |(from, to): (usize, usize)| {
        let end = to.max(from + 1);
        (from..end).step_by((end - from).div_ceil(AVERAGED))
    };
    let mut sums = [0u32; 3];
    let mut count = 0;
    for y in steps(down) {
        for x in steps(across) {
            for (sum, part) in sums.iter_mut().zip(pixel(x, y)) {
                *sum += u32::from(part);
            }
            count += 1;
        }
    }
    sums.map(|sum| u8::try_from(sum / count.max(1)).unwrap_or(u8::MAX))
}

pub(super) fn scan(value: &Value, body: &Body) -> Readable {
    let mut out = Readable::headed(value);
    let (least, most) = (float(value, "range_min").unwrap_or(0.0), float(value, "range_max").unwrap_or(f64::INFINITY));
    let (first, step) = (float(value, "angle_min").unwrap_or(0.0), float(value, "angle_increment").unwrap_or(0.0));
    let ranges = floats(value, "ranges", body, usize::MAX);
    let valid = |range: &f64| range.is_finite() && *range >= least && *range <= most;
    let good = ranges.iter().map(|(_, range)| *range).filter(valid);
    let degrees = |path: &str| float(value, path).map_or_else(|| String::from("-"), |angle| number(angle.to_degrees()));
    out.line("Angles", format!("{}° to {}°", degrees("angle_min"), degrees("angle_max")));
    out.line("Range", format!("{} to {} m", number(least), number(most)));
    out.line("Beams", format!("{}, of these {} in range", ranges.len(), good.clone().count()));
    out.line("Scan time, s", shown(value, "scan_time"));
    let nearest = good.clone().fold(f64::INFINITY, f64::min);
    let farthest = good.fold(0.0, f64::max);
    if nearest.is_finite() {
        out.line("Nearest, farthest", format!("{}, {}", metres(nearest), metres(farthest)));
    }
    let every = ranges.len().div_ceil(MOST_POINTS).max(1);
    let point = |(at, range): &(usize, f64)| {
        let angle = first + step * f64::from(u32::try_from(*at).unwrap_or(u32::MAX));
        (range * angle.cos(), range * angle.sin())
    };
    let shown = ranges.iter().filter(|(_, range)| valid(range)).step_by(every);
    out.plot = plot("Scan from above", shown.map(point).collect(), Some((0.0, 0.0)), false);
    out
}

pub(super) fn plot(title: &str, points: Vec<(f64, f64)>, here: Option<(f64, f64)>, path: bool) -> Option<Plot> {
    let points: Vec<(f64, f64)> = points.into_iter().filter(|(x, y)| x.is_finite() && y.is_finite()).collect();
    let axes = (String::from("x, m"), String::from("y, m"));
    (!points.is_empty()).then(|| Plot { title: title.to_owned(), axes, points, path, here })
}

struct Part {
    name: String,
    offset: usize,
    kind: usize,
    count: usize,
}

const KINDS: [&str; 9] = ["?", "int8", "uint8", "int16", "uint16", "int32", "uint32", "float32", "float64"];

pub(super) fn cloud(value: &Value, body: &Body) -> Readable {
    let mut out = Readable::headed(value);
    let parts = parts(value);
    let (columns, rows) = (value.count("width").unwrap_or(0), value.count("height").unwrap_or(0));
    out.line("Points", format!("{} ({columns} x {rows})", columns.saturating_mul(rows)));
    out.line("Bytes of a point", text(value, "point_step"));
    out.line("Dense", if value.count("is_dense") == Some(1) { "yes" } else { "no: points may be missing" });
    let head = ["field", "offset", "type", "count"].map(String::from).to_vec();
    let cells = parts.iter().map(|part| {
        let kind = KINDS.get(part.kind).copied().unwrap_or("?").to_owned();
        vec![part.name.clone(), part.offset.to_string(), kind, part.count.to_string()]
    });
    out.tables.push(Table { title: String::from("Fields"), head, rows: cells.collect() });
    let points = seen_from_above(value, body, &parts).unwrap_or_default();
    if let Some((low, high)) = heights(&points) {
        out.line("Heights", format!("{} to {}", metres(low), metres(high)));
    }
    let flat = points.into_iter().map(|(x, y, _)| (x, y)).collect();
    out.plot = plot("Cloud from above", flat, Some((0.0, 0.0)), false);
    out
}

fn parts(value: &Value) -> Vec<Part> {
    let Some(Value::Array(items)) = value.get("fields") else { return Vec::new() };
    let part = |item: &Value| {
        let Some(Value::Text(name)) = item.get("name") else { return None };
        let (offset, kind, many) = (item.count("offset")?, item.count("datatype")?, item.count("count")?);
        Some(Part { name: clean(name, 40), offset, kind, count: many })
    };
    items.iter().take(64).filter_map(part).collect()
}

fn heights(points: &[(f64, f64, f64)]) -> Option<(f64, f64)> {
    let heights = points.iter().map(|(_, _, z)| *z).filter(|z| z.is_finite());
    let (low, high) = heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), z| (low.min(z), high.max(z)));
    (low <= high).then_some((low, high))
}

/// x, y and z of a sample of the points.
fn seen_from_above(value: &Value, body: &Body, parts: &[Part]) -> Option<Vec<(f64, f64, f64)>> {
    let big = value.count("is_bigendian")? != 0;
    let step = value.count("point_step").filter(|step| *step > 0)?;
    let data = bytes(value.get("data")?, body)?;
    let axis = |name: &str| parts.iter().find(|part| part.name == name && matches!(part.kind, 7 | 8));
    let (x, y, z) = (axis("x")?, axis("y")?, axis("z"));
    let points = data.len() / step;
    let every = points.div_ceil(MOST_POINTS).max(1);
    let read = |point: &[u8], part: &Part| coordinate(point.get(part.offset..)?, part.kind == 8, big);
    let point = |point: &[u8]| {
        let height = z.and_then(|z| read(point, z)).unwrap_or(f64::NAN);
        Some((read(point, x)?, read(point, y)?, height)).filter(|(x, y, _)| x.is_finite() && y.is_finite())
    };
    Some(data.chunks_exact(step).step_by(every).filter_map(point).collect())
}

/// A float of four bytes, or of eight, at the beginning of the bytes.
pub(super) fn coordinate(bytes: &[u8], wide: bool, big: bool) -> Option<f64> {
    if wide {
        let bytes = *bytes.first_chunk::<8>()?;
        return Some(if big { f64::from_be_bytes(bytes) } else { f64::from_le_bytes(bytes) });
    }
    let bytes = *bytes.first_chunk::<4>()?;
    Some(f64::from(if big { f32::from_be_bytes(bytes) } else { f32::from_le_bytes(bytes) }))
}

pub(super) fn bytes<'a>(value: &Value, body: &'a Body) -> Option<std::borrow::Cow<'a, [u8]>> {
    match value {
        Value::Large { bytes, .. } => body.0.get(bytes.clone()).map(std::borrow::Cow::Borrowed),
        Value::Array(items) => {
            let byte = |item: &Value| match item {
                Value::Unsigned(number) => u8::try_from(*number).ok(),
                _ => None,
            };
            items.iter().map(byte).collect::<Option<Vec<u8>>>().map(std::borrow::Cow::Owned)
        }
        _ => None,
    }
}

pub(super) fn path(value: &Value, _: &Body) -> Readable {
    let mut out = Readable::headed(value);
    let Some(Value::Array(poses)) = value.get("poses") else { return out };
    out.line("Poses", poses.len().to_string());
    let point = |pose: &Value| Some((float(pose, "pose.position.x")?, float(pose, "pose.position.y")?));
    out.plot = plot("Path", poses.iter().filter_map(point).collect(), None, true);
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn png(colour: ColorType, depth: BitDepth, data: &[u8]) -> Vec<u8> {
        let mut out = Vec::new();
        let mut encoder = png::Encoder::new(&mut out, 2, 1);
        encoder.set_color(colour);
        encoder.set_depth(depth);
        encoder.set_palette(&[9, 8, 7, 60, 50, 40]);
        encoder.write_header().expect("header").write_image_data(data).expect("data");
        out
    }

    #[test]
    fn every_kind_of_sample_becomes_rgb() {
        use BitDepth::{Eight, Four, One, Sixteen};
        for (colour, depth, data, wanted) in [
            (ColorType::Rgba, Eight, &[1, 2, 3, 0, 4, 5, 6, 255][..], [1, 2, 3, 4, 5, 6]),
            (ColorType::GrayscaleAlpha, Eight, &[1, 0, 4, 255], [1, 1, 1, 4, 4, 4]),
            (ColorType::Grayscale, Four, &[0x0f], [0, 0, 0, 255, 255, 255]),
            (ColorType::Grayscale, Sixteen, &[0, 128, 0, 129], [0, 0, 0, 1, 1, 1]),
            (ColorType::Indexed, One, &[0x40], [9, 8, 7, 60, 50, 40]),
        ] {
            let file = png(colour, depth, data);
            assert_eq!(decode(&file), Ok(Raster { width: 2, height: 1, rgb: wanted.to_vec() }), "{colour:?}");
        }
        let mut grey = Vec::new();
        JpegEncoder::new(&mut grey, 100).encode(&[100; 128], 16, 8, JpegColour::Luma).expect("encoded");
        let rgb = decode(&grey).expect("a grey JPEG");
        assert_eq!((rgb.width, rgb.height, rgb.rgb.len()), (16, 8, 384));
        assert!(rgb.rgb.iter().all(|sample| sample.abs_diff(100) <= 1), "{:?}", &rgb.rgb[..9]);
    }

    #[test]
    fn colours_of_a_jpeg_come_back_within_its_losses() {
        let pixels = [200, 40, 90].repeat(24 * 16);
        let file = jpeg_file(&pixels, (24, 16), 92).expect("encoded");
        let back = decode(&file).expect("decoded");
        assert_eq!((back.width, back.height), (24, 16));
        assert!(back.rgb.iter().zip(&pixels).all(|(back, sent)| back.abs_diff(*sent) <= 4));
        assert!((1..file.len()).all(|end| decode(&file[..end]).map_or(true, |cut| cut.rgb.len() == pixels.len())));
    }

    #[test]
    fn a_jpeg_that_claims_too_much_is_refused_by_its_header() {
        let mut file = jpeg_file(&[0; 192], (8, 8), 92).expect("encoded");
        let frame = file.windows(2).position(|marker| marker == [0xff, 0xc0]).expect("a frame");
        file[frame + 5..frame + 9].copy_from_slice(&[0xff; 4]);
        assert_eq!(decode(&file), Err(PictureError::Large(65_535, 65_535)));
    }
}

#[cfg(test)]
mod raster_tests {
    use super::*;

    #[test]
    fn pictures_keep_their_shape_and_are_never_made_larger() {
        assert_eq!(fitted((640, 480), (240, 160)), (213, 160));
        assert_eq!(fitted((100, 50), (240, 160)), (100, 50));
        assert_eq!(fitted((1_000_000, 1), (240, 160)), (240, 1));
        assert_eq!(fitted((0, 5), (240, 160)), (0, 0));
    }

    #[test]
    fn pixels_are_averaged() {
        let chequered = |x: usize, y: usize| if (x + y).is_multiple_of(2) { [200, 0, 100] } else { [0, 0, 0] };
        let raster = Raster::of((8, 8), (2, 2), &chequered);
        assert_eq!((raster.width, raster.height, raster.rgb.len()), (2, 2, 12));
        assert_eq!(raster.pixel(1, 1), [100, 0, 50]);
        assert_eq!(raster.fit((1, 1)).pixel(0, 0), [100, 0, 50]);
        assert_eq!(raster.pixel(9, 9), [0, 0, 0]);
    }
}
