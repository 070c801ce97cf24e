//! What the chain is still owed: expired epochs, unfinished revocations, missing envelopes. All of it is sent again
//! until it is on the chain.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::task::block_in_place;

use super::Sharing;
use crate::chain::Call;
use crate::failure::refused;
use crate::gateway::RevokeNotice;
use crate::model::{Address, ErrorKind, Timestamp};
use crate::pipeline::directory::{GrantState, Granted};
use crate::pipeline::{Network, Owner};
use crate::reply::{Failure, Result, TransactionView};
use crate::store::notes::Revoking;

/// How long before an expiry the next epoch is prepared, nanoseconds.
const FORESIGHT: u64 = 60_000_000_000;

const LONGEST_REST: Duration = Duration::from_secs(8);

/// Time for the watcher to see the transactions of a first attempt.
const PATIENCE: Duration = Duration::from_secs(30);

impl Sharing {
    /// Prepares the next epoch if a grant that covers the current one runs out soon or already did: from that moment
    /// records are sealed under the next, even if the chain is away. `also` is an expiry not on the chain yet.
    pub fn foresee_expiry(&self, owner: &Owner, network: &Network, also: Option<Timestamp>) -> Result<()> {
        self.foresee(owner, network, also, Timestamp(network.directory.now().0 + FORESIGHT))
    }

    /// The same for any future expiry: a locked keyring could not do it in time.
    pub fn foresee_locked(&self, owner: &Owner, network: &Network) -> Result<()> {
        self.foresee(owner, network, None, Timestamp(u64::MAX))
    }

    fn foresee(&self, owner: &Owner, network: &Network, also: Option<Timestamp>, before: Timestamp) -> Result<()> {
        let Some(keys) = owner.sealing().filter(|keys| keys.domain == network.domain) else { return Ok(()) };
        let earliest = earliest_expiry(owner, network, keys.epoch).into_iter().chain(also).min();
        if let Some(moment) = earliest.filter(|moment| *moment < before) {
            owner.prepare_epoch(network.domain, keys.epoch + 1)?;
            owner.seal_from(moment, network.domain, keys.epoch + 1)?;
        }
        Ok(())
    }

    /// Sends what is overdue: the next epoch, interrupted revocations, missing envelopes.
    pub async fn settle_overdue(&self, owner: &Owner, network: &Network) -> Result<()> {
        if self.has_news(owner, network) {
            let _one_at_a_time = owner.changes.lock().await;
            self.take_up_epoch(owner, network)?;
        }
        self.foresee_expiry(owner, network, None)?;
        // A robot out of reach holds up no revocation.
        let told = block_in_place(|| self.enrolments.tell_devices(owner, network));
        self.settle_chain(owner, network).await.map_err(|failure| {
            let message =
                format!("the end of a grant of {} is not on the chain yet: {}", owner.profile, failure.message);
            Failure { message, ..failure }
        })?;
        told
    }

    async fn settle_chain(&self, owner: &Owner, network: &Network) -> Result<()> {
        if !self.owes(owner, network)? {
            return Ok(());
        }
        let _one_at_a_time = owner.changes.lock().await;
        // Another change may have begun the epoch meanwhile.
        if self.is_behind(owner, network)? {
            self.next_epoch(owner, network, "a grant expired").await?;
        }
        self.rewrap(owner, network).await
    }

    /// Whether the chain is owed anything that needs the profile's keys.
    pub fn owes(&self, owner: &Owner, network: &Network) -> Result<bool> {
        Ok(self.is_behind(owner, network)? || !self.lacking(owner, network)?.is_empty())
    }

    pub(super) fn is_behind(&self, owner: &Owner, network: &Network) -> Result<bool> {
        let (epoch, now) = (network.directory.epoch(owner.address), network.directory.now());
        if epoch == 0 {
            return Ok(false);
        }
        let sealing = owner.sealing().filter(|keys| keys.domain == network.domain);
        let covered = |grant: &Granted| grant.state(now) == GrantState::Expired && grant.is_wrapped(epoch);
        let expired = network.directory.grants_of(owner.address).iter().any(covered);
        let ended = sealing.is_some_and(|keys| keys.epoch > epoch) || expired;
        Ok(ended && !self.went_back(owner, network) || !self.owed_revocations(owner, network)?.is_empty())
    }

    /// Begins the next epoch, through an interrupted revocation if there is one: a rotation would give the new key to
    /// the reader being revoked.
    pub async fn next_epoch(&self, owner: &Owner, network: &Network, why: &str) -> Result<TransactionView> {
        let Some(grantee) = self.owed_revocations(owner, network)?.first().copied() else {
            return self.begin_rotated(owner, network, why).await;
        };
        let call = |new_token, envelope| Call::AuthorityRevoke { grantee, new_token, envelope };
        let view = self.begin_epoch(owner, network, &format!("revoke {grantee} (resumed)"), call).await?;
        self.settle_revocation(owner, grantee)?;
        Ok(view)
    }

    /// Requested revocations that are not on the chain yet.
    pub fn owed_revocations(&self, owner: &Owner, network: &Network) -> Result<Vec<Address>> {
        let note = Revoking { owner: owner.address };
        let mut owed = self.parts.plant.ledger.notes.read(&note)?.unwrap_or_default();
        owed.retain(|grantee| self.active_grant(network, owner.address, *grantee).is_some());
        Ok(owed)
    }

