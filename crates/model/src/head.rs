//! The sealed head of a record: the metadata of a message that only readers may see.
#![warn(missing_docs, clippy::missing_errors_doc)]

use std::collections::BTreeMap;

use super::bytes::Digest;
use super::wire::{Reader, WireError, put_text};

/// The most tags in a head.
pub const MOST_TAGS: usize = 64;

/// How the body was compressed before it was sealed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Compression {
    /// Not compressed.
    None,
    /// LZ4, a single block.
    Lz4,
    /// As a matrix of numbers: raw pictures, depth, clouds (`crypto::compression`).
    Matrix,
}

impl Compression {
    /// Every method, in the order of the codes.
    const ALL: [Self; 3] = [Self::None, Self::Lz4, Self::Matrix];

    /// Its code in the head.
    fn code(self) -> u8 {
        match self {
            Self::None => 0,
            Self::Lz4 => 1,
            Self::Matrix => 2,
        }
    }

    fn from_code(code: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|compression| compression.code() == code)
    }

    /// Its name for people.
    pub fn word(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Lz4 => "lz4",
            Self::Matrix => "matrix",
        }
    }
}

/// The sealed head, in the order of writing.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Head {
    /// Topic name.
    pub topic: String,
    /// Message type, `package/Type`.
    pub type_name: String,
    /// The type's md5sum, 32 hex characters, as stated by the publisher.
    pub md5sum: String,
    /// SM3 of the message definition.
    pub definition: Digest,
    /// The publisher's node name.
    pub caller_id: String,
    /// This boot of the recording machine.
    pub boot_id: [u8; 16],
    /// How the body was compressed.
    pub compression: Compression,
    /// Length of the message as captured, bytes.
    pub plain_length: u64,
    /// Tags (mission, robot, classification, retention, simulated).
    pub tags: BTreeMap<String, String>,
}

/// The tag that simulated robots send.
pub const SIMULATED: (&str, &str) = ("simulated", "true");

impl Head {
    /// Whether a simulated robot sent it.
    pub fn is_simulated(&self) -> bool {
        self.tags.get(SIMULATED.0).is_some_and(|value| value == SIMULATED.1)
    }

    /// Encodes the bytes to be sealed.
    ///
    /// Texts have a two-byte length; definition (32), boot id (16), compression (1),
    /// plain length (8), tag count (2) and pairs, in the order of the tags' bytes.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = Vec::with_capacity(192);
        for text in [&self.topic, &self.type_name, &self.md5sum] {
            put_text(&mut out, text);
        }
        out.extend_from_slice(&self.definition.0);
        put_text(&mut out, &self.caller_id);
        out.extend_from_slice(&self.boot_id);
        out.push(self.compression.code());
        out.extend_from_slice(&self.plain_length.to_be_bytes());
        let count = self.tags.len().min(MOST_TAGS);
        out.extend_from_slice(&u16::try_from(count).unwrap_or(0).to_be_bytes());
        for (key, value) in self.tags.iter().take(count) {
            put_text(&mut out, key);
            put_text(&mut out, value);
        }
        out
    }

    /// Parses a whole head.
    ///
    /// # Errors
    /// [`WireError`] if the bytes are not exactly one head.
    pub fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(bytes);
        let head = Self {
            topic: reader.text("topic")?,
            type_name: reader.text("type")?,
            md5sum: reader.text("md5sum")?,
            definition: Digest(reader.array("definition")?),
            caller_id: reader.text("caller id")?,
            boot_id: reader.array("boot id")?,
            compression: Compression::from_code(reader.u8("compression")?).ok_or(WireError::Value("compression"))?,
            plain_length: reader.u64("plain length")?,
            tags: read_tags(&mut reader)?,
        };
        reader.end()?;
        Ok(head)
    }
}

fn read_tags(reader: &mut Reader<'_>) -> Result<BTreeMap<String, String>, WireError> {
    let count = usize::from(reader.u16("tag count")?);
    if count > MOST_TAGS {
        return Err(WireError::Value("tag count"));
    }
    let mut tags: BTreeMap<String, String> = BTreeMap::new();
    for _ in 0..count {
        let (tag, value) = (reader.text("tag")?, reader.text("tag value")?);
        // In order and without duplicates: every head has exactly one encoding.
        if tags.last_key_value().is_some_and(|(last, _)| *last >= tag) {
            return Err(WireError::Value("tag"));
        }
        tags.insert(tag, value);
    }
    Ok(tags)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn tags_out_of_order_or_twice_are_refused() {
        let head = |tags: [(&str, &str); 2]| {
            let empty = Head {
                topic: "/a".into(),
                type_name: "a/B".into(),
                md5sum: "0".repeat(32),
                definition: Digest([1; 32]),
                caller_id: "/a".into(),
                boot_id: [2; 16],
                compression: Compression::None,
                plain_length: 0,
                tags: BTreeMap::new(),
            };
            let mut bytes = empty.encode();
            bytes.truncate(bytes.len() - 2);
            bytes.extend_from_slice(&[0, 2]);
            for (tag, value) in tags {
                put_text(&mut bytes, tag);
                put_text(&mut bytes, value);
            }
            Head::parse(&bytes)
        };
        assert!(head([("mission", "1"), ("robot", "2")]).is_ok());
        assert_eq!(head([("robot", "2"), ("mission", "1")]), Err(WireError::Value("tag")));
        assert_eq!(head([("robot", "1"), ("robot", "2")]), Err(WireError::Value("tag")));
    }

    proptest! {
        #[test]
        fn round_trip(topic in "/[a-z]{1,20}", caller in any::<String>(), length in any::<u64>(), code in 0u8..3,
                      tags in proptest::collection::btree_map("[a-z]{1,8}", any::<String>(), 0..5)) {
            let head = Head {
                topic, type_name: "a/B".into(), md5sum: "0".repeat(32), definition: Digest([1; 32]),
                caller_id: caller, boot_id: [2; 16], plain_length: length, tags,
                compression: Compression::from_code(code).expect("known"),
            };
            prop_assert_eq!(Head::parse(&head.encode()), Ok(head));
        }

        #[test]
        fn noise_never_panics(noise in proptest::collection::vec(any::<u8>(), 0..400)) {
            let _ = Head::parse(&noise);
        }
    }
}
