//! What keeps a gateway from wearing this site out: pauses between rounds, between pages that bring nothing, and before
//! missed records are asked for again.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use crate::gateway::{Entry, GatewayError};
use crate::model::{Address, Digest};

/// A round as long as this says nothing of the next one.
const LONG: Duration = Duration::from_secs(10);
/// Short rounds in a row without a pause: several owners share within a moment.
const FREE: u32 = 4;
/// The first pause between rounds after those, and the longest.
const ROUNDS: (Duration, Duration) = (Duration::from_millis(500), Duration::from_secs(5));

/// How soon a mirror's next round may begin: counts short rounds in a row. Rounds end when an owner begins or ceases to share,
/// and a gateway that ends each at once must not keep this site opening sessions.
#[derive(Debug, Default)]
pub(super) struct Pace {
    short: u32,
}

impl Pace {
    /// The pause after a round of this length.
    pub fn after(&mut self, lasted: Duration) -> Duration {
        if lasted >= LONG {
            self.short = 0;
            return Duration::ZERO;
        }
        self.short = self.short.saturating_add(1);
        match self.short.checked_sub(FREE + 1) {
            None => Duration::ZERO,
            Some(further) => (ROUNDS.0 * 2_u32.pow(further.min(8))).min(ROUNDS.1),
        }
    }
}

/// Pauses before the next page, by how many in a row brought nothing new. A page has 500 records.
const PAGES: [(usize, Duration); 2] = [(10_000, Duration::from_millis(100)), (100, Duration::from_millis(10))];
/// The most pages in a row without any entry. Ours have one, unless they are the last.
const MOST_EMPTY: usize = 16;

/// Patience with a gateway's list: the more pages bring nothing, the more slowly they are asked for. A list of what is here
/// already may be long and honest; one of empty pages is not.
#[derive(Debug, Default)]
pub(super) struct Patience {
    idle: usize,
    empty: usize,
}

impl Patience {
    /// How long to wait, if at all, before the page after one with this many entries, of which something was `new`.
    ///
    /// # Errors
    /// One empty page follows another.
    pub fn after(&mut self, entries: usize, new: bool) -> Result<Option<Duration>, GatewayError> {
        self.idle = if new { 0 } else { self.idle + 1 };
        self.empty = if entries > 0 { 0 } else { self.empty + 1 };
        if self.empty > MOST_EMPTY {
            return Err(GatewayError::Unexpected("a list that goes on and brings nothing"));
        }
        Ok(PAGES.iter().find(|(pages, _)| self.idle > *pages).map(|(_, pause)| *pause))
    }
}

/// The most missed records that are remembered; further ones come with the next listing.
const MOST_MISSED: usize = 1024;
/// The first pause before missed records are asked for again, and the longest.
const AGAIN: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(60));

/// Records that came before the chain here knew enough to take them in: its node was behind, so neither the block of their
/// anchor nor the loan of their signer's key was known. They are sent once, so they are asked for again.
#[derive(Debug, Default)]
pub(super) struct Missed {
    entries: BTreeMap<Digest, (Address, Entry)>,
    again: Option<Instant>,
    pause: Duration,
}

impl Missed {
    /// A record of an owner could not be taken in now.
    pub fn add(&mut self, source: Address, entry: &Entry, now: Instant) {
        if self.entries.len() < MOST_MISSED {
            self.entries.insert(entry.digest, (source, *entry));
        }
        if self.again.is_none() {
            self.pause = (self.pause * 2).clamp(AGAIN.0, AGAIN.1);
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
    #![allow(clippy::expect_used, reason = "a test fails by panicking")]

    use super::*;
    use crate::gateway::Standing;
    use crate::model::{RecordKind, RecorderId, Timestamp, TopicId};

    #[test]
    fn a_few_grants_in_a_row_wait_for_nothing_and_rounds_without_end_become_rare() {
        let mut pace = Pace::default();
        let short: Vec<u128> = (0..10).map(|_| pace.after(Duration::from_millis(600)).as_millis()).collect();
        assert_eq!(short, [0, 0, 0, 0, 500, 1_000, 2_000, 4_000, 5_000, 5_000]);
        assert_eq!(pace.after(Duration::from_secs(10)), Duration::ZERO);
        assert_eq!(pace.after(Duration::from_secs(1)), Duration::ZERO, "a long round begins the count anew");
    }

    #[test]
    fn what_is_known_already_is_read_through_slowly_and_empty_pages_end() {
        let mut patience = Patience::default();
        let mut after = |_| patience.after(500, false).expect("it may be honest").map_or(0, |pause| pause.as_millis());
        let pauses: Vec<u128> = (0..30_000).map(&mut after).collect();
        assert_eq!([99, 100, 9_999, 10_000, 29_999].map(|page| pauses[page]), [0, 10, 10, 100, 100]);
        assert!(patience.after(1, true).is_ok_and(|pause| pause.is_none()), "something came");
        let empty = (0..100).find(|_| patience.after(0, false).is_err());
        assert_eq!(empty, Some(MOST_EMPTY));
    }

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
        assert_eq!(missed.due(now + AGAIN.0).len(), 1, "another one is asked for soon");
    }

    #[test]
    fn who_tells_of_endless_records_fills_no_memory() {
        let (mut missed, now) = (Missed::default(), Instant::now());
        for number in 0..4000_u32 {
            let mut digest = [0; 32];
            digest[..4].copy_from_slice(&number.to_be_bytes());
            missed.add(ALICE, &Entry { digest: Digest(digest), ..entry(1) }, now);
        }
        assert_eq!(missed.due(now + AGAIN.1).len(), MOST_MISSED);
    }
}
