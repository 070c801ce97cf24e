//! Answers about robots.

use serde::{Deserialize, Serialize};

use crate::model::{ProfileName, SignerId, Timestamp};

/// What a robot was asked for of its ring.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RingPullView {
    /// N.
    pub robot: ProfileName,
    /// SM3 of its public key.
    pub device: SignerId,
    /// What was captured at this time or later,
    pub since: Timestamp,
    /// and before this time.
    pub until: Timestamp,
    /// Of topics that match one of these; empty = of all. Cleaned.
    pub topics: Vec<String>,
}
