//! Where the next chunk of a damaged bag begins: found by the bytes that every chunk header contains.

use std::io::{self, Read, Seek, SeekFrom};

use super::record::{Fields, Op, sized};
use crate::ros::recording::ChunkCompression;

/// Part of every chunk header: a field of four bytes, `op=` and the chunk's code.
const MARK: &[u8] = b"\x04\0\0\0op=\x05";

/// The greatest distance from the start of a chunk record to the mark, bytes.
const LONGEST_LEAD: u64 = 64;

/// The longest chunk header searched for, bytes.
const LONGEST: usize = 128;

const WINDOW: usize = 64 * 1024;

/// The compression of a chunk, from its header; `None` if it is unknown.
pub(super) fn chunk_compression(fields: &Fields<'_>) -> Option<ChunkCompression> {
    match fields.bytes("compression")? {
        b"none" => Some(ChunkCompression::None),
        b"bz2" => Some(ChunkCompression::Bz2),
        b"lz4" => Some(ChunkCompression::Lz4),
        _ => None,
    }
}

/// The first position at or after `from` where a chunk record begins.
///
/// # Errors
/// Errors of the file.
pub(super) fn next_chunk(file: &mut (impl Read + Seek), from: u64) -> io::Result<Option<u64>> {
    let mut at = from;
    let mut window = Vec::with_capacity(WINDOW);
    loop {
        window.clear();
        file.seek(SeekFrom::Start(at))?;
        file.by_ref().take(WINDOW as u64).read_to_end(&mut window)?;
        let marks = window.windows(MARK.len()).enumerate().filter(|(_, bytes)| *bytes == MARK);
        for mark in marks.map(|(index, _)| at + index as u64).collect::<Vec<_>>() {
            if let Some(start) = start_of_chunk(file, from, mark)? {
                return Ok(Some(start));
            }
        }
        if window.len() < WINDOW {
            return Ok(None);
        }
        at += (WINDOW - MARK.len() + 1) as u64;
    }
}

/// The start of the chunk record whose mark is at `mark`.
fn start_of_chunk(file: &mut (impl Read + Seek), from: u64, mark: u64) -> io::Result<Option<u64>> {
    let first = from.max(mark.saturating_sub(LONGEST_LEAD));
    let mut bytes = Vec::with_capacity(LONGEST * 2);
    file.seek(SeekFrom::Start(first))?;
    file.by_ref().take(LONGEST as u64 * 2).read_to_end(&mut bytes)?;
    let lead = usize::try_from(mark - first).unwrap_or(0);
    // The nearest start that gives a valid header is the right one.
    let starts = (0..=lead.saturating_sub(4)).rev().filter(|start| start + 4 <= lead);
    let is_chunk =
        |start: &usize| bytes.get(*start..).and_then(sized).is_some_and(|(header, _)| is_chunk_header(header));
    Ok(starts.into_iter().find(is_chunk).map(|start| first + start as u64))
}

fn is_chunk_header(header: &[u8]) -> bool {
    header.len() <= LONGEST
        && Fields::parse(header).is_some_and(|fields| {
            fields.op() == Some(Op::Chunk) && chunk_compression(&fields).is_some() && fields.u32("size").is_some()
        })
}
