//! A recording by its file: its format, and one reader and one writer for both formats.

use std::fs::File;
use std::io::{BufReader, BufWriter, Read, Seek, SeekFrom};
use std::path::Path;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::{Channel, ChunkCompression, Encoding, Findings, RecordedMessage, Sent};
use crate::model::Timestamp;
use crate::ros::RosError;
use crate::ros::bag::{self, BagReader, BagWriter};
use crate::ros::mcap::{self, McapReader, McapWriter};

/// The most entries of a folder that are looked at.
const MOST_ENTRIES: usize = 4096;

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
}

impl RecordingFormat {
    /// Its word.
    pub fn word(self) -> &'static str {
        match self {
            Self::Bag => "bag",
            Self::Mcap => "mcap",
        }
    }

    /// Whether chunks of this format may use this compression.
    pub fn takes(self, compression: ChunkCompression) -> bool {
        match self {
            Self::Bag => compression != ChunkCompression::Zstd,
            Self::Mcap => compression != ChunkCompression::Bz2,
        }
    }

    /// Whether messages of this encoding can be written in this format.
    pub fn holds(self, encoding: Encoding) -> bool {
        self == Self::Mcap || encoding == Encoding::Ros1
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
        None if magic.starts_with(b"SQLite format 3\0") => format!("an SQLite file: {CONVERT}"),
        None if magic.starts_with(&[0x28, 0xb5, 0x2f, 0xfd]) => unpacked("zstd", "zstd -d"),
        None if magic.starts_with(&[0x1f, 0x8b]) => unpacked("gzip", "gunzip -k"),
        None if magic.starts_with(b"BZh") => unpacked("bzip2", "bunzip2 -k"),
        None if magic.starts_with(b"rosbag2_bagfile_") => {
            "the description of a folder of rosbag2; import the .mcap files beside it one by one, in the order of their \
             numbers"
                .to_owned()
        }
        None => "neither a bag nor MCAP".to_owned(),
    }
}

/// What helps with rosbag2's own files.
const CONVERT: &str = "if rosbag2 wrote it, make an MCAP of its folder (`ros2 bag convert -i FOLDER -o OPTIONS.yaml` with \
                       `storage_id: mcap`) and import that";

fn unpacked(format: &str, command: &str) -> String {
    format!("compressed with {format}; unpack it with `{command}` and import what comes out")
}

/// What a folder is, if a person gave one for a recording.
fn folder(path: &Path) -> String {
    let Ok(entries) = std::fs::read_dir(path) else { return "a folder that cannot be read".to_owned() };
    let names: Vec<_> = entries.flatten().take(MOST_ENTRIES).map(|entry| entry.file_name()).collect();
    let ends = |end: &str| names.iter().any(|name| name.to_string_lossy().ends_with(end));
    if !ends("metadata.yaml") {
        return "a folder; give the recording itself".to_owned();
    }
    if ends(".mcap") {
        return "a folder of rosbag2; import its .mcap files one by one, in the order of their numbers".to_owned();
    }
    format!("a folder of rosbag2 without an MCAP file: {CONVERT}")
}

/// A recording being read, message by message in file order.
pub enum Recording {
    /// A bag.
    Bag(BagReader<BufReader<File>>),
    /// MCAP.
    Mcap(McapReader<BufReader<File>>),
}

impl Recording {
    /// Opens a file of either format.
    ///
    /// # Errors
    /// [`RosError::Recording`] if it cannot be read or is not a recording.
    pub fn open(path: &Path) -> Result<Self, RosError> {
        let unreadable = |error: std::io::Error| RosError::recording(&format!("{}: {error}", path.display()));
        if path.is_dir() {
            return Err(RosError::recording(&format!("{} is {}", path.display(), folder(path))));
        }
        let mut file = BufReader::with_capacity(BUFFER, File::open(path).map_err(unreadable)?);
        let mut magic = Vec::new();
        file.by_ref().take(16).read_to_end(&mut magic).map_err(unreadable)?;
        file.seek(SeekFrom::Start(0)).map_err(unreadable)?;
        if magic.starts_with(mcap::MAGIC) {
            return McapReader::open(file).map(Self::Mcap);
        }
        if magic.starts_with(bag::MAGIC) {
            return BagReader::open(file).map(Self::Bag);
        }
        Err(RosError::recording(&format!("{} is {}", path.display(), other_than_a_recording(&magic))))
    }

    /// Its format.
    pub fn format(&self) -> RecordingFormat {
        match self {
            Self::Bag(_) => RecordingFormat::Bag,
            Self::Mcap(_) => RecordingFormat::Mcap,
        }
    }

    /// The next readable message; `None` at the end. Damage is not an error: see [`Self::findings`].
    ///
    /// # Errors
    /// [`RosError::Recording`] if the file itself cannot be read.
    pub fn next_message(&mut self) -> Result<Option<RecordedMessage>, RosError> {
        match self {
            Self::Bag(reader) => reader.next_message(),
            Self::Mcap(reader) => reader.next_message(),
        }
    }

    /// What has been skipped so far.
    pub fn findings(&self) -> &Findings {
        match self {
            Self::Bag(reader) => reader.findings(),
            Self::Mcap(reader) => reader.findings(),
        }
    }

    /// Bytes of the file read so far, and its size.
    pub fn progress(&self) -> (u64, u64) {
        match self {
            Self::Bag(reader) => reader.progress(),
            Self::Mcap(reader) => reader.progress(),
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
            RecordingFormat::Mcap => Self::Mcap(Box::new(McapWriter::begin(out, compression)?)),
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
        assert_eq!(other_than_a_recording(b"PK\x03\x04"), "neither a bag nor MCAP");
        assert!(other_than_a_recording(b"SQLite format 3\0").contains("ros2 bag convert"));
        assert!(other_than_a_recording(&[0x28, 0xb5, 0x2f, 0xfd, 0]).contains("zstd -d"));
        assert!(other_than_a_recording(&[0x1f, 0x8b, 8]).contains("gunzip"));
        assert!(other_than_a_recording(b"BZh91AY&SY").contains("bunzip2"));
        assert!(other_than_a_recording(b"rosbag2_bagfile_information:").contains("one by one"));
    }

    #[test]
    fn a_folder_is_named_as_what_it_is() {
        let directory = tempfile::tempdir().expect("temporary directory");
        let said = || Recording::open(directory.path()).err().map(|error| error.to_string()).unwrap_or_default();
        assert!(said().contains("give the recording itself"), "{}", said());
        std::fs::write(directory.path().join("metadata.yaml"), "").expect("written");
        std::fs::write(directory.path().join("run_0.db3"), "").expect("written");
        assert!(said().contains("ros2 bag convert"), "{}", said());
        std::fs::write(directory.path().join("run_0.mcap"), "").expect("written");
        assert!(said().contains("one by one"), "{}", said());
    }
}
