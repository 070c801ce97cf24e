//! The digests of a file so far: of all that was read, and of each of its chunks.

use std::collections::VecDeque;
use std::fs::File;
use std::io::ErrorKind;
use std::ops::Range;
use std::os::unix::fs::FileExt;

use authros_evidence::recorded::RecordedChunk;

use crate::crypto::Sm3Hasher;
use crate::model::Digest;

/// Bytes read at a time.
const BLOCK: usize = 256 * 1024;

/// A file hashed up to a place. Where a read fails it goes on from there.
#[derive(Default)]
pub(super) struct Hashed {
    whole: Sm3Hasher,
    at: u64,
    spans: VecDeque<Range<u64>>,
    chunk: Sm3Hasher,
    chunks: Vec<RecordedChunk>,
    buffer: Vec<u8>,
}

impl Hashed {
    /// Bytes hashed so far.
    pub fn at(&self) -> u64 {
        self.at
    }

    /// Their SM3.
    pub fn digest(&self) -> Digest {
        Digest(self.whole.clone().finish())
    }

    /// The chunks among them.
    pub fn chunks(&self) -> &[RecordedChunk] {
        &self.chunks
    }

    /// Hashes on to a place; `spans` are the chunks that end before it and were not told before, in file order.
    pub fn advance(&mut self, file: &File, to: u64, spans: Vec<Range<u64>>) -> std::io::Result<()> {
        self.spans.extend(spans);
        while let Some(span) = self.spans.front().cloned() {
            self.feed(file, span.start.min(to), false)?;
            self.feed(file, span.end.min(to), true)?;
            if self.at < span.end {
                return Ok(());
            }
            self.spans.pop_front();
            let digest = Digest(std::mem::take(&mut self.chunk).finish());
            self.chunks.push(RecordedChunk { at: span.start, length: span.end - span.start, digest });
        }
        self.feed(file, to, false)
    }

    fn feed(&mut self, file: &File, to: u64, is_chunk: bool) -> std::io::Result<()> {
        self.buffer.resize(BLOCK, 0);
        while self.at < to {
            let wanted = usize::try_from(to - self.at).unwrap_or(BLOCK).min(BLOCK);
            let read = match file.read_at(self.buffer.get_mut(..wanted).unwrap_or_default(), self.at) {
                Ok(0) => return Err(std::io::Error::new(ErrorKind::UnexpectedEof, "it became shorter")),
                Ok(read) => read,
                Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                Err(error) => return Err(error),
            };
            let bytes = self.buffer.get(..read).unwrap_or_default();
            self.whole.update(bytes);
            if is_chunk {
                self.chunk.update(bytes);
            }
            self.at += read as u64;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::crypto::sm3::sm3;

    #[test]
    fn chunks_and_the_whole_are_hashed_in_one_pass_wherever_it_stops() {
        let bytes: Vec<u8> = (0..1_000_000_u32).map(|number| number.to_le_bytes()[0]).collect();
        let home = tempfile::tempdir().expect("a folder");
        let path = home.path().join("run.mcap");
        std::fs::write(&path, &bytes).expect("written");
        let file = File::open(&path).expect("open");
        let mut hashed = Hashed::default();
        hashed.advance(&file, 100, Vec::new()).expect("read");
        hashed.advance(&file, 700_000, vec![200..600_000, 600_000..700_000]).expect("read");
        assert_eq!(hashed.digest(), Digest(sm3(&[&bytes[..700_000]])));
        hashed.advance(&file, 1_000_000, std::iter::once(800_000..900_000).collect()).expect("read");
        assert_eq!(hashed.digest(), Digest(sm3(&[&bytes])));
        let found: Vec<_> = hashed.chunks().iter().map(|chunk| (chunk.at, chunk.digest)).collect();
        let expected = [(200, 600_000), (600_000, 700_000), (800_000, 900_000)];
        let expected = expected.map(|(from, to)| (from as u64, Digest(sm3(&[&bytes[from..to]]))));
        assert_eq!(found, expected);
        assert!(hashed.advance(&file, 1_000_001, Vec::new()).is_err(), "a file that is shorter");
    }
}
