//! Reading an MCAP file while it is written: only whole records are read, until the file has its footer, or the caller
//! closes it.

use std::io::{BufRead, Seek};
use std::ops::Range;

use super::{Code, Fields, LEAD, McapReader};
use crate::{Result, RosError, model::Timestamp};

#[derive(Debug, Default)]
pub(super) struct Growing {
    open: bool,
    /// Whether the caller wants the positions of chunks.
    pub told: bool,
    pub chunks: Vec<Range<u64>>,
}

impl<R: BufRead + Seek> McapReader<R> {
    /// [`McapReader::next_message`] then also returns `None` where the next record is not whole yet.
    pub fn follow(file: R) -> Result<Self> {
        let mut reader = Self::begin(file)?;
        reader.growing = Growing { open: true, told: true, chunks: Vec::new() };
        Ok(reader)
    }

    /// The file's length now, bytes.
    pub fn grown(&mut self, length: u64) {
        self.length = self.length.max(length);
    }

    /// No recorder writes the file any more: a missing end is damage.
    pub fn close(&mut self) -> Result<()> {
        self.growing.open = false;
        self.read_summary().map_err(RosError::unreadable)
    }

    pub fn is_finished(&self) -> bool {
        self.ended && self.chunk.at >= self.chunk.bytes.len()
    }

    pub fn has_footer(&self) -> bool {
        self.has_footer
    }

    /// Chunks read since the last call, in file order.
    pub fn take_chunks(&mut self) -> Vec<Range<u64>> {
        std::mem::take(&mut self.growing.chunks)
    }

    /// Whether the next record is whole, or no more will come.
    pub(super) fn may_go_on(&mut self) -> std::io::Result<bool> {
        if !self.growing.open || self.is_next_whole()? {
            return Ok(true);
        }
        // The summary is read where there is one; without a footer the file still grows.
        self.has_footer = self.ends_with_footer()?;
        if self.has_footer {
            self.growing.open = false;
            self.read_summary()?;
        }
        Ok(self.has_footer)
    }

    fn is_next_whole(&mut self) -> std::io::Result<bool> {
        let Some((code, length)) = self.look(self.position)? else { return Ok(false) };
        let end = self.position.saturating_add(LEAD).saturating_add(length);
        match Code::from_repr(code) {
            // No record has this code: bytes not written yet.
            None if code == 0 => Ok(false),
            // What follows is read immediately.
            Some(Code::DataEnd | Code::Footer) => Ok(false),
            // Metadata has no time of its own. Before the first message it gets that one's.
            Some(Code::Metadata) if self.latest == Timestamp(0) && end <= self.length => {
                let time = self.first_time()?;
                self.latest = time.unwrap_or_default();
                Ok(time.is_some())
            }
            _ => Ok(end <= self.length),
        }
    }

    /// Time of the first message from here on, if it is there already.
    fn first_time(&mut self) -> std::io::Result<Option<Timestamp>> {
        let mut at = self.position;
        while let Some((code, length)) = self.look(at)? {
            let before_time = match Code::from_repr(code) {
                Some(Code::Chunk) => 0,
                // Its channel and its number.
                Some(Code::Message) => 6,
                Some(Code::DataEnd | Code::Footer) => return Ok(None),
                None if code == 0 => return Ok(None),
                _ => {
                    at = at.saturating_add(LEAD).saturating_add(length);
                    continue;
                }
            };
            let time = super::read_at(&mut self.file, at.saturating_add(LEAD + before_time), 8)?;
            return Ok(Fields(&time).u64().filter(|time| *time <= super::LATEST).map(Timestamp));
        }
        Ok(None)
    }

    fn ends_with_footer(&mut self) -> std::io::Result<bool> {
        let Some(footer) = self.length.checked_sub(super::TAIL).filter(|footer| *footer >= self.position) else {
            return Ok(false);
        };
        let tail = super::read_at(&mut self.file, footer, super::TAIL)?;
        Ok(crate::ros::mcap::footer(&tail).is_some())
    }
}

#[cfg(test)]
mod tests {
    use std::fs::File;
    use std::io::{BufReader, Cursor, Write};
    use std::sync::Arc;

    use super::*;
    use std::collections::BTreeMap;

    use crate::ros::mcap::{Beside, McapWriter};
    use crate::ros::recording::{Channel, ChunkCompression, Encoding, RecordingReader as _, Sent};

