//! Queries and their answers. Topics, types and tags are pseudonyms that the reader computes; the wire carries no
//! names.

use crate::model::header::{LARGEST_STORED, MOST_FILTERS};
use crate::model::wire::{Reader, WireError};
use crate::model::{Address, Digest, FilterId, RecordKind, RecorderId, Timestamp, TopicId};

use super::answer::Standing;

/// The most entries on a page.
pub const MOST_ENTRIES: usize = 500;

/// A selection of records: owner (20) || flags (1: topic 1, kind 2) || topic id (16, zeros without) || kind (1, 0
/// without) || filter count (1) || filters (8 each).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Selection {
    /// The owner.
    pub owner: Address,
    /// Of one topic only.
    pub topic_id: Option<TopicId>,
    /// Of one kind only.
    pub kind: Option<RecordKind>,
    /// With all of these filter ids.
    pub filters: Vec<FilterId>,
}

impl Selection {
    /// All records of an owner.
    pub fn all(owner: Address) -> Self {
        Self { owner, topic_id: None, kind: None, filters: Vec::new() }
    }

    pub(super) fn encode(&self) -> Vec<u8> {
        let flags = u8::from(self.topic_id.is_some()) | u8::from(self.kind.is_some()) << 1;
        let topic = self.topic_id.map_or([0; 16], |id| id.0);
        let filters = &self.filters[..self.filters.len().min(MOST_FILTERS)];
        let mut out = [&self.owner.0[..], &[flags], &topic].concat();
        out.push(self.kind.map_or(0, RecordKind::code));
        out.push(u8::try_from(filters.len()).unwrap_or(0));
        filters.iter().for_each(|filter| out.extend_from_slice(&filter.0));
        out
    }

    pub(super) fn read(reader: &mut Reader<'_>) -> Result<Self, WireError> {
        let owner = Address(reader.array("owner")?);
        let flags = reader.u8("flags")?;
        let topic: [u8; 16] = reader.array("topic id")?;
        let kind = reader.u8("kind")?;
        let topic_id = optional(flags & 1 != 0, TopicId(topic), topic == [0; 16], "topic id")?;
        let code = RecordKind::from_code(kind);
        let kind = match (flags & 2 != 0, code) {
            (true, Some(code)) => Some(code),
            (false, None) if kind == 0 => None,
            _ => return Err(WireError::Value("kind")),
        };
        if flags > 3 {
            return Err(WireError::Value("flags"));
        }
        let count = usize::from(reader.u8("filter count")?);
        if count > MOST_FILTERS {
            return Err(WireError::Value("filter count"));
        }
        let filters = (0..count).map(|_| reader.array("filter").map(FilterId)).collect::<Result<_, _>>()?;
        Ok(Self { owner, topic_id, kind, filters })
    }
}

/// Absent values are zeros, so that every message has exactly one encoding.
fn optional<T>(present: bool, value: T, zero: bool, field: &'static str) -> Result<Option<T>, WireError> {
    match (present, zero) {
        (true, _) => Ok(Some(value)),
        (false, true) => Ok(None),
        (false, false) => Err(WireError::Value(field)),
    }
}

/// A page of a list: selection || from (8) || until (8) || cursor (16) || limit (2).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Query {
    /// The selection.
    pub selection: Selection,
    /// Captured at or after.
    pub from: Timestamp,
    /// Captured before.
    pub until: Timestamp,
    /// 0 for the first page, then the previous page's [`Page::next`].
    pub cursor: u128,
    /// Entries wanted, 1 to [`MOST_ENTRIES`].
    pub limit: u16,
}

impl Query {
    pub(super) fn encode(&self) -> Vec<u8> {
        let mut out = self.selection.encode();
        out.extend_from_slice(&self.from.0.to_be_bytes());
        out.extend_from_slice(&self.until.0.to_be_bytes());
        out.extend_from_slice(&self.cursor.to_be_bytes());
        out.extend_from_slice(&self.limit.to_be_bytes());
        out
    }

