//! Granting and revoking, and the list of who may read what.

mod epochs;
#[cfg(test)]
mod tests;

use std::collections::{HashMap, HashSet};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use tokio::task::block_in_place;

use crate::chain::Call;
use crate::command::GrantFrom;
use crate::crypto::{GrantedKeys, WrappedKeys};
use crate::gateway::{GrantNotice, RevokeNotice};
use crate::model::grant::MOST_TOPICS;
use crate::model::{Address, ErrorKind, GrantTerms, Party, Scope, Timestamp, TopicId, TopicName, clean, natural};
use crate::pipeline::directory::kept;
use crate::pipeline::{CapturedMessage, GrantState, Granted, Network, Owner, Reader, Rings, authority};
use crate::reply::{Direction, Failure, GrantRow, NOTHING_OLDER, Part, Result, TransactionView, input, refused};
use crate::site::{Contacts, Enrolments, Joined, Parts, RosSide};
use crate::store::notes::{GrantedFrom, GrantedTopic, Revoking};
use crate::store::{RecordRow, Reserve};

pub(in crate::site) struct Sharing {
    pub parts: Parts,
    pub contacts: Arc<Contacts>,
    pub enrolments: Arc<Enrolments>,
    pub joined: Arc<Joined>,
    pub reserve: Arc<Reserve>,
    /// Captured and not sealed yet.
    pub rings: Arc<Rings<CapturedMessage>>,
    pub ros: Arc<RosSide>,
    /// The epoch that each owner began here last. Under one begun elsewhere anything may have been sealed.
    pub begun: Mutex<HashMap<Address, u64>>,
    pub missing: Mutex<epochs::Missing>,
}

impl Sharing {
    /// Puts the grantee's envelope on the chain.
    pub async fn grant(
        &self,
        owner: &Owner,
        grantee: &Party,
        topics: &[TopicName],
        from: GrantFrom,
        expires: Option<Timestamp>,
    ) -> Result<TransactionView> {
        let (network, _one_at_a_time) = (self.parts.link.network().await?, owner.changes.lock().await);
        network.directory.identity(owner.address)?;
        let grantee = self.contacts.resolve(grantee)?;
        if grantee == owner.address {
            let text = format!("{grantee} is this profile itself; it can read its own records without a grant");
            return Err(refused(text));
        }
        if topics.len() > MOST_TOPICS {
            return Err(input(format!("a grant can name at most {MOST_TOPICS} topics; grant fewer, or all topics")));
        }
        if expires.is_some_and(|at| at <= network.directory.now()) {
            return Err(input(too_early(network.directory.now())));
        }
        if self.went_back(owner, &network) {
            return Err(refused(self.missing_text().unwrap_or_default()));
        }
        network.directory.identity(grantee)?;
        self.contacts.check_contact(&network, grantee).await?;
        self.contacts.check_reader(&network, owner.address, grantee).await?;
        if self.active_grant(&network, owner.address, grantee).is_some() {
            return Err(refused(format!("{grantee} already has an active grant; revoke it first to change its terms")));
        }
        let names: Vec<String> = topics.iter().map(ToString::to_string).collect();
        self.remember_topics(owner, &names)?;
        let scope = scope(owner, topics);
        let (first, begun) = self.first_for(owner, &network, &scope, from).await?;
        let epoch = network.directory.epoch(owner.address);
        let terms = GrantTerms { owner: owner.address, grantee, epoch, expiry: expires, scope };
        let opens = self.opened_by(&network, owner, owner.address, &terms.scope, first)?;
        let covered: Vec<u64> =
            owner.epochs(network.domain).into_iter().filter(|known| (first..=epoch).contains(known)).collect();
        // An older keyring may lack the first.
        let first = covered.first().copied().unwrap_or(first);
        let envelope = self.wrap_keys(owner, &network, terms.clone(), &names, covered)?;
        let sent = async {
            self.settle_revocation(owner, grantee)?;
            self.foresee_expiry(owner, &network, expires)?;
            let call = Call::AuthorityGrant { grantee, epoch, expiry: terms.expiry, scope: terms.scope, envelope };
            Ok(self.parts.sender.send(&network.chain, &owner.eoa(), call, "authorityGrant").await?)
        };
        let (transaction, receipt) = self.parts.log.deed(&owner.profile, "grant", &grantee.to_string(), sent).await?;
        // Only the grantee can open the envelope: without this note the list cannot tell about earlier epochs.
        let note = GrantedFrom { transaction };
        drop(self.parts.plant.ledger.notes.write(&note, &first));
        let notice = GrantNotice { grantee, epoch, expiry: expires.map_or(0, Timestamp::seconds), transaction };
        self.joined.tell_of_grant(owner, &network, notice).await;
        self.parts.link.scanned(receipt.block).await;
        self.parts.hub.changed(Part::Grants);
        let what = if names.is_empty() { "all topics".to_owned() } else { names.join(", ") };
        let (moment, times) = match begun || from == GrantFrom::Now {
            true => (NOTHING_OLDER.to_owned(), Vec::new()),
            false => (opens.words(Timestamp::in_utc), Vec::from_iter(opens.since)),
        };
        let begun = if begun { format!("; epoch {epoch} has begun for it") } else { String::new() };
        let text = format!("{grantee} can read {what}, {moment}{begun}");
        Ok(TransactionView { times, ..TransactionView::mined(transaction, receipt.block, epoch, text) })
    }

