//! What each signer of an owner has recorded, by topic: from the counters, whatever the number of records.

use std::collections::BTreeMap;

use rusqlite::params;

use super::Ledger;
use super::rows::{self, LEARNED_NAME, TOPIC_NAME, unsigned};
use crate::model::{Address, RecordKind, RecordState, SignerId};
use crate::store::StoreError;

/// The messages of one topic that one key signed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SignerTopic {
    /// The key.
    pub signer: SignerId,
    /// The topic's name, as far as it is known here.
    pub topic: String,
    /// Records by state.
    pub records: BTreeMap<RecordState, u64>,
}

impl Ledger {
    /// What keys other than `own` recorded for an owner.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn signer_topics(&self, owner: Address, own: SignerId) -> Result<Vec<SignerTopic>, StoreError> {
        self.read(|connection| {
            let mut statement = connection.prepare_cached(&format!(
                "SELECT r.signer, {TOPIC_NAME} AS topic, c.state, sum(c.records) FROM streams s
                     JOIN topics t ON t.key = s.topic JOIN recorders r ON r.key = t.recorder
                     JOIN counters c ON c.stream = s.key {LEARNED_NAME}
                     WHERE t.owner = ?1 AND s.kind = ?2 AND r.signer <> ?3 AND c.records > 0
                     GROUP BY r.signer, {TOPIC_NAME}, c.state"
            ))?;
            let mut found: BTreeMap<(SignerId, String), BTreeMap<RecordState, u64>> = BTreeMap::new();
            let mut rows = statement.query(params![owner.0, RecordKind::Data.code(), own.0])?;
            while let Some(row) = rows.next()? {
                let place = (SignerId(row.get(0)?), row.get(1)?);
                found.entry(place).or_default().insert(rows::state(row, 2)?, unsigned(row, 3)?);
            }
            let topics = found.into_iter().map(|((signer, topic), records)| SignerTopic { signer, topic, records });
            Ok(topics.collect())
        })
    }
}