    /// Notes that `grantee` will lose the grant, whatever happens now.
    pub fn owe_revocation(&self, owner: &Owner, grantee: Address) -> Result<()> {
        self.change_owed(owner, |owed| {
            if !owed.contains(&grantee) {
                owed.push(grantee);
            }
        })
    }

    /// The revocation is on the chain, or a new grant replaces it.
    pub fn settle_revocation(&self, owner: &Owner, grantee: Address) -> Result<()> {
        self.change_owed(owner, |owed| owed.retain(|other| *other != grantee))
    }

    fn change_owed(&self, owner: &Owner, change: impl FnOnce(&mut Vec<Address>)) -> Result<()> {
        let changed = |owed: &mut Vec<Address>| {
            change(owed);
            Ok(())
        };
        self.parts.plant.ledger.notes.change(&Revoking { owner: owner.address }, changed)
    }

    /// Sends what the chain is owed; retries with growing pauses.
    pub async fn keep_settled(self: Arc<Self>) {
        let mut resting: HashMap<Address, (Instant, Duration)> = HashMap::new();
        while self.parts.life.beat(Duration::from_secs(1)).await {
            let Some(network) = self.parts.link.network_now() else { continue };
            // Overdue work needs keys that a locked keyring lacks; keys sealed ahead work without.
            for owner in self.parts.owners.all().into_iter().filter(|owner| !owner.is_locked()) {
                if resting.get(&owner.address).is_some_and(|(until, _)| Instant::now() < *until) {
                    continue;
                }
                let Err(failure) = self.settle_overdue(&owner, &network).await else {
                    resting.remove(&owner.address);
                    continue;
                };
                let pause = resting.get(&owner.address).map_or(Duration::from_secs(2), |(_, pause)| *pause * 2);
                let pause = pause.min(LONGEST_REST);
                resting.insert(owner.address, (Instant::now() + pause, pause));
                self.parts.hub.alarm(&failure.message);
            }
        }
    }

    /// Stops sharing with an account. What it has read cannot be recalled.
    pub async fn revoke(&self, owner: &Owner, grantee: Address) -> Result<TransactionView> {
        let (network, _one_at_a_time) = (self.parts.link.network().await?, owner.changes.lock().await);
        if self.active_grant(&network, owner.address, grantee).is_none() {
            return Err(refused(format!(
                "{grantee} has no active grant from {}; `authros grant list` shows who has",
                owner.address
            )));
        }
        let failure = match self.revoke_once(owner, &network, grantee).await {
            Ok(view) => return Ok(view),
            Err(failure) => failure,
        };
        // Space helps only if the disk is full.
        if failure.kind != ErrorKind::Home || !block_in_place(|| self.reserve.release())? {
            return Err(failure);
        }
        let _space_is_for_this = self.parts.plant.ledger.records.hold();
        let text =
            "the disk is full: the reserved space was used for a revoke; free some space, records wait in memory";
        self.parts.hub.alarm(text);
        self.revoke_again(owner, &network, grantee).await
    }

    async fn revoke_once(&self, owner: &Owner, network: &Network, grantee: Address) -> Result<TransactionView> {
        self.owe_revocation(owner, grantee)?;
        let call = |new_token, envelope| Call::AuthorityRevoke { grantee, new_token, envelope };
        let sent = self.begin_epoch(owner, network, &format!("revoke {grantee}"), call).await;
        let view = sent.map_err(|failure| {
            let noted = "the revocation is stored and is resent until the chain has it";
            Failure { message: format!("{}; {noted}", failure.message), ..failure }
        })?;
        if let (Some(transaction), Some(token)) = (view.transaction, owner.token(network.domain, view.epoch)) {
            let notice = RevokeNotice { grantee, epoch: view.epoch, token, transaction };
            self.joined.tell_of_revoke(owner, network, notice).await;
        }
        self.settle_revocation(owner, grantee)?;
        Ok(told(grantee, view))
    }

    /// Resumes an attempt that a full disk interrupted at any point.
    async fn revoke_again(&self, owner: &Owner, network: &Network, grantee: Address) -> Result<TransactionView> {
        self.settle_open(owner, network).await?;
        let head = network.chain.head().await?.number;
        drop(tokio::time::timeout(PATIENCE, self.parts.link.scanned(head)).await);
        if self.active_grant(network, owner.address, grantee).is_some() {
            return self.revoke_once(owner, network, grantee).await;
        }
        let epoch = network.directory.epoch(owner.address);
        self.parts.log.write(&owner.profile, "revoke", &format!("{grantee} epoch {epoch}"), "done").await?;
        owner.confirm_epoch(network.domain, epoch)?;
        self.settle_revocation(owner, grantee)?;
        let view = TransactionView { epoch, ..TransactionView::default() };
        Ok(told(grantee, view))
    }
}

/// First expiry of the grants that cover an epoch.
pub(in crate::site) fn earliest_expiry(owner: &Owner, network: &Network, epoch: u64) -> Option<Timestamp> {
    let grants = network.directory.grants_of(owner.address);
    let covering = grants.iter().filter(|grant| grant.is_wrapped(epoch));
    covering.filter_map(Granted::expiry).min()
}

fn told(grantee: Address, view: TransactionView) -> TransactionView {
    let epoch = view.epoch;
    let text = format!(
        "{grantee} can no longer read new records (epoch {epoch} begins); what was already read cannot be taken back"
    );
    TransactionView { text, ..view }
}
