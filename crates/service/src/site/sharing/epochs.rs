//! Epochs: begun at a revoke, a rotation or an expiry, and re-wrapped for the remaining readers. The recorder switches
//! before the transaction is sent. Epoch keys that an old keyring lacks come from the chain, or are reported.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::time::{Duration, Instant};

use tokio::task::block_in_place;

use crate::chain::Call;
use crate::command::GrantFrom;
use crate::crypto::{GrantedKeys, WrappedKeys, signer_id, wrap};
use crate::model::{Address, GrantTerms, Party, ProfileName, Scope, Timestamp, Token, TopicName, counted, locked};
use crate::pipeline::directory::kept;
use crate::pipeline::epoch::EpochKeys;
use crate::pipeline::{Granted, Network, Owner, PipelineError, authority, recovery};
use crate::reply::{Failure, GrantForesight, Opens, Part, Result, TransactionView, input, refused};
use crate::site::Sharing;
use crate::store::SealedQuery;

/// Keeps a `wrap` transaction below 32 KB.
pub(super) const ENVELOPES_A_CALL: usize = 8;

const MOST_NAMED: usize = 8;

impl Sharing {
    pub async fn rotate(&self, owner: &Owner, why: &str) -> Result<TransactionView> {
        let (network, _one_at_a_time) = (self.parts.link.network().await?, owner.changes.lock().await);
        network.directory.identity(owner.address)?;
        self.begin_rotated(owner, &network, why).await
    }

    /// Begins an epoch that every reader gets the keys of. The caller holds the owner's changes.
    pub(super) async fn begin_rotated(&self, owner: &Owner, network: &Network, why: &str) -> Result<TransactionView> {
        let call = |new_token, envelope| Call::Rotate { new_token, envelope };
        self.begin_epoch(owner, network, &format!("rotate ({why})"), call).await
    }

    /// Switches the recorder to the next epoch, sends it to the chain with its key wrapped for the owner, and re-wraps
    /// for the remaining readers. Needs no earlier keys.
    pub async fn begin_epoch(
        &self,
        owner: &Owner,
        network: &Network,
        purpose: &str,
        call: impl FnOnce(Token, Vec<u8>) -> Call,
    ) -> Result<TransactionView> {
        self.repeat_epochs(owner, network).await?;
        let next = network.directory.epoch(owner.address) + 1;
        let token = owner.prepare_epoch(network.domain, next)?;
        let envelope = recovery::own_envelope(&self.parts.plant, network, owner, next)?;
        if !crate::crypto::fault::is_off("revoke") {
            owner.seal_under(network.domain, next)?;
        }
        let sent = self.parts.sender.send(&network.chain, &owner.eoa(), call(token, envelope), purpose).await;
        let (action, what) = purpose.split_once(' ').unwrap_or((purpose, ""));
        let subject = format!("{what} epoch {next}");
        let sent = sent.map_err(Failure::from);
        let (transaction, receipt) = self.parts.log.ended(&owner.profile, action, subject.trim_start(), sent).await?;
        self.parts.link.scanned(receipt.block).await;
        let known =
            block_in_place(|| kept::token(&self.parts.plant.ledger.rights, &network.directory, owner.address, next))?;
        if known.is_some_and(|known| known != token) {
            return Err(refused(format!(
                "epoch {next} of '{}' was begun by another site with the same keys; run the command again, and let only \
                 one site have these keys",
                owner.profile
            )));
        }
        owner.confirm_epoch(network.domain, next)?;
        self.note_missing(owner, network)?;
        if let Err(failure) = self.rewrap(owner, network).await {
            self.parts.hub.alarm(&format!(
                "some readers of {} do not have all keys up to epoch {next} yet: {}",
                owner.profile, failure.message
            ));
        }
        self.parts.hub.changed(Part::Grants);
        let text = format!("{purpose}: epoch {next} has begun; new records are sealed under its key");
        Ok(TransactionView::mined(transaction, receipt.block, next, text))
    }

    /// Begins again the epochs that the chain lost. None is used a second time: revoked readers know their keys.
    async fn repeat_epochs(&self, owner: &Owner, network: &Network) -> Result<()> {
        let seen = owner.confirmed_epoch(network.domain);
        for epoch in network.directory.epoch(owner.address) + 1..=seen {
            let new_token = owner.prepare_epoch(network.domain, epoch)?;
            let envelope = recovery::own_envelope(&self.parts.plant, network, owner, epoch)?;
            let call = Call::Rotate { new_token, envelope };
            let sent = self.parts.sender.send(&network.chain, &owner.eoa(), call, "rotate (again)").await;
            let subject = format!("epoch {epoch}");
            let sent =
                self.parts.log.ended(&owner.profile, "rotate again", &subject, sent.map_err(Failure::from)).await?;
            self.parts.link.scanned(sent.1.block).await;
        }
        self.went_back(owner, network);
        Ok(())
    }

