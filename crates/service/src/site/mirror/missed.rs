//! Records that came before the chain here knew enough to take them in: its node was behind, so neither the block of their
//! anchor nor the loan of their signer's key was known. They are told once, and so they are asked for again.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use crate::gateway::Entry;
use crate::model::{Address, Digest};

/// The most that are remembered; further ones come with the next listing.
const MOST: usize = 1024;
/// The first pause before they are asked for again, and the longest.
const PAUSES: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(60));

/// What is to be asked for again.
#[derive(Debug, Default)]
pub(super) struct Missed {
    entries: BTreeMap<Digest, (Address, Entry)>,
    again: Option<Instant>,
    pause: Duration,
}

impl Missed {
    /// A record of an owner could not be taken in now.
    pub fn add(&mut self, source: Address, entry: &Entry, now: Instant) {
        if self.entries.len() < MOST {
            self.entries.insert(entry.digest, (source, *entry));
        }
        if self.again.is_none() {
            self.pause = (self.pause * 2).clamp(PAUSES.0, PAUSES.1);
            self.again = Some(now + self.pause);
        }
    }

    /// What is due. Those that are missed again have to be added again.
    pub fn due(&mut self, now: Instant) -> Vec<(Address, Entry)> {
        match self.again {
            Some(again) if again <= now => {
                self.again = None;
                std::mem::take(&mut self.entries).into_values().collect()
            }
            Some(_) => Vec::new(),
            None => {
                // All of the last time were taken.
                self.pause = Duration::ZERO;
                Vec::new()
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gateway::Standing;
    use crate::model::{RecordKind, RecorderId, Timestamp, TopicId};

    const ALICE: Address = Address([1; 20]);

    fn entry(number: u8) -> Entry {
        Entry {
            digest: Digest([number; 32]),
            owner: ALICE,
            recorder: RecorderId([2; 16]),
            seq: number.into(),
            topic_id: TopicId([3; 16]),
            epoch: 1,
            captured_at: Timestamp(4),
            length: 5,
            kind: RecordKind::Data,
            standing: Standing::Verified,
        }
    }

    #[test]
    fn what_was_missed_is_asked_for_again_after_pauses_that_grow_and_begin_anew() {
        let begun = Instant::now();
        let (mut missed, mut now) = (Missed::default(), begun);
        assert!(missed.due(now).is_empty());
        let mut pauses = Vec::new();
        for _ in 0..8 {
            missed.add(ALICE, &entry(1), now);
            missed.add(ALICE, &entry(1), now);
            let asked = now;
            while missed.due(now).is_empty() {
                now += Duration::from_millis(250);
            }
            pauses.push((now - asked).as_secs());
        }
        assert_eq!(pauses, [1, 2, 4, 8, 16, 32, 60, 60]);
        assert!(missed.due(now).is_empty(), "it was taken");
        missed.add(ALICE, &entry(2), now);
        assert!(missed.due(now).is_empty());
        assert_eq!(missed.due(now + PAUSES.0).len(), 1, "another one is asked for soon");
    }

    #[test]
    fn who_tells_of_endless_records_fills_no_memory() {
        let (mut missed, now) = (Missed::default(), Instant::now());
        for number in 0..4000_u32 {
            let mut digest = [0; 32];
            digest[..4].copy_from_slice(&number.to_be_bytes());
            missed.add(ALICE, &Entry { digest: Digest(digest), ..entry(1) }, now);
        }
        assert_eq!(missed.due(now + PAUSES.1).len(), MOST);
    }
}
