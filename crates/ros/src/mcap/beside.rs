//! What an MCAP file holds beside its messages: files attached to it, and names with values about it. Each is kept as
//! MCAP's own bytes of it, without code and length, so that it comes out as it went in.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::record::{Code, Fields, put_length, put_text};
use crate::model::Timestamp;
use crate::ros::recording::{Channel, Encoding};

/// The name under which all of it is filed; no topic of ROS begins like this.
pub const TOPIC: &str = "authros/attachments";

/// The latest time of an attachment, nanoseconds.
const LATEST: u64 = i64::MAX as u64;

/// A kind of what is beside the messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Beside {
    /// A file, such as a calibration or a map.
    Attachment,
    /// Names with values about the recording.
    Metadata,
}

/// A file attached to a recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AttachedFile<'a> {
    /// When it was added to the recording.
    pub logged_at: Timestamp,
    /// When it was made, nanoseconds since 1970; 0 if nobody said.
    pub created_at: u64,
    /// Its name, as written.
    pub name: Arc<str>,
    /// Its media type, as written.
    pub media_type: Arc<str>,
    /// Its content.
    pub data: &'a [u8],
    /// CRC-32 of all before it; 0 if nobody computed one.
    pub checksum: u32,
}

/// What is read of it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum BesideContent<'a> {
    /// An attachment.
    File(AttachedFile<'a>),
    /// Metadata.
    Metadata {
        /// Its name, as written.
        name: Arc<str>,
        /// Its names and values, in their order; a name may occur twice.
        entries: Vec<(Arc<str>, Arc<str>)>,
    },
}

impl BesideContent<'_> {
    /// Its name, as written.
    pub fn name(&self) -> &Arc<str> {
        match self {
            Self::File(file) => &file.name,
            Self::Metadata { name, .. } => name,
        }
    }
}

impl Beside {
    /// What takes the place of a message type.
    pub fn type_name(self) -> &'static str {
        match self {
            Self::Attachment => "authros/Attachment",
            Self::Metadata => "authros/Metadata",
        }
    }

    /// The kind of this type name.
    pub fn of_type(name: &str) -> Option<Self> {
        [Self::Attachment, Self::Metadata].into_iter().find(|kind| kind.type_name() == name)
    }

    /// What takes the place of a channel.
    pub fn channel(self) -> Channel {
        Channel {
            topic: TOPIC.into(),
            type_name: self.type_name().into(),
            md5sum: "".into(),
            definition: "".into(),
            caller_id: "".into(),
            latching: false,
            encoding: Encoding::Beside(self),
            about: BTreeMap::new(),
        }
    }

    /// Parses it whole; `None` if it is not as MCAP has it.
    pub fn parse(self, bytes: &[u8]) -> Option<BesideContent<'_>> {
        let mut fields = Fields(bytes);
        let content = match self {
            Self::Attachment => BesideContent::File(AttachedFile {
                logged_at: Timestamp(fields.u64().filter(|time| *time <= LATEST)?),
                created_at: fields.u64()?,
                name: fields.text()?,
                media_type: fields.text()?,
                data: {
                    let length = usize::try_from(fields.u64()?).ok()?;
                    fields.bytes(length)?
                },
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

    /// Its name, from the beginning of its bytes.
    pub(super) fn name_of(self, beginning: &[u8]) -> Arc<str> {
        let mut fields = Fields(beginning);
        let name = match self {
            Self::Attachment => fields.u64().and(fields.u64()).and_then(|_| fields.text()),
            Self::Metadata => fields.text(),
        };
        name.unwrap_or_default()
    }

    pub(super) fn of_code(code: Code) -> Option<Self> {
        match code {
            Code::Attachment => Some(Self::Attachment),
            Code::Metadata => Some(Self::Metadata),
            _ => None,
        }
    }

    pub(super) fn code(self) -> Code {
        match self {
            Self::Attachment => Code::Attachment,
            Self::Metadata => Code::Metadata,
        }
    }

    /// One word in a finding.
    pub(super) fn word(self) -> &'static str {
        match self {
            Self::Attachment => "attachment",
            Self::Metadata => "metadata record",
        }
    }
}

/// Metadata in MCAP's own bytes.
pub fn metadata_record(name: &str, entries: &[(&str, &str)]) -> Vec<u8> {
    let mut out = Vec::new();
    put_text(&mut out, name);
    put_length(&mut out, entries.iter().map(|(key, value)| 8 + key.len() + value.len()).sum());
    for (key, value) in entries {
        put_text(&mut out, key);
        put_text(&mut out, value);
    }
    out
}

/// A file in MCAP's own bytes of an attachment.
pub fn attachment_record(logged_at: Timestamp, name: &str, media_type: &str, data: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(data.len() + 128);
    out.extend_from_slice(&logged_at.0.to_le_bytes());
    out.extend_from_slice(&0_u64.to_le_bytes());
    put_text(&mut out, name);
    put_text(&mut out, media_type);
    out.extend_from_slice(&(data.len() as u64).to_le_bytes());
    out.extend_from_slice(data);
    let checksum = crc32fast::hash(&out);
    out.extend_from_slice(&checksum.to_le_bytes());
    out
}
