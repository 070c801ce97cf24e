//! What reads a followed file: MCAP while it grows, a database of rosbag2 once it is closed.

use std::fs::File;
use std::io::BufReader;
use std::ops::Range;
use std::path::Path;

use super::folder::is_database;
use crate::ros::RosError;
use crate::ros::mcap::McapReader;
use crate::ros::recording::{Findings, RecordedMessage, RecordingReader as _};
use crate::ros::rosbag2::Db3Reader;
use crate::service::failure::input;
use crate::service::reply::Failure;

const BUFFER: usize = 256 * 1024;

/// The pieces of a database that have a digest of their own: the least length, bytes, and the most of them.
const PIECE: u64 = 1 << 20;
const MOST_PIECES: u64 = 1 << 16;

pub(super) enum Source {
    Growing(Box<McapReader<BufReader<File>>>),
    /// A `.db3` that nobody writes.
    Closed {
        reader: Box<Db3Reader>,
        /// Whether the last message was read.
        is_finished: bool,
        /// Its pieces, until they are taken.
        pieces: Vec<Range<u64>>,
        /// Whether its recorder closed it.
        is_complete: bool,
    },
}

impl Source {
    /// Opens a file of this length; `is_followed` says whether a later one is there, or the recording was closed.
    pub fn open(path: &Path, length: u64, is_followed: bool) -> Result<Self, Failure> {
        if is_database(path) {
            let reader = Box::new(Db3Reader::open(path)?);
            return Ok(Self::Closed { reader, is_finished: false, pieces: pieces(length), is_complete: is_followed });
        }
        let file = File::open(path).map_err(|error| input(format!("it cannot be read: {error}")))?;
        Ok(Self::Growing(Box::new(McapReader::follow(BufReader::with_capacity(BUFFER, file))?)))
    }

    /// The next message; `None` at the end, or where the next is not whole yet.
    pub fn next_message(&mut self) -> Result<Option<RecordedMessage>, RosError> {
        match self {
            Self::Growing(reader) => reader.next_message(),
            Self::Closed { reader, is_finished, .. } => {
                let message = reader.next_message()?;
                *is_finished = message.is_none();
                Ok(message)
            }
        }
    }

    /// The file is now so long, bytes.
    pub fn grown(&mut self, length: u64) {
        if let Self::Growing(reader) = self {
            reader.grown(length);
        }
    }

    /// Nobody writes it any more.
    pub fn close(&mut self) -> Result<(), RosError> {
        match self {
            Self::Growing(reader) => reader.close(),
            Self::Closed { .. } => Ok(()),
        }
    }

    /// Whether all of it was read, and nothing more is expected.
    pub fn is_finished(&self) -> bool {
        match self {
            Self::Growing(reader) => reader.is_finished(),
            Self::Closed { is_finished, .. } => *is_finished,
        }
    }

    /// Whether its recorder closed it.
    pub fn is_complete(&self) -> bool {
        match self {
            Self::Growing(reader) => reader.has_footer(),
            Self::Closed { is_complete, .. } => *is_complete,
        }
    }

    /// Bytes read so far.
    pub fn at(&self) -> u64 {
        match self {
            Self::Growing(reader) => reader.progress().0,
            Self::Closed { reader, .. } => reader.progress().0,
        }
    }

    /// Its chunks that were read since this was last asked; of a database its pieces, all at once.
    pub fn take_chunks(&mut self) -> Vec<Range<u64>> {
        match self {
            Self::Growing(reader) => reader.take_chunks(),
            Self::Closed { pieces, .. } => std::mem::take(pieces),
        }
    }

    /// What has been skipped so far.
    pub fn findings(&self) -> &Findings {
        match self {
            Self::Growing(reader) => reader.findings(),
            Self::Closed { reader, .. } => reader.findings(),
        }
    }
}

/// Pieces of a file that has no chunks, so that a place in it can be named where it differs.
fn pieces(length: u64) -> Vec<Range<u64>> {
    let size = length.div_ceil(MOST_PIECES).next_multiple_of(PIECE).max(PIECE);
    (0..length.div_ceil(size)).map(|number| number * size..((number + 1) * size).min(length)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pieces_of_a_database_cover_it_and_are_not_too_many() {
        for length in [0, 1, PIECE, PIECE + 1, 300 << 30] {
            let pieces = pieces(length);
            assert!(pieces.len() as u64 <= MOST_PIECES, "{length}");
            assert_eq!(pieces.iter().map(|piece| piece.end - piece.start).sum::<u64>(), length);
            assert!(pieces.windows(2).all(|pair| pair[0].end == pair[1].start), "{length}");
        }
    }
}
