//! The records of a bag: a header of named fields, then data; all lengths 32 bits, little endian.

use std::sync::Arc;

use crate::model::Timestamp;
use crate::ros::recording::{BAG_TOPIC, Channel, Encoding, kept_about};

/// The longest header of a record, bytes: the fields of a bag's own records are short.
pub(super) const LONGEST_HEADER: usize = 64 * 1024;

/// The longest data of a connection record, bytes: it holds a definition.
pub(super) const LONGEST_CONNECTION: usize = 2 << 20;

/// The kind of a record (its field `op`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Op {
    Message = 2,
    BagHeader = 3,
    Index = 4,
    Chunk = 5,
    ChunkInfo = 6,
    Connection = 7,
}

impl Op {
    fn from_code(code: u8) -> Option<Self> {
        let all = [Self::Message, Self::BagHeader, Self::Index, Self::Chunk, Self::ChunkInfo, Self::Connection];
        all.into_iter().find(|op| *op as u8 == code)
    }
}

/// The fields of a header, as slices of its bytes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Fields<'a> {
    fields: Vec<(&'a [u8], &'a [u8])>,
}

impl<'a> Fields<'a> {
    /// Parses a whole header; `None` if the bytes are not exactly fields.
    pub fn parse(mut bytes: &'a [u8]) -> Option<Self> {
        let mut fields = Vec::new();
        while !bytes.is_empty() {
            let (field, rest) = sized(bytes)?;
            let equals = field.iter().position(|byte| *byte == b'=').filter(|at| *at > 0)?;
            fields.push((field.get(..equals)?, field.get(equals + 1..)?));
            bytes = rest;
        }
        Some(Self { fields })
    }

    pub fn bytes(&self, name: &str) -> Option<&'a [u8]> {
        self.fields.iter().find(|(field, _)| *field == name.as_bytes()).map(|(_, value)| *value)
    }

    pub fn text(&self, name: &str) -> Option<Arc<str>> {
        self.bytes(name).map(|bytes| String::from_utf8_lossy(bytes).into())
    }

    pub fn u32(&self, name: &str) -> Option<u32> {
        self.bytes(name)?.try_into().ok().map(u32::from_le_bytes)
    }

    pub fn u64(&self, name: &str) -> Option<u64> {
        self.bytes(name)?.try_into().ok().map(u64::from_le_bytes)
    }

    /// Seconds and nanoseconds, as one number.
    pub fn time(&self, name: &str) -> Option<Timestamp> {
        let bytes: [u8; 8] = self.bytes(name)?.try_into().ok()?;
        let [seconds, nanoseconds] =
            [bytes.first_chunk::<4>()?, bytes.last_chunk::<4>()?].map(|b| u32::from_le_bytes(*b));
        Some(Timestamp(u64::from(seconds) * 1_000_000_000 + u64::from(nanoseconds)))
    }

    /// The fields of a connection's header that a channel has no field for.
    fn others(&self) -> impl Iterator<Item = (Arc<str>, Arc<str>)> {
        let text = |bytes: &[u8]| -> Arc<str> { String::from_utf8_lossy(bytes).into() };
        let others = self.fields.iter().map(move |(name, value)| (text(name), text(value)));
        others.filter(|(name, _)| !OWN.contains(&&**name) && &**name != BAG_TOPIC)
    }

    pub fn op(&self) -> Option<Op> {
        match self.bytes("op")? {
            [code] => Op::from_code(*code),
            _ => None,
        }
    }
}

/// A length and that many bytes; then the rest.
pub(super) fn sized(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let (length, rest) = bytes.split_first_chunk::<4>()?;
    rest.split_at_checked(usize::try_from(u32::from_le_bytes(*length)).ok()?)
}

/// Fields of a connection's header that a channel has fields for.
const OWN: [&str; 6] = ["topic", "type", "md5sum", "message_definition", "callerid", "latching"];

/// A connection record: its number, its description of the publisher, and whether all of it is kept.
pub(super) fn connection(fields: &Fields<'_>, data: &[u8]) -> Option<(u32, Channel, bool)> {
    let about = Fields::parse(data)?;
    let topic = fields.text("topic")?;
    let latching = about.text("latching");
    let named = about.text("topic").unwrap_or_default();
    let mut others: Vec<(Arc<str>, Arc<str>)> = Vec::new();
    others.extend(latching.iter().filter(|value| ***value != *"1").map(|value| ("latching".into(), Arc::clone(value))));
    others.extend((named != topic).then(|| (BAG_TOPIC.into(), named)));
    others.extend(about.others());
    let (others, is_whole) = kept_about(others);
    let channel = Channel {
        topic: Arc::clone(&topic),
        type_name: about.text("type")?,
        md5sum: about.text("md5sum")?,
        definition: about.text("message_definition")?,
        caller_id: about.text("callerid").unwrap_or_default(),
        latching: latching.as_ref().is_some_and(|value| &**value == "1"),
        encoding: Encoding::Ros1,
        about: others,
    };
    Some((fields.u32("conn")?, channel, is_whole))
}

/// Appends a header of fields with its length.
pub(super) fn put_fields(out: &mut Vec<u8>, fields: &[(&str, &[u8])]) {
    let length: usize = fields.iter().map(|(name, value)| 4 + name.len() + 1 + value.len()).sum();
    put_length(out, length);
    for (name, value) in fields {
        put_length(out, name.len() + 1 + value.len());
        out.extend_from_slice(name.as_bytes());
        out.push(b'=');
        out.extend_from_slice(value);
    }
}

/// Appends a length; nothing here is longer than the format's 32 bits.
pub(super) fn put_length(out: &mut Vec<u8>, length: usize) {
    out.extend_from_slice(&u32::try_from(length).unwrap_or(u32::MAX).to_le_bytes());
}

/// Appends a connection record.
pub(super) fn put_connection(out: &mut Vec<u8>, number: u32, channel: &Channel) {
    let number = number.to_le_bytes();
    put_fields(out, &[("op", &[Op::Connection as u8]), ("conn", &number), ("topic", channel.topic.as_bytes())]);
    let named = channel.about.get(BAG_TOPIC).unwrap_or(&channel.topic);
    let mut about: Vec<(&str, &[u8])> = Vec::with_capacity(8);
    if !named.is_empty() {
        about.push(("topic", named.as_bytes()));
    }
    about.extend([
        ("type", channel.type_name.as_bytes()),
        ("md5sum", channel.md5sum.as_bytes()),
        ("message_definition", channel.definition.as_bytes()),
    ]);
    if !channel.caller_id.is_empty() {
        about.push(("callerid", channel.caller_id.as_bytes()));
    }
    match channel.about.get("latching") {
        Some(value) => about.push(("latching", value.as_bytes())),
        None if channel.latching => about.push(("latching", b"1")),
        None => {}
    }
    let is_writable = |name: &str| !OWN.contains(&name) && name != BAG_TOPIC && !name.is_empty() && !name.contains('=');
    let others = channel.about.iter().filter(|(name, _)| is_writable(name));
    about.extend(others.map(|(name, value)| (&**name, value.as_bytes())));
    put_fields(out, &about);
}

/// A time in the format of a bag.
pub(super) fn time_bytes(time: Timestamp) -> [u8; 8] {
    let seconds = u32::try_from(time.0 / 1_000_000_000).unwrap_or(u32::MAX).to_le_bytes();
    let nanoseconds = u32::try_from(time.0 % 1_000_000_000).unwrap_or(0).to_le_bytes();
    let mut bytes = [0; 8];
    bytes[..4].copy_from_slice(&seconds);
    bytes[4..].copy_from_slice(&nanoseconds);
    bytes
}
