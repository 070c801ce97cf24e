//! Attachments and metadata of an MCAP file, kept as MCAP's own bytes without code and length, so that they come out as
//! they went in.

use std::collections::BTreeMap;
use std::io::{BufReader, Read, Seek, SeekFrom, Write};
use std::sync::Arc;

use super::{
    Code, Fields, LATEST, LEAD, MAGIC, TAIL, beside_line, end_summary, put_map, put_numbers, put_record, put_text,
};
use crate::model::Timestamp;
use crate::ros::recording::{Channel, Encoding};
use crate::ros::{Result, RosError};

/// Files them under this name; no topic of ROS begins like this.
pub const TOPIC: &str = "authros/attachments";

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Beside {
    /// A file, such as a calibration or a map.
    Attachment,
    /// Names with values about the recording.
    Metadata,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AttachedFile<'a> {
    pub logged_at: Timestamp,
    /// Nanoseconds since 1970; 0 if unknown.
    pub created_at: u64,
    /// As written.
    pub name: Arc<str>,
    /// As written.
    pub media_type: Arc<str>,
    pub data: &'a [u8],
    /// CRC-32 of everything before it; 0 if there is none.
    pub checksum: u32,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum BesideContent<'a> {
    File(AttachedFile<'a>),
    Metadata { name: Arc<str>, entries: Vec<(Arc<str>, Arc<str>)> },
}

impl AttachedFile<'_> {
    /// MCAP's own bytes, with a checksum.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = Vec::with_capacity(self.data.len() + 256);
        put_numbers(&mut out, &[self.logged_at.0, self.created_at]);
        put_text(&mut out, &self.name);
        put_text(&mut out, &self.media_type);
        put_numbers(&mut out, &[self.data.len() as u64]);
        out.extend_from_slice(self.data);
        let checksum = crc32fast::hash(&out);
        out.extend_from_slice(&checksum.to_le_bytes());
        out
    }
}

impl BesideContent<'_> {
    pub fn name(&self) -> &Arc<str> {
        match self {
            Self::File(file) => &file.name,
            Self::Metadata { name, .. } => name,
        }
    }
}

impl Beside {
    /// Stands for a message type.
    pub fn type_name(self) -> &'static str {
        self.names().1
    }

    /// Its code, what stands for a message type, and its word in a finding.
    fn names(self) -> (Code, &'static str, &'static str) {
        match self {
            Self::Attachment => (Code::Attachment, "authros/Attachment", "attachment"),
            Self::Metadata => (Code::Metadata, "authros/Metadata", "metadata record"),
        }
    }

    pub fn of_type(name: &str) -> Option<Self> {
        [Self::Attachment, Self::Metadata].into_iter().find(|kind| kind.type_name() == name)
    }

    pub fn channel(self) -> Channel {
        let about = BTreeMap::new();
        Channel { md5sum: "".into(), ..Channel::plain((TOPIC, self.type_name(), ""), Encoding::Beside(self), about) }
    }

    /// `None` if it is not exactly as MCAP has it.
    pub fn parse(self, bytes: &[u8]) -> Option<BesideContent<'_>> {
        let mut fields = Fields(bytes);
        let content = match self {
            Self::Attachment => BesideContent::File(AttachedFile {
                logged_at: Timestamp(fields.u64().filter(|time| *time <= LATEST)?),
                created_at: fields.u64()?,
                name: fields.text()?,
                media_type: fields.text()?,
                data: fields.u64().and_then(|length| fields.bytes(usize::try_from(length).ok()?))?,
                checksum: fields.u32()?,
            }),
            Self::Metadata => BesideContent::Metadata { name: fields.text()?, entries: fields.map()? },
        };
        fields.0.is_empty().then_some(content)
    }

    /// Whether its checksum matches; `None` if it has none.
    pub(super) fn is_sound(content: &BesideContent<'_>, bytes: &[u8]) -> Option<bool> {
        match content {
            BesideContent::File(AttachedFile { checksum: 0, .. }) | BesideContent::Metadata { .. } => None,
            BesideContent::File(file) => {
                let covered = bytes.get(..bytes.len().saturating_sub(4)).unwrap_or_default();
                Some(crc32fast::hash(covered) == file.checksum)
            }
        }
    }

    /// From the beginning of its bytes.
    pub(super) fn name_of(self, beginning: &[u8]) -> Arc<str> {
        let mut fields = Fields(beginning);
        let name = match self {
            Self::Attachment => fields.u64().and(fields.u64()).and_then(|_| fields.text()),
            Self::Metadata => fields.text(),
        };
        name.unwrap_or_default()
    }

    pub(super) fn of_code(code: Code) -> Option<Self> {
        [Self::Attachment, Self::Metadata].into_iter().find(|kind| kind.code() == code)
    }

    pub(super) fn code(self) -> Code {
        self.names().0
    }

    pub(super) fn word(self) -> &'static str {
        self.names().2
    }
}

