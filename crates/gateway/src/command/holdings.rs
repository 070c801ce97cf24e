//! What gateways of one fleet tell and give each other: which anchored records one holds, as ranges of numbers by
//! recorder and topic, in the order of the anchoring blocks; then the records of a range, with their proofs.

use crate::model::wire::{Reader, WireError};
use crate::model::{Address, Header, Ranges, RecorderId, TopicId};

use super::answer::Fetched;

/// The most numbers told in one answer, and asked for in one request.
pub const MOST_TOLD: u64 = 8192;
/// The most records handed over in one answer.
pub const MOST_HANDED: usize = 64;
/// The most ranges that are asked for at once.
pub const MOST_RANGES: usize = 64;
/// Bytes of a range that is asked for.
const RANGE: usize = 68;
/// No further record is handed over once an answer has this many bytes; a single longer one travels alone.
pub const MOST_HANDED_BYTES: usize = 4 * 1024 * 1024;

/// A place in a gateway's holdings: block (8) || batch (8) || leaf (8). Only the block means something to others: a place
/// of a block that begins with zeros stands before all that the block anchors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub struct HoldingPlace {
    /// The block of the anchor.
    pub block: u64,
    /// The gateway's own number of the batch.
    pub batch: u64,
    /// The record's place in the batch.
    pub leaf: u64,
}

impl HoldingPlace {
    pub(super) fn encode(&self) -> Vec<u8> {
        [self.block, self.batch, self.leaf].into_iter().flat_map(u64::to_be_bytes).collect()
    }

    pub(super) fn read(reader: &mut Reader<'_>) -> Result<Self, WireError> {
        Ok(Self { block: reader.u64("block")?, batch: reader.u64("batch")?, leaf: reader.u64("leaf")? })
    }
}

/// Records of one recorder and topic: owner (20) || recorder (16) || topic id (16) || count (2) || first (8) || last (8)
/// of each range.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Held {
    /// The owner.
    pub owner: Address,
    /// The recorder.
    pub recorder: RecorderId,
    /// Pseudonym of the topic.
    pub topic_id: TopicId,
    /// Their numbers.
    pub ranges: Ranges,
}

impl Held {
    fn encode(&self) -> Vec<u8> {
        let count = u16::try_from(self.ranges.iter().len()).unwrap_or(u16::MAX);
        let mut out = [&self.owner.0[..], &self.recorder.0, &self.topic_id.0, &count.to_be_bytes()].concat();
        for (first, last) in self.ranges.iter().take(usize::from(count)) {
            out.extend_from_slice(&first.to_be_bytes());
            out.extend_from_slice(&last.to_be_bytes());
        }
        out
    }

    /// `left` is how many numbers may still be told.
    fn read(reader: &mut Reader<'_>, left: &mut u64) -> Result<Self, WireError> {
        let owner = Address(reader.array("owner")?);
        let (recorder, topic_id) = (RecorderId(reader.array("recorder")?), TopicId(reader.array("topic id")?));
        let count = reader.u16("range count")?;
        if count == 0 || u64::from(count) > *left {
            return Err(WireError::Value("range count"));
        }
        let mut ranges = Ranges::default();
        for _ in 0..count {
            if !ranges.push(reader.u64("first number")?, reader.u64("last number")?) {
                return Err(WireError::Value("range"));
            }
        }
        *left = left.checked_sub(ranges.count()).ok_or(WireError::Value("range"))?;
        Ok(Self { owner, recorder, topic_id, ranges })
    }
}

/// A part of a gateway's holdings: count (2) || entries || next place (24) || whether there is more (1).
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Holdings {
    /// What it holds; at most [`MOST_TOLD`] numbers in all.
    pub held: Vec<Held>,
    /// Where the next part begins.
    pub next: HoldingPlace,
    /// Whether there is one now.
    pub more: bool,
}

impl Holdings {
    pub(super) fn encode(&self) -> Vec<u8> {
        let count = u16::try_from(self.held.len()).unwrap_or(u16::MAX);
        let mut out = count.to_be_bytes().to_vec();
        self.held.iter().take(usize::from(count)).for_each(|held| out.extend_from_slice(&held.encode()));
        out.extend_from_slice(&self.next.encode());
        out.push(u8::from(self.more));
        out
    }

    pub(super) fn read(reader: &mut Reader<'_>) -> Result<Self, WireError> {
        let (count, mut left) = (reader.u16("holding count")?, MOST_TOLD);
        if u64::from(count) > MOST_TOLD {
            return Err(WireError::Value("holding count"));
        }
        let held = (0..count).map(|_| Held::read(reader, &mut left)).collect::<Result<_, _>>()?;
        let next = HoldingPlace::read(reader)?;
        let more = match reader.u8("more")? {
            0 => false,
            1 => true,
            _ => return Err(WireError::Value("more")),
        };
        Ok(Self { held, next, more })
    }
}

