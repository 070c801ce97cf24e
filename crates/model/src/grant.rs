//! What a grant covers.

use serde::{Deserialize, Serialize};

use super::{Address, Timestamp, TopicId};

/// The most topics in a scoped grant (contract limit).
pub const MOST_TOPICS: usize = 32;

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind", content = "topics")]
pub enum Scope {
    All,
    /// Only these, at most [`MOST_TOPICS`].
    Topics(Vec<TopicId>),
}

impl Scope {
    pub fn covers(&self, topic: TopicId) -> bool {
        match self {
            Self::All => true,
            Self::Topics(topics) => topics.contains(&topic),
        }
    }
}

/// The public terms of a grant, as stated in the chain's event.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct GrantTerms {
    pub owner: Address,
    pub grantee: Address,
    /// The epoch whose key the envelope carries.
    pub epoch: u64,
    /// When it ends; `None` = never.
    pub expiry: Option<Timestamp>,
    pub scope: Scope,
}
