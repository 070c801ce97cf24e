//! What the console asks the site for, and how old each answer is.

use strum::{EnumCount, EnumIter, IntoEnumIterator as _};

use crate::model::Timestamp;
use crate::service::{Failure, Part};

/// Nanoseconds.
const RETRY_AFTER: u64 = 5_000_000_000;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, EnumCount, EnumIter)]
pub enum Feed {
    Site,
    Identity,
    Keys,
    Topics,
    Records,
    Received,
    Grants,
    Chain,
    Audit,
    Gateway,
    Contacts,
    Progress,
    Incidents,
    Robots,
}

impl Feed {
    pub fn touched_by(part: Part) -> &'static [Self] {
        match part {
            Part::Topics => &[Self::Topics],
            Part::Uploads => &[Self::Records, Self::Site, Self::Gateway],
            Part::Grants => &[Self::Grants, Self::Received, Self::Audit],
            Part::Chain => &[Self::Chain, Self::Received, Self::Gateway],
            Part::Health => &[Self::Site, Self::Gateway],
            Part::Identity => &[Self::Identity, Self::Keys, Self::Audit, Self::Robots],
        }
    }
}

#[expect(clippy::struct_excessive_bools, reason = "each is a fact of its own")]
#[derive(Debug, Clone, Default)]
pub struct Slot {
    /// Grows when the request changes, so that older answers are dropped.
    pub generation: u64,
    /// In flight.
    pub outstanding: bool,
    /// Older than the site's data.
    pub stale: bool,
    /// Answered at least once.
    pub loaded: bool,
    /// From an earlier visit to the screen.
    pub left: bool,
    /// The generation that the data answers.
    pub told: u64,
    pub failure: Option<Failure>,
    pub retry_at: Option<Timestamp>,
}

impl Slot {
    pub fn is_answered(&self) -> bool {
        self.loaded && self.told == self.generation
    }
}

#[derive(Debug, Clone)]
pub struct Feeds([Slot; Feed::COUNT]);

impl Default for Feeds {
    fn default() -> Self {
        Self(std::array::from_fn(|_| Slot { stale: true, ..Slot::default() }))
    }
}

impl Feeds {
    pub fn slot(&self, feed: Feed) -> &Slot {
        &self.0[feed as usize]
    }

    pub fn slot_mut(&mut self, feed: Feed) -> &mut Slot {
        &mut self.0[feed as usize]
    }

    pub fn touch(&mut self, part: Part) {
        for feed in Feed::touched_by(part) {
            self.slot_mut(*feed).stale = true;
        }
    }

    pub fn touch_all(&mut self) {
        for slot in &mut self.0 {
            slot.stale = true;
        }
    }

    pub fn touch_failed(&mut self) {
        for slot in self.0.iter_mut().filter(|slot| slot.failure.is_some()) {
            slot.stale = true;
        }
    }

    /// Marks data that went stale while its screen was hidden.
    pub fn look(&mut self, feed: Feed) {
        let slot = self.slot_mut(feed);
        slot.left |= slot.stale && slot.loaded;
    }

    /// The request changed (page, filter): drops the answer in flight.
    pub fn renew(&mut self, feed: Feed) {
        let slot = self.slot_mut(feed);
        slot.generation += 1;
        slot.outstanding = false;
        slot.stale = true;
    }

    /// An act of this console changed the data: an answer in flight may predate it, and is dropped.
    pub fn overtake(&mut self, feed: Feed) {
        let slot = self.slot_mut(feed);
        slot.stale = true;
        if std::mem::take(&mut slot.outstanding) {
            slot.told += u64::from(slot.told == slot.generation);
            slot.generation += 1;
        }
    }

    /// Answers to requests of `former` match none of these.
    pub fn follow(&mut self, former: &Self) {
        for (slot, before) in self.0.iter_mut().zip(&former.0) {
            slot.generation = before.generation + 1;
        }
    }

    /// Requests everything once, even though the view is frozen from now on.
    pub fn gather(&mut self) {
        Feed::iter().for_each(|feed| self.renew(feed));
    }

    /// False for an answer to an older request.
    pub fn answered(&mut self, feed: Feed, generation: u64, failure: Option<Failure>, now: Timestamp) -> bool {
        let slot = self.slot_mut(feed);
        if slot.generation != generation {
            return false;
        }
        slot.outstanding = false;
        if failure.is_none() {
            (slot.loaded, slot.left, slot.told) = (true, false, generation);
        }
        slot.retry_at = failure.as_ref().map(|_| Timestamp(now.0.saturating_add(RETRY_AFTER)));
        slot.failure = failure;
        true
    }

    pub fn retry(&mut self, now: Timestamp) {
        for slot in self.0.iter_mut().filter(|slot| slot.retry_at.is_some_and(|at| at <= now)) {
            slot.retry_at = None;
            slot.stale = true;
        }
    }

    pub fn next_retry(&self) -> Option<Timestamp> {
        self.0.iter().filter_map(|slot| slot.retry_at).min()
    }
}
