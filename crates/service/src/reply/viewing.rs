//! A path over the records of a topic.

use serde::{Deserialize, Serialize};

use crate::ros::readable::Plot;

/// A path over the records of a topic.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PathView {
    /// The record it leads to.
    pub id: String,
    /// Its topic, cleaned.
    pub topic: String,
    /// Records that contained a position.
    pub records: usize,
    /// Records that could not be opened or decoded.
    pub unread: usize,
    /// The path; `None` if no record contained a position.
    pub plot: Option<Plot>,
}
