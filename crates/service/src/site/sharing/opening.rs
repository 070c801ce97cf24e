//! From when on a grant opens records: which epochs it covers, what they hold, what it costs, and the new epoch that "from
//! now on" needs. That epoch comes first: after a crash in between nobody has its keys, and the command is repeated.

use std::ops::RangeInclusive;
use std::sync::PoisonError;
use std::time::{Duration, Instant};

use tokio::task::block_in_place;

use super::Sharing;
use super::epochs::ENVELOPES_A_CALL;
use crate::failure::{input, refused};
use crate::model::{Address, Party, Scope, Timestamp, TopicName};
use crate::pipeline::{Network, Owner, authority};
use crate::service::command::GrantFrom;
use crate::service::reply::{GrantForesight, Opens, Result};
use crate::store::SealedQuery;

/// How long messages captured before may wait to be sealed.
const PATIENCE: Duration = Duration::from_secs(10);
const LOOK: Duration = Duration::from_millis(20);

impl Sharing {
    /// What a grant opens from this epoch on, as far as it has arrived here. Of the owner's own epochs, those that the
    /// keyring has the key of.
    pub(super) fn opened_by(
        &self,
        network: &Network,
        reader: &Owner,
        owner: Address,
        scope: &Scope,
        first: u64,
    ) -> Result<Opens> {
        let of_robots = owner == reader.address && self.enrolments.has_any(owner)?;
        let epochs = match owner == reader.address {
            true => runs(reader.epochs(network.domain).into_iter().filter(|epoch| *epoch >= first)),
            false => vec![first..=network.directory.epoch(owner)],
        };
        let mut all = Opens { of_robots, ..Opens::default() };
        for query in queries(owner, scope, &epochs, Timestamp::default()) {
            let (records, since) = block_in_place(|| self.parts.plant.ledger.counts.opened_by(&query))?;
            all.records += records;
            all.since = all.since.into_iter().chain(since).min();
        }
        Ok(all)
    }

    /// The first of the owner's epochs in which anything of the scope was captured since.
    fn first_since(&self, owner: &Owner, network: &Network, scope: &Scope, since: Timestamp) -> Result<Option<u64>> {
        let epochs = runs(owner.epochs(network.domain).into_iter());
        let mut first: Option<u64> = None;
        for query in queries(owner.address, scope, &epochs, since) {
            let found = block_in_place(|| self.parts.plant.ledger.counts.first_epoch(&query))?;
            first = first.into_iter().chain(found).min();
        }
        Ok(first)
    }

    /// The first epoch that such a grant opens; one beyond the current epoch is still to begin.
    fn first_epoch(&self, owner: &Owner, network: &Network, scope: &Scope, from: GrantFrom) -> Result<u64> {
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
            GrantFrom::Time(moment) => self.first_since(owner, network, scope, moment)?,
        };
        match found {
            Some(epoch) => Ok(epoch),
            None if self.is_unused(owner, network, current)? => Ok(current),
            // What was sealed since a grant expired is in an epoch that is not on the chain yet.
            None => Ok(current + 1 + u64::from(self.is_behind(owner, network)?)),
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
    pub(super) async fn first_for(
        &self,
        owner: &Owner,
        network: &Network,
        scope: &Scope,
        from: GrantFrom,
    ) -> Result<(u64, bool)> {
        if matches!(from, GrantFrom::Now | GrantFrom::Time(_)) {
            self.all_sealed().await?;
        }
        let mut first = self.first_epoch(owner, network, scope, from)?;
        if first > network.directory.epoch(owner.address) && self.is_behind(owner, network)? {
            self.next_epoch(owner, network, "a grant expired").await?;
            first = self.first_epoch(owner, network, scope, from)?;
        }
        if first <= network.directory.epoch(owner.address) {
            return Ok((first, false));
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
        let scope = super::scope(owner, topics);
        let first = self.first_epoch(owner, &network, &scope, from)?;
        let current = network.directory.epoch(owner.address);
        let mut readers = authority::standing_grants(&network.directory, owner.address);
        readers.retain(|grant| grant.terms.grantee != grantee);
        let replaces = self.active_grant(&network, owner.address, grantee).is_some();
        let begun = usize::try_from(first.saturating_sub(current)).unwrap_or(usize::MAX);
        let epochs = begun + usize::from(replaces);
        let opens = self.opened_by(&network, owner, owner.address, &scope, first)?;
        let robots = match epochs {
            0 => Vec::new(),
            _ => self.enrolments.lent(owner, &network)?.into_iter().map(|robot| robot.name).collect(),
        };
        // An epoch costs its own transaction, and the envelopes of the readers who stay.
        let transactions = 1 + epochs * (1 + readers.len().div_ceil(ENVELOPES_A_CALL));
        let readers = if epochs == 0 { 0 } else { readers.len() };
        let nothing_older = match first > current {
            // The epoch of a past moment may not be on the chain yet.
            true => opens.records == 0,
            false => self.is_unused(owner, &network, first)?,
        };
        let topics = topics.to_vec();
        Ok(GrantForesight { epoch: first, topics, epochs, nothing_older, opens, readers, robots, transactions })
    }
}

/// Runs of consecutive epochs, which come in order.
fn runs(epochs: impl Iterator<Item = u64>) -> Vec<RangeInclusive<u64>> {
    let mut runs: Vec<RangeInclusive<u64>> = Vec::new();
    for epoch in epochs {
        match runs.last_mut().filter(|run| run.end() + 1 == epoch) {
            Some(run) => *run = *run.start()..=epoch,
            None => runs.push(epoch..=epoch),
        }
    }
    runs
}

/// What the store is asked: nothing beyond the scope is read.
fn queries(owner: Address, scope: &Scope, epochs: &[RangeInclusive<u64>], since: Timestamp) -> Vec<SealedQuery> {
    let topics = match scope {
        Scope::All => vec![None],
        Scope::Topics(topics) => topics.iter().copied().map(Some).collect(),
    };
    let of_topic = |topic| epochs.iter().cloned().map(move |epochs| SealedQuery { owner, topic, epochs, since });
    topics.into_iter().flat_map(of_topic).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::TopicId;

    #[test]
    fn only_what_a_grant_covers_is_asked_for() {
        let epochs = runs([1, 2, 4, 5, 6, 9].into_iter());
        assert_eq!(epochs, [1..=2, 4..=6, 9..=9]);
        let asked = |scope: &Scope| queries(Address([1; 20]), scope, &epochs, Timestamp(7));
        assert_eq!(asked(&Scope::All).iter().map(|query| query.topic).collect::<Vec<_>>(), [None; 3]);
        let scoped = asked(&Scope::Topics(vec![TopicId([3; 16]), TopicId([4; 16])]));
        assert_eq!(scoped.len(), 6);
        assert!(scoped.iter().all(|query| query.topic.is_some() && query.since == Timestamp(7)), "{scoped:?}");
        assert!(asked(&Scope::Topics(Vec::new())).is_empty());
    }
}
