//! Reader of a followed file: MCAP while it grows, a database of rosbag2 once it is closed.

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
use crate::service::reply::Result;

const BUFFER: usize = 256 * 1024;

/// Shortest piece of a database with a digest of its own, bytes, and the most pieces.
const PIECE: u64 = 1 << 20;
const MOST_PIECES: u64 = 1 << 16;

pub(super) enum Source {
    Growing(Box<McapReader<BufReader<File>>>),
    /// A `.db3` that nobody writes.
    Closed {
        reader: Box<Db3Reader>,
        is_finished: bool,
        /// Until they are taken.
        pieces: Vec<Range<u64>>,
        /// Its recorder closed it.
        is_complete: bool,
    },
}

impl Source {
    /// `is_followed`: a later file exists, or the recording was closed.
    pub fn open(path: &Path, length: u64, is_followed: bool) -> Result<Self> {
        if is_database(path) {
            let reader = Box::new(Db3Reader::open(path)?);
            return Ok(Self::Closed { reader, is_finished: false, pieces: pieces(length), is_complete: is_followed });
        }
        let file = File::open(path).map_err(|error| input(format!("it cannot be read: {error}")))?;
        Ok(Self::Growing(Box::new(McapReader::follow(BufReader::with_capacity(BUFFER, file))?)))
    }

    /// `None` at the end, or where the next message is incomplete.
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

    /// The new length, bytes.
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

    /// Everything was read, and nothing more is expected.
    pub fn is_finished(&self) -> bool {
        match self {
            Self::Growing(reader) => reader.is_finished(),
            Self::Closed { is_finished, .. } => *is_finished,
        }
    }

    /// Its recorder closed it.
    pub fn is_complete(&self) -> bool {
        match self {
            Self::Growing(reader) => reader.has_footer(),
            Self::Closed { is_complete, .. } => *is_complete,
        }
    }

    pub fn at(&self) -> u64 {
        match self {
            Self::Growing(reader) => reader.progress().0,
            Self::Closed { reader, .. } => reader.progress().0,
        }
    }

    /// New chunks since the last call; for a database all its pieces at once.
    pub fn take_chunks(&mut self) -> Vec<Range<u64>> {
        match self {
            Self::Growing(reader) => reader.take_chunks(),
            Self::Closed { pieces, .. } => std::mem::take(pieces),
        }
    }

    pub fn findings(&self) -> &Findings {
        match self {
            Self::Growing(reader) => reader.findings(),
            Self::Closed { reader, .. } => reader.findings(),
        }
    }
}

/// Pieces of a file without chunks, so that the place of a difference can be named.
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