    fn recorded(compression: ChunkCompression) -> Vec<u8> {
        let text = ("/words", "std_msgs/msg/String", "string data");
        let channel = Arc::new(Channel::plain(text, Encoding::Cdr { idl: false }, BTreeMap::new()));
        let mut writer = McapWriter::begin(Cursor::new(Vec::new()), compression).expect("begun");
        let mut facts = 3_u32.to_le_bytes().to_vec();
        facts.extend(b"rig\0\0\0\0");
        let sent = Sent { time: Timestamp(1), sequence: 1 };
        let beside = Arc::new(Beside::Metadata.channel());
        writer.write_sent(&beside, Timestamp(0), sent, &facts).expect("written");
        for number in 0..40_u64 {
            let time = Timestamp(1_000 + number);
            writer.write(&channel, time, &vec![u8::try_from(number).expect("small"); 100_000]).expect("written");
        }
        writer.finish().expect("finished").into_inner()
    }

    type Followed = Vec<(Timestamp, Vec<u8>)>;

    fn all(reader: &mut McapReader<BufReader<File>>, found: &mut Followed) {
        while let Some(message) = reader.next_message().expect("readable") {
            found.push((message.time, message.body));
        }
    }

    #[test]
    fn a_growing_file_is_read_record_by_record_as_the_whole_one_would_be() {
        for compression in [ChunkCompression::None, ChunkCompression::Zstd] {
            let bytes = recorded(compression);
            let directory = tempfile::tempdir().expect("a folder");
            let path = directory.path().join("run.mcap");
            let mut file = File::create(&path).expect("created");
            file.write_all(&bytes[..20]).expect("written");
            let mut reader = McapReader::follow(BufReader::new(File::open(&path).expect("open"))).expect("MCAP");
            let (mut found, mut at, mut chunks) = (Vec::new(), 20, Vec::new());
            // Pieces that end anywhere.
            for step in (1..=997).cycle().step_by(91) {
                all(&mut reader, &mut found);
                chunks.extend(reader.take_chunks());
                if at == bytes.len() {
                    break;
                }
                assert!(!reader.is_finished() && reader.findings().is_whole(), "{:?}", reader.findings());
                let next =
                    (at + step * if at + 300 > bytes.len() { 1 } else { bytes.len() / 9_000 + 1 }).min(bytes.len());
                file.write_all(&bytes[at..next]).expect("written");
                at = next;
                reader.grown(at as u64);
            }
            assert!(reader.is_finished() && reader.has_footer() && reader.findings().is_whole());
            let mut whole = McapReader::open(BufReader::new(File::open(&path).expect("open"))).expect("MCAP");
            let mut expected = Vec::new();
            all(&mut whole, &mut expected);
            assert_eq!((found.len(), found == expected), (41, true), "the metadata has the first message's time");
            assert!(chunks.len() > 1 && chunks.windows(2).all(|pair| pair[0].end <= pair[1].start), "{chunks:?}");
        }
    }

    #[test]
    fn a_file_that_nobody_closes_is_read_as_far_as_it_goes() {
        let bytes = recorded(ChunkCompression::None);
        let directory = tempfile::tempdir().expect("a folder");
        let path = directory.path().join("run.mcap");
        std::fs::write(&path, &bytes[..bytes.len() / 2]).expect("written");
        let mut reader = McapReader::follow(BufReader::new(File::open(&path).expect("open"))).expect("MCAP");
        let mut found = Vec::new();
        all(&mut reader, &mut found);
        let before = found.len();
        assert!(before > 5 && !reader.is_finished(), "{before}");
        reader.close().expect("closed");
        all(&mut reader, &mut found);
        assert!(reader.is_finished() && !reader.has_footer() && found.len() > before, "{}", found.len());
        assert!(!reader.findings().is_whole());
    }

    #[test]
    fn bytes_that_are_not_written_yet_are_waited_for() {
        let mut bytes = super::super::MAGIC.to_vec();
        let whole = bytes.len();
        bytes.extend([0; 4096]);
        let mut reader = McapReader::follow(Cursor::new(bytes)).expect("MCAP");
        assert_eq!(reader.next_message().expect("readable"), None);
        assert_eq!((reader.is_finished(), reader.progress().0), (false, whole as u64));
        assert!(reader.findings().is_whole(), "{:?}", reader.findings());
    }
}
