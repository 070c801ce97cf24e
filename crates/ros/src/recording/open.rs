//! A recording by its file: its format, and one reader and one writer for both formats.

use std::fs::File;
use std::io::{BufReader, BufWriter, Read, Seek, SeekFrom};
use std::path::Path;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::{Channel, ChunkCompression, Encoding, Findings, RecordedMessage, Sent, ZSTD};
use crate::model::Timestamp;
use crate::ros::RosError;
use crate::ros::bag::{self, BagReader, BagWriter};
use crate::ros::mcap::{self, McapReader, McapWriter};
use crate::ros::rosbag2::{Db3Reader, FolderReader, SQLITE, unpacked};

/// Bytes read ahead.
const BUFFER: usize = 256 * 1024;

/// The formats.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RecordingFormat {
    /// rosbag 2.0.
    Bag,
    /// MCAP.
    Mcap,
    /// A folder of rosbag2 with one MCAP file.
    Rosbag2,
}

impl RecordingFormat {
    /// Its word.
    pub fn word(self) -> &'static str {
        match self {
            Self::Bag => "bag",
            Self::Mcap => "mcap",
            Self::Rosbag2 => "rosbag2",
        }
    }

    /// Whether chunks of this format may use this compression.
    pub fn takes(self, compression: ChunkCompression) -> bool {
        match self {
            Self::Bag => compression != ChunkCompression::Zstd,
            Self::Mcap | Self::Rosbag2 => compression != ChunkCompression::Bz2,
        }
    }

    /// Whether messages of this encoding can be written in this format.
    pub fn holds(self, encoding: Encoding) -> bool {
        match self {
            Self::Mcap => true,
            Self::Bag => encoding == Encoding::Ros1,
            Self::Rosbag2 => encoding != Encoding::Ros1,
        }
    }
}

/// What a file that begins like this is, if it is not a recording in either format.
fn other_than_a_recording(magic: &[u8]) -> String {
    let version = [&b"#ROSBAG V"[..], b"#ROSRECORD V"].iter().find_map(|lead| magic.strip_prefix(*lead));
    match version {
        Some(version) => {
            let version: Vec<u8> = version.iter().copied().take_while(|byte| !byte.is_ascii_whitespace()).collect();
            let version = crate::model::clean(&String::from_utf8_lossy(&version), 8);
            format!("a bag of version {version}; only 2.0 is supported, convert it with `rosbag fix` of ROS 1")
        }
        None if magic.is_empty() => "an empty file".to_owned(),
        None if magic.starts_with(&[0x1f, 0x8b]) => packed("gzip", "gunzip -k"),
        None if magic.starts_with(b"BZh") => packed("bzip2", "bunzip2 -k"),
        None if magic.starts_with(b"rosbag2_bagfile_") => {
            "the description of a folder of rosbag2; import the folder".to_owned()
        }
        None => "no recording: neither a bag, MCAP nor .db3".to_owned(),
    }
}

fn packed(format: &str, command: &str) -> String {
    format!("compressed with {format}; unpack it with `{command}` and import what comes out")
}

/// A file at its beginning, and what it begins with.
fn begin(path: &Path) -> Result<(BufReader<File>, Vec<u8>), RosError> {
    let unreadable = |error: std::io::Error| RosError::recording(&format!("{}: {error}", path.display()));
    let mut file = BufReader::with_capacity(BUFFER, File::open(path).map_err(unreadable)?);
    let mut magic = Vec::new();
    file.by_ref().take(16).read_to_end(&mut magic).map_err(unreadable)?;
    file.seek(SeekFrom::Start(0)).map_err(unreadable)?;
    Ok((file, magic))
}

/// The content of a file, by which it is known: of one that is compressed as a whole, what comes out of it, if it can be
/// unpacked. A recorder compresses what it has closed, which may have been sealed before.
///
/// # Errors
/// [`RosError::Recording`] if it cannot be read.
pub fn content_of(path: &Path) -> Result<File, RosError> {
    let (file, magic) = begin(path)?;
    let whole = if magic.starts_with(&ZSTD) { unpacked(path).ok() } else { None };
    // What cannot be unpacked is told when it is read as a recording.
    Ok(whole.and_then(|whole| whole.reopen().ok()).unwrap_or_else(|| file.into_inner()))
}

