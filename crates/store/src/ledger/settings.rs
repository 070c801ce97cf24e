//! Small durable state: key-value settings, and the positions of those who walk the chain.

use std::collections::BTreeMap;
use std::sync::PoisonError;

use rusqlite::params;
use serde::{Deserialize, Serialize};

use super::database::whole;
use super::{Ledger, rows};
use crate::StoreError;
use crate::database::Statements as _;
use crate::model::{FilterId, Hash, TopicId};

impl Ledger {
    /// Stores a value under a key, replacing the previous one.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like; the previous value is then unchanged.
    pub fn put_setting(&self, key: &str, value: &str) -> Result<(), StoreError> {
        let (key, value) = (key.to_owned(), value.to_owned());
        self.write(move |session| {
            session.connection.run("REPLACE INTO settings VALUES (?1, ?2)", [key, value])?;
            Ok(())
        })
    }

    /// Replaces the value under a key by what `change` makes of it, `None` if there is none; what it returns beside it is
    /// returned. The door for every setting that more than one task reads, changes and writes: of several changes at
    /// once none is lost. `change` itself may read, but makes no other change of a setting.
    ///
    /// # Errors
    /// What `change` returns, or those of [`Self::put_setting`]; the previous value is then unchanged.
    pub fn change_setting<T, E: From<StoreError>>(
        &self,
        key: &str,
        change: impl FnOnce(Option<&str>) -> Result<(String, T), E>,
    ) -> Result<T, E> {
        let _one_at_a_time = self.shared.settings.lock().unwrap_or_else(PoisonError::into_inner);
        let before = self.setting(key)?;
        let (value, answer) = change(before.as_deref())?;
        if before.as_ref() != Some(&value) {
            self.put_setting(key, &value)?;
        }
        Ok(answer)
    }

    /// The value under a key.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn setting(&self, key: &str) -> Result<Option<String>, StoreError> {
        self.read(|connection| {
            Ok(connection.find("SELECT value FROM settings WHERE key = ?1", [key], |row| row.get(0))?)
        })
    }

    /// Deletes a key if it still has this value.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like; the key is then unchanged.
    pub fn drop_setting(&self, key: &str, value: &str) -> Result<(), StoreError> {
        let (key, value) = (key.to_owned(), value.to_owned());
        self.write(move |session| {
            let sql = "DELETE FROM settings WHERE key = ?1 AND value = ?2";
            session.connection.run(sql, [key, value])?;
            Ok(())
        })
    }

    /// The last block (number and hash) that the walker `name` has finished.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn cursor(&self, name: &str) -> Result<Option<(u64, Hash)>, StoreError> {
        self.read(|connection| {
            Ok(connection.find("SELECT block, hash FROM cursors WHERE name = ?1", [name], |row| {
                Ok((rows::unsigned(row, 0)?, Hash(row.get(1)?)))
            })?)
        })
    }

    /// Stores the last block that the walker `name` has finished.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`] and the like; the previous position is then unchanged.
    pub fn set_cursor(&self, name: &str, block: u64, hash: Hash) -> Result<(), StoreError> {
        let (name, block) = (name.to_owned(), whole("block", block)?);
        self.write(move |session| {
            session.connection.run("REPLACE INTO cursors VALUES (?1, ?2, ?3)", params![name, block, hash.0])?;
            Ok(())
        })
    }
}

// The pseudonyms of types and tags by which records are found.

/// A filter id that finds records: the same for every topic, or another one for some topics.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FilterChoice {
    /// For records of any topic.
    pub id: FilterId,
    /// For records of these topics.
    pub by_topic: BTreeMap<TopicId, FilterId>,
}

impl FilterChoice {
    /// Both ids that records of a topic may have; the same twice if there is only one.
    pub(super) fn of(&self, topic: TopicId) -> [FilterId; 2] {
        [self.id, self.by_topic.get(&topic).copied().unwrap_or(self.id)]
    }

    /// Whether it finds a record of a topic with these ids.
    pub fn is_in(&self, topic: TopicId, ids: &[FilterId]) -> bool {
        self.of(topic).iter().any(|id| ids.contains(id))
    }
}

impl From<FilterId> for FilterChoice {
    fn from(id: FilterId) -> Self {
        Self { id, by_topic: BTreeMap::new() }
    }
}
