//! Data by pull: a note says that a part changed, then the lists on screen are asked for
//! again, at most one question per list under way.

use crate::model::Timestamp;
use crate::service::{Failure, Part};

/// Nanoseconds before a failed question is asked again.
const RETRY_AFTER: u64 = 5_000_000_000;

/// One list or view the site can be asked for.
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
}

impl Feed {
    /// All feeds.
    pub const ALL: [Self; 13] = [
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
    ];

    /// What a change of `part` makes out of date.
    pub fn touched_by(part: Part) -> &'static [Self] {
        match part {
            Part::Topics => &[Self::Topics],
            Part::Uploads => &[Self::Uploads, Self::Site, Self::Gateway],
            Part::Grants => &[Self::Grants, Self::Shared, Self::Audit],
            Part::Chain => &[Self::Chain, Self::Shared, Self::Gateway],
            Part::Health => &[Self::Site, Self::Gateway],
            Part::Identity => &[Self::Identity, Self::Keys, Self::Audit],
        }
    }
}

/// How one feed stands.
#[expect(clippy::struct_excessive_bools, reason = "each is a fact of its own")]
#[derive(Debug, Clone, Default)]
pub struct Slot {
    /// Raised when the question itself changes, so that older answers are dropped.
    pub generation: u64,
    /// A question is under way.
    pub outstanding: bool,
    /// The data on hand is older than the site's.
    pub stale: bool,
    /// Data arrived at least once.
    pub loaded: bool,
    /// The data on hand is from an earlier look at its screen.
    pub left: bool,
    /// The question that the data on hand answers.
    pub told: u64,
    /// Why the last question failed.
    pub failure: Option<Failure>,
    /// When a failed question is asked again.
    pub retry_at: Option<Timestamp>,
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

    /// One feed's slot, to change.
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

    /// The screen of a feed comes into view: what is not up to date is from the last time.
    pub fn look(&mut self, feed: Feed) {
        let slot = self.slot_mut(feed);
        slot.left |= slot.stale && slot.loaded;
    }

    /// The question itself changed (page, filter): ask anew and drop an answer under way.
    pub fn renew(&mut self, feed: Feed) {
        let slot = self.slot_mut(feed);
        slot.generation += 1;
        slot.outstanding = false;
        slot.stale = true;
    }

    /// No answer to what `former` asked is one to these.
    pub fn follow(&mut self, former: &Self) {
        for (slot, before) in self.0.iter_mut().zip(&former.0) {
            slot.generation = before.generation + 1;
        }
    }

    /// All are asked anew, once, though the view stands still from now on.
    pub fn gather(&mut self) {
        Feed::ALL.into_iter().for_each(|feed| self.renew(feed));
    }

    /// Takes note of an answer; false where it answers an older question.
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

    /// Marks failed feeds whose time has come as out of date.
    pub fn retry(&mut self, now: Timestamp) {
        for slot in self.0.iter_mut().filter(|slot| slot.retry_at.is_some_and(|at| at <= now)) {
            slot.retry_at = None;
            slot.stale = true;
        }
    }

    /// The next moment at which a failed question is asked again.
    pub fn next_retry(&self) -> Option<Timestamp> {
        self.0.iter().filter_map(|slot| slot.retry_at).min()
    }
}