pub fn metadata_record(name: &str, entries: &[(&str, &str)]) -> Vec<u8> {
    let mut out = Vec::new();
    put_text(&mut out, name);
    put_map(&mut out, entries);
    out
}

/// Bytes of the record that ends the data.
const DATA_END: u64 = LEAD + 4;

/// Bytes.
const LONGEST_SUMMARY: u64 = 256 << 20;

const ATTACHMENTS: usize = 8 + 2 + 4;

/// Counts the written bytes and their CRC-32.
struct Counted<W> {
    out: W,
    position: u64,
    checksum: crc32fast::Hasher,
}

impl<W: Write> Counted<W> {
    fn put(&mut self, bytes: &[u8]) -> Result<()> {
        self.out.write_all(bytes).map_err(RosError::unwritable)?;
        self.position += bytes.len() as u64;
        self.checksum.update(bytes);
        Ok(())
    }
}

/// Copies a file that its recorder closed to `out`, with `file` attached.
pub fn attach(source: impl Read + Seek, out: impl Write, file: &AttachedFile<'_>) -> Result<()> {
    let mut source = BufReader::new(source);
    let length = source.seek(SeekFrom::End(0)).map_err(RosError::unreadable)?;
    let not_closed = || RosError::recording("nothing can be attached to it: it was not closed, or its end is damaged");
    let footer = length.checked_sub(TAIL).ok_or_else(not_closed)?;
    let tail = between(&mut source, footer, length)?;
    let (start, _) = super::footer(&tail).ok_or_else(not_closed)?;
    let after_data = if start == 0 { footer } else { start };
    let data_end = after_data.checked_sub(DATA_END).filter(|_| after_data <= footer).ok_or_else(not_closed)?;
    let mut end = Fields(&between(&mut source, data_end, after_data)?).0.to_vec();
    let checksum = match Fields(&end).record() {
        Some((code, content)) if code == Code::DataEnd as u8 => Fields(content).u32(),
        _ => None,
    };
    let has_checksum = checksum.ok_or_else(not_closed)? != 0;

    let mut out = Counted { out, position: 0, checksum: crc32fast::Hasher::new() };
    source.seek(SeekFrom::Start(0)).map_err(RosError::unreadable)?;
    copy(&mut source, data_end, &mut out)?;
    let mut record = Vec::new();
    put_record(&mut record, Code::Attachment, |out| out.extend_from_slice(&file.encode()));
    let line = beside_line(&BesideContent::File(file.clone()), data_end, record.len() as u64);
    out.put(&record)?;
    end.clear();
    let checksum = if has_checksum { out.checksum.clone().finalize() } else { 0 };
    put_record(&mut end, Code::DataEnd, |out| out.extend_from_slice(&checksum.to_le_bytes()));
    out.put(&end)?;
    if start > 0 {
        let summary = between(&mut source, start, footer)?;
        let summary = with_line(&summary, &line, out.position).ok_or_else(not_closed)?;
        out.put(&summary)?;
    } else {
        out.put(tail.get(..tail.len() - MAGIC.len()).unwrap_or_default())?;
    }
    out.put(MAGIC)?;
    out.out.flush().map_err(RosError::unwritable)
}

fn between(source: &mut (impl Read + Seek), from: u64, to: u64) -> Result<Vec<u8>> {
    let wanted = to.saturating_sub(from);
    if wanted > LONGEST_SUMMARY {
        return Err(RosError::recording("nothing can be attached to it: its summary is too long"));
    }
    let mut bytes = Vec::new();
    source.seek(SeekFrom::Start(from)).map_err(RosError::unreadable)?;
    source.by_ref().take(wanted).read_to_end(&mut bytes).map_err(RosError::unreadable)?;
    Ok(bytes)
}

fn copy(source: &mut impl Read, mut left: u64, out: &mut Counted<impl Write>) -> Result<()> {
    let mut buffer = vec![0; 256 * 1024];
    while left > 0 {
        let wanted = usize::try_from(left).unwrap_or(usize::MAX).min(buffer.len());
        let block = buffer.get_mut(..wanted).unwrap_or_default();
        source.read_exact(block).map_err(RosError::unreadable)?;
        out.put(block)?;
        left -= wanted as u64;
    }
    Ok(())
}

