//! What the index behind a chunk says of its messages, compared with the messages themselves: rosbag reads by it alone, and
//! in a chunk without a checksum nothing else shows that a time or a connection was altered.

use std::collections::BTreeMap;

use super::record::Fields;

/// Bytes of an entry: a time, and the message's offset in its chunk.
pub(super) const ENTRY: usize = 12;

/// The messages of a chunk, or an index's entries, of one connection; in any order.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
struct Entries {
    count: u64,
    /// Of their digests, which are no secret: who forges a bag can forge its index as well.
    sum: u64,
}

impl Entries {
    fn add(&mut self, entry: [u8; ENTRY]) {
        let number = |part: Option<&[u8; 8]>| part.map_or(0, |bytes| u64::from_le_bytes(*bytes));
        let (time, offset) = (number(entry.first_chunk()), number(entry.last_chunk()));
        self.count += 1;
        self.sum = self.sum.wrapping_add(mixed(mixed(time).wrapping_add(offset)));
    }
}

/// Spreads a number over all bits (SplitMix64), so that sums of different entries differ.
fn mixed(number: u64) -> u64 {
    let number = number.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let number = (number ^ (number >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let number = (number ^ (number >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    number ^ (number >> 31)
}

/// The messages of the chunk that was read last, by connection, without those whose index was met.
#[derive(Debug, Default)]
pub(super) struct ChunkMessages {
    of: BTreeMap<u32, Entries>,
}

impl ChunkMessages {
    /// Adds a message that begins at this offset of its chunk.
    pub fn add(&mut self, fields: &Fields<'_>, offset: usize) {
        let time: Option<[u8; 8]> = fields.bytes("time").and_then(|bytes| bytes.try_into().ok());
        let (Some(connection), Some(time)) = (fields.u32("conn"), time) else { return };
        let mut entry = [0; ENTRY];
        entry[..8].copy_from_slice(&time);
        entry[8..].copy_from_slice(&u32::try_from(offset).unwrap_or(u32::MAX).to_le_bytes());
        self.of.entry(connection).or_default().add(entry);
    }

    /// How many messages of a connection there are.
    pub fn count(&self, connection: u32) -> u64 {
        self.of.get(&connection).map_or(0, |entries| entries.count)
    }

    /// Whether the entries of a connection's index are its messages; these are then done with.
    pub fn take(&mut self, connection: u32, index: &[u8]) -> bool {
        let mut entries = Entries::default();
        index.as_chunks::<ENTRY>().0.iter().for_each(|entry| entries.add(*entry));
        self.of.remove(&connection).unwrap_or_default() == entries
    }

    /// A connection whose index was not met.
    pub fn left(&self) -> Option<u32> {
        self.of.keys().next().copied()
    }
}

/// The position that the index at the end gives for a chunk; `None` if it is not as rosbag writes it.
pub(super) fn chunk_position(fields: &Fields<'_>, length: u64) -> Option<u64> {
    let is_whole = fields.u32("ver") == Some(1)
        && fields.u32("count").is_some_and(|count| u64::from(count) * 8 == length)
        && ["start_time", "end_time"].iter().all(|name| fields.time(name).is_some());
    fields.u64("chunk_pos").filter(|_| is_whole)
}
