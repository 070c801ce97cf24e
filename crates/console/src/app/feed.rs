//! Data by pull: a note says that a part changed, then the lists on screen are requested again, with at most one
//! request per list in flight.

use crate::model::Timestamp;
use crate::service::{Failure, Part};

/// Nanoseconds before a failed request is repeated.
const RETRY_AFTER: u64 = 5_000_000_000;

/// One list or view that the site can be asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Feed {
    /// `SiteStatus`.
    Site,
    /// `ShowIdentity`.
    Identity,
    /// `ListKeys`.
    Keys,
    /// `ListTopics`.
    Topics,
    /// `ListUploads`, one page.
    Uploads,
    /// `ListShared`, one page.
    Shared,
    /// `ListGrants`.
    Grants,
    /// `ChainStatus`.
    Chain,
    /// `ListAudit`.
    Audit,
    /// `Operation::GatewayStatus`.
    Gateway,
    /// `ListContacts`.
    Contacts,
    /// `RecordingProgress`.
    Progress,
    /// `ListIncidents`.
    Incidents,
    /// `ListRobots`.
    Robots,
}

impl Feed {
    /// All feeds.
    pub const ALL: [Self; 14] = [
        Self::Site,
        Self::Identity,
        Self::Keys,
        Self::Topics,
        Self::Uploads,
        Self::Shared,
        Self::Grants,
        Self::Chain,
        Self::Audit,
        Self::Gateway,
        Self::Contacts,
        Self::Progress,
        Self::Incidents,
        Self::Robots,
    ];

    /// What a change of `part` makes out of date.
    pub fn touched_by(part: Part) -> &'static [Self] {
        match part {
            Part::Topics => &[Self::Topics],
            Part::Uploads => &[Self::Uploads, Self::Site, Self::Gateway],
            Part::Grants => &[Self::Grants, Self::Shared, Self::Audit],
            Part::Chain => &[Self::Chain, Self::Shared, Self::Gateway],
            Part::Health => &[Self::Site, Self::Gateway],
            Part::Identity => &[Self::Identity, Self::Keys, Self::Audit, Self::Robots],
        }
    }
}

/// The state of one feed.
#[expect(clippy::struct_excessive_bools, reason = "each is a fact of its own")]
#[derive(Debug, Clone, Default)]
pub struct Slot {
    /// Increased when the request itself changes, so that older answers are dropped.
    pub generation: u64,
    /// A request is in flight.
    pub outstanding: bool,
    /// The data here is older than the site's.
    pub stale: bool,
    /// Data arrived at least once.
    pub loaded: bool,
    /// The data here is from an earlier visit to its screen.
    pub left: bool,
    /// The request answered by the data here.
    pub told: u64,
    /// Why the last request failed.
    pub failure: Option<Failure>,
    /// When a failed request is repeated.
    pub retry_at: Option<Timestamp>,
}

impl Slot {
    /// Whether the data here answers the present request.
    pub fn is_answered(&self) -> bool {
        self.loaded && self.told == self.generation
    }
}

/// All slots.
#[derive(Debug, Clone)]
pub struct Feeds([Slot; Feed::ALL.len()]);

impl Default for Feeds {
    fn default() -> Self {
        Self(std::array::from_fn(|_| Slot { stale: true, ..Slot::default() }))
    }
}

impl Feeds {
    /// One feed's slot.
    pub fn slot(&self, feed: Feed) -> &Slot {
        &self.0[feed as usize]
    }

    /// One feed's slot, mutable.
    pub fn slot_mut(&mut self, feed: Feed) -> &mut Slot {
        &mut self.0[feed as usize]
    }

    /// The data of `part` is out of date.
    pub fn touch(&mut self, part: Part) {
        for feed in Feed::touched_by(part) {
            self.slot_mut(*feed).stale = true;
        }
    }

    /// Everything is out of date.
    pub fn touch_all(&mut self) {
        for slot in &mut self.0 {
            slot.stale = true;
        }
    }

    /// What could not be had is out of date.
    pub fn touch_failed(&mut self) {
        for slot in self.0.iter_mut().filter(|slot| slot.failure.is_some()) {
            slot.stale = true;
        }
    }

    /// The screen of a feed becomes visible: data that is not up to date is from the last visit.
    pub fn look(&mut self, feed: Feed) {
        let slot = self.slot_mut(feed);
        slot.left |= slot.stale && slot.loaded;
    }

    /// The request itself changed (page, filter): send it anew and drop the answer in flight.
    pub fn renew(&mut self, feed: Feed) {
        let slot = self.slot_mut(feed);
        slot.generation += 1;
        slot.outstanding = false;
        slot.stale = true;
    }

    /// An act of this console changed the data. An answer in flight may be from before it, and is dropped; what is shown
    /// answers the same request as the next one does.
    pub fn overtake(&mut self, feed: Feed) {
        let slot = self.slot_mut(feed);
        slot.stale = true;
        if std::mem::take(&mut slot.outstanding) {
            slot.told += u64::from(slot.told == slot.generation);
            slot.generation += 1;
        }
    }

    /// No answer to a request of `former` answers one of these.
    pub fn follow(&mut self, former: &Self) {
        for (slot, before) in self.0.iter_mut().zip(&former.0) {
            slot.generation = before.generation + 1;
        }
    }

    /// All are requested anew, once, even though the view is frozen from now on.
    pub fn gather(&mut self) {
        Feed::ALL.into_iter().for_each(|feed| self.renew(feed));
    }

    /// Handles an answer; false if it answers an older request.
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

    /// Marks failed feeds whose pause is over as out of date.
    pub fn retry(&mut self, now: Timestamp) {
        for slot in self.0.iter_mut().filter(|slot| slot.retry_at.is_some_and(|at| at <= now)) {
            slot.retry_at = None;
            slot.stale = true;
        }
    }

    /// The next moment at which a failed request is repeated.
    pub fn next_retry(&self) -> Option<Timestamp> {
        self.0.iter().filter_map(|slot| slot.retry_at).min()
    }
}
