//! How far this ledger's recorder has counted, and which recorder it succeeds.

use rusqlite::params;

use super::rows::unsigned;
use super::{Ledger, PREDECESSOR};
use crate::model::{Address, RecorderId, TopicId};
use crate::store::StoreError;

impl Ledger {
    /// The highest acknowledged number of each topic of an owner for this ledger's recorder, by topic id; topics filed
    /// under one of these names are left out.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn heights(&self, owner: Address, but: [&str; 2]) -> Result<Vec<(TopicId, u64)>, StoreError> {
        self.read(|connection| {
            let mut statement = connection.prepare_cached(
                "SELECT topic_id, highest FROM
                 (SELECT topic_id, (SELECT max(seq) FROM records WHERE topic = topics.key) AS highest FROM topics
                  WHERE owner = ?1 AND recorder = (SELECT recorder FROM about) AND name NOT IN (?2, ?3))
                 WHERE highest IS NOT NULL ORDER BY topic_id",
            )?;
            let [one, other] = but;
            let rows = statement
                .query_map(params![owner.0, one, other], |row| Ok((TopicId(row.get(0)?), unsigned(row, 1)?)))?;
            Ok(rows.collect::<Result<_, _>>()?)
        })
    }

    /// The recorder of the ledger that this one is a copy of, restored or opened elsewhere.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn predecessor(&self) -> Result<Option<RecorderId>, StoreError> {
        Ok(self.setting(PREDECESSOR)?.and_then(|text| text.parse().ok()))
    }
}