    /// Finishes an epoch that did not reach the chain, and re-wraps what is missing.
    pub async fn finish_epoch(&self, owner: &Owner) -> Result<()> {
        let (network, _one_at_a_time) = (self.parts.link.network().await?, owner.changes.lock().await);
        // Transactions of the previous run may still bring the epoch to the chain.
        self.settle_open(owner, &network).await?;
        if self.went_back(owner, &network) {
            return Ok(());
        }
        let on_chain = network.directory.epoch(owner.address);
        if owner.epochs(network.domain).last().is_some_and(|newest| *newest > on_chain) {
            self.next_epoch(owner, &network, "resumed").await?;
        }
        self.rewrap(owner, &network).await
    }

    pub async fn settle_open(&self, owner: &Owner, network: &Network) -> Result<()> {
        for _ in 0..60 {
            if self.parts.plant.ledger.lanes.open_lane(owner.address)?.iter().all(|row| row.anchors) {
                return Ok(());
            }
            let head = network.chain.head().await?.number;
            self.parts.sender.tend(&network.chain, &owner.eoa()).await?;
            network.chain.next_block(head, std::time::Duration::from_secs(1)).await?;
        }
        Err(refused(format!("earlier transactions of '{}' are still not in a block", owner.profile)))
    }

    /// Active readers who lack an envelope, by epoch: the current one for their current key, or one since their grant
    /// that ended before they got it. Not those being revoked.
    pub fn lacking(&self, owner: &Owner, network: &Network) -> Result<BTreeMap<u64, Vec<Granted>>> {
        if self.went_back(owner, network) {
            return Ok(BTreeMap::new());
        }
        let (epoch, known) = (network.directory.epoch(owner.address), owner.epochs(network.domain));
        let holds = recovery::holds_current(network, owner);
        let mut lacking: BTreeMap<u64, Vec<Granted>> = BTreeMap::new();
        for grant in authority::standing_grants(&network.directory, owner.address) {
            let since = network.directory.envelope_key_since(grant.terms.grantee);
            let current = Some(epoch).filter(|epoch| holds && !grant.is_wrapped_since(*epoch, since));
            let earlier = grant.unwrapped_before(epoch).filter(|epoch| known.contains(epoch));
            for epoch in earlier.chain(current).collect::<Vec<u64>>() {
                lacking.entry(epoch).or_default().push(grant.clone());
            }
        }
        if !lacking.is_empty() {
            let leaving = self.owed_revocations(owner, network)?;
            lacking.retain(|_, grants| {
                grants.retain(|grant| !leaving.contains(&grant.terms.grantee));
                !grants.is_empty()
            });
        }
        Ok(lacking)
    }

    /// Sends readers their missing envelopes, oldest epoch first; one failing reader does not hold up the others.
    pub async fn rewrap(&self, owner: &Owner, network: &Network) -> Result<()> {
        let mut failed = None;
        for (epoch, grants) in self.lacking(owner, network)? {
            failed = self.rewrap_epoch(owner, network, epoch, grants).await.err().or(failed);
        }
        failed.map_or(Ok(()), Err)
    }

    async fn rewrap_epoch(&self, owner: &Owner, network: &Network, epoch: u64, grants: Vec<Granted>) -> Result<()> {
        let (mut envelopes, mut failed) = (Vec::new(), None);
        for grant in grants {
            let checked = self.contacts.check_reader(network, owner.address, grant.terms.grantee).await;
            match checked.and_then(|()| self.envelope_for(owner, network, &grant, epoch)) {
                Ok(envelope) => envelopes.push((grant.terms.grantee, envelope)),
                Err(failure) => failed = Some(failure),
            }
        }
        if envelopes.is_empty() {
            return failed.map_or(Ok(()), Err);
        }
        let readers: Vec<String> = envelopes.iter().map(|(reader, _)| reader.short()).collect();
        let subject = format!("epoch {epoch} for {}", readers.join(" "));
        let wrapped = async {
            let mut failed = None;
            for chunk in envelopes.chunks(ENVELOPES_A_CALL) {
                let call = Call::Wrap { epoch, envelopes: chunk.to_vec() };
                match self.parts.sender.send(&network.chain, &owner.eoa(), call, "wrap").await {
                    Ok((_, receipt)) => self.parts.link.scanned(receipt.block).await,
                    Err(error) => failed = Some(Failure::from(error)),
                }
            }
            failed.map_or(Ok(()), Err)
        };
        let sent = self.parts.log.deed(&owner.profile, "wrap", &subject, wrapped).await;
        sent.and(failed.map_or(Ok(()), Err))
    }

