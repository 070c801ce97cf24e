//! Granting and revoking, and the list of who may read what.

use std::sync::Arc;

use super::Site;
use crate::chain::Call;
use crate::gateway::GrantNotice;
use crate::model::grant::MOST_TOPICS;
use crate::model::{Address, GrantTerms, Party, Scope, Timestamp, TopicName};
use crate::pipeline::Owner;
use crate::pipeline::directory::Granted;
use crate::service::command::Epochs;
use crate::service::event::Part;
use crate::service::failure::{input, refused};
use crate::service::reply::{Failure, GrantRow, TransactionView};

impl Site {
    /// Shares with an account: its envelope goes on the chain.
    pub(super) async fn grant(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        grantee: &Party,
        topics: &[TopicName],
        epochs: Epochs,
        expires: Option<Timestamp>,
    ) -> Result<TransactionView, Failure> {
        let network = self.network().await?;
        let _one_at_a_time = owner.changes.lock().await;
        network.directory.identity(owner.address)?;
        let grantee = self.resolve(grantee)?;
        if grantee == owner.address {
            return Err(refused(format!("{grantee} is this profile itself; it reads its own records without a grant")));
        }
        if topics.len() > MOST_TOPICS {
            return Err(input(format!("a grant names at most {MOST_TOPICS} topics; grant all topics, or fewer")));
        }
        if expires.is_some_and(|at| at <= Timestamp::now()) {
            return Err(input("the grant would end before it begins; give a later --expires"));
        }
        network.directory.identity(grantee)?;
        self.check_contact(&network, grantee).await?;
        if self.active_grant(&network, owner.address, grantee).is_some() {
            return Err(refused(format!("{grantee} has an active grant already; revoke it first to change its terms")));
        }
        let epoch = network.directory.epoch(owner.address);
        let terms = GrantTerms { owner: owner.address, grantee, epoch, expiry: expires, scope: scope(owner, topics) };
        let names: Vec<String> = topics.iter().map(ToString::to_string).collect();
        self.remember_topics(owner, grantee, &names)?;
        let covered = match epochs {
            Epochs::Current => vec![epoch],
            Epochs::All => owner.epochs(network.domain).into_iter().filter(|known| *known <= epoch).collect(),
        };
        let envelope = self.wrap_keys(owner, &network, terms.clone(), &names, covered)?;
        self.audit_first(owner, "grant", &grantee.to_string()).await?;
        self.settle_revocation(owner, grantee)?;
        self.foresee_expiry(owner, &network, expires)?;
        let call = Call::AuthorityGrant { grantee, epoch, expiry: terms.expiry, scope: terms.scope, envelope };
        let sent = self.sender.send(&network.chain, &owner.eoa(), call, "authorityGrant").await;
        let sent = self.audit_end(owner, "grant", &grantee.to_string(), sent.map_err(Failure::from)).await;
        let (transaction, receipt) = sent?;
        let notice = GrantNotice { grantee, epoch, expiry: expires.map_or(0, Timestamp::seconds), transaction };
        self.tell_of_grant(owner, &network, notice).await;
        self.scanned(receipt.block).await;
        self.changed(Part::Grants);
        let what = if names.is_empty() { "all topics".to_owned() } else { names.join(", ") };
        Ok(TransactionView {
            transaction: Some(transaction),
            block: Some(receipt.block),
            epoch,
            text: format!("{grantee} may read {what}, from epoch {epoch} on"),
        })
    }

    pub(super) fn active_grant(
        &self,
        network: &crate::pipeline::Network,
        owner: Address,
        grantee: Address,
    ) -> Option<Granted> {
        let now = Timestamp::now();
        network
            .directory
            .grants(|grant| grant.terms.owner == owner && grant.terms.grantee == grantee && grant.is_active(now))
            .pop()
    }

    fn remember_topics(&self, owner: &Owner, grantee: Address, topics: &[String]) -> Result<(), Failure> {
        let text = serde_json::to_string(topics).unwrap_or_default();
        Ok(tokio::task::block_in_place(|| self.plant.ledger.put_setting(&topics_key(owner, grantee), &text))?)
    }

    /// Names of the topics that a scoped grant of this owner covers.
    pub(super) fn granted_topics(&self, owner: &Owner, grantee: Address) -> Result<Vec<String>, Failure> {
        let text = tokio::task::block_in_place(|| self.plant.ledger.setting(&topics_key(owner, grantee)))?;
        Ok(text.and_then(|text| serde_json::from_str(&text).ok()).unwrap_or_default())
    }

    /// Grants given and received.
    pub(super) async fn grant_rows(self: &Arc<Self>, owner: &Arc<Owner>) -> Result<Vec<GrantRow>, Failure> {
        let network = self.network().await?;
        let me = owner.address;
        let grants = network.directory.grants(|grant| grant.terms.owner == me || grant.terms.grantee == me);
        let names = self.names();
        let with_name = |mut row: GrantRow| {
            let other = if row.owner == me { row.grantee } else { row.owner };
            row.name = names.get(&other).cloned();
            row.fingerprint = Self::registered_fingerprint(&network, other);
            row
        };
        grants.iter().map(|grant| self.grant_row(owner, &network, grant).map(with_name)).collect()
    }

    fn grant_row(
        &self,
        owner: &Owner,
        network: &crate::pipeline::Network,
        grant: &Granted,
    ) -> Result<GrantRow, Failure> {
        let given = grant.terms.owner == owner.address;
        let topics = match &grant.terms.scope {
            Scope::All => Vec::new(),
            Scope::Topics(ids) if given => {
                let names = self.granted_topics(owner, grant.terms.grantee)?;
                if names.is_empty() { ids.iter().map(ToString::to_string).collect() } else { names }
            }
            Scope::Topics(ids) => self.received_topics(owner, network, grant, ids),
        };
        Ok(GrantRow {
            direction: if given { "given" } else { "received" }.to_owned(),
            owner: grant.terms.owner,
            grantee: grant.terms.grantee,
            epoch: grant.terms.epoch,
            expires: grant.terms.expiry,
            topics,
            state: grant.word(Timestamp::now()).to_owned(),
            block: grant.block,
            transaction: grant.transaction,
            name: None,
            fingerprint: None,
        })
    }

    fn received_topics(
        &self,
        owner: &Owner,
        network: &crate::pipeline::Network,
        grant: &Granted,
        ids: &[crate::model::TopicId],
    ) -> Vec<String> {
        let reader = crate::pipeline::reader::Reader { plant: &self.plant, network, reader: owner };
        match reader.open_envelope(grant, grant.terms.epoch).as_deref() {
            Ok(crate::crypto::WrappedKeys { keys: crate::crypto::GrantedKeys::Topics { keys }, .. }) => {
                let mut names: Vec<String> =
                    keys.iter().map(|(_, topic, _, _)| crate::model::clean(topic, 255)).collect();
                names.sort();
                names.dedup();
                names
            }
            _ => ids.iter().map(ToString::to_string).collect(),
        }
    }
}

fn scope(owner: &Owner, topics: &[TopicName]) -> Scope {
    if topics.is_empty() {
        return Scope::All;
    }
    let mut ids = Vec::with_capacity(topics.len());
    for topic in topics {
        let id = owner.topic_id(topic.as_str());
        if !ids.contains(&id) {
            ids.push(id);
        }
    }
    Scope::Topics(ids)
}

fn topics_key(owner: &Owner, grantee: Address) -> String {
    format!("granted:{}:{grantee}", owner.address)
}
