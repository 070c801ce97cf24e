//! The public header of a record (CT1), version 1: the part that store, cache and gateway may see.
#![warn(missing_docs, clippy::missing_errors_doc)]

use serde::{Deserialize, Serialize};

use super::bytes::{Commit, Domain, FilterId, RecorderId, Salt, SignerId, TopicId};
use super::wire::{Reader, Wire, WireError, put_list, read_list};
use super::{Address, Timestamp};

/// First bytes of every record; the first is no text character, so that text tools cannot corrupt one unnoticed.
pub const MAGIC: [u8; 8] = *b"\x89AuthROS";
/// The format written by this program.
pub const VERSION: u8 = 1;
/// The suite SM4-GCM, SM3, SM2, HKDF-SM3.
pub const SUITE_SM: u8 = 1;
/// The most filter ids in a header.
pub const MOST_FILTERS: usize = 4;
/// The largest sealed head accepted, bytes.
pub const LARGEST_HEAD: u32 = 64 * 1024;
/// The largest sealed body accepted, bytes (64 MiB plus a tag).
pub const LARGEST_BODY: u64 = 64 * 1024 * 1024 + 16;
/// The highest sequence number: about a thousand records a second for 34 years.
pub const LARGEST_SEQ: u64 = 1 << 40;
/// The highest epoch and capture time: what a ledger can hold.
pub const LARGEST_STORED: u64 = u64::MAX >> 1;
/// The GCM tag at the end of each sealed part, bytes.
pub const TAG_LENGTH: usize = 16;

/// The kind of a record; never derived from ROS names.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, strum::FromRepr, strum::IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
#[repr(u8)]
#[serde(rename_all = "snake_case")]
pub enum RecordKind {
    /// A captured message.
    Data = 1,
    /// A message definition, sent once per epoch, topic and definition.
    Definition,
    /// A count of messages lost.
    Gap,
    /// Count and rolling hash of quarantined messages.
    Quarantine,
    /// A key notice to a device.
    Key,
    /// What retention is about to delete.
    Retention,
    /// A lost EOA's successor.
    Succession,
    /// A home's statements about itself: head of its audit log, birth and highest sequence numbers of its recorder.
    Audit,
    /// What a recording holds beside its messages: a file attached to it, or names and values about it.
    Attachment,
}

crate::words!(RecordKind);

impl RecordKind {
    /// The byte in the header.
    pub fn code(self) -> u8 {
        self as u8
    }

    /// From the byte in the header.
    pub fn from_code(code: u8) -> Option<Self> {
        Self::from_repr(code)
    }

    /// Whether it holds what its owner recorded or imported, rather than what a site says about that.
    pub fn is_content(self) -> bool {
        matches!(self, Self::Data | Self::Attachment)
    }
}

/// The public header, in the order of writing.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Header {
    /// The kind of record.
    pub kind: RecordKind,
    /// The network it belongs to.
    pub domain: Domain,
    /// The owner.
    pub owner: Address,
    /// SM3 of the key that signs it.
    pub signer: SignerId,
    /// The epoch whose key seals it.
    pub epoch: u64,
    /// The recorder; its id carries a tag of the signer.
    pub recorder: RecorderId,
    /// From 1 to [`LARGEST_SEQ`], per owner, signer, recorder and topic, across epochs.
    pub seq: u64,
    /// Pseudonym of the topic.
    pub topic_id: TopicId,
    /// Pseudonyms of type and tags, at most [`MOST_FILTERS`].
    pub filters: Vec<FilterId>,
    /// When the message was captured.
    pub captured_at: Timestamp,
    /// Length of the sealed head with its tag, bytes.
    pub head_length: u32,
    /// Length of the sealed body with its tag, bytes.
    pub body_length: u64,
    /// Fresh randomness of this record.
    pub salt: Salt,
    /// Commitment to the record's keys.
    pub commit: Commit,
}

crate::layout!(RecordKind by code, from_code);
crate::layout!(Header {
    kind: "kind",
    domain: "domain",
    owner: "owner",
    signer: "signer",
    epoch: "epoch",
    recorder: "recorder",
    seq: "seq",
    topic_id: "topic id",
    filters: "filter",
    captured_at: "capture time",
    head_length: "head length",
    body_length: "body length",
    salt: "salt",
    commit: "commit",
});

