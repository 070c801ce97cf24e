//! How far this ledger's recorder has counted, and which recorder it succeeds.

use rusqlite::{OptionalExtension as _, params};

use super::Ledger;
use super::rows::unsigned;
use crate::model::{Address, RecorderId, SignerId, TopicId};
use crate::store::StoreError;

impl Ledger {
    /// The highest acknowledged number that `signer` gave in this ledger in each topic of an owner, by topic id; topics
    /// filed under one of these names are left out.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn heights(&self, owner: Address, signer: SignerId, but: [&str; 2]) -> Result<Vec<(TopicId, u64)>, StoreError> {
        let recorder = self.recorder().of_signer(&signer);
        self.read(|connection| {
            let mut statement = connection.prepare_cached(
                "SELECT topic_id, highest FROM
                 (SELECT topic_id, (SELECT max(seq) FROM records WHERE topic = topics.key) AS highest FROM topics
                  WHERE owner = ?1 AND keeper IS NULL AND name NOT IN (?2, ?3)
                  AND recorder = (SELECT key FROM recorders WHERE id = ?4 AND signer = ?5))
                 WHERE highest IS NOT NULL ORDER BY topic_id",
            )?;
            let [one, other] = but;
            let rows = statement.query_map(params![owner.0, one, other, recorder.0, signer.0], |row| {
                Ok((TopicId(row.get(0)?), unsigned(row, 1)?))
            })?;
            Ok(rows.collect::<Result<_, _>>()?)
        })
    }

    /// The recorder that the one of `signer` follows for an owner: that of the key before, or of the ledger that this one is
    /// a copy of, restored or opened elsewhere.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn predecessor(&self, owner: Address, signer: SignerId) -> Result<Option<RecorderId>, StoreError> {
        let recorder = self.recorder().of_signer(&signer);
        self.read(|connection| {
            let mut statement = connection.prepare_cached(
                "SELECT id FROM recorders WHERE key < coalesce(
                     (SELECT key FROM recorders WHERE id = ?2 AND signer = ?3), 9223372036854775807)
                 AND EXISTS (SELECT 1 FROM topics WHERE recorder = recorders.key AND owner = ?1 AND keeper IS NULL)
                 ORDER BY key DESC LIMIT 1",
            )?;
            let found = statement.query_row(params![owner.0, recorder.0, signer.0], |row| row.get(0));
            Ok(found.optional()?.map(RecorderId))
        })
    }
}