/// The summary with one more attachment, at its new place; `None` if it is damaged.
fn with_line(summary: &[u8], line: &[u8], start: u64) -> Option<Vec<u8>> {
    let mut groups: Vec<(Code, Vec<u8>)> = Vec::new();
    let mut rest = Fields(summary);
    while !rest.0.is_empty() {
        let (code, content) = rest.record()?;
        let code = Code::from_repr(code)?;
        let mut content = content.to_vec();
        match code {
            Code::SummaryOffset => continue,
            Code::Statistics => {
                let count = content.get_mut(ATTACHMENTS..ATTACHMENTS + 4)?;
                let more = u32::from_le_bytes((&*count).try_into().ok()?).checked_add(1)?;
                count.copy_from_slice(&more.to_le_bytes());
            }
            _ => {}
        }
        put_in_group(&mut groups, code, &content);
    }
    put_in_group(&mut groups, Code::AttachmentIndex, line);
    let (mut out, mut places) = (Vec::new(), Vec::new());
    for (code, records) in &groups {
        places.push((*code, start + out.len() as u64, records.len() as u64));
        out.extend_from_slice(records);
    }
    end_summary(&mut out, start, &places);
    Some(out)
}

/// Records of a kind are together in a summary.
fn put_in_group(groups: &mut Vec<(Code, Vec<u8>)>, code: Code, content: &[u8]) {
    let at = groups.iter().position(|(known, _)| *known == code).unwrap_or_else(|| {
        groups.push((code, Vec::new()));
        groups.len() - 1
    });
    if let Some((_, records)) = groups.get_mut(at) {
        put_record(records, code, |out| out.extend_from_slice(content));
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;
    use crate::model::Timestamp;
    use crate::ros::mcap::{Beside, McapReader, McapWriter};
    use crate::ros::recording::{ChunkCompression, RecordedMessage, RecordingReader as _};

    fn recorded(messages: u64) -> Vec<u8> {
        let text = ("/words", "std_msgs/msg/String", "string data");
        let channel = Arc::new(Channel::plain(text, Encoding::Cdr { idl: false }, BTreeMap::new()));
        let mut writer = McapWriter::begin(Cursor::new(Vec::new()), ChunkCompression::Lz4).expect("begun");
        for number in 0..messages {
            writer.write(&channel, Timestamp(1_000 + number), &vec![7; 300_000]).expect("written");
        }
        writer.finish().expect("finished").into_inner()
    }

    fn all(bytes: &[u8]) -> Vec<RecordedMessage> {
        let mut reader = McapReader::open(Cursor::new(bytes)).expect("MCAP");
        let mut found = Vec::new();
        while let Some(message) = reader.next_message().expect("readable") {
            found.push(message);
        }
        assert!(reader.findings().is_whole(), "{:?}", reader.findings());
        found
    }

    fn file(data: &[u8]) -> AttachedFile<'_> {
        let (name, media_type) = ("run.mcap.authros".into(), "application/zip".into());
        AttachedFile { logged_at: Timestamp(5), created_at: 6, name, media_type, data, checksum: 0 }
    }

    #[test]
    fn a_copy_has_the_same_messages_in_the_same_places_and_what_was_attached() {
        let before = recorded(9);
        let (mut once, mut twice) = (Vec::new(), Vec::new());
        attach(Cursor::new(&before), &mut once, &file(b"proof")).expect("attached");
        attach(Cursor::new(&once), &mut twice, &file(b"another")).expect("attached");
        let (messages, mut found) = (all(&before), all(&twice));
        let (last, proof) = (found.pop().expect("attached"), found.pop().expect("attached"));
        assert_eq!(found, messages);
        for (attached, data) in [(proof, &b"proof"[..]), (last, b"another")] {
            let Some(BesideContent::File(attached)) = Beside::Attachment.parse(&attached.body) else {
                panic!("a file")
            };
            assert_eq!((&*attached.name, attached.data, attached.logged_at.0), ("run.mcap.authros", data, 5));
            assert_ne!(attached.checksum, 0);
        }
        let some = before.len() / 2;
        assert!(once.len() > before.len() && once[..some] == before[..some]);
    }

    #[test]
    fn nothing_is_attached_to_what_was_not_closed() {
        let whole = recorded(3);
        for end in [0, 8, 100, whole.len() - 8, whole.len() - 1] {
            assert!(attach(Cursor::new(&whole[..end]), Vec::new(), &file(b"proof")).is_err(), "{end}");
        }
        let mut footer = whole.clone();
        let at = footer.len() - 28;
        footer[at..at + 8].copy_from_slice(&(whole.len() as u64).to_le_bytes());
        assert!(attach(Cursor::new(&footer), Vec::new(), &file(b"proof")).is_err(), "a summary behind the end");
    }
}
