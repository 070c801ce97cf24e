//! Epochs: beginning a new one at a revoke, a rotation or an expiry, and re-wrapping the remaining readers' keys. The
//! recorder switches before the transaction is sent.

use super::Sharing;
use std::collections::BTreeMap;
use std::sync::Arc;

use tokio::task::block_in_place;

use crate::chain::Call;
use crate::crypto::{GrantedKeys, WrappedKeys, wrap};
use crate::model::{Address, GrantTerms, Scope, Token};
use crate::pipeline::directory::{Granted, kept};
use crate::pipeline::{Network, Owner, PipelineError, authority, recovery};
use crate::service::event::{NoticeLevel, Part};
use crate::service::failure::refused;
use crate::service::reply::{Failure, TransactionView};

/// The most envelopes in a `wrap` transaction, to stay below 32 KB.
const ENVELOPES_A_CALL: usize = 8;

impl Sharing {
    /// Begins a new epoch.
    pub(in crate::site) async fn rotate(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        why: &str,
    ) -> Result<TransactionView, Failure> {
        let network = self.link.network().await?;
        let _one_at_a_time = owner.changes.lock().await;
        network.directory.identity(owner.address)?;
        let call = |new_token, envelope| Call::Rotate { new_token, envelope };
        self.begin_epoch(owner, &network, &format!("rotate ({why})"), call).await
    }

