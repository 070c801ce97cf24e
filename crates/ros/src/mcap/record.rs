//! The records of MCAP: a code, a 64-bit length, fields in a fixed order; all numbers little endian.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::ros::recording::{Channel, Encoding, kept_about};

/// The kind of a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Code {
    Header = 1,
    Footer = 2,
    Schema = 3,
    Channel = 4,
    Message = 5,
    Chunk = 6,
    MessageIndex = 7,
    ChunkIndex = 8,
    Attachment = 9,
    AttachmentIndex = 10,
    Statistics = 11,
    Metadata = 12,
    MetadataIndex = 13,
    SummaryOffset = 14,
    DataEnd = 15,
}

impl Code {
    /// `None` for records that a reader of messages skips.
    pub fn from_byte(byte: u8) -> Option<Self> {
        let all = [
            Self::Header,
            Self::Footer,
            Self::Schema,
            Self::Channel,
            Self::Message,
            Self::Chunk,
            Self::MessageIndex,
            Self::ChunkIndex,
            Self::Attachment,
            Self::AttachmentIndex,
            Self::Statistics,
            Self::Metadata,
            Self::MetadataIndex,
            Self::SummaryOffset,
            Self::DataEnd,
        ];
        all.into_iter().find(|code| *code as u8 == byte)
    }
}

/// Whether an entry of a channel's metadata is said by a field here.
fn is_own(key: &str, value: &str) -> bool {
    matches!((key, value), ("md5sum" | "callerid", _) | ("latching", "1"))
}

/// Parses consecutive fields; `None` if the bytes end too early.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fields<'a>(pub &'a [u8]);

impl<'a> Fields<'a> {
    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (array, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*array)
    }

    pub fn bytes(&mut self, length: usize) -> Option<&'a [u8]> {
        let (bytes, rest) = self.0.split_at_checked(length)?;
        self.0 = rest;
        Some(bytes)
    }

    pub fn u8(&mut self) -> Option<u8> {
        self.array::<1>().map(|[byte]| byte)
    }

    pub fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    pub fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    pub fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    pub fn sized(&mut self) -> Option<&'a [u8]> {
        let length = usize::try_from(self.u32()?).ok()?;
        self.bytes(length)
    }

    pub fn text(&mut self) -> Option<Arc<str>> {
        self.sized().map(|bytes| String::from_utf8_lossy(bytes).into())
    }

    /// Names with values, in their order, behind the length of them all.
    pub fn map(&mut self) -> Option<Vec<(Arc<str>, Arc<str>)>> {
        let mut map = Fields(self.sized()?);
        let mut entries = Vec::new();
        while !map.0.is_empty() {
            entries.push((map.text()?, map.text()?));
        }
        Some(entries)
    }

    /// A record: its code and its content.
    pub fn record(&mut self) -> Option<(u8, &'a [u8])> {
        let code = self.u8()?;
        let length = usize::try_from(self.u64()?).ok()?;
        Some((code, self.bytes(length)?))
    }
}

/// A schema: the name of a type, and its definition.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Schema {
    pub name: Arc<str>,
    pub encoding: Arc<str>,
    pub text: Arc<str>,
}

impl Schema {
    /// Bytes of its texts.
    pub fn size(&self) -> usize {
        self.name.len() + self.encoding.len() + self.text.len() + 64
    }
}

/// A schema record: its number (never 0) and its content.
pub(super) fn schema(mut fields: Fields<'_>) -> Option<(u16, Schema)> {
    let number = fields.u16().filter(|number| *number > 0)?;
    Some((number, Schema { name: fields.text()?, encoding: fields.text()?, text: fields.text()? }))
}

/// The content of a channel record, without its schema's text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct ChannelRecord {
    pub number: u16,
    pub schema: u16,
    topic: Arc<str>,
    encoding: Arc<str>,
    about: BTreeMap<String, Arc<str>>,
}

impl ChannelRecord {
    pub fn parse(mut fields: Fields<'_>) -> Option<Self> {
        let (number, schema) = (fields.u16()?, fields.u16()?);
        let (topic, encoding) = (fields.text()?, fields.text()?);
        let about = fields.map()?.into_iter().map(|(key, value)| (key.to_string(), value)).collect();
        Some(Self { number, schema, topic, encoding, about })
    }

    /// Bytes of its texts.
    pub fn size(&self) -> usize {
        let about = self.about.iter().map(|(key, value)| key.len() + value.len());
        self.topic.len() + self.encoding.len() + about.sum::<usize>() + 128
    }

    /// Whether all its metadata is kept.
    pub fn is_kept(&self) -> bool {
        kept_about(self.others()).1
    }

    fn others(&self) -> impl Iterator<Item = (Arc<str>, Arc<str>)> {
        let others = self.about.iter().filter(|(key, value)| !is_own(key, value));
        others.map(|(key, value)| (key.as_str().into(), Arc::clone(value)))
    }

    /// The channel's topic.
    pub fn topic(&self) -> &Arc<str> {
        &self.topic
    }

