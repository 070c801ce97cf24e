//! How chunks are compressed: nothing, bzip2, LZ4 frames, Zstandard. All in Rust; every output has a bound.

use std::fmt;
use std::io::{BufRead, Read, Write};
use std::str::FromStr;

/// How the chunks of a recording are compressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ChunkCompression {
    /// Not at all.
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
    /// Its word on the command line and in a bag.
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
                format!("'{}' is no compression; write none, bz2, lz4 or zstd", crate::model::clean(text, 40))
            })
    }
}

/// Unpacks at most `limit` bytes from `source` into `out`. Memory grows with what really comes out.
///
/// # Errors
/// Where the data is damaged or longer than `limit`; what came out before lies in `out`.
pub(in crate::ros) fn unpack(
    compression: ChunkCompression,
    source: impl BufRead,
    limit: usize,
    out: &mut Vec<u8>,
) -> Result<(), String> {
    match compression {
        ChunkCompression::None => drain(source, limit, out),
        ChunkCompression::Bz2 => drain(bzip2::bufread::BzDecoder::new(source), limit, out),
        ChunkCompression::Lz4 => drain(lz4_flex::frame::FrameDecoder::new(source), limit, out),
        ChunkCompression::Zstd => {
            let window = u64::try_from(super::LARGEST_CHUNK).unwrap_or(u64::MAX);
            let decoder = ruzstd::decoding::StreamingDecoder::new_with_max_window_size(source, window);
            drain(decoder.map_err(|error| error.to_string())?, limit, out)
        }
    }
}

fn drain(source: impl Read, limit: usize, out: &mut Vec<u8>) -> Result<(), String> {
    let most = u64::try_from(limit).unwrap_or(u64::MAX).saturating_add(1);
    source.take(most).read_to_end(out).map_err(|error| error.to_string())?;
    if out.len() > limit {
        out.truncate(limit);
        return Err(format!("it holds more than the {limit} bytes that it claims"));
    }
    Ok(())
}

/// Packs the bytes of a chunk.
///
/// # Errors
/// The compressor's words.
pub(in crate::ros) fn pack(compression: ChunkCompression, bytes: &[u8]) -> Result<Vec<u8>, String> {
    match compression {
        ChunkCompression::None => Ok(bytes.to_vec()),
        ChunkCompression::Bz2 => {
            let mut encoder = bzip2::write::BzEncoder::new(Vec::new(), bzip2::Compression::best());
            encoder.write_all(bytes).map_err(|error| error.to_string())?;
            encoder.finish().map_err(|error| error.to_string())
        }
        ChunkCompression::Lz4 => {
            // ROS's own reader knows independent blocks only, and wants the checksum of the whole.
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
