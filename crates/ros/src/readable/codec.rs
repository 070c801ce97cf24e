//! Picture files, PNG and JPEG: decoded to RGB within limits of pixels and memory, and encoded.

use std::io::Cursor;

use jpeg_encoder::{ColorType as JpegColour, Encoder as JpegEncoder, SamplingFactor};
use png::{BitDepth, ColorType, Transformations};
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use super::picture::PictureError;

/// The most pixels of a compressed picture that is decoded: 4000 x 3000.
pub const MOST_PIXELS: u64 = 12_000_000;

/// The most memory that decoding one may take, bytes.
pub const DECODER_MEMORY: usize = 128 << 20;

/// The start of every PNG.
pub(super) const PNG_MAGIC: &[u8] = b"\x89PNG";

/// A picture, three bytes a pixel.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Rgb {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row by row.
    pub pixels: Vec<u8>,
}

fn broken(error: impl std::fmt::Display) -> PictureError {
    PictureError::Broken(crate::model::clean(&error.to_string(), 200))
}

/// Decodes a JPEG or PNG file within [`MOST_PIXELS`] and [`DECODER_MEMORY`].
///
/// # Errors
/// [`PictureError::Large`] before anything is decoded, [`PictureError::Broken`].
pub fn decode(data: &[u8]) -> Result<Rgb, PictureError> {
    if data.starts_with(PNG_MAGIC) { decode_png(data) } else { decode_jpeg(data) }
}

fn within_bounds(width: u32, height: u32) -> Result<(), PictureError> {
    let is_large = u64::from(width) * u64::from(height) > MOST_PIXELS;
    if is_large { Err(PictureError::Large(width, height)) } else { Ok(()) }
}

fn decode_png(data: &[u8]) -> Result<Rgb, PictureError> {
    let limits = png::Limits { bytes: DECODER_MEMORY };
    let mut decoder = png::Decoder::new_with_limits(Cursor::new(data), limits);
    decoder.set_ignore_text_chunk(true);
    decoder.set_ignore_iccp_chunk(true);
    // Palettes and samples below a byte are expanded to bytes.
    decoder.set_transformations(Transformations::EXPAND);
    let (width, height) = decoder.read_header_info().map_err(broken)?.size();
    within_bounds(width, height)?;
    let mut reader = decoder.read_info().map_err(broken)?;
    let size = reader.output_buffer_size().filter(|size| *size <= DECODER_MEMORY);
    let mut samples = vec![0; size.ok_or(PictureError::Large(width, height))?];
    reader.next_frame(&mut samples).map_err(broken)?;
    let (colour, depth) = reader.output_color_type();
    if depth == BitDepth::Sixteen {
        samples = samples.as_chunks().0.iter().map(|pair| as_byte(u16::from_be_bytes(*pair))).collect();
    }
    rgb((width, height), colour.samples(), samples)
}

/// Sixteen bits rounded to eight.
fn as_byte(sample: u16) -> u8 {
    u8::try_from((u32::from(sample) + 128) / 257).unwrap_or(u8::MAX)
}

fn decode_jpeg(data: &[u8]) -> Result<Rgb, PictureError> {
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
    rgb(size, colours.num_components(), samples)
}

/// Pixels of one to four samples, without transparency.
fn rgb((width, height): (u32, u32), channels: usize, samples: Vec<u8>) -> Result<Rgb, PictureError> {
    let (width, height) = (width as usize, height as usize);
    if samples.len() != width * height * channels {
        return Err(broken("its data does not have the length its size implies"));
    }
    let pixels = match channels {
        1 => samples.iter().flat_map(|grey| [*grey; 3]).collect(),
        2 => samples.as_chunks().0.iter().flat_map(|[grey, _]| [*grey; 3]).collect(),
        4 => samples.as_chunks().0.iter().flat_map(|[red, green, blue, _]| [*red, *green, *blue]).collect(),
        _ => samples,
    };
    Ok(Rgb { width, height, pixels })
}

/// Writes a PNG of 8-bit RGB, or of 16-bit greys, high byte first.
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

/// Writes a JPEG of RGB without chroma subsampling.
pub(super) fn jpeg_file(data: &[u8], size: (usize, usize), quality: u8) -> Result<Vec<u8>, PictureError> {
    let side = |length: usize| u16::try_from(length).map_err(|_| broken("it is too large"));
    let mut out = Vec::new();
    let mut encoder = JpegEncoder::new(&mut out, quality);
    encoder.set_sampling_factor(SamplingFactor::F_1_1);
    encoder.encode(data, side(size.0)?, side(size.1)?, JpegColour::Rgb).map_err(broken)?;
    Ok(out)
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
            assert_eq!(decode(&file), Ok(Rgb { width: 2, height: 1, pixels: wanted.to_vec() }), "{colour:?}");
        }
        let mut grey = Vec::new();
        JpegEncoder::new(&mut grey, 100).encode(&[100; 128], 16, 8, JpegColour::Luma).expect("encoded");
        let rgb = decode(&grey).expect("a grey JPEG");
        assert_eq!((rgb.width, rgb.height, rgb.pixels.len()), (16, 8, 384));
        assert!(rgb.pixels.iter().all(|sample| sample.abs_diff(100) <= 1), "{:?}", &rgb.pixels[..9]);
    }

    #[test]
    fn colours_of_a_jpeg_come_back_within_its_losses() {
        let pixels = [200, 40, 90].repeat(24 * 16);
        let file = jpeg_file(&pixels, (24, 16), 92).expect("encoded");
        let back = decode(&file).expect("decoded");
        assert_eq!((back.width, back.height), (24, 16));
        assert!(back.pixels.iter().zip(&pixels).all(|(back, sent)| back.abs_diff(*sent) <= 4));
        assert!((1..file.len()).all(|end| decode(&file[..end]).map_or(true, |cut| cut.pixels.len() == pixels.len())));
    }

    #[test]
    fn a_jpeg_that_claims_too_much_is_refused_by_its_header() {
        let mut file = jpeg_file(&[0; 192], (8, 8), 92).expect("encoded");
        let frame = file.windows(2).position(|marker| marker == [0xff, 0xc0]).expect("a frame");
        file[frame + 5..frame + 9].copy_from_slice(&[0xff; 4]);
        assert_eq!(decode(&file), Err(PictureError::Large(65_535, 65_535)));
    }
}
