//! Whether the right to play continues, owner by owner, according to the chain now; and whose next key is on its way.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use super::{Play, RIGHTS};
use crate::model::{Address, Hash};
use crate::pipeline::authority;
use crate::service::event::NoticeLevel;
use crate::service::reply::PlayEnd;
use crate::store::RecordRow;

/// How long a key is awaited before the operator is told, and how often it is looked for.
const UNTOLD: Duration = Duration::from_secs(10);
const LOOK: Duration = Duration::from_millis(500);

/// How long records wait for a key that need not come: of an epoch that the chain does not know yet, because its owner's sites
/// seal under it before they send it, and anybody who may sign for her can make up a number; or of one that was passed over.
const UNSURE: Duration = Duration::from_secs(120);

/// How long they wait where there are keys: those of the newest block may have come while the record was looked at.
const JUST_COME: Duration = Duration::from_secs(5);

/// The key of an epoch that this reader does not have yet.
pub(super) struct AwaitedKey {
    since: Instant,
    looked: Instant,
    has_begun: bool,
    is_told: bool,
}

impl Play<'_> {
    /// Whether a record's key is awaited, and was looked for a moment ago.
    pub(super) fn looked_for_key(&self, row: &RecordRow) -> bool {
        self.awaited.get(&(row.owner, row.epoch)).is_some_and(|awaited| awaited.looked.elapsed() < LOOK)
    }

    /// Whether the key of a record's epoch is still to come: an epoch begins before its keys reach those who may read on.
    pub(super) fn awaits_key(&mut self, row: &RecordRow) -> bool {
        let directory = &self.network.directory;
        let (epoch, begun) = (row.epoch, directory.epoch(row.owner));
        let Some(grant) = directory.grant_between(row.owner, self.owner.address) else { return false };
        if epoch < grant.terms.epoch || epoch > begun + 1 {
            return false;
        }
        let now = Instant::now();
        let fresh = || AwaitedKey { since: now, looked: now, has_begun: epoch <= begun, is_told: false };
        let awaited = self.awaited.entry((row.owner, epoch)).or_insert_with(fresh);
        if epoch <= begun && !awaited.has_begun {
            *awaited = fresh();
        }
        awaited.looked = now;
        let waited = awaited.since.elapsed();
        let is_due = epoch <= begun && grant.newest_wrapped().is_some_and(|newest| newest < epoch);
        let longest = if grant.is_wrapped(epoch) { JUST_COME } else { UNSURE };
        if !is_due && waited >= longest {
            return false;
        }
        if waited >= UNTOLD && !std::mem::replace(&mut awaited.is_told, true) {
            let text = format!(
                "playback into {} waits: the key of epoch {epoch} of {} has not come yet; her site gives it once it \
                 reaches the chain",
                self.target.name(),
                self.name_of(row.owner)
            );
            self.bridge.hub.notice(NoticeLevel::Warning, &text);
        }
        true
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
