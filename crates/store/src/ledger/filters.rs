//! The pseudonyms of types and tags by which records are found.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::model::{FilterId, TopicId};

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
