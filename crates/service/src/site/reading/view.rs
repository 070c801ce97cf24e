//! Ledger rows for viewing: compared with their records, untrusted text cleaned, names learnt for pseudonyms.

use std::collections::HashMap;
use std::sync::{Arc, PoisonError};

use tokio::task::block_in_place;

use super::Reading;
use crate::command::UploadQuery;
use crate::crypto::{CryptoError, IndexKey, Names, TopicKey, topic_id, topic_key};
use crate::model::bytes::hex;
use crate::model::{Address, Digest, Header, ProfileName, RecordKind, TopicPattern, TopicPatterns, Verdict, clean};
use crate::pipeline::columns::{Comparison, Keys, Shown};
use crate::pipeline::reader::Reader;
use crate::pipeline::{Network, Owner, PipelineError};
use crate::reply::{RecordPage, RecordView, Result};
use crate::site::identity::Owners;
use crate::store::{FilterChoice, RecordQuery, RecordRow};

/// Characters; ROS names are shorter.
const WIDEST: usize = 255;

/// Records of a stream opened to learn its names: among a stolen robot's, some are false.
const TRIES: usize = 8;
/// Records not opened again for their names.
const MOST_NAMELESS: usize = 8192;

pub(in crate::site) struct OwnKeys(HashMap<Address, Arc<Owner>>);

impl OwnKeys {
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

/// Why a record was not checked against the chain.
pub(super) fn reason_of(verdict: Verdict, network: &Network) -> Option<String> {
    network.absent.as_ref().filter(|_| verdict == Verdict::NotChecked).map(ToString::to_string)
}

impl Reading {
    /// Keys of the profiles opened since the site began.
    pub fn own_keys(&self) -> OwnKeys {
        OwnKeys::of(&self.parts.owners)
    }

    /// Rows ready to be shown; each must have the ids in `filters` by which it was found.
    pub fn compared(&self, rows: Vec<RecordRow>, keys: &dyn Keys, filters: &[FilterChoice]) -> Result<Vec<Shown>> {
        let comparison = Comparison { plant: &self.parts.plant, keys, heads: &self.heads, filters };
        Ok(block_in_place(|| comparison.of(rows))?)
    }

    pub fn compared_one(&self, row: &RecordRow, keys: &dyn Keys) -> Result<Shown> {
        let shown = self.compared(vec![row.clone()], keys, &[])?.into_iter().next();
        Ok(shown.unwrap_or_else(|| Shown::unread(row.clone())))
    }

    /// Learns the names of the profile's own topics: robots' records arrive without.
    pub async fn learn_own_names(&self, profile: &ProfileName) -> Result<()> {
        let owner = self.parts.owners.get(profile).filter(|owner| !owner.is_locked());
        let (Some(owner), Some(network)) = (owner, self.parts.link.network_now()) else { return Ok(()) };
        let reader = Reader { plant: &self.parts.plant, network: &network, reader: &owner };
        self.learn_names(&reader, owner.address).await
    }

    /// Opens a record of each unnamed stream of `owner`, as far as the reader may.
    pub async fn learn_names(&self, reader: &Reader<'_>, owner: Address) -> Result<()> {
        let unnamed = self.parts.plant.ledger.names.unnamed(owner, TRIES)?;
        for stream in unnamed {
            for digest in stream {
                if self.learn_from(reader, digest).await? {
                    break;
                }
            }
        }
        Ok(())
    }

    /// Names the requested topic, if it is here only as a pseudonym. IK derives that from the name, so no record is
    /// opened or believed.
    pub fn name_asked(&self, owner: Address, index: Option<IndexKey>, topic: Option<&TopicPattern>) -> Result<()> {
        let name = topic.filter(|topic| topic.is_plain()).map(ToString::to_string);
        let (Some(index), Some(name)) = (index, name) else { return Ok(()) };
        let id = topic_id(&index, &name);
        Ok(self.parts.plant.ledger.names.keep_topic(owner, id, name)?)
    }

    /// Returns whether there were names to learn.
    async fn learn_from(&self, reader: &Reader<'_>, digest: Digest) -> Result<bool> {
        let tried = (reader.reader.address, digest);
        if self.nameless.lock().unwrap_or_else(PoisonError::into_inner).contains(&tried) {
            return Ok(false);
        }
        let row = self.parts.plant.ledger.records.find(digest)?;
        let Some(row) = row else { return Ok(false) };
        let opened = match reader.open(&row).await {
            Ok(opened) => opened,
            Err(error) => {
                if matches!(error, PipelineError::Crypto(CryptoError::FalseName(_))) {
                    self.pass_over(tried);
                }
                return Ok(false);
            }
        };
        let (topic, type_name) = (opened.head.topic, opened.head.type_name);
        let with_type = !row.type_name.is_empty() && row.type_name != type_name;
        // Without IK the owner of the type's pseudonym is unknown: its name stays with each record.
        let with_type = with_type && reader.index_key(&row).is_some();
        if !with_type {
            self.pass_over(tried);
        }
        block_in_place(|| {
            let names = &self.parts.plant.ledger.names;
            names.keep(row.owner, hex(&row.topic_id.0), topic)?;
            if with_type {
                names.keep(row.owner, row.type_name, type_name)?;
            }
            Ok(true)
        })
    }

    /// Opens a record no more for its names.
    fn pass_over(&self, tried: (Address, Digest)) {
        let mut nameless = self.nameless.lock().unwrap_or_else(PoisonError::into_inner);
        if nameless.len() >= MOST_NAMELESS {
            nameless.clear();
        }
        nameless.insert(tried);
    }
}

/// `with_owner` for lists of other owners' records.
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

pub fn record_page(rows: &[Shown], next: Option<String>, with_owner: bool) -> RecordPage {
    let records = rows.iter().map(|row| record_view(row, with_owner)).collect();
    RecordPage { records, next, arriving: None }
}

/// Captured messages unless another kind is requested.
pub(in crate::site) fn record_query(query: UploadQuery) -> RecordQuery {
    RecordQuery {
        topics: query.topic.into_iter().map(|topic| TopicPatterns(vec![topic])).collect(),
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
