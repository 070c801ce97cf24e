//! Lossless compression of each message before it is sealed, and bounded decompression. `pipeline` decides which
//! messages are worth compressing; `ros` says where the matrix of a message lies.

mod filter;
mod matrix;

pub use matrix::{MOST_CHANNELS, Matrix};

use crate::model::head::Compression;
use crate::model::wire::WireError;

/// Messages shorter than this are not compressed, bytes.
pub const SHORTEST: usize = 128;

/// The most bytes that LZ4 expands one byte to.
const MOST_PER_BYTE: usize = 255;

/// Bytes sampled to see whether a long message is worth compressing.
const PROBE: usize = 16 * 1024;

/// A compressed message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Packed {
    /// The method.
    pub compression: Compression,
    /// The bytes to seal.
    pub bytes: Vec<u8>,
}

/// Compresses `body` if that saves at least an eighth of it.
pub fn pack(body: &[u8], matrix: Option<&Matrix>) -> Option<Packed> {
    if body.len() < SHORTEST {
        return None;
    }
    if let Some(bytes) = matrix.and_then(|matrix| matrix::pack(body, matrix)).filter(|bytes| pays(bytes, body)) {
        return Some(Packed { compression: Compression::Matrix, bytes });
    }
    if body.len() > 4 * PROBE && !pays(&lz4_flex::block::compress(middle(body)), middle(body)) {
        return None;
    }
    let bytes = lz4_flex::block::compress(body);
    pays(&bytes, body).then_some(Packed { compression: Compression::Lz4, bytes })
}

fn middle(body: &[u8]) -> &[u8] {
    let start = (body.len() - PROBE) / 2;
    &body[start..start + PROBE]
}

fn pays(packed: &[u8], body: &[u8]) -> bool {
    packed.len() <= body.len() - body.len() / 8
}

/// Restores a message of `length` bytes; the caller has bounded `length`. Allocates no more than that.
///
/// # Errors
/// [`WireError`] if `packed` is not what [`pack`] produces for a message of that length.
pub fn unpack(compression: Compression, packed: &[u8], length: usize) -> Result<Vec<u8>, WireError> {
    let damaged = WireError::Value("compressed body");
    match compression {
        Compression::None if packed.len() == length => Ok(packed.to_vec()),
        Compression::None => Err(damaged),
        Compression::Matrix => matrix::unpack(packed, length),
        Compression::Lz4 if length / MOST_PER_BYTE > packed.len() => Err(damaged),
        Compression::Lz4 => {
            let plain = lz4_flex::block::decompress(packed, length).map_err(|_| damaged)?;
            if plain.len() == length { Ok(plain) } else { Err(damaged) }
        }
    }
}

#[cfg(test)]
mod tests;