/// A recording being read, message by message in file order.
pub enum Recording {
    /// A bag.
    Bag(BagReader<BufReader<File>>),
    /// MCAP.
    Mcap(McapReader<BufReader<File>>),
    /// A closed `.db3` file of rosbag2.
    Db3(Box<Db3Reader>),
    /// A folder of rosbag2.
    Folder(Box<FolderReader>),
}

impl Recording {
    /// Opens a file of any format, or a folder of rosbag2.
    ///
    /// # Errors
    /// [`RosError::Recording`] if it cannot be read or is not a recording.
    pub fn open(path: &Path) -> Result<Self, RosError> {
        if path.is_dir() { FolderReader::open(path).map(Box::new).map(Self::Folder) } else { Self::open_file(path) }
    }

    /// Opens a single file. One that is compressed as a whole is unpacked into a temporary file, which is gone at the end.
    pub(crate) fn open_file(path: &Path) -> Result<Self, RosError> {
        let (file, magic) = begin(path)?;
        if !magic.starts_with(&ZSTD) {
            return Self::of(path, file, &magic);
        }
        drop(file);
        let whole = unpacked(path)?;
        let (file, magic) = begin(whole.path())?;
        // It is open by now, so its name is no longer needed.
        Self::of(whole.path(), file, &magic)
    }

    fn of(path: &Path, file: BufReader<File>, magic: &[u8]) -> Result<Self, RosError> {
        if magic.starts_with(mcap::MAGIC) {
            return McapReader::open(file).map(Self::Mcap);
        }
        if magic.starts_with(bag::MAGIC) {
            return BagReader::open(file).map(Self::Bag);
        }
        if magic.starts_with(SQLITE) {
            return Db3Reader::open(path).map(Box::new).map(Self::Db3);
        }
        Err(RosError::recording(&format!("{} is {}", path.display(), other_than_a_recording(magic))))
    }

    /// The next readable message; `None` at the end. Damage is not an error: see [`Self::findings`].
    ///
    /// # Errors
    /// [`RosError::Recording`] if the file itself cannot be read.
    pub fn next_message(&mut self) -> Result<Option<RecordedMessage>, RosError> {
        match self {
            Self::Bag(reader) => reader.next_message(),
            Self::Mcap(reader) => reader.next_message(),
            Self::Db3(reader) => reader.next_message(),
            Self::Folder(reader) => reader.next_message(),
        }
    }

    /// What has been skipped so far.
    pub fn findings(&self) -> &Findings {
        match self {
            Self::Bag(reader) => reader.findings(),
            Self::Mcap(reader) => reader.findings(),
            Self::Db3(reader) => reader.findings(),
            Self::Folder(reader) => reader.findings(),
        }
    }

    /// The file of a folder that the last message is from; `None` where the recording is one file.
    pub fn file(&self) -> Option<&Path> {
        match self {
            Self::Folder(reader) => Some(reader.file()),
            Self::Bag(_) | Self::Mcap(_) | Self::Db3(_) => None,
        }
    }

    /// Bytes of the file read so far, and its size.
    pub fn progress(&self) -> (u64, u64) {
        match self {
            Self::Bag(reader) => reader.progress(),
            Self::Mcap(reader) => reader.progress(),
            Self::Db3(reader) => reader.progress(),
            Self::Folder(reader) => reader.progress(),
        }
    }
}

/// A recording being written.
pub enum RecordingWriter {
    /// A bag.
    Bag(Box<BagWriter<BufWriter<File>>>),
    /// MCAP.
    Mcap(Box<McapWriter<BufWriter<File>>>),
}

impl RecordingWriter {
    /// Starts a recording in an empty file.
    ///
    /// # Errors
    /// [`RosError::Recording`] if it cannot be written.
    pub fn begin(format: RecordingFormat, compression: ChunkCompression, file: File) -> Result<Self, RosError> {
        let out = BufWriter::with_capacity(BUFFER, file);
        Ok(match format {
            RecordingFormat::Bag => Self::Bag(Box::new(BagWriter::begin(out, compression)?)),
            RecordingFormat::Mcap | RecordingFormat::Rosbag2 => {
                Self::Mcap(Box::new(McapWriter::begin(out, compression)?))
            }
        })
    }