    /// The channel with its schema; or why its messages cannot be used. Bodies in CDR are kept also without a
    /// definition: they are what is to be proven.
    pub fn with(&self, schema: Option<&Schema>) -> Result<Channel, String> {
        let Some(schema) = schema else {
            return Err(match (&*self.encoding, self.schema) {
                ("ros1" | "cdr", 0) => String::from("its channel names no type (schema 0)"),
                ("ros1" | "cdr", number) => format!("its schema {number} is not in the file"),
                _ => self.foreign(),
            });
        };
        let encoding = match (&*self.encoding, &*schema.encoding) {
            ("ros1", "ros1msg" | "") => Encoding::Ros1,
            ("cdr", "ros2msg" | "") => Encoding::Cdr { idl: false },
            ("cdr", "ros2idl" | "omgidl") => Encoding::Cdr { idl: true },
            ("ros1" | "cdr", other) => return Err(format!("its schema's encoding '{other}' is not of ROS")),
            _ => return Err(self.foreign()),
        };
        let about = |key: &str| self.about.get(key).cloned();
        let definition = if schema.encoding.is_empty() { "".into() } else { Arc::clone(&schema.text) };
        let computed = || match encoding {
            Encoding::Ros1 if !definition.is_empty() => {
                crate::ros::md5sum(&schema.name, &definition).ok().map(Arc::from)
            }
            Encoding::Ros1 | Encoding::Cdr { .. } | Encoding::Beside(_) => None,
        };
        Ok(Channel {
            md5sum: about("md5sum").filter(|sum| &**sum != "*").or_else(computed).unwrap_or_else(|| "*".into()),
            caller_id: about("callerid").unwrap_or_default(),
            latching: about("latching").is_some_and(|value| matches!(&*value, "1" | "true")),
            topic: Arc::clone(&self.topic),
            type_name: Arc::clone(&schema.name),
            definition,
            encoding,
            about: kept_about(self.others()).0,
        })
    }

    fn foreign(&self) -> String {
        format!("its encoding '{}' is not of ROS", self.encoding)
    }
}

/// Appends a record whose content is written by `fill`.
pub(super) fn put_record(out: &mut Vec<u8>, code: Code, fill: impl FnOnce(&mut Vec<u8>)) {
    out.push(code as u8);
    let at = out.len();
    out.extend_from_slice(&[0; 8]);
    fill(out);
    let length = (out.len() - at - 8) as u64;
    if let Some(place) = out.get_mut(at..at + 8) {
        place.copy_from_slice(&length.to_le_bytes());
    }
}

/// Appends a text with its length.
pub(super) fn put_text(out: &mut Vec<u8>, text: &str) {
    put_length(out, text.len());
    out.extend_from_slice(text.as_bytes());
}

/// Appends a 32-bit length; nothing written here is longer.
pub(super) fn put_length(out: &mut Vec<u8>, length: usize) {
    out.extend_from_slice(&u32::try_from(length).unwrap_or(u32::MAX).to_le_bytes());
}

/// Appends the schema of a channel.
pub(super) fn put_schema(out: &mut Vec<u8>, number: u16, channel: &Channel) {
    put_record(out, Code::Schema, |out| {
        out.extend_from_slice(&number.to_le_bytes());
        put_text(out, &channel.type_name);
        // Without a definition it is no text in any language, as rosbag2 writes it.
        let is_described = !channel.definition.is_empty() || channel.encoding == Encoding::Ros1;
        put_text(out, if is_described { schema_encoding(channel.encoding) } else { "" });
        put_text(out, &channel.definition);
    });
}

/// The name of the schema encoding.
pub(super) fn schema_encoding(encoding: Encoding) -> &'static str {
    match encoding {
        Encoding::Ros1 => "ros1msg",
        Encoding::Cdr { idl: false } => "ros2msg",
        Encoding::Cdr { idl: true } => "ros2idl",
        Encoding::Beside(_) => "",
    }
}

/// Appends a channel of a schema.
pub(super) fn put_channel(out: &mut Vec<u8>, number: u16, schema: u16, channel: &Channel) {
    let mut about = vec![("md5sum", &*channel.md5sum)];
    if !channel.caller_id.is_empty() {
        about.push(("callerid", &channel.caller_id));
    }
    if channel.latching && !channel.about.contains_key("latching") {
        about.push(("latching", "1"));
    }
    about.retain(|(key, value)| *key != "md5sum" || *value != "*");
    about.extend(channel.about.iter().map(|(key, value)| (&**key, &**value)));
    put_record(out, Code::Channel, |out| {
        out.extend_from_slice(&number.to_le_bytes());
        out.extend_from_slice(&schema.to_le_bytes());
        put_text(out, &channel.topic);
        put_text(out, if channel.encoding == Encoding::Ros1 { "ros1" } else { "cdr" });
        put_length(out, about.iter().map(|(key, value)| 8 + key.len() + value.len()).sum());
        for (key, value) in about {
            put_text(out, key);
            put_text(out, value);
        }
    });
}
