//! Names of topics and types that arrived as pseudonyms: learned from a record of each stream by a reader who may open
//! it, and only if the pseudonym is the one derived from the name.

use super::Reading;
use std::sync::{Arc, PoisonError};

use crate::crypto::{CryptoError, IndexKey, topic_id};
use crate::model::bytes::hex;
use crate::model::{Address, Digest, ProfileName, TopicName};
use crate::pipeline::PipelineError;
use crate::pipeline::columns::Keys;
use crate::pipeline::reader::Reader;
use crate::service::reply::Failure;
use crate::site::blocking;

/// Records of a stream that are opened to learn its names: among those of a stolen robot, some are false.
const TRIES: usize = 8;
/// Records that are not opened again for their names.
const MOST_NAMELESS: usize = 8192;

impl Reading {
    /// Learns what can be learned now of the profile's own topics: those of its robots arrive without names.
    pub(in crate::site) async fn learn_own_names(self: &Arc<Self>, profile: &ProfileName) -> Result<(), Failure> {
        let owner = self.owners.get(profile).filter(|owner| !owner.is_locked());
        let (Some(owner), Some(network)) = (owner, self.link.network_now()) else { return Ok(()) };
        let reader = Reader { plant: &self.plant, network: &network, reader: &owner };
        self.learn_names(&reader, owner.address).await
    }

    /// Opens a record of each stream of `owner` that has no name yet, as far as the reader may.
    pub(in crate::site) async fn learn_names(
        self: &Arc<Self>,
        reader: &Reader<'_>,
        owner: Address,
    ) -> Result<(), Failure> {
        let unnamed = blocking(self, move |reading| Ok(reading.plant.ledger.unnamed(owner, TRIES)?)).await?;
        for stream in unnamed {
            for digest in stream {
                if self.learn_from(reader, digest).await? {
                    break;
                }
            }
        }
        Ok(())
    }

    /// Names the topic that is asked for, if it is here under its pseudonym alone. With IK that is derived from the
    /// name, so no record has to be opened, nor believed.
    pub(in crate::site) async fn name_asked(
        self: &Arc<Self>,
        owner: Address,
        index: Option<IndexKey>,
        topic: Option<TopicName>,
    ) -> Result<(), Failure> {
        let (Some(index), Some(topic)) = (index, topic) else { return Ok(()) };
        let name = topic.to_string();
        let id = topic_id(&index, &name);
        blocking(self, move |reading| Ok(reading.plant.ledger.name_topic(owner, id, name)?)).await
    }

    /// Learns the names of one record; whether there was something to learn.
    async fn learn_from(self: &Arc<Self>, reader: &Reader<'_>, digest: Digest) -> Result<bool, Failure> {
        let tried = (reader.reader.address, digest);
        if self.nameless.lock().unwrap_or_else(PoisonError::into_inner).contains(&tried) {
            return Ok(false);
        }
        let row = blocking(self, move |reading| Ok(reading.plant.ledger.record(digest)?)).await?;
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
        // Without IK nobody knows whose pseudonym the type's is: its name stays with each record.
        let with_type = with_type && reader.index_key(&row).is_some();
        if !with_type {
            self.pass_over(tried);
        }
        blocking(self, move |reading| {
            let ledger = &reading.plant.ledger;
            ledger.name(row.owner, hex(&row.topic_id.0), topic)?;
            if with_type {
                ledger.name(row.owner, row.type_name, type_name)?;
            }
            Ok(())
        })
        .await?;
        Ok(true)
    }

    /// This reader opens a record no more for its names.
    fn pass_over(&self, tried: (Address, Digest)) {
        let mut nameless = self.nameless.lock().unwrap_or_else(PoisonError::into_inner);
        if nameless.len() >= MOST_NAMELESS {
            nameless.clear();
        }
        nameless.insert(tried);
    }
}