    /// Writes one message. A bag has no room for data about its publishing.
    ///
    /// # Errors
    /// [`RosError::Recording`] if it cannot be written, or the format cannot hold it.
    pub fn write(
        &mut self,
        channel: &Arc<Channel>,
        time: Timestamp,
        sent: Option<Sent>,
        body: &[u8],
    ) -> Result<(), RosError> {
        match (self, sent) {
            (Self::Bag(writer), _) => writer.write(channel, time, body),
            (Self::Mcap(writer), Some(sent)) => writer.write_sent(channel, time, sent, body),
            (Self::Mcap(writer), None) => writer.write(channel, time, body),
        }
    }

    /// Writes the index; the file is then on disk.
    ///
    /// # Errors
    /// [`RosError::Recording`] if it cannot be written.
    pub fn finish(self) -> Result<(), RosError> {
        let out = match self {
            Self::Bag(writer) => writer.finish()?,
            Self::Mcap(writer) => writer.finish()?,
        };
        let file = out.into_inner().map_err(|error| RosError::unwritable(error.error()))?;
        file.sync_all().map_err(|error| RosError::unwritable(&error))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_files_are_named_as_what_they_are() {
        let said = other_than_a_recording(b"#ROSRECORD V1.2\n");
        assert!(said.contains("version 1.2") && said.contains("rosbag fix"), "{said}");
        assert!(other_than_a_recording(b"#ROSBAG V1.1\n").contains("version 1.1"));
        assert_eq!(other_than_a_recording(b""), "an empty file");
        assert_eq!(other_than_a_recording(b"PK\x03\x04"), "no recording: neither a bag, MCAP nor .db3");
        assert!(other_than_a_recording(&[0x1f, 0x8b, 8]).contains("gunzip"));
        assert!(other_than_a_recording(b"BZh91AY&SY").contains("bunzip2"));
        assert!(other_than_a_recording(b"rosbag2_bagfile_information:").contains("import the folder"));
    }

    #[test]
    fn a_file_compressed_as_a_whole_is_known_by_what_comes_out_of_it() {
        let directory = tempfile::tempdir().expect("temporary directory");
        let path = directory.path().join("run_0.mcap.zstd");
        let level = ruzstd::encoding::CompressionLevel::Fastest;
        let packed = ruzstd::encoding::compress_to_vec(&b"what was recorded"[..], level);
        let cut = packed.get(..packed.len() / 2).expect("its half").to_vec();
        for (bytes, known) in [(packed, b"what was recorded".to_vec()), (cut.clone(), cut)] {
            std::fs::write(&path, bytes).expect("written");
            let mut content = Vec::new();
            content_of(&path).expect("there").read_to_end(&mut content).expect("read");
            assert_eq!(content, known);
        }
    }

    #[test]
    fn a_folder_is_a_recording_only_with_its_description_and_what_it_lacks_is_said() {
        let directory = tempfile::tempdir().expect("temporary directory");
        let said = || Recording::open(directory.path()).err().map(|error| error.to_string()).unwrap_or_default();
        assert!(said().contains("without metadata.yaml") && said().contains("reindex"), "{}", said());
        std::fs::write(directory.path().join("metadata.yaml"), "a: 1").expect("written");
        assert!(said().contains("does not describe a recording"), "{}", said());
        let text = "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n  relative_file_paths:\n  - a.mcap\n  \
                    message_count: 7\n  files:\n  - path: a.mcap\n    message_count: 7\n";
        std::fs::write(directory.path().join("metadata.yaml"), text).expect("written");
        std::fs::write(directory.path().join("b.db3"), "").expect("written");
        let mut recording = Recording::open(directory.path()).expect("opened");
        while recording.next_message().expect("read").is_some() {}
        let told: Vec<_> = recording.findings().damages.iter().map(|damage| damage.text.clone()).collect();
        assert!(told.iter().any(|text| text.contains("b.db3 is in the folder")), "{told:?}");
        assert!(told.iter().any(|text| text.contains("a.mcap was left out (7 messages)")), "{told:?}");
    }
}
