//! Attachments and metadata of an MCAP file, kept as MCAP's own bytes without code and length, so that they come out as
//! they went in.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::{Code, Fields, LATEST, put_map, put_numbers, put_text};
use crate::model::Timestamp;
use crate::ros::recording::{Channel, Encoding};

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
