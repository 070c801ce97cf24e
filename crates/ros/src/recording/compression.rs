//! Compression of chunks: none, bzip2, LZ4 frames, Zstandard. All in Rust; every output is bounded.

use std::fmt;
use std::io::{BufRead, Read, Write};
use std::str::FromStr;

use super::Encoding;
use crate::ros::tcpros::LONGEST_MESSAGE;

/// How the chunks of a recording are compressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ChunkCompression {
    /// No compression.
    #[default]
    None,
    /// bzip2 (bags).
    Bz2,
    /// LZ4 frames (bags, MCAP).
    Lz4,
    /// Zstandard (MCAP).
    Zstd,
}

impl ChunkCompression {
    /// Its name on the command line and in a bag.
    pub fn word(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Bz2 => "bz2",
            Self::Lz4 => "lz4",
            Self::Zstd => "zstd",
        }
    }
}

impl fmt::Display for ChunkCompression {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.word())
    }
}

impl FromStr for ChunkCompression {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        [Self::None, Self::Bz2, Self::Lz4, Self::Zstd]
            .into_iter()
            .find(|compression| compression.word() == text)
            .ok_or_else(|| {
                format!("'{}' is not a compression; choose none, bz2, lz4 or zstd", crate::model::clean(text, 40))
            })
    }
}

/// Decompresses at most `limit` bytes from `source` into `out`; returns whether a checksum of the compression itself
/// covered all of them. Memory grows only with the actual output.
///
/// # Errors
/// If the data is damaged, its checksum does not match, or it is longer than `limit`; the output so far is in `out`.
pub(crate) fn unpack(
    compression: ChunkCompression,
    source: impl BufRead,
    limit: usize,
    out: &mut Vec<u8>,
) -> Result<bool, String> {
    match compression {
        ChunkCompression::None => drain(source, limit, out).map(|()| false),
        // Every block and the whole have a CRC.
        ChunkCompression::Bz2 => drain(bzip2::bufread::BzDecoder::new(source), limit, out).map(|()| true),
        ChunkCompression::Lz4 => unpack_lz4(source, limit, out),
        ChunkCompression::Zstd => unpack_zstd(source, limit, out),
    }
}

/// What a decoder's own words come to for whoever reads a notice.
pub(crate) const SPOILT: &str = "its compressed data is damaged";

/// Why a read failed: the disk's own words, but none of a decoder's.
pub(crate) fn why(error: &std::io::Error) -> String {
    if error.raw_os_error().is_some() { error.to_string() } else { SPOILT.to_owned() }
}

/// The frame's descriptor says which checksums it has; the decoder compares those.
fn unpack_lz4(mut source: impl BufRead, limit: usize, out: &mut Vec<u8>) -> Result<bool, String> {
    /// Magic number (4), then flags: bit 4 for checksums of blocks, bit 2 for one of the content.
    const CHECKSUMS: u8 = 0b0001_0100;
    let mut lead = Vec::with_capacity(5);
    source.by_ref().take(5).read_to_end(&mut lead).map_err(|error| why(&error))?;
    let covered = lead.get(4).is_some_and(|flags| flags & CHECKSUMS != 0);
    drain(lz4_flex::frame::FrameDecoder::new(lead.as_slice().chain(source)), limit, out).map(|()| covered)
}

/// The decoder computes the checksum of the content; comparing it is up to the caller.
fn unpack_zstd(source: impl BufRead, limit: usize, out: &mut Vec<u8>) -> Result<bool, String> {
    let window = u64::try_from(super::LARGEST_CHUNK).unwrap_or(u64::MAX);
    let decoder = ruzstd::decoding::StreamingDecoder::new_with_max_window_size(source, window);
    let mut decoder = decoder.map_err(|_| SPOILT)?;
    drain(&mut decoder, limit, out)?;
    let decoder = decoder.into_frame_decoder();
    match decoder.get_checksum_from_data() {
        Some(told) if decoder.get_calculated_checksum() == Some(told) => Ok(true),
        Some(_) => Err(String::from("the unpacked data does not match its zstd checksum")),
        None => Ok(false),
    }
}

/// What every zstd frame begins with; no message in CDR does.
pub(crate) const ZSTD: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];

/// The body of a message: rosbag2 with `compression_mode: MESSAGE` makes a zstd frame of each. What is sealed is the message.
///
/// # Errors
/// Why the frame cannot be unpacked.
pub(crate) fn unpacked_body(encoding: Encoding, body: Vec<u8>) -> Result<Vec<u8>, String> {
    if !matches!(encoding, Encoding::Cdr { .. }) || !body.starts_with(&ZSTD) {
        return Ok(body);
    }
    let mut unpacked = Vec::new();
    unpack(ChunkCompression::Zstd, body.as_slice(), LONGEST_MESSAGE, &mut unpacked)
        .map_err(|error| format!("it is compressed with zstd and cannot be unpacked: {error}"))?;
    Ok(unpacked)
}

fn drain(source: impl Read, limit: usize, out: &mut Vec<u8>) -> Result<(), String> {
    let most = u64::try_from(limit).unwrap_or(u64::MAX).saturating_add(1);
    source.take(most).read_to_end(out).map_err(|error| why(&error))?;
    if out.len() > limit {
        out.truncate(limit);
        return Err(format!("it holds more than the {limit} bytes it claims"));
    }
    Ok(())
}

/// Compresses the bytes of a chunk.
///
/// # Errors
/// The compressor's error text.
pub(crate) fn pack(compression: ChunkCompression, bytes: &[u8]) -> Result<Vec<u8>, String> {
    match compression {
        ChunkCompression::None => Ok(bytes.to_vec()),
        ChunkCompression::Bz2 => {
            let mut encoder = bzip2::write::BzEncoder::new(Vec::new(), bzip2::Compression::best());
            encoder.write_all(bytes).map_err(|error| error.to_string())?;
            encoder.finish().map_err(|error| error.to_string())
        }
        ChunkCompression::Lz4 => {
            // ROS's own reader supports only independent blocks, and requires the checksum of the whole.
            let frame = lz4_flex::frame::FrameInfo::new()
                .block_mode(lz4_flex::frame::BlockMode::Independent)
                .block_size(lz4_flex::frame::BlockSize::Max1MB)
                .content_checksum(true);
            let mut encoder = lz4_flex::frame::FrameEncoder::with_frame_info(frame, Vec::new());
            encoder.write_all(bytes).map_err(|error| error.to_string())?;
            encoder.finish().map_err(|error| error.to_string())
        }
        ChunkCompression::Zstd => {
            Ok(ruzstd::encoding::compress_to_vec(bytes, ruzstd::encoding::CompressionLevel::Fastest))
        }
    }
}
