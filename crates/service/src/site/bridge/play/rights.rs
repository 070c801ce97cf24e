//! Whether the right to play continues, and whose next key is on its way.

use std::collections::{HashMap, HashSet};
use std::time::{Duration, Instant};

use super::{Play, RIGHTS, granted_to};
use crate::model::{Address, TopicId, counted};
use crate::service::reply::PlayEnd;
use crate::store::RecordRow;

const UNTOLD: Duration = Duration::from_secs(10);
const LOOK: Duration = Duration::from_millis(500);

/// Wait for a key that may never come: anybody who signs for the owner can name an epoch unknown to the chain.
const UNSURE: Duration = Duration::from_secs(120);

/// Wait where keys exist: those of the newest block may have come after the record was opened.
const JUST_COME: Duration = Duration::from_secs(5);

/// After a key `Came` and opened a record, one that it does not open belongs to somebody else.
pub(super) enum TopicKeyState {
    Came,
    Awaited { since: Instant, looked: Instant, has_begun: bool },
}

type Which = (Address, TopicId, u64);

pub(super) fn key_of(row: &RecordRow) -> Which {
    (row.owner, row.topic_id, row.epoch)
}

#[derive(Default)]
pub(super) struct Keys {
    states: HashMap<Which, TopicKeyState>,
    told: HashSet<(Address, u64)>,
}

impl Keys {
    pub fn looked_for(&self, which: Which, now: Instant) -> bool {
        let state = self.states.get(&which);
        matches!(state, Some(TopicKeyState::Awaited { looked, .. }) if now.duration_since(*looked) < LOOK)
    }

    pub fn came(&mut self, which: Which) {
        self.states.insert(which, TopicKeyState::Came);
    }

    /// The wait so far; `None` if the key came, or `longest` is over.
    fn awaited(&mut self, which: Which, begun: bool, longest: Duration, now: Instant) -> Option<Duration> {
        let fresh = || TopicKeyState::Awaited { since: now, looked: now, has_begun: begun };
        let state = self.states.entry(which).or_insert_with(fresh);
        if matches!(state, TopicKeyState::Awaited { has_begun, .. } if begun && !*has_begun) {
            *state = fresh();
        }
        let TopicKeyState::Awaited { since, looked, .. } = state else { return None };
        let waited = now.duration_since(*since);
        if waited >= longest {
            return None;
        }
        *looked = now;
        Some(waited)
    }
}

impl Play<'_> {
    pub(super) fn awaits_key(&mut self, row: &RecordRow) -> bool {
        let directory = &self.network.directory;
        let (epoch, newest_epoch, now) = (row.epoch, directory.epoch(row.owner), Instant::now());
        let Some(grant) = directory.grant_between(row.owner, self.owner.address) else { return false };
        let has_begun = epoch <= newest_epoch;
        if epoch < grant.terms.epoch || epoch > newest_epoch + 1 {
            return false;
        }
        let is_due = has_begun && grant.newest_wrapped().is_some_and(|newest| newest < epoch);
        let longest = match is_due {
            true => Duration::MAX,
            false if grant.is_wrapped(epoch) => JUST_COME,
            false => UNSURE,
        };
        let Some(waited) = self.keys.awaited(key_of(row), has_begun, longest, now) else { return false };
        if waited >= UNTOLD && self.keys.told.insert((row.owner, epoch)) {
            let (target, owner) = (self.target.name(), self.name_of(row.owner));
            self.bridge.parts.hub.warn(&format!(
                "playback into {target} waits: the key of epoch {epoch} of {owner} has not arrived yet; the owner's \
                 site sends it once it reaches the chain"
            ));
        }
        true
    }

    pub(super) fn right_ended(&mut self) -> Option<PlayEnd> {
        if self.owner.is_locked() {
            self.tell("the keyring was locked");
            return Some(PlayEnd::Locked);
        }
        if let Some(network) = self.bridge.parts.link.network_now() {
            self.network = network;
        }
        if self.rights_at.elapsed() < RIGHTS {
            return None;
        }
        self.rights_at = Instant::now();
        let standing = granted_to(self.owner, &self.network);
        // A grant that was revoked and given again, perhaps for less, differs.
        let is_over = |giver: &&Address| standing.get(giver).is_none_or(|now| self.granted.get(giver) != Some(now));
        let ended: Vec<Address> = self.givers.keys().filter(is_over).copied().collect();
        let mut end = None;
        for giver in ended {
            end = Some(self.take_back(giver));
        }
        end.filter(|_| self.givers.is_empty())
    }

    pub(super) fn take_back(&mut self, giver: Address) -> PlayEnd {
        self.givers.remove(&giver);
        self.target.silence(giver);
        let grant = self.network.directory.grant_between(giver, self.owner.address);
        let is_same = |transaction| self.granted.get(&giver) == Some(&transaction);
        let is_expired = grant.is_some_and(|grant| grant.revoked.is_none() && is_same(grant.transaction));
        let (end, why) = if is_expired { (PlayEnd::Expired, "has expired") } else { (PlayEnd::Revoked, "was revoked") };
        self.tell(&format!("the grant of {} {why}", self.name_of(giver)));
        end
    }

    fn name_of(&self, account: Address) -> String {
        let names = self.bridge.contacts.names().unwrap_or_default();
        names.get(&account).map_or_else(|| account.to_string(), ToString::to_string)
    }

    fn tell(&self, why: &str) {
        let (target, count) = (self.target.name(), counted(self.tally.published, "message"));
        self.bridge.parts.hub.warn(&format!("playback into {target} ended: {why}; published: {count}"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn which(topic: u8) -> Which {
        (Address([1; 20]), TopicId([topic; 16]), 3)
    }

    #[test]
    fn a_key_that_does_not_come_holds_its_own_topic_for_a_while_only() {
        let (mut keys, begin) = (Keys::default(), Instant::now());
        let after = |seconds: u64| begin + Duration::from_secs(seconds);
        assert_eq!(keys.awaited(which(1), true, UNSURE, begin), Some(Duration::ZERO));
        assert!(keys.looked_for(which(1), begin) && !keys.looked_for(which(2), begin), "another topic is looked at");
        assert!(!keys.looked_for(which(1), after(1)), "it is looked for again");
        assert_eq!(keys.awaited(which(1), true, UNSURE, after(119)), Some(Duration::from_secs(119)));
        for moment in [120, 121] {
            assert_eq!(keys.awaited(which(1), true, UNSURE, after(moment)), None, "given up");
            assert!(!keys.looked_for(which(1), after(moment)), "and those after it are not held");
        }
        // One that is sure to come is awaited for as long as it takes.
        assert!(keys.awaited(which(1), true, Duration::MAX, after(9_999)).is_some());
        keys.came(which(2));
        assert_eq!(keys.awaited(which(2), true, UNSURE, after(1)), None, "what it does not open is another's");
    }

    #[test]
    fn an_epoch_that_begins_later_is_awaited_anew() {
        let (mut keys, begin) = (Keys::default(), Instant::now());
        let after = |seconds: u64| begin + Duration::from_secs(seconds);
        assert!(keys.awaited(which(1), false, UNSURE, begin).is_some());
        assert_eq!(keys.awaited(which(1), false, UNSURE, after(500)), None);
        assert_eq!(keys.awaited(which(1), true, UNSURE, after(501)), Some(Duration::ZERO));
        assert_eq!(keys.awaited(which(1), true, UNSURE, after(502)), Some(Duration::from_secs(1)));
    }
}
