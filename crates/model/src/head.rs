//! The sealed head of a record: the metadata of a message that only readers may see.
#![warn(missing_docs, clippy::missing_errors_doc)]

use std::collections::BTreeMap;

use super::bytes::Digest;
use super::wire::{Reader, Wire, WireError, put_text, read_list};

/// The most tags in a head.
pub const MOST_TAGS: usize = 64;

/// How the body was compressed before it was sealed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, strum::FromRepr, strum::IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
#[repr(u8)]
pub enum Compression {
    /// Not compressed.
    None,
    /// LZ4, a single block.
    Lz4,
    /// As a matrix of numbers: raw pictures, depth, clouds (`crypto::compression`).
    Matrix,
}

crate::words!(Compression);

impl Compression {
    fn code(self) -> u8 {
        self as u8
    }
}

/// The sealed head, in the order of writing. Texts have a two-byte length; tags have a two-byte count.
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

crate::layout!(Compression by code, from_repr);
crate::layout!(Head {
    topic: "topic",
    type_name: "type",
    md5sum: "md5sum",
    definition: "definition",
    caller_id: "caller id",
    boot_id: "boot id",
    compression: "compression",
    plain_length: "plain length",
    tags: "tag",
});
crate::body!(Head);

impl Head {
    /// Whether a simulated robot sent it.
    pub fn is_simulated(&self) -> bool {
        self.tags.get(SIMULATED.0).is_some_and(|value| value == SIMULATED.1)
    }
}

/// Tags by their names: without duplicates and in one order, so that every head has exactly one encoding.
impl Wire for BTreeMap<String, String> {
    fn put(&self, out: &mut Vec<u8>) {
        u16::try_from(self.len().min(MOST_TAGS)).unwrap_or(0).put(out);
        for (tag, value) in self.iter().take(MOST_TAGS) {
            put_text(out, tag);
            put_text(out, value);
        }
    }

    fn read(reader: &mut Reader<'_>, field: &'static str) -> Result<Self, WireError> {
        let tags: Vec<(String, String)> = read_list::<u16, _>(reader, 0..=MOST_TAGS, ("tag count", field))?;
        if !tags.is_sorted_by(|(one, _), (next, _)| one < next) {
            return Err(WireError::Value(field));
        }
        Ok(tags.into_iter().collect())
    }
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
                compression: Compression::from_repr(code).expect("known"),
            };
            prop_assert_eq!(Head::parse(&head.encode()), Ok(head));
        }

        #[test]
        fn noise_never_panics(noise in proptest::collection::vec(any::<u8>(), 0..400)) {
            let _ = Head::parse(&noise);
        }
    }
}