    /// Extends an active grant; its keys and epoch stay.
    pub async fn extend(&self, owner: &Owner, grantee: &Party, expires: Option<Timestamp>) -> Result<TransactionView> {
        let (network, _one_at_a_time) = (self.parts.link.network().await?, owner.changes.lock().await);
        let grantee = self.contacts.resolve(grantee)?;
        let Some(grant) = self.active_grant(&network, owner.address, grantee) else {
            return Err(refused(format!("{grantee} has no active grant; `authros grant add` gives one")));
        };
        let Some(ends) = grant.expiry() else {
            return Err(refused(format!("the grant to {grantee} has no end, so there is nothing to extend")));
        };
        if expires.is_some_and(|expires| expires <= ends) {
            return Err(refused(format!(
                "the grant to {grantee} already ends at {ends}; `extend` only lengthens it, revoke it to end it sooner"
            )));
        }
        let call = Call::Extend { grantee, expiry: expires };
        let sent = async { Ok(self.parts.sender.send(&network.chain, &owner.eoa(), call, "extend").await?) };
        let (transaction, receipt) = self.parts.log.deed(&owner.profile, "extend", &grantee.to_string(), sent).await?;
        self.parts.link.scanned(receipt.block).await;
        self.parts.hub.changed(Part::Grants);
        let end = expires.map_or_else(|| "has no end".to_owned(), |expires| format!("ends {}", expires.in_utc()));
        let epoch = network.directory.epoch(owner.address);
        let text = format!("the grant to {grantee} now {end} instead of {}", ends.in_utc());
        let times = expires.into_iter().chain([ends]).collect();
        Ok(TransactionView { times, ..TransactionView::mined(transaction, receipt.block, epoch, text) })
    }

    pub fn active_grant(&self, network: &Network, owner: Address, grantee: Address) -> Option<Granted> {
        authority::standing_grant(&network.directory, owner, grantee)
    }

    /// Names are stored under their pseudonyms on the chain, so that each grant finds its own.
    fn remember_topics(&self, owner: &Owner, topics: &[String]) -> Result<()> {
        let keep = |topic: &String| {
            let note = GrantedTopic { owner: owner.address, topic: owner.topic_id(topic) };
            Ok(self.parts.plant.ledger.notes.write(&note, topic)?)
        };
        block_in_place(|| topics.iter().try_for_each(keep))
    }

    /// Topic names of this owner's scoped grant, in the event's order; `None` if no known name matches.
    pub fn granted_topics(&self, owner: &Owner, ids: &[TopicId]) -> Result<Vec<Option<String>>> {
        block_in_place(|| {
            let ledger = &self.parts.plant.ledger;
            let name_of = |id: &TopicId| {
                let kept = ledger.notes.read(&GrantedTopic { owner: owner.address, topic: *id })?;
                let others = ledger.names.of_topic(owner.address, *id)?;
                let mut known = kept.into_iter().chain(others);
                Ok(known.find(|name| owner.topic_id(name) == *id))
            };
            ids.iter().map(name_of).collect()
        })
    }

