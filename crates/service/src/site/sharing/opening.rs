//! From when on a grant opens records: which epochs it covers, what they hold, what it costs, and the new epoch that "from
//! now on" needs. That epoch comes first: after a crash in between nobody has its keys, and the command is repeated.

use std::sync::PoisonError;
use std::time::{Duration, Instant};

use tokio::task::block_in_place;

use super::Sharing;
use super::epochs::ENVELOPES_A_CALL;
use crate::failure::{input, refused};
use crate::model::{Address, Party, Scope, Timestamp, TopicId, TopicName};
use crate::pipeline::{Network, Owner, authority};
use crate::service::command::GrantFrom;
use crate::service::reply::{GrantForesight, Opens, Result};
use crate::store::SealedInEpoch;

/// How long messages captured before may wait to be sealed.
const PATIENCE: Duration = Duration::from_secs(10);
const LOOK: Duration = Duration::from_millis(20);

/// What is sealed for one owner, as far as this home knows it.
#[derive(Debug, Default)]
pub(super) struct Sealed(Vec<SealedInEpoch>);

impl Sealed {
    /// What a grant opens from this epoch on.
    pub fn opened_by(&self, scope: &Scope, first: u64) -> Opens {
        let covers = |topic: &TopicId| match scope {
            Scope::All => true,
            Scope::Topics(topics) => topics.contains(topic),
        };
        let opened = self.0.iter().filter(|one| one.epoch >= first && covers(&one.topic));
        opened.fold(Opens::default(), |all, one| Opens {
            records: all.records + one.records,
            since: Some(all.since.map_or(one.first, |since| since.min(one.first))),
        })
    }

    fn first_since(&self, moment: Timestamp) -> Option<u64> {
        self.0.iter().filter(|one| one.last >= moment).map(|one| one.epoch).min()
    }
}

impl Sharing {
    /// Up to the current epoch; of the owner's own epochs, those that the keyring has the key of.
    pub(super) fn sealed_by(&self, network: &Network, reader: &Owner, owner: Address) -> Result<Sealed> {
        let epochs = 1..=network.directory.epoch(owner);
        let mut sealed = block_in_place(|| self.parts.plant.ledger.counts.by_epoch(owner, epochs))?;
        if owner == reader.address {
            let known = reader.epochs(network.domain);
            sealed.retain(|one| known.contains(&one.epoch));
        }
        Ok(Sealed(sealed))
    }

    /// The first epoch that such a grant opens; one beyond the current epoch is still to begin.
    fn first_epoch(&self, owner: &Owner, network: &Network, from: GrantFrom) -> Result<u64> {
        let current = network.directory.epoch(owner.address);
        let found = match from {
            GrantFrom::Now => None,
            GrantFrom::Current => Some(current),
            GrantFrom::Epoch(epoch) if (1..=current).contains(&epoch) => Some(epoch),
            GrantFrom::Epoch(epoch) => {
                return Err(input(format!("there is no epoch {epoch}: the first is 1, the current one is {current}")));
            }
            GrantFrom::Time(moment) if moment > network.directory.now() => {
                return Err(input("a grant opens records from a past moment or from now on; choose one of these"));
            }
            // Nothing was captured since: that is from now on.
            GrantFrom::Time(moment) => self.sealed_by(network, owner, owner.address)?.first_since(moment),
        };
        match found {
            Some(epoch) => Ok(epoch),
            None if self.is_unused(owner, network, current)? => Ok(current),
            None => Ok(current + 1),
        }
    }

    /// Whether nobody can have sealed anything under this epoch's keys. Robots seal out of sight.
    fn is_unused(&self, owner: &Owner, network: &Network, epoch: u64) -> Result<bool> {
        let seals = owner.sealing().is_some_and(|keys| keys.domain == network.domain && keys.epoch == epoch);
        let begun_here = self.begun.lock().unwrap_or_else(PoisonError::into_inner).get(&owner.address) == Some(&epoch);
        let used = || self.parts.plant.ledger.counts.is_epoch_used(owner.address, epoch);
        Ok(seals && begun_here && self.enrolments.lent(owner, network)?.is_empty() && !block_in_place(used)?)
    }

    /// The first epoch that a grant opens, begun if it has to be, and whether it was. The caller holds the owner's changes.
    pub(super) async fn first_for(&self, owner: &Owner, network: &Network, from: GrantFrom) -> Result<(u64, bool)> {
        if matches!(from, GrantFrom::Now | GrantFrom::Time(_)) {
            self.all_sealed().await?;
        }
        let first = self.first_epoch(owner, network, from)?;
        if first <= network.directory.epoch(owner.address) {
            return Ok((first, false));
        }
        // What was sealed since a grant expired is in an epoch that is not on the chain yet.
        if self.is_behind(owner, network)? {
            self.next_epoch(owner, network, "a grant expired").await?;
        }
        let begun = self.begin_rotated(owner, network, "for a grant from now on").await?;
        self.begun.lock().unwrap_or_else(PoisonError::into_inner).insert(owner.address, begun.epoch);
        // They are told again as long as one does not know.
        if let Err(failure) = block_in_place(|| self.enrolments.tell_devices(owner, network)) {
            self.parts.hub.alarm(&failure.message);
        }
        Ok((begun.epoch, true))
    }

    /// Waits until what was captured so far is sealed: under the keys of a later epoch it would be opened as well.
    async fn all_sealed(&self) -> Result<()> {
        // What waits for its publisher's name was captured, too.
        block_in_place(|| self.ros.second.settle(None));
        let (came, end) = (self.rings.came(), Instant::now() + PATIENCE);
        while !self.rings.is_past(came) {
            if Instant::now() >= end || self.parts.life.is_stopping() {
                return Err(refused(
                    "`authros status` says why messages captured before now still wait to be sealed; a grant from now on \
                     would open them, so nothing was granted: run the command again once they are stored",
                ));
            }
            tokio::time::sleep(LOOK).await;
        }
        Ok(())
    }

    /// What a grant would open now, and what it costs.
    pub async fn foresee_grant(
        &self,
        owner: &Owner,
        grantee: &Party,
        topics: &[TopicName],
        from: GrantFrom,
    ) -> Result<GrantForesight> {
        let network = self.parts.link.network().await?;
        network.directory.identity(owner.address)?;
        let grantee = self.contacts.resolve(grantee)?;
        let first = self.first_epoch(owner, &network, from)?;
        let current = network.directory.epoch(owner.address);
        let mut readers = authority::standing_grants(&network.directory, owner.address);
        readers.retain(|grant| grant.terms.grantee != grantee);
        let replaces = self.active_grant(&network, owner.address, grantee).is_some();
        let epochs = usize::from(first > current) + usize::from(replaces);
        let opens = match first > current {
            true => Opens::default(),
            false => self.sealed_by(&network, owner, owner.address)?.opened_by(&super::scope(owner, topics), first),
        };
        let robots = match epochs {
            0 => Vec::new(),
            _ => self.enrolments.lent(owner, &network)?.into_iter().map(|robot| robot.name).collect(),
        };
        // An epoch costs its own transaction, and the envelopes of the readers who stay.
        let transactions = 1 + epochs * (1 + readers.len().div_ceil(ENVELOPES_A_CALL));
        let readers = if epochs == 0 { 0 } else { readers.len() };
        let nothing_older = first > current || self.is_unused(owner, &network, first)?;
        Ok(GrantForesight { epoch: first, epochs, nothing_older, opens, readers, robots, transactions })
    }
}
