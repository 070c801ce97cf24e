//! Recordings of rosbag2: a folder with `metadata.yaml` and `.mcap` or `.db3` files, all untrusted.

mod db3;
mod metadata;

use std::collections::{BTreeMap, VecDeque};
use std::io::{BufRead as _, BufReader, BufWriter, Read, Write as _};
use std::path::{Path, PathBuf};
use std::{fs::File, sync::Arc};

use metadata::Metadata;
use tempfile::NamedTempFile;

use crate::mcap::{AttachedFile, Beside};
use crate::model::{clean, counted, grouped};
use crate::recording::{Encoding, Findings, LARGEST_CHUNK, RecordedMessage, Recording, RecordingReader, SPOILT, why};
use crate::{Result, RosError};

pub use db3::{Db3Reader, has_journal};
pub use metadata::{METADATA, Tally};

pub(super) const SQLITE: &[u8] = b"SQLite format 3\0";

/// Files read at a time: their ends may overlap.
const AT_ONCE: usize = 2;

const LONGEST: u64 = 4 << 20;

const MOST_ENTRIES: usize = 65_536;

struct Part {
    name: String,
    path: Arc<Path>,
    recording: Box<Recording>,
    next: RecordedMessage,
}

pub struct FolderReader {
    folder: PathBuf,
    metadata: Metadata,
    left: VecDeque<String>,
    parts: Vec<Part>,
    described: Option<RecordedMessage>,
    file: Arc<Path>,
    findings: Findings,
    met: BTreeMap<Arc<str>, u64>,
    done: u64,
    size: u64,
    ended: bool,
}

fn described(folder: &Path) -> Result<(String, Metadata)> {
    let path = folder.join(METADATA);
    let wrong = |why: &str| RosError::recording(&format!("{} cannot be read: {why}", path.display()));
    let size = match std::fs::metadata(&path) {
        Ok(found) if found.is_file() => found.len(),
        Ok(_) => return Err(wrong("it is not a file")),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            return Err(RosError::recording(&format!(
                "{} is a folder without {METADATA}: rosbag2 writes that when it ends; wait for it, run `ros2 bag reindex` if it was \
                 killed, or give a single file",
                folder.display()
            )));
        }
        Err(error) => return Err(wrong(&error.to_string())),
    };
    if size > LONGEST {
        return Err(wrong(&format!("it is longer than {LONGEST} bytes")));
    }
    let text = std::fs::read_to_string(&path).map_err(|error| wrong(&error.to_string()))?;
    let metadata = Metadata::parse(&text).map_err(|why| wrong(&clean(&why, 200)))?;
    Ok((text, metadata))
}

/// The files whose content identifies a recording: a file itself; of a folder its `metadata.yaml`, and the present
/// files that it names.
pub fn files_of(path: &Path) -> Result<Vec<PathBuf>> {
    if !path.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let (_, metadata) = described(path)?;
    let files = metadata.files.iter().map(|name| path.join(name)).filter(|file| file.is_file());
    Ok(std::iter::once(path.join(METADATA)).chain(files).collect())
}

impl RecordingReader for FolderReader {
    fn next_message(&mut self) -> Result<Option<RecordedMessage>> {
        if let Some(described) = self.described.take() {
            return Ok(Some(described));
        }
        while self.parts.len() < AT_ONCE {
            let Some(name) = self.left.pop_front() else { break };
            self.begin(name)?;
        }
        let first = self.parts.iter().enumerate().min_by_key(|(_, part)| part.next.time).map(|(number, _)| number);
        let Some((number, part)) = first.and_then(|number| Some((number, self.parts.get_mut(number)?))) else {
            self.compare();
            return Ok(None);
        };
        self.file = Arc::clone(&part.path);
        let message = match part.recording.next_message()? {
            Some(next) => std::mem::replace(&mut part.next, next),
            None => {
                let part = self.parts.remove(number);
                self.done += part.recording.progress().1;
                self.findings.add(&part.name, part.recording.findings());
                part.next
            }
        };
        if !matches!(message.channel.encoding, Encoding::Beside(_)) {
            *self.met.entry(Arc::clone(&message.channel.topic)).or_default() += 1;
        }
        Ok(Some(message))
    }

    fn findings(&self) -> &Findings {
        &self.findings
    }

    fn progress(&self) -> (u64, u64) {
        let now: u64 = self.parts.iter().map(|part| part.recording.progress().0).sum();
        ((self.done + now).min(self.size), self.size)
    }

    fn file(&self) -> Option<&Path> {
        Some(&self.file)
    }
}

impl FolderReader {
    /// Its recorder has ended.
    pub fn open(folder: &Path) -> Result<Self> {
        let (text, metadata) = described(folder)?;
        let (name, media_type, data) = (METADATA.into(), "application/yaml".into(), text.as_bytes());
        let body =
            AttachedFile { logged_at: metadata.begins, created_at: 0, name, media_type, data, checksum: 0 }.encode();
        let channel = Arc::new(Beside::Attachment.channel());
        let described = RecordedMessage { channel, time: metadata.begins, sent: None, body };
        let size = |name: &String| std::fs::metadata(folder.join(name)).map_or(0, |found| found.len());
        let mut reader = Self {
            folder: folder.to_owned(),
            left: metadata.files.iter().cloned().collect(),
            parts: Vec::new(),
            described: Some(described),
            file: folder.join(METADATA).into(),
            findings: Findings::default(),
            met: BTreeMap::new(),
            done: 0,
            size: metadata.files.iter().map(size).sum(),
            ended: false,
            metadata,
        };
        reader.note_others();
        Ok(reader)
    }