    fn envelope_for(&self, owner: &Owner, network: &Network, grant: &Granted, epoch: u64) -> Result<Vec<u8>> {
        let topics = match &grant.terms.scope {
            Scope::All => Vec::new(),
            Scope::Topics(ids) => self.granted_topics(owner, ids)?.into_iter().flatten().collect(),
        };
        let terms = GrantTerms { epoch, ..grant.terms.clone() };
        self.wrap_keys(owner, network, terms, &topics, vec![epoch])
    }

    /// Wraps the keys of `epochs` for the grantee of `terms`: all topics, or only `topics`.
    pub fn wrap_keys(
        &self,
        owner: &Owner,
        network: &Network,
        terms: GrantTerms,
        topics: &[String],
        epochs: Vec<u64>,
    ) -> Result<Vec<u8>> {
        let reader = network.directory.identity(terms.grantee)?;
        let mut keys = Vec::with_capacity(epochs.len());
        for epoch in epochs {
            let key = owner.epoch_key(network.domain, epoch);
            keys.push((epoch, key.ok_or(PipelineError::UnknownEpoch(epoch))?));
        }
        let keys = match terms.scope {
            Scope::All => GrantedKeys::All { epochs: keys, index_key: owner.index() },
            Scope::Topics(_) => {
                let mut granted = Vec::new();
                for (epoch, key) in &keys {
                    for topic in topics {
                        let id = owner.topic_id(topic);
                        granted.push((*epoch, topic.clone(), id, crate::crypto::topic_key(key, &id)));
                    }
                }
                GrantedKeys::Topics { keys: granted }
            }
        };
        let wrapped = WrappedKeys { terms, keys };
        Ok(wrap(self.parts.plant.provider, &network.domain, &wrapped, &owner.signing(), &reader.envelope)?)
    }

    /// Brings keyring and recorder to the chain's epochs: fetches missing keys, and seals under the current epoch or
    /// one that never reached the chain. Without the current key nothing is sealed: nobody knows who reads under an
    /// earlier one. The caller holds the owner's changes.
    pub fn take_up_epoch(&self, owner: &Owner, network: &Network) -> Result<()> {
        if owner.is_locked() {
            return Ok(());
        }
        self.fetch_missing(owner, network)?;
        if !recovery::holds_current(network, owner) {
            owner.author.rest();
            self.parts.hub.changed(Part::Identity);
            return Ok(());
        }
        let (domain, on_chain) = (network.domain, network.directory.epoch(owner.address));
        owner.confirm_epoch(domain, on_chain)?;
        let newest = owner.epochs(domain).last().copied().unwrap_or(on_chain).max(on_chain);
        let signer = signer_id(&owner.public_keys().0);
        let stale = |keys: &EpochKeys| {
            let other = owner.token(domain, keys.epoch) != Some(keys.token);
            keys.domain != domain || keys.epoch < newest || keys.signer != signer || other
        };
        if owner.sealing().is_none_or(|keys| stale(&keys)) {
            owner.seal_under(domain, newest)?;
        }
        self.foresee_expiry(owner, network, None)?;
        self.parts.hub.changed(Part::Identity);
        Ok(())
    }

    /// Whether the chain has an event, since the last attempt, that may supply missing keys.
    pub fn has_news(&self, owner: &Owner, network: &Network) -> bool {
        if network.directory.epoch(owner.address) == 0 {
            return false;
        }
        match locked(&self.missing).epochs.get(&owner.profile) {
            Some(lack) => lack.seen != network.directory.newest(),
            None => !recovery::holds_current(network, owner),
        }
    }

    fn fetch_missing(&self, owner: &Owner, network: &Network) -> Result<()> {
        let lacking = block_in_place(|| recovery::lacking(&self.parts.plant, network, owner))?;
        if !lacking.is_empty() {
            let still = block_in_place(|| recovery::recover_epochs(&self.parts.plant, network, owner, &lacking))?;
            let fetched = (lacking.len() - still.len()) as u64;
            if fetched > 0 {
                let profile = &owner.profile;
                self.parts.hub.inform(&format!(
                    "the chain returned the keys of {} that the keyring of '{profile}' lacked",
                    counted(fetched, "epoch")
                ));
            }
        }
        self.note_missing(owner, network)
    }

