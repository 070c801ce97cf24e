//! Ledger rows for viewing: first compared with their records, untrusted text cleaned.

use super::Reading;
use std::collections::HashMap;
use std::sync::Arc;

use tokio::task::block_in_place;

use super::super::super::reply::{RecordPage, RecordView};
use crate::crypto::{IndexKey, Names, TopicKey, topic_key};
use crate::model::{Address, Header, RecordKind, Verdict, clean};
use crate::pipeline::columns::{Comparison, Keys, Shown};
use crate::pipeline::{Network, Owner};
use crate::service::command::UploadQuery;
use crate::service::reply::Failure;
use crate::site::identity::owners::Owners;
use crate::store::{FilterChoice, RecordQuery, RecordRow};

/// Widest topic or type shown, characters (ROS names are shorter than this).
const WIDEST: usize = 255;

/// Keys of the profiles that are open here.
pub(in crate::site) struct OwnKeys(HashMap<Address, Arc<Owner>>);

impl OwnKeys {
    /// Of the profiles whose keyrings were opened since the site began.
    pub fn of(owners: &Owners) -> Self {
        Self(owners.all().into_iter().map(|owner| (owner.address, owner)).collect())
    }
}

impl Keys for OwnKeys {
    fn opening(&self, header: &Header) -> Option<(TopicKey, Names)> {
        let owner = self.0.get(&header.owner)?;
        let key = owner.epoch_key(header.domain, header.epoch)?;
        Some((topic_key(&key, &header.topic_id), Names::Derived(owner.index())))
    }

    fn index_key(&self, row: &RecordRow) -> Option<IndexKey> {
        // IK stays in memory while a keyring is locked: records are sealed with it.
        self.0.get(&row.owner).map(|owner| owner.index())
    }
}

/// Why a record was not checked against the chain, if it was not.
pub(super) fn reason_of(verdict: Verdict, network: &Network) -> Option<String> {
    network.absent.as_ref().filter(|_| verdict == Verdict::NotChecked).map(ToString::to_string)
}

impl Reading {
    /// Keys of the profiles whose keyrings were opened since the site began.
    pub(in crate::site) fn own_keys(&self) -> OwnKeys {
        OwnKeys::of(&self.owners)
    }

    /// Rows ready to be shown; each must have the ids in `filters` by which they were found.
    pub(in crate::site) fn compared(
        &self,
        rows: Vec<RecordRow>,
        keys: &dyn Keys,
        filters: &[FilterChoice],
    ) -> Result<Vec<Shown>, Failure> {
        let comparison = Comparison { plant: &self.plant, keys, heads: &self.heads, filters };
        Ok(block_in_place(|| comparison.of(rows))?)
    }

    /// One row ready to be shown.
    pub(in crate::site) fn compared_one(&self, row: &RecordRow, keys: &dyn Keys) -> Result<Shown, Failure> {
        let shown = self.compared(vec![row.clone()], keys, &[])?.into_iter().next();
        Ok(shown.unwrap_or_else(|| Shown::unread(row.clone())))
    }
}

/// One row; `with_owner` for lists of other owners' records.
pub(in crate::site) fn record_view(shown: &Shown, with_owner: bool) -> RecordView {
    let row = &shown.row;
    RecordView {
        id: row.id.clone(),
        owner: with_owner.then_some(row.owner),
        owner_name: None,
        seq: row.seq,
        topic: clean(&row.topic, WIDEST),
        type_name: clean(&row.type_name, WIDEST),
        kind: row.kind,
        state: shown.state(),
        digest: row.digest,
        bytes: row.bytes,
        captured_at: row.captured_at,
        epoch: row.epoch,
        simulated: row.simulated,
        transaction: row.transaction,
        block: row.block,
        compared: shown.compared,
        differs: shown.differs.map(str::to_owned),
        erased: None,
    }
}

/// A page of rows, and where the next one begins.
pub fn record_page(rows: &[Shown], next: Option<String>, with_owner: bool) -> RecordPage {
    let records = rows.iter().map(|row| record_view(row, with_owner)).collect();
    RecordPage { records, next, arriving: None }
}

/// A person's query in the ledger's form; captured messages unless another kind is requested.
pub(in crate::site) fn record_query(query: UploadQuery) -> RecordQuery {
    RecordQuery {
        topic: query.topic.map(|topic| topic.to_string()),
        type_name: query.type_name.map(|name| name.to_string()),
        words: query.words,
        kind: Some(query.kind.unwrap_or(RecordKind::Data)),
        state: query.state,
        since: query.since,
        until: query.until,
        after: query.after,
        limit: query.limit.clamp(1, 1000),
        newest_first: query.newest_first,
        ..RecordQuery::default()
    }
}
