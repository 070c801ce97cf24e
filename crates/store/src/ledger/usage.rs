//! What an owner uses in this ledger: streams and bytes, from the counters; a gateway compares it with its quotas.

use rusqlite::params;

use super::Ledger;
use crate::model::{Address, RecordKind, RecorderId, SignerId, TopicId};
use crate::store::StoreError;

/// An owner's usage.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct OwnerUsage {
    /// Bytes of plaintext of all its records, including those whose ciphertext was deleted.
    pub bytes: u64,
    /// Streams: combinations of recorder, topic, kind, type and signer.
    pub streams: u64,
}

impl Ledger {
    /// An owner's usage here. The cost is proportional to its streams.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn owner_usage(&self, owner: Address) -> Result<OwnerUsage, StoreError> {
        self.read(|connection| {
            let usage = connection
                .prepare_cached(
                    "SELECT count(DISTINCT s.key), coalesce(sum(c.bytes), 0)
                     FROM topics t JOIN streams s ON s.topic = t.key LEFT JOIN counters c ON c.stream = s.key
                     WHERE t.owner = ?1",
                )?
                .query_row([owner.0], |row| {
                    let (streams, bytes): (i64, i64) = (row.get(0)?, row.get(1)?);
                    Ok(OwnerUsage { bytes: bytes.cast_unsigned(), streams: streams.cast_unsigned() })
                })?;
            Ok(usage)
        })
    }

    /// Whether an owner already has such a stream.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn has_stream(
        &self,
        owner: Address,
        (recorder, topic): (RecorderId, TopicId),
        (kind, type_name, signer): (RecordKind, &str, SignerId),
    ) -> Result<bool, StoreError> {
        self.read(|connection| {
            let found = connection
                .prepare_cached(
                    "SELECT EXISTS (SELECT 1 FROM topics t JOIN streams s ON s.topic = t.key
                     WHERE t.owner = ?1 AND t.topic_id = ?2
                     AND t.recorder = (SELECT key FROM recorders WHERE id = ?3 AND signer = ?6)
                     AND s.kind = ?4 AND s.type_name = ?5)",
                )?
                .query_row(params![owner.0, topic.0, recorder.0, kind.code(), type_name, signer.0], |row| row.get(0))?;
            Ok(found)
        })
    }
}
