//! Whether the right to play continues, owner by owner, according to the chain now; and whose next key is on its way.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use super::{Play, RIGHTS};
use crate::model::{Address, Hash};
use crate::pipeline::authority;
use crate::service::event::NoticeLevel;
use crate::service::reply::PlayEnd;
use crate::store::RecordRow;

/// How long a key is awaited before the operator is told.
const UNTOLD: Duration = Duration::from_secs(10);

/// How long a record waits for an epoch that the chain does not know yet. Its owner's sites seal under an epoch before they
/// send it to the chain; a number that anybody who may sign for her made up must not hold a topic for ever.
const UNKNOWN: Duration = Duration::from_secs(120);

/// The key of an epoch that has begun and that this reader does not have yet.
pub(super) struct AwaitedKey {
    epoch: u64,
    since: Instant,
    is_told: bool,
}

impl Play<'_> {
    /// Whether the key of a record's epoch is still to come: an epoch begins before its keys reach those who may read on.
    pub(super) fn awaits_key(&mut self, row: &RecordRow) -> bool {
        let directory = &self.network.directory;
        let newest = directory.grant_between(row.owner, self.owner.address).and_then(|grant| grant.newest_wrapped());
        let begun = directory.epoch(row.owner);
        if newest.is_none_or(|newest| newest >= row.epoch) || row.epoch > begun + 1 {
            return false;
        }
        let now = AwaitedKey { epoch: row.epoch, since: Instant::now(), is_told: false };
        let awaited = self.awaited.entry(row.owner).or_insert(now);
        if awaited.epoch != row.epoch {
            *awaited = AwaitedKey { epoch: row.epoch, since: Instant::now(), is_told: false };
        }
        let waited = awaited.since.elapsed();
        if waited >= UNTOLD && !std::mem::replace(&mut awaited.is_told, true) {
            let name = self.name_of(row.owner);
            let text = format!(
                "playback into {} waits: the key of epoch {} of {name} has not come yet; her site gives it once it reaches \
                 the chain",
                self.target.name(),
                row.epoch
            );
            self.bridge.hub.notice(NoticeLevel::Warning, &text);
        }
        row.epoch <= begun || waited < UNKNOWN
    }

    /// Whether the right to everything that is played has ended, according to the chain now.
    pub(super) fn right_ended(&mut self) -> Option<PlayEnd> {
        if self.owner.is_locked() {
            self.tell("the keyring was locked");
            return Some(PlayEnd::Locked);
        }
        if let Some(network) = self.bridge.link.network_now() {
            self.network = network;
        }
        if self.rights_at.elapsed() < RIGHTS {
            return None;
        }
        self.rights_at = Instant::now();
        let standing = authority::shared_with(&self.network.directory, self.owner.address);
        let standing: HashMap<Address, Hash> =
            standing.into_iter().map(|grant| (grant.terms.owner, grant.transaction)).collect();
        // A grant that was revoked and given again, perhaps for less, is a different grant.
        let is_over = |giver: &&Address| standing.get(giver).is_none_or(|now| self.granted.get(giver) != Some(now));
        let ended: Vec<Address> = self.givers.keys().filter(is_over).copied().collect();
        let mut end = None;
        for giver in ended {
            end = Some(self.take_back(giver));
        }
        end.filter(|_| self.givers.is_empty())
    }

    /// An owner no longer shares: her queued and latched messages are not given out either.
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
        self.bridge.contacts.names().get(&account).map_or_else(|| account.to_string(), ToString::to_string)
    }

    fn tell(&self, why: &str) {
        let text =
            format!("playback into {} ended: {why}; {} messages were published", self.target.name(), self.published);
        self.bridge.hub.notice(NoticeLevel::Warning, &text);
    }
}