/// The records of a range: owner (20) || recorder (16) || topic id (16) || first (8) || last (8), at most [`MOST_TOLD`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Wanted {
    /// The owner.
    pub owner: Address,
    /// The recorder.
    pub recorder: RecorderId,
    /// Pseudonym of the topic.
    pub topic_id: TopicId,
    /// The first number.
    pub first: u64,
    /// The last.
    pub last: u64,
}

impl Wanted {
    pub(super) fn encode(&self) -> Vec<u8> {
        let (first, last) = (self.first.to_be_bytes(), self.last.to_be_bytes());
        [&self.owner.0[..], &self.recorder.0, &self.topic_id.0, &first, &last].concat()
    }

    pub(super) fn read(reader: &mut Reader<'_>) -> Result<Self, WireError> {
        let wanted = Self {
            owner: Address(reader.array("owner")?),
            recorder: RecorderId(reader.array("recorder")?),
            topic_id: TopicId(reader.array("topic id")?),
            first: reader.u64("first number")?,
            last: reader.u64("last number")?,
        };
        let mut range = Ranges::default();
        let fits = range.push(wanted.first, wanted.last) && range.count() <= MOST_TOLD;
        if fits { Ok(wanted) } else { Err(WireError::Value("range")) }
    }

    /// Whether a record is one of the range.
    pub fn has(&self, header: &Header) -> bool {
        (self.owner, self.recorder, self.topic_id) == (header.owner, header.recorder, header.topic_id)
            && (self.first..=self.last).contains(&header.seq)
    }

    /// How many numbers the range has.
    pub fn count(&self) -> u64 {
        self.last.saturating_sub(self.first).saturating_add(1)
    }
}

/// Several ranges, one after the other; those that are too many are left out.
pub(super) fn encode_wanted(wanted: &[Wanted]) -> Vec<u8> {
    wanted.iter().take(MOST_RANGES).flat_map(Wanted::encode).collect()
}

/// One range, or several of at most [`MOST_TOLD`] numbers in all.
pub(super) fn read_wanted(reader: &mut Reader<'_>) -> Result<Vec<Wanted>, WireError> {
    let ranges = reader.rest().len().div_ceil(RANGE).max(1);
    if ranges > MOST_RANGES {
        return Err(WireError::Value("range count"));
    }
    let wanted = (0..ranges).map(|_| Wanted::read(reader)).collect::<Result<Vec<_>, _>>()?;
    if wanted.iter().map(Wanted::count).sum::<u64>() > MOST_TOLD {
        return Err(WireError::Value("range"));
    }
    Ok(wanted)
}

/// Records of a range, in the order of their numbers: count (2) || length (4) and record, as an answer to Fetch, each ||
/// the number to go on with (8), 0 at the end of the range.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct HandedOver {
    /// At most [`MOST_HANDED`]; a number that is missing is not, or no longer, there.
    pub records: Vec<Fetched>,
    /// The number to ask from next.
    pub next: Option<u64>,
}

impl HandedOver {
    pub(super) fn encode(&self) -> Vec<u8> {
        let records = &self.records[..self.records.len().min(MOST_HANDED)];
        let mut out = u16::try_from(records.len()).unwrap_or(u16::MAX).to_be_bytes().to_vec();
        for record in records {
            let bytes = record.encode();
            out.extend_from_slice(&u32::try_from(bytes.len()).unwrap_or(u32::MAX).to_be_bytes());
            out.extend_from_slice(&bytes);
        }
        out.extend_from_slice(&self.next.unwrap_or(0).to_be_bytes());
        out
    }

    pub(super) fn read(reader: &mut Reader<'_>) -> Result<Self, WireError> {
        let count = usize::from(reader.u16("record count")?);
        if count > MOST_HANDED {
            return Err(WireError::Value("record count"));
        }
        let mut records = Vec::new();
        for _ in 0..count {
            let length = usize::try_from(reader.u32("record length")?).unwrap_or(usize::MAX);
            let mut record = Reader::new(reader.take(length, "record")?);
            records.push(Fetched::read(&mut record)?);
        }
        let next = reader.u64("next number")?;
        Ok(Self { records, next: (next != 0).then_some(next) })
    }
}

/// Records of several ranges, in the order in which those were asked for: an answer for one range || the range to go on in
/// (2), counted from 0.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ManyHandedOver {
    /// The records, and the number to ask from next.
    pub handed: HandedOver,
    /// In which range that is; those before it are done. Means nothing at the end of the last one.
    pub range: u16,
}