    /// Switches the recorder to the next epoch, tells the chain, and re-wraps for the remaining readers. The key goes to
    /// the chain with the same transaction, wrapped for its owner. The keys of earlier epochs are not needed.
    pub(in crate::site) async fn begin_epoch(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        network: &Network,
        purpose: &str,
        call: impl FnOnce(Token, Vec<u8>) -> Call,
    ) -> Result<TransactionView, Failure> {
        self.repeat_epochs(owner, network).await?;
        let next = network.directory.epoch(owner.address) + 1;
        let token = owner.prepare_epoch(network.domain, next)?;
        let envelope = recovery::own_envelope(&self.plant, network, owner, next)?;
        if !crate::crypto::fault::is_off("revoke") {
            owner.seal_under(network.domain, next)?;
        }
        let sent = self.sender.send(&network.chain, &owner.eoa(), call(token, envelope), purpose).await;
        let (action, what) = purpose.split_once(' ').unwrap_or((purpose, ""));
        let subject = format!("{what} epoch {next}");
        let sent = sent.map_err(Failure::from);
        let (transaction, receipt) = self.log.ended(&owner.profile, action, subject.trim_start(), sent).await?;
        self.link.scanned(receipt.block).await;
        let known = block_in_place(|| kept::token(&self.plant.ledger.rights, &network.directory, owner.address, next))?;
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
            let text = format!(
                "some readers of {} do not have all keys up to epoch {next} yet: {}",
                owner.profile, failure.message
            );
            self.hub.notice(NoticeLevel::Error, &text);
        }
        self.hub.changed(Part::Grants);
        Ok(TransactionView {
            transaction: Some(transaction),
            block: Some(receipt.block),
            epoch: next,
            text: format!("{purpose}: epoch {next} has started; new records are sealed under its key"),
        })
    }

    /// Begins the epochs that the chain had before and lost again. None of them is used for a second time: readers who were
    /// revoked know their keys.
    async fn repeat_epochs(self: &Arc<Self>, owner: &Arc<Owner>, network: &Network) -> Result<(), Failure> {
        let seen = owner.confirmed_epoch(network.domain);
        for epoch in network.directory.epoch(owner.address) + 1..=seen {
            let new_token = owner.prepare_epoch(network.domain, epoch)?;
            let envelope = recovery::own_envelope(&self.plant, network, owner, epoch)?;
            let call = Call::Rotate { new_token, envelope };
            let sent = self.sender.send(&network.chain, &owner.eoa(), call, "rotate (again)").await;
            let subject = format!("epoch {epoch}");
            let sent = self.log.ended(&owner.profile, "rotate again", &subject, sent.map_err(Failure::from)).await?;
            self.link.scanned(sent.1.block).await;
        }
        self.went_back(owner, network);
        Ok(())
    }

    /// Finishes an epoch that was begun but did not reach the chain, and re-wraps what is missing.
    pub(in crate::site) async fn finish_epoch(self: &Arc<Self>, owner: &Arc<Owner>) -> Result<(), Failure> {
        let network = self.link.network().await?;
        let _one_at_a_time = owner.changes.lock().await;
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

    pub(in crate::site) async fn settle_open(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        network: &Network,
    ) -> Result<(), Failure> {
        let ledger = self.plant.ledger.clone();
        let account = owner.address;
        for _ in 0..60 {
            let open = block_in_place(|| ledger.lanes.open_lane(account))?;
            if open.iter().all(|row| row.anchors) {
                return Ok(());
            }
            let head = network.chain.head().await?.number;
            self.sender.tend(&network.chain, &owner.eoa()).await?;
            network.chain.next_block(head, std::time::Duration::from_secs(1)).await?;
        }
        Err(refused(format!("earlier transactions of '{}' are still not in a block", owner.profile)))
    }

    /// Active readers who lack an envelope, by its epoch: of the current one for their current key, or of an earlier one that
    /// began since their grant, because the epoch after it began before they could be given it. Not those who are being
    /// revoked.
    pub(in crate::site) fn lacking(
        &self,
        owner: &Owner,
        network: &Network,
    ) -> Result<BTreeMap<u64, Vec<Granted>>, Failure> {
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

    /// Sends every active reader the envelopes that they lack, the oldest epoch first. If one reader cannot be given any,
    /// the others still get theirs.
    ///
    /// # Errors
    /// The last failure; it is tried again.
    pub(in crate::site) async fn rewrap(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        network: &Network,
    ) -> Result<(), Failure> {
        let mut failed = None;
        for (epoch, grants) in self.lacking(owner, network)? {
            failed = self.rewrap_epoch(owner, network, epoch, grants).await.err().or(failed);
        }
        failed.map_or(Ok(()), Err)
    }

    async fn rewrap_epoch(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        network: &Network,
        epoch: u64,
        grants: Vec<Granted>,
    ) -> Result<(), Failure> {
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
        let sent =
            self.log.deed(&owner.profile, "wrap", &subject, self.wrap_all(owner, network, epoch, &envelopes)).await;
        sent.and(failed.map_or(Ok(()), Err))
    }

    async fn wrap_all(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        network: &Network,
        epoch: u64,
        envelopes: &[(Address, Vec<u8>)],
    ) -> Result<(), Failure> {
        let mut failed = None;
        for chunk in envelopes.chunks(ENVELOPES_A_CALL) {
            let call = Call::Wrap { epoch, envelopes: chunk.to_vec() };
            match self.sender.send(&network.chain, &owner.eoa(), call, "wrap").await {
                Ok((_, receipt)) => self.link.scanned(receipt.block).await,
                Err(error) => failed = Some(Failure::from(error)),
            }
        }
        failed.map_or(Ok(()), Err)
    }

    fn envelope_for(&self, owner: &Owner, network: &Network, grant: &Granted, epoch: u64) -> Result<Vec<u8>, Failure> {
        let topics = match &grant.terms.scope {
            Scope::All => Vec::new(),
            Scope::Topics(ids) => self.granted_topics(owner, ids)?.into_iter().flatten().collect(),
        };
        let terms = GrantTerms { epoch, ..grant.terms.clone() };
        self.wrap_keys(owner, network, terms, &topics, vec![epoch])
    }

    /// Wraps the keys of `epochs` for the grantee of `terms`: all topics, or only `topics`.
    pub(in crate::site) fn wrap_keys(
        &self,
        owner: &Owner,
        network: &Network,
        terms: GrantTerms,
        topics: &[String],
        epochs: Vec<u64>,
    ) -> Result<Vec<u8>, Failure> {
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
        Ok(wrap(self.plant.provider, &network.domain, &wrapped, &owner.signing(), &reader.envelope)?)
    }
}
