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
                "SELECT s.signer, {TOPIC_NAME} AS topic, c.state, sum(c.records) FROM streams s
                     JOIN topics t ON t.key = s.topic JOIN counters c ON c.stream = s.key {LEARNED_NAME}
                     WHERE t.owner = ?1 AND s.kind = ?2 AND s.signer <> ?3 AND c.records > 0
                     GROUP BY s.signer, {TOPIC_NAME}, c.state"
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

    /// How many records of all kinds that `signer` signed for an owner are sealed, but in no block yet: a recall of the
    /// key now would leave them without an anchor. Those that wait for a right already are not counted.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn on_their_way(&self, owner: Address, signer: SignerId) -> Result<u64, StoreError> {
        self.signed_in(owner, signer, [RecordState::Sealed, RecordState::Submitted], None)
    }

    /// How many messages that `signer` signed for an owner are in quarantine: whichever is released needs an anchor, too.
    /// Definitions stay there when messages are discarded, and are not counted.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn quarantined_of(&self, owner: Address, signer: SignerId) -> Result<u64, StoreError> {
        self.signed_in(owner, signer, [RecordState::Quarantined; 2], Some(RecordKind::Data))
    }

    /// Records of one kind or of all, from the first state to the last.
    fn signed_in(
        &self,
        owner: Address,
        signer: SignerId,
        states: [RecordState; 2],
        kind: Option<RecordKind>,
    ) -> Result<u64, StoreError> {
        let [first, last] = states.map(RecordState::code);
        self.read(|connection| {
            let sql = "SELECT coalesce(sum(c.records), 0) FROM streams s JOIN topics t ON t.key = s.topic
                       JOIN counters c ON c.stream = s.key
                       WHERE t.owner = ?1 AND s.signer = ?2 AND c.state BETWEEN ?3 AND ?4
                       AND (?5 IS NULL OR s.kind = ?5)";
            let values = params![owner.0, signer.0, first, last, kind.map(RecordKind::code)];
            Ok(connection.prepare_cached(sql)?.query_row(values, |row| unsigned(row, 0))?)
        })
    }
}