    pub(super) fn read(reader: &mut Reader<'_>) -> Result<Self, WireError> {
        let query = Self {
            selection: Selection::read(reader)?,
            // No record was captured after this, and no ledger can compare it. An end beyond it means none.
            from: Some(reader.u64("from")?)
                .filter(|from| *from <= LARGEST_STORED)
                .map(Timestamp)
                .ok_or(WireError::Value("from"))?,
            until: Timestamp(reader.u64("until")?),
            cursor: u128::from_be_bytes(reader.array("cursor")?),
            limit: reader.u16("limit")?,
        };
        let allowed = (1..=MOST_ENTRIES).contains(&usize::from(query.limit));
        if allowed { Ok(query) } else { Err(WireError::Value("limit")) }
    }
}

/// A gateway's entry for a record: digest (32) owner (20) recorder (16) seq (8) topic id (16) epoch (8) capture time
/// (8) length (8) kind (1) standing (1).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Entry {
    /// D.
    pub digest: Digest,
    /// The owner.
    pub owner: Address,
    /// The recorder.
    pub recorder: RecorderId,
    /// Its seq.
    pub seq: u64,
    /// Pseudonym of its topic.
    pub topic_id: TopicId,
    /// The epoch whose key sealed it.
    pub epoch: u64,
    /// When it was captured.
    pub captured_at: Timestamp,
    /// Bytes of the blob.
    pub length: u64,
    /// The kind of record.
    pub kind: RecordKind,
    /// Its standing.
    pub standing: Standing,
}

impl Entry {
    /// Bytes of its encoding.
    pub const LENGTH: usize = 118;

    pub(super) fn encode(&self) -> Vec<u8> {
        let parts: [&[u8]; 9] = [
            &self.digest.0,
            &self.owner.0,
            &self.recorder.0,
            &self.seq.to_be_bytes(),
            &self.topic_id.0,
            &self.epoch.to_be_bytes(),
            &self.captured_at.0.to_be_bytes(),
            &self.length.to_be_bytes(),
            &[self.kind.code(), self.standing.code()],
        ];
        parts.concat()
    }

    pub(super) fn read(reader: &mut Reader<'_>) -> Result<Self, WireError> {
        Ok(Self {
            digest: Digest(reader.array("digest")?),
            owner: Address(reader.array("owner")?),
            recorder: RecorderId(reader.array("recorder")?),
            seq: reader.u64("seq")?,
            topic_id: TopicId(reader.array("topic id")?),
            epoch: reader.u64("epoch")?,
            captured_at: Timestamp(reader.u64("capture time")?),
            length: reader.u64("length")?,
            kind: RecordKind::from_code(reader.u8("kind")?).ok_or(WireError::Value("kind"))?,
            standing: Standing::from_code(reader.u8("standing")?).ok_or(WireError::Value("standing"))?,
        })
    }
}

/// A page: count (2) || entries || next cursor (16, 0 after the last page).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Page {
    /// At most [`MOST_ENTRIES`].
    pub entries: Vec<Entry>,
    /// Cursor of the next page.
    pub next: Option<u128>,
}

impl Page {
    pub(super) fn encode(&self) -> Vec<u8> {
        let entries = &self.entries[..self.entries.len().min(MOST_ENTRIES)];
        let mut out = u16::try_from(entries.len()).unwrap_or(u16::MAX).to_be_bytes().to_vec();
        entries.iter().for_each(|entry| out.extend_from_slice(&entry.encode()));
        out.extend_from_slice(&self.next.unwrap_or(0).to_be_bytes());
        out
    }

    pub(super) fn read(reader: &mut Reader<'_>) -> Result<Self, WireError> {
        let count = usize::from(reader.u16("entry count")?);
        if count > MOST_ENTRIES {
            return Err(WireError::Value("entry count"));
        }
        let entries = (0..count).map(|_| Entry::read(reader)).collect::<Result<_, _>>()?;
        let next = u128::from_be_bytes(reader.array("next")?);
        Ok(Self { entries, next: (next != 0).then_some(next) })
    }
}