impl Header {
    /// The bytes in front of the sealed head; they are the AAD of both head and body.
    /// Magic (8) version suite kind (1 each) domain (32) owner (20) signer (32) epoch (8)
    /// recorder (16) seq (8) topic id (16) filter count (1) filters (8 each) capture time (8)
    /// head length (4) body length (8) salt (24) commit (32); big endian.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = Vec::with_capacity(256);
        out.extend_from_slice(&MAGIC);
        out.extend_from_slice(&[VERSION, SUITE_SM]);
        self.put(&mut out);
        out
    }

    /// Parses a header from the start of `bytes`; also returns its length in bytes.
    /// # Errors
    /// [`WireError`] if the bytes are not a version 1 header; nothing is allocated before a check.
    pub fn parse(bytes: &[u8]) -> Result<(Self, usize), WireError> {
        let mut reader = Reader::new(bytes);
        expect(reader.array("magic")? == MAGIC, "magic")?;
        expect(reader.u8("version")? == VERSION, "version")?;
        expect(reader.u8("suite")? == SUITE_SM, "suite")?;
        let header = Self::read(&mut reader, "header")?;
        let tag = u32::try_from(TAG_LENGTH).unwrap_or(16);
        expect((tag..=LARGEST_HEAD).contains(&header.head_length), "head length")?;
        expect((u64::from(tag)..=LARGEST_BODY).contains(&header.body_length), "body length")?;
        expect((1..=LARGEST_STORED).contains(&header.epoch), "epoch")?;
        expect((1..=LARGEST_SEQ).contains(&header.seq), "seq, which is 1 to 2^40,")?;
        expect(header.captured_at.0 <= LARGEST_STORED, "capture time")?;
        expect(header.recorder.is_of(&header.signer), "recorder, which is not of the key that signs,")?;
        Ok((header, bytes.len() - reader.rest().len()))
    }
}

impl Wire for Vec<FilterId> {
    fn put(&self, out: &mut Vec<u8>) {
        put_list::<u8>(out, self, MOST_FILTERS);
    }

    fn read(reader: &mut Reader<'_>, field: &'static str) -> Result<Self, WireError> {
        read_list::<u8, _>(reader, 0..=MOST_FILTERS, ("filter count", field))
    }
}

fn expect(condition: bool, field: &'static str) -> Result<(), WireError> {
    if condition { Ok(()) } else { Err(WireError::Value(field)) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::RecorderPrefix;
    use proptest::prelude::*;

    fn sample(filters: usize) -> Header {
        Header {
            kind: RecordKind::Data,
            domain: Domain([1; 32]),
            owner: Address([2; 20]),
            signer: SignerId([3; 32]),
            epoch: 4,
            recorder: RecorderPrefix::ledger([5; 7]).of_signer(&SignerId([3; 32])),
            seq: 6,
            topic_id: TopicId([7; 16]),
            filters: vec![FilterId([8; 8]); filters],
            captured_at: Timestamp(9),
            head_length: 100,
            body_length: 1000,
            salt: Salt([10; 24]),
            commit: Commit([11; 32]),
        }
    }

    #[test]
    fn round_trip_with_every_filter_count() {
        for filters in 0..=MOST_FILTERS {
            let header = sample(filters);
            let bytes = header.encode();
            assert_eq!(Header::parse(&bytes), Ok((header, bytes.len())));
            for cut in 0..bytes.len() {
                assert!(Header::parse(&bytes[..cut]).is_err());
            }
        }
    }

    #[test]
    fn another_version_is_refused() {
        for version in [0, 2, 255] {
            let mut bytes = sample(1).encode();
            bytes[8] = version;
            assert_eq!(Header::parse(&bytes), Err(WireError::Value("version")), "{version}");
        }
    }

    #[test]
    fn a_number_of_another_keys_recorder_or_out_of_bounds_is_refused() {
        type Change = fn(&mut Header);
        let sealed = |change: Change| {
            let mut header = sample(1);
            change(&mut header);
            Header::parse(&header.encode()).map(|_| ()).map_err(|error| error.to_string())
        };
        assert_eq!(sealed(|header| header.seq = LARGEST_SEQ), Ok(()));
        let refused: [(Change, &str); 6] = [
            (|header| header.seq = LARGEST_SEQ + 1, "seq"),
            (|header| header.seq = u64::MAX >> 1, "seq"),
            (|header| header.epoch = 1 << 63, "epoch"),
            (|header| header.captured_at = Timestamp(1 << 63), "capture time"),
            (|header| header.signer = SignerId([4; 32]), "recorder"),
            (|header| header.recorder.0[0] = 0, "recorder"),
        ];
        for (change, field) in refused {
            let error = sealed(change).expect_err(field);
            assert!(error.starts_with(&format!("the {field}")), "{error}");
        }
    }

    #[test]
    fn kinds_have_distinct_codes() {
        for kind in (0..=u8::MAX).filter_map(RecordKind::from_code) {
            assert_eq!(RecordKind::from_code(kind.code()), Some(kind));
        }
        assert_eq!(RecordKind::from_code(0), None);
        assert_eq!(RecordKind::from_code(10), None);
    }

    proptest! {
        #[test]
        fn what_parses_is_what_was_written(noise in proptest::collection::vec(any::<u8>(), 0..300), at in 0usize..240, bit in 0u8..8) {
            let _ = Header::parse(&noise);
            let mut bytes = sample(2).encode();
            let at = at % bytes.len();
            bytes[at] ^= 1 << bit;
            if let Ok((header, length)) = Header::parse(&bytes) {
                prop_assert_eq!(header.encode(), &bytes[..length]);
            }
        }
    }
}
