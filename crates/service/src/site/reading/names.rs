//! Names of topics and types that arrived as pseudonyms: learned from one record of each stream by a reader who may
//! open it.

use super::Reading;
use std::sync::Arc;

use crate::model::bytes::hex;
use crate::model::{Address, ProfileName};
use crate::pipeline::reader::Reader;
use crate::service::reply::Failure;
use crate::site::blocking;

impl Reading {
    /// Learns what can be learned now of the profile's own topics: those of its robots arrive without names.
    pub(in crate::site) async fn learn_own_names(self: &Arc<Self>, profile: &ProfileName) -> Result<(), Failure> {
        let owner = self.owners.get(profile).filter(|owner| !owner.is_locked());
        let (Some(owner), Some(network)) = (owner, self.link.network_now()) else { return Ok(()) };
        let reader = Reader { plant: &self.plant, network: &network, reader: &owner };
        self.learn_names(&reader, owner.address).await
    }

    /// Opens one record of each stream of `owner` that has no name yet, as far as the reader may.
    pub(in crate::site) async fn learn_names(
        self: &Arc<Self>,
        reader: &Reader<'_>,
        owner: Address,
    ) -> Result<(), Failure> {
        let unnamed = blocking(self, move |reading| Ok(reading.plant.ledger.unnamed(owner)?)).await?;
        for digest in unnamed {
            let row = blocking(self, move |reading| Ok(reading.plant.ledger.record(digest)?)).await?;
            let Some(row) = row else { continue };
            // What cannot be opened keeps its pseudonym.
            let Ok(opened) = reader.open(&row).await else { continue };
            let (topic, type_name) = (opened.head.topic, opened.head.type_name);
            blocking(self, move |reading| {
                let ledger = &reading.plant.ledger;
                ledger.name(row.owner, hex(&row.topic_id.0), topic)?;
                if !row.type_name.is_empty() && row.type_name != type_name {
                    ledger.name(row.owner, row.type_name, type_name)?;
                }
                Ok(())
            })
            .await?;
        }
        Ok(())
    }
}
