//! Answers about robots.

use serde::{Deserialize, Serialize};

use super::RobotGatewayView;
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

/// An enrolled robot.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RobotRow {
    /// N.
    pub name: ProfileName,
    /// SM3 of its public key.
    pub device: SignerId,
    /// The capture of its newest record that is here, by its clock.
    pub last_seen: Option<Timestamp>,
    /// The first address of its gateway, host:port. Cleaned.
    pub address: Option<String>,
    /// Its records that are here and not verified yet.
    pub waiting: u64,
    /// The version of the policy that it is to work by; 0 = none was ever set.
    pub wanted: u64,
    /// The version that it says it works by; `None` = it never told, 0 = its own settings alone.
    pub running: Option<u64>,
    /// How it stands to what is wanted, in words.
    pub standing: String,
    /// Whether it works by another version than the wanted one.
    pub drift: bool,
    /// Since when.
    pub drift_since: Option<Timestamp>,
}

/// What a robot recorded of a topic, as far as it is here.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RobotTopicRow {
    /// The topic. Cleaned.
    pub topic: String,
    /// Messages.
    pub records: u64,
    /// Of these verified.
    pub verified: u64,
    /// Of these not verified yet.
    pub waiting: u64,
    /// Messages that the robot lost, by its newest reports.
    pub lost: u64,
}

/// One robot in full.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RobotView {
    /// As in the list.
    #[serde(flatten)]
    pub row: RobotRow,
    /// Its gateway.
    pub gateway: Option<RobotGatewayView>,
    /// The topics it has keys for; empty = all.
    pub enrolled: Vec<String>,
    /// What it recorded, by topic.
    pub topics: Vec<RobotTopicRow>,
    /// Why it did not take up the last policy that it heard of. Cleaned.
    pub refused: Option<String>,
    /// Where its own settings say something else, and the policy counts. Cleaned.
    pub overruled: Vec<String>,
    /// The policy that it is to work by, as TOML; empty = its own settings alone.
    pub policy: String,
    /// When that was set.
    pub set_at: Option<Timestamp>,
}
