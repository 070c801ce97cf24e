//! Records shared by others: listed, checked and opened, according to the chain's grants at that moment.

use super::Reading;
use std::collections::HashMap;

use super::of_namespace;
use super::view::reason_of;
use crate::crypto::GrantedKeys;
use crate::model::{Address, Scope, TopicId};
use crate::pipeline::directory::Granted;
use crate::pipeline::epoch::tag_choice;
use crate::pipeline::reader::{Reader, is_held};
use crate::pipeline::{Network, Owner, authority};
use crate::service::command::UploadQuery;
use crate::service::failure::input;
use crate::service::reply::{CheckView, ContractAnswer, RecordPage, Result};
use crate::store::{FilterChoice, RecordQuery, RecordRow};

impl Reading {
    /// Records of all owners with an active grant to this profile, within each grant's scope.
    pub async fn list_shared(&self, owner: &Owner, query: UploadQuery) -> Result<RecordPage> {
        if query.incident.is_some() {
            return Err(input("incidents cover your own records: use `authros records list --incident NAME`"));
        }
        let network = self.parts.link.network().await?;
        let wanted = query.owner.as_ref().map(|owner| self.contacts.resolve(owner)).transpose()?;
        let mut grants = authority::shared_with(&network.directory, owner.address);
        grants.retain(|grant| wanted.is_none_or(|wanted| wanted == grant.terms.owner));
        let scopes = grants.iter().map(|grant| (grant.terms.owner, grant.terms.scope.clone()));
        let scopes: HashMap<Address, Scope> = scopes.collect();
        if scopes.is_empty() {
            return Ok(RecordPage { records: Vec::new(), next: None, arriving: None });
        }
        self.parts.log.asked(owner, "list shared", &query).await?;
        let filters = self.shared_tag_filters(&network, owner, &grants, &query.tags)?;
        let readable = self.readable_topics(&scopes)?;
        let reader = Reader { plant: &self.parts.plant, network: &network, reader: owner };
        for owner in scopes.keys() {
            self.name_asked(*owner, reader.index_of(*owner), query.topic.as_ref())?;
            self.learn_names(&reader, *owner).await?;
        }
        let query = RecordQuery {
            owners: Some(scopes.keys().copied().collect()),
            owner: None,
            topic_ids: Some(readable),
            filters: filters.clone(),
            ..of_namespace(query)?
        };
        self.readable_page(&reader, query, &filters)
    }

    /// The next page with a record that the reader's keys open; it may be short.
    fn readable_page(
        &self,
        reader: &Reader<'_>,
        mut query: RecordQuery,
        filters: &[FilterChoice],
    ) -> Result<RecordPage> {
        loop {
            let mut page = self.parts.plant.ledger.records.list(&query)?;
            page.rows.retain(|row| !is_held(row) && reader.topic_key(row).is_ok());
            if !page.rows.is_empty() || page.next.is_none() {
                return self.page_of(page, reader, filters, true);
            }
            query.after = page.next;
        }
    }

    /// Filter ids of another owner's tags, from the IK that a grant of all topics carries.
    fn shared_tag_filters(
        &self,
        network: &Network,
        owner: &Owner,
        grants: &[Granted],
        tags: &[(String, String)],
    ) -> Result<Vec<FilterChoice>> {
        if tags.is_empty() {
            return Ok(Vec::new());
        }
        let [grant] = grants else {
            return Err(input("tags are searched among the records of one owner; give the owner as well"));
        };
        let reader = Reader { plant: &self.parts.plant, network, reader: owner };
        match reader.open_envelope(grant, grant.terms.epoch)?.keys {
            GrantedKeys::All { ref index_key, .. } => {
                let topics = self.topics_of(grant.terms.owner)?;
                Ok(tags.iter().map(|(name, value)| tag_choice(index_key, name, value, &topics)).collect())
            }
            GrantedKeys::Topics { .. } => Err(input(
                "a grant of some topics does not include the key needed to search by tag; search by topic or type",
            )),
        }
    }

    pub fn readable_topics(&self, scopes: &HashMap<Address, Scope>) -> Result<Vec<TopicId>> {
        let mut ids = Vec::new();
        for (owner, scope) in scopes {
            match scope {
                Scope::Topics(topics) => ids.extend(topics.iter().copied()),
                Scope::All => {
                    let counts = self.parts.plant.ledger.counts.by_state(Some(*owner))?;
                    ids.extend(counts.topics.iter().filter_map(|topic| topic.topic_id));
                    ids.extend(counts.attachments);
                }
            }
        }
        Ok(ids)
    }

    /// A record that the owner may read now, and the chain that says so; counts a refusal. Own records need no chain,
    /// others' always do.
    pub async fn authorised(&self, owner: &Owner, id: &str) -> Result<(RecordRow, Network)> {
        let row = self.find_record(id)?;
        let is_own = row.owner == owner.address;
        let network = if is_own { self.network_or_kept().await? } else { self.parts.link.network().await? };
        let allowed = Reader { plant: &self.parts.plant, network: &network, reader: owner }.authorise(&row);
        self.parts.log.count_refusal(owner, &allowed);
        allowed?;
        Ok((row, network))
    }

    /// The paper's `Data_Check`: digest and signature, without any key; also asks the contract about the right to read.
    pub async fn check_record(&self, owner: &Owner, id: &str) -> Result<CheckView> {
        let (row, network) = self.authorised(owner, id).await?;
        let reader = Reader { plant: &self.parts.plant, network: &network, reader: owner };
        let checked = async {
            let (verdict, digest) = reader.check(&row).await?;
            let asked = authority::ask_contract(&self.parts.plant, &network, owner.address, row.owner, row.epoch);
            Ok((verdict, digest, asked.await?))
        };
        let (verdict, digest, answer) = self.parts.log.deed(&owner.profile, "check", &row.id, checked).await?;
        let contract = answer.map(|answer| ContractAnswer {
            reader: owner.address,
            owner: row.owner,
            authorised: answer.authorised,
            epoch: answer.epoch,
            count: answer.count,
            last: (answer.count > 0).then_some(answer.last),
        });
        let (reason, transaction, block) = (reason_of(verdict, &network), row.transaction, row.block);
        Ok(CheckView { id: row.id, verdict, reason, digest, transaction, block, contract })
    }
}
