//! Commands about robots: enrolled devices with an agent.

use serde::{Deserialize, Serialize};

use super::{Ask, Command};
use crate::model::{IncidentName, Timestamp, TopicPattern};
use crate::service::reply::{RingPullView, RobotRow, RobotView};

/// The longest policy of a robot, bytes.
pub const LONGEST_POLICY: usize = crate::crypto::LONGEST_POLICY;

requests! {
    /// One of these; needs the keyring.
    #[serde(rename_all = "snake_case", tag = "robot")]
    enum RobotCommand by Command::OfRobot;
    /// Ask a robot for a span of its ring; it sends that like other records.
    PullRing {
        /// Its name, or the beginning of its device's id.
        name: String,
        /// What was captured at this time or later; `None` = since the incident begins.
        since: Option<Timestamp>,
        /// Before this time; `None` = until the incident ends, or until now.
        until: Option<Timestamp>,
        /// Of these topics; empty = of those of the incident, or of all.
        topics: Vec<TopicPattern>,
        /// Takes from this incident what is not named here.
        incident: Option<IncidentName>,
    } => RingPullView;
    /// The enrolled robots, each with the policy wanted and the one it works by.
    ListRobots => Vec<RobotRow>;
    /// One robot with its policy, topics and losses.
    ShowRobot {
        /// Its name, or the beginning of its device's id.
        name: String,
    } => RobotView;
    /// Set the policy of a robot.
    SetRobotPolicy {
        /// Its name, or the beginning of its device's id.
        name: String,
        /// The policy, as TOML; empty = the robot's own settings alone.
        text: String,
    } => RobotView;
}
