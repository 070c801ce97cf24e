//! Whether the right to play continues, owner by owner, according to the chain now.

use std::collections::HashMap;
use std::time::Instant;

use super::{Play, RIGHTS};
use crate::model::{Address, Hash};
use crate::pipeline::authority;
use crate::service::event::NoticeLevel;
use crate::service::reply::PlayEnd;

impl Play<'_> {
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
        let name = self.bridge.contacts.names().get(&giver).map_or_else(|| giver.to_string(), ToString::to_string);
        self.tell(&format!("the grant of {name} {why}"));
        end
    }

    fn tell(&self, why: &str) {
        let text =
            format!("playback into {} ended: {why}; {} messages were published", self.target.name(), self.published);
        self.bridge.hub.notice(NoticeLevel::Warning, &text);
    }
}