    pub async fn rows(&self, owner: &Arc<Owner>) -> Result<Vec<GrantRow>> {
        let network = self.parts.link.network().await?;
        let me = owner.address;
        let grants = block_in_place(|| kept::history(&self.parts.plant.ledger.rights, &network.directory, me))?;
        let names = self.contacts.names()?;
        let with_name = |mut row: GrantRow| {
            let other = if row.owner == me { row.grantee } else { row.owner };
            row.name = names.get(&other).cloned();
            row.fingerprint = Contacts::registered_fingerprint(&network, other);
            row
        };
        grants.iter().map(|grant| self.grant_row(owner, &network, grant).map(with_name)).collect()
    }

    fn grant_row(&self, owner: &Owner, network: &Network, grant: &Granted) -> Result<GrantRow> {
        let given = grant.terms.owner == owner.address;
        let topics = match &grant.terms.scope {
            Scope::All => Vec::new(),
            Scope::Topics(ids) if given => {
                let names = self.granted_topics(owner, ids)?;
                let shown = |(name, id): (Option<String>, &TopicId)| {
                    name.map_or_else(|| RecordRow::unnamed(*id), |name| clean(&name, 255))
                };
                names.into_iter().zip(ids).map(shown).collect()
            }
            Scope::Topics(ids) => self.received_topics(owner, network, grant, ids),
        };
        let from = match given {
            // `None` = given elsewhere.
            true => self.parts.plant.ledger.notes.read(&GrantedFrom { transaction: grant.transaction })?,
            false => self.received_from(owner, network, grant),
        };
        let state = grant.state(network.directory.now());
        let opened = |first| self.opened_by(network, owner, grant.terms.owner, &grant.terms.scope, first);
        let opens = from.filter(|_| state == GrantState::Active).map(opened).transpose()?;
        Ok(GrantRow {
            direction: if given { Direction::Given } else { Direction::Received },
            owner: grant.terms.owner,
            grantee: grant.terms.grantee,
            epoch: grant.terms.epoch,
            from,
            opens,
            expires: grant.expiry(),
            topics,
            state,
            block: grant.block,
            transaction: grant.transaction,
            name: None,
            fingerprint: None,
        })
    }

    /// The first epoch that a received grant opens, by its envelope; `None` = that does not open.
    fn received_from(&self, owner: &Owner, network: &Network, grant: &Granted) -> Option<u64> {
        let reader = Reader { plant: &self.parts.plant, network, reader: owner };
        let envelope = reader.open_envelope(grant, grant.terms.epoch).ok()?;
        match &envelope.keys {
            GrantedKeys::All { epochs, .. } => epochs.iter().map(|(epoch, _)| *epoch).min(),
            GrantedKeys::Topics { keys } => keys.iter().map(|(epoch, ..)| *epoch).min(),
        }
    }

    fn received_topics(&self, owner: &Owner, network: &Network, grant: &Granted, ids: &[TopicId]) -> Vec<String> {
        let reader = Reader { plant: &self.parts.plant, network, reader: owner };
        match reader.open_envelope(grant, grant.terms.epoch).as_deref() {
            Ok(WrappedKeys { keys: GrantedKeys::Topics { keys }, .. }) => {
                let mut names: Vec<String> = keys.iter().map(|(_, topic, _, _)| clean(topic, 255)).collect();
                names.sort_by(|one, other| natural(one, other));
                names.dedup();
                names
            }
            _ => ids.iter().map(|id| RecordRow::unnamed(*id)).collect(),
        }
    }
}

/// The chain's time may be ahead of this machine's clock.
fn too_early(now: Timestamp) -> String {
    let ahead = now.seconds().saturating_sub(Timestamp::now().seconds());
    let why = || format!(": grants use the chain's time, which is {ahead} s ahead of this machine's clock");
    let chain = if ahead > 60 { why() } else { String::new() };
    format!("the grant would end before it starts{chain}; give a later --expires")
}

fn scope(owner: &Owner, topics: &[TopicName]) -> Scope {
    if topics.is_empty() {
        return Scope::All;
    }
    let mut known = HashSet::new();
    let ids = topics.iter().map(|topic| owner.topic_id(topic.as_str()));
    Scope::Topics(ids.filter(|id| known.insert(*id)).collect())
}

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