impl ManyHandedOver {
    pub(super) fn encode(&self) -> Vec<u8> {
        let mut out = self.handed.encode();
        out.extend_from_slice(&self.range.to_be_bytes());
        out
    }

    /// Without a range it is the answer for one.
    pub(super) fn read(reader: &mut Reader<'_>) -> Result<(HandedOver, Option<u16>), WireError> {
        let handed = HandedOver::read(reader)?;
        let range = if reader.rest().is_empty() { None } else { Some(reader.u16("range")?) };
        Ok((handed, range))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gateway::{Answer, Command, Request};

    fn wanted(first: u64, last: u64) -> Wanted {
        let (owner, recorder) = (Address([1; 20]), RecorderId([2; 16]));
        Wanted { owner, recorder, topic_id: TopicId([3; 16]), first, last }
    }

    /// An answer with these ranges of one topic, whatever they are.
    fn told(claimed: u16, ranges: &[(u64, u64)]) -> Vec<u8> {
        let mut out = [&1_u16.to_be_bytes()[..], &[7; 52], &claimed.to_be_bytes()].concat();
        ranges.iter().flat_map(|(first, last)| [*first, *last]).for_each(|n| out.extend_from_slice(&n.to_be_bytes()));
        out.extend_from_slice(&[0; 25]);
        out
    }

    #[test]
    fn ranges_that_are_reversed_overlap_or_are_endless_are_no_message() {
        let parse = |claimed, ranges: &[(u64, u64)]| Answer::parse(Command::Holdings, &told(claimed, ranges));
        assert!(parse(2, &[(1, 3), (5, 5)]).is_ok());
        assert!(parse(1, &[(1, MOST_TOLD)]).is_ok());
        let lies: [&[(u64, u64)]; 9] = [
            &[(3, 1)],
            &[(0, 1)],
            &[(1, 3), (3, 4)],
            &[(1, 3), (4, 5)],
            &[(5, 6), (1, 2)],
            &[(1, u64::MAX)],
            &[(1, MOST_TOLD + 1)],
            &[(1, MOST_TOLD), (MOST_TOLD + 2, MOST_TOLD + 2)],
            &[(u64::MAX, u64::MAX)],
        ];
        for ranges in lies {
            assert!(parse(u16::try_from(ranges.len()).expect("few"), ranges).is_err(), "{ranges:?}");
        }
        assert!(parse(0, &[]).is_err() && parse(u16::MAX, &[(1, 1)]).is_err(), "absurd counts");
        assert!(Answer::parse(Command::Holdings, &[0xff; 60]).is_err());
    }

    #[test]
    fn a_wanted_range_is_no_longer_than_what_is_told_at_once() {
        let parse = |wanted: Wanted| Request::parse(Command::HandOver, &wanted.encode());
        assert!(parse(wanted(1, MOST_TOLD)).is_ok() && parse(wanted(9, 9)).is_ok());
        for (first, last) in [(0, 1), (2, 1), (1, MOST_TOLD + 1), (1, u64::MAX), (u64::MAX, u64::MAX)] {
            assert!(parse(wanted(first, last)).is_err(), "{first} to {last}");
        }
    }

    #[test]
    fn ranges_that_are_asked_for_together_are_few_and_have_no_more_numbers_than_are_told_at_once() {
        let parse = |wanted: &[Wanted]| Request::parse(Command::HandOver, &encode_wanted(wanted));
        assert_eq!(parse(&[wanted(1, 2)]), Ok(Request::HandOver(wanted(1, 2))), "one is what it always was");
        let half = MOST_TOLD / 2;
        for some in [vec![wanted(1, half), wanted(half + 1, MOST_TOLD)], vec![wanted(3, 3); MOST_RANGES]] {
            assert_eq!(parse(&some), Ok(Request::HandOverMany(some)));
        }
        assert!(parse(&[wanted(1, half), wanted(1, half + 1)]).is_err());
        assert!(parse(&[wanted(1, 1), wanted(5, 4)]).is_err());
        let many = vec![wanted(1, 1).encode(); MOST_RANGES + 1].concat();
        assert!(Request::parse(Command::HandOver, &many).is_err());
        assert!(Request::parse(Command::HandOver, &many[..RANGE * 3 - 1]).is_err());
    }

    #[test]
    fn a_count_of_records_is_bounded_before_anything_is_kept() {
        let many = u16::try_from(MOST_HANDED + 1).expect("few").to_be_bytes();
        assert!(Answer::parse(Command::HandOver, &[&many[..], &vec![0; 70_000]].concat()).is_err());
        let long = [&1_u16.to_be_bytes()[..], &u32::MAX.to_be_bytes(), &[0; 500]].concat();
        assert!(Answer::parse(Command::HandOver, &long).is_err());
    }
}
