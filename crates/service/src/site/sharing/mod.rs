//! Granting and revoking, and the list of who may read what.

mod epochs;
mod opening;
pub(super) mod overdue;
#[cfg(test)]
mod tests;

use crate::site::capture::ros::RosSide;
use crate::site::contacts::Contacts;
use crate::site::devices::enrolled::Enrolments;
use crate::site::mirror::Joined;
use crate::site::parts::Parts;
use crate::store::Reserve;
use crate::store::notes::{GrantedFrom, GrantedTopic};
use std::collections::{HashMap, HashSet};
use std::sync::{Arc, Mutex};

use tokio::task::block_in_place;

use crate::chain::Call;
use crate::crypto::{GrantedKeys, WrappedKeys};
use crate::gateway::GrantNotice;
use crate::model::grant::MOST_TOPICS;
use crate::model::{Address, GrantTerms, Party, Scope, Timestamp, TopicId, TopicName, clean, natural};
use crate::pipeline::directory::{GrantState, Granted, kept};
use crate::pipeline::reader::Reader;
use crate::pipeline::recorder::CapturedMessage;
use crate::pipeline::ring::Rings;
use crate::pipeline::{Network, Owner, authority};
use crate::service::command::GrantFrom;
use crate::service::event::Part;
use crate::service::failure::{input, refused};
use crate::service::reply::{Direction, Failure, GrantRow, NOTHING_OLDER, Result, TransactionView};
use crate::store::RecordRow;

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
        self.parts.log.begin(owner, "grant", &grantee.to_string()).await?;
        self.settle_revocation(owner, grantee)?;
        self.foresee_expiry(owner, &network, expires)?;
        let call = Call::AuthorityGrant { grantee, epoch, expiry: terms.expiry, scope: terms.scope, envelope };
        let sent = self.parts.sender.send(&network.chain, &owner.eoa(), call, "authorityGrant").await;
        let sent = self.parts.log.end(owner, "grant", &grantee.to_string(), sent.map_err(Failure::from)).await;
        let (transaction, receipt) = sent?;
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
        let subject = grantee.to_string();
        self.parts.log.begin(owner, "extend", &subject).await?;
        let sent = self.parts.sender.send(&network.chain, &owner.eoa(), call, "extend").await.map_err(Failure::from);
        let (transaction, receipt) = self.parts.log.end(owner, "extend", &subject, sent).await?;
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
