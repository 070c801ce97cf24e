//! What a grant covers.

use serde::{Deserialize, Serialize};

use super::{Address, Timestamp, TopicId};

/// The most topics in a scoped grant (contract limit).
pub const MOST_TOPICS: usize = 32;

/// Which topics a grant covers.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind", content = "topics")]
pub enum Scope {
    /// Every topic of the owner.
    All,
    /// Only these, at most [`MOST_TOPICS`].
    Topics(Vec<TopicId>),
}

impl Scope {
    /// Whether records of `topic` are covered.
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
    /// What it covers.
    pub scope: Scope,
}
