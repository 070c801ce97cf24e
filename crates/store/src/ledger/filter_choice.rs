//! By which pseudonyms of types and tags records are found.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::model::{FilterId, TopicId};

/// A filter id that records are found by: the same on every topic, or another one on some topics.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FilterChoice {
    /// Records of any topic have it.
    pub id: FilterId,
    /// Or those of these topics have these.
    #[serde(default)]
    pub by_topic: BTreeMap<TopicId, FilterId>,
}

impl FilterChoice {
    /// Both ids that records of a topic may have; the same twice where there is but one.
    pub(super) fn of(&self, topic: TopicId) -> [FilterId; 2] {
        [self.id, self.by_topic.get(&topic).copied().unwrap_or(self.id)]
    }

    /// Whether a record of a topic with these ids is found by it.
    pub fn is_in(&self, topic: TopicId, ids: &[FilterId]) -> bool {
        self.of(topic).iter().any(|id| ids.contains(id))
    }
}

impl From<FilterId> for FilterChoice {
    fn from(id: FilterId) -> Self {
        Self { id, by_topic: BTreeMap::new() }
    }
}
