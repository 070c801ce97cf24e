//! Records that others share: listed, checked and opened, by the chain's grants at that moment.

use std::collections::HashMap;
use std::sync::Arc;

use super::Site;
use super::view::{record_page, record_query, record_view};
use crate::model::{Address, Scope, Timestamp, TopicId, clean};
use crate::pipeline::Owner;
use crate::pipeline::reader::{Reader, is_held};
use crate::ros::Limits;
use crate::service::command::UploadQuery;
use crate::service::reply::{CheckView, Failure, OpenedView, RecordPage};
use crate::store::RecordQuery;

impl Site {
    /// Records of all owners with an active grant to this profile, within each grant's scope.
    pub(super) async fn list_shared(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        query: UploadQuery,
    ) -> Result<RecordPage, Failure> {
        let network = self.network().await?;
        let (me, now) = (owner.address, Timestamp::now());
        let grants = network.directory.grants(|grant| grant.terms.grantee == me && grant.is_active(now));
        let mut scopes: HashMap<Address, Scope> = HashMap::new();
        let wanted = query.owner.as_ref().map(|owner| self.resolve(owner)).transpose()?;
        for grant in grants.into_iter().filter(|grant| wanted.is_none_or(|wanted| wanted == grant.terms.owner)) {
            scopes.insert(grant.terms.owner, grant.terms.scope);
        }
        if scopes.is_empty() {
            return Ok(RecordPage { records: Vec::new(), next: None });
        }
        self.audit_query(owner, "list shared", &query).await?;
        let readable = self.readable_topics(&scopes).await?;
        let query = RecordQuery {
            owners: Some(scopes.keys().copied().collect()),
            owner: None,
            topic_ids: Some(readable),
            ..record_query(query)
        };
        let reader = Reader { plant: &self.plant, network: &network, reader: owner };
        for owner in scopes.keys() {
            self.learn_names(&reader, *owner).await?;
        }
        let mut page = self.readable_page(&reader, query).await?;
        let names = self.names();
        for record in &mut page.records {
            record.owner_name = record.owner.and_then(|owner| names.get(&owner).cloned());
        }
        Ok(page)
    }

    /// The next page with a record that the reader's keys open; such pages may be short.
    async fn readable_page(
        self: &Arc<Self>,
        reader: &Reader<'_>,
        mut query: RecordQuery,
    ) -> Result<RecordPage, Failure> {
        loop {
            let asked = query.clone();
            let mut page = self.blocking(move |site| Ok(site.plant.ledger.list(&asked)?)).await?;
            page.rows.retain(|row| !is_held(row) && reader.topic_key(row).is_ok());
            if !page.rows.is_empty() || page.next.is_none() {
                return Ok(record_page(page, true));
            }
            query.after = page.next;
        }
    }

    pub(super) async fn readable_topics(
        self: &Arc<Self>,
        scopes: &HashMap<Address, Scope>,
    ) -> Result<Vec<TopicId>, Failure> {
        let mut ids = Vec::new();
        for (owner, scope) in scopes {
            match scope {
                Scope::Topics(topics) => ids.extend(topics.iter().copied()),
                Scope::All => {
                    let owner = *owner;
                    let counts = self.blocking(move |site| Ok(site.plant.ledger.counts(Some(owner))?)).await?;
                    ids.extend(counts.topics.iter().filter_map(|topic| topic.topic_id));
                }
            }
        }
        Ok(ids)
    }

    /// The paper's `Data_Check`: digest against the chain, signature; no key needed.
    pub(super) async fn check_record(self: &Arc<Self>, owner: &Arc<Owner>, id: &str) -> Result<CheckView, Failure> {
        let row = self.find_record(id).await?;
        let network = self.network().await?;
        let reader = Reader { plant: &self.plant, network: &network, reader: owner };
        let allowed = reader.authorise(&row);
        self.count_refusal(owner, &allowed);
        allowed?;
        self.audit_first(owner, "check", &row.id).await?;
        let (verdict, digest) = reader.check(&row).await?;
        Ok(CheckView { id: row.id, verdict, digest, transaction: row.transaction, block: row.block })
    }

    /// Checks, decrypts and decodes one record, shared or own.
    pub(super) async fn open_record(self: &Arc<Self>, owner: &Arc<Owner>, id: &str) -> Result<OpenedView, Failure> {
        let row = self.find_record(id).await?;
        let network = self.network().await?;
        let reader = Reader { plant: &self.plant, network: &network, reader: owner };
        let allowed = reader.authorise(&row);
        self.count_refusal(owner, &allowed);
        allowed?;
        self.audit_first(owner, "decrypt", &row.id).await?;
        let opened = reader.open(&row).await?;
        let definition = reader.definition(&row, &opened).await?;
        let decoded =
            definition.as_ref().and_then(|definition| definition.decode(&opened.body, Limits::default()).ok());
        let picture = definition
            .as_ref()
            .and_then(|definition| definition.compressed_image(&opened.body))
            .and_then(|picture| opened.body.get(picture.data).map(<[u8]>::to_vec))
            .filter(|_| !crate::crypto::fault::is_off("restore"));
        let fields = decoded.as_ref().map(|value| value.flatten()).unwrap_or_default();
        Ok(OpenedView {
            record: record_view(&row, row.owner != owner.address),
            verdict: opened.verdict,
            caller_id: clean(&opened.head.caller_id, 255),
            tags: opened.head.tags.iter().map(|(key, value)| (clean(key, 64), clean(value, 200))).collect(),
            fields: fields.into_iter().map(|(path, text)| (clean(&path, 200), clean(&text, 400))).collect(),
            message: decoded.map_or(serde_json::Value::Null, |value| value.to_json()),
            body: Some(opened.body),
            picture,
        })
    }
}