    /// Notes what the keyring lacks now, and reports it once.
    pub(super) fn note_missing(&self, owner: &Owner, network: &Network) -> Result<()> {
        // Read before: an event that comes meanwhile is news.
        let seen = network.directory.newest();
        let epochs = block_in_place(|| recovery::lacking(&self.parts.plant, network, owner))?;
        if epochs.is_empty() {
            locked(&self.missing).epochs.remove(&owner.profile);
            return Ok(());
        }
        let lack = Lack { current: !recovery::holds_current(network, owner), epochs, seen };
        let text = lack.text(&owner.profile);
        let before = locked(&self.missing).epochs.insert(owner.profile.clone(), lack);
        if before.is_none_or(|before| before.text(&owner.profile) != text) {
            self.parts.hub.alarm(&text);
            self.parts.hub.changed(Part::Health);
        }
        Ok(())
    }

    /// `None` if the profile has the chain's SM2 pairs.
    pub fn note_pairs(&self, owner: &Owner, why: Option<String>) {
        match why {
            Some(why) => {
                self.parts.hub.alarm(&why);
                locked(&self.missing).pairs.insert(owner.profile.clone(), why);
            }
            None => drop(locked(&self.missing).pairs.remove(&owner.profile)),
        }
    }

    /// Whether the chain has an earlier epoch than before, as an older copy or a lagging node does. A reader revoked
    /// since may be active again in it, so nothing is wrapped until the owner has looked.
    pub fn went_back(&self, owner: &Owner, network: &Network) -> bool {
        let (chain, seen) = (network.directory.epoch(owner.address), owner.confirmed_epoch(network.domain));
        if chain >= seen {
            if locked(&self.missing).back.remove(&owner.profile).is_some() {
                self.parts.hub.changed(Part::Health);
            }
            return false;
        }
        let text = format!(
            "the chain has epoch {chain} of '{}' and had epoch {seen} before: it is an older copy, in which a reader \
             revoked since may have a grant again; look at `authros grant list`, revoke as before, then run \
             `authros keys rotate`",
            owner.profile
        );
        if locked(&self.missing).back.insert(owner.profile.clone(), text.clone()).is_none() {
            self.parts.hub.alarm(&text);
            self.parts.hub.changed(Part::Health);
        }
        true
    }

    /// `None` if open profiles have all keys.
    pub fn missing_text(&self) -> Option<String> {
        let missing = locked(&self.missing);
        let mut texts: Vec<String> = missing.pairs.values().chain(missing.back.values()).cloned().collect();
        texts.extend(missing.epochs.iter().map(|(profile, lack)| lack.text(profile)));
        (!texts.is_empty()).then(|| texts.join("; "))
    }
}

#[derive(Default)]
pub(in crate::site) struct Missing {
    epochs: BTreeMap<ProfileName, Lack>,
    /// Why the chain's newer SM2 pairs are not in the keyring, or the keyring's not on the chain.
    pairs: BTreeMap<ProfileName, String>,
    /// The chain has an earlier epoch than before.
    back: BTreeMap<ProfileName, String>,
}

struct Lack {
    epochs: Vec<u64>,
    /// The current epoch is among them: nothing is sealed then.
    current: bool,
    /// The chain's newest event at that time.
    seen: u64,
}

impl Lack {
    fn text(&self, profile: &ProfileName) -> String {
        let named: Vec<String> = self.epochs.iter().take(MOST_NAMED).map(ToString::to_string).collect();
        let more = if self.epochs.len() > MOST_NAMED { ", ..." } else { "" };
        let sealed = if self.current { " and nothing new is sealed" } else { "" };
        let rotate = if self.current { ", or seal under a new epoch with `authros keys rotate`" } else { "" };
        format!(
            "the keyring of '{profile}' lacks the keys of epochs {}{more}: their records cannot be opened here{sealed}; \
             the chain does not return them to these keys, so restore a newer backup of the keyring{rotate}",
            named.join(", ")
        )
    }
}

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
        let begun_here = locked(&self.begun).get(&owner.address) == Some(&epoch);
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
        locked(&self.begun).insert(owner.address, begun.epoch);
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