    /// Reports recordings in the folder that `metadata.yaml` does not name; they are not read.
    fn note_others(&mut self) {
        let Ok(entries) = std::fs::read_dir(&self.folder) else { return };
        let names = entries.flatten().take(MOST_ENTRIES).map(|entry| entry.file_name().to_string_lossy().into_owned());
        let is_one = |name: &String| {
            let end = name.strip_suffix(".zstd").unwrap_or(name).rsplit_once('.').map(|(_, end)| end);
            matches!(end, Some("db3" | "mcap"))
        };
        let mut others: Vec<String> = names.filter(is_one).filter(|name| !self.metadata.files.contains(name)).collect();
        others.sort();
        for name in others {
            self.findings.note(0, &format!("{name} is in the folder, but not in {METADATA}: it was not read"));
        }
    }

    /// A file that cannot be read is damage.
    fn begin(&mut self, name: String) -> Result<()> {
        let path = self.folder.join(&name);
        let opened =
            if path.exists() { Recording::open_file(&path) } else { Err(RosError::recording("it is not there")) };
        let mut recording = match opened {
            Ok(recording) => recording,
            Err(error) => {
                let lost = self.metadata.of_file.get(&name).map(|count| format!(" ({})", counted(*count, "message")));
                self.findings.note(0, &format!("{name} was left out{}: {error}", lost.unwrap_or_default()));
                return Ok(());
            }
        };
        match recording.next_message()? {
            Some(next) => self.parts.push(Part { name, path: path.into(), recording, next }),
            None => {
                self.done += recording.progress().1;
                self.findings.add(&name, recording.findings());
            }
        }
        Ok(())
    }

    /// The counts of `metadata.yaml` must be met.
    fn compare(&mut self) {
        if std::mem::replace(&mut self.ended, true) || !self.findings.damages.is_empty() {
            return;
        }
        let mut met = std::mem::take(&mut self.met);
        for row in &self.findings.unusable {
            *met.entry(row.topic.as_str().into()).or_default() += row.messages;
        }
        let all: u64 = met.values().sum();
        for (topic, stated) in &self.metadata.topics {
            let met = met.get(topic.as_str()).copied().unwrap_or_default();
            if *stated != met {
                let text = format!(
                    "{METADATA} counts {} of '{topic}', the folder has {}",
                    counted(*stated, "message"),
                    grouped(met)
                );
                self.findings.note(0, &text);
            }
        }
        self.findings.compare(0, "messages", self.metadata.messages, all);
    }
}

/// Bytes between checks of the room left.
const STEP: usize = 16 << 20;

/// Bytes that stay free on the disk.
const RESERVE: u64 = 512 << 20;

/// Unpacks a compressed file into a temporary one.
pub(crate) fn unpacked(path: &Path) -> Result<NamedTempFile> {
    let failed = |why: &str| RosError::recording(&format!("{} cannot be unpacked with zstd: {why}", path.display()));
    let told = |error: std::io::Error| failed(&why(&error));
    let made = NamedTempFile::new().map_err(told)?;
    let mut source = BufReader::with_capacity(1 << 18, File::open(path).map_err(told)?);
    let mut out = BufWriter::new(made.as_file());
    let window = u64::try_from(LARGEST_CHUNK).unwrap_or(u64::MAX);
    let mut buffer = vec![0; 1 << 18];
    let mut written = 0;
    while !source.fill_buf().map_err(told)?.is_empty() {
        let decoder = ruzstd::decoding::StreamingDecoder::new_with_max_window_size(&mut source, window);
        let mut decoder = decoder.map_err(|_| failed(SPOILT))?;
        loop {
            let read = decoder.read(&mut buffer).map_err(told)?;
            let bytes = buffer.get(..read).unwrap_or_default();
            if bytes.is_empty() {
                break;
            }
            out.write_all(bytes).map_err(told)?;
            if written / STEP != (written + read) / STEP {
                let room = rustix::fs::fstatvfs(made.as_file()).map_err(|error| told(error.into()))?;
                if room.f_bavail.saturating_mul(room.f_frsize) < RESERVE {
                    return Err(failed(&format!(
                        "less than {RESERVE} bytes are left in {}; name a larger folder in TMPDIR",
                        std::env::temp_dir().display()
                    )));
                }
            }
            written += read;
        }
        let decoder = decoder.into_frame_decoder();
        let told = decoder.get_checksum_from_data();
        if told.is_some() && told != decoder.get_calculated_checksum() {
            return Err(failed("what comes out does not match its checksum"));
        }
    }
    out.flush().map_err(told)?;
    drop(out);
    Ok(made)
}
