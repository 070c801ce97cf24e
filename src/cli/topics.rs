//! `authros topics`: arguments, requests and the list.

#![deny(clippy::wildcard_enum_match_arm)]

use clap::{Args, Subcommand};

use super::connect::ProfileNeed;
use super::coverage::{self, CoverageArguments};
use super::plan::{NEITHER, Plan, ROS};
use super::quarantine::{self, PinArguments};
use super::{parse, show::or_dash};
use crate::model::{Sampling, TopicPattern};
use crate::service::{Failure, command, reply, reply::input};
use authros_output::{Output, table};

/// `topics …`
#[derive(Debug, Subcommand)]
pub enum TopicsVerb {
    /// List every topic of the ROS graph
    List,
    /// Capture a topic whenever a site runs; repeated, it replaces the earlier rule immediately
    Watch {
        #[command(flatten)]
        topics: TopicChoice,
        /// Reject messages of other types
        #[arg(long = "type", value_name = "TYPE")]
        type_name: Option<String>,
        /// Keep at most this many messages a second [default: as the settings say]
        #[arg(long, value_name = "N", allow_hyphen_values = true)]
        rate: Option<String>,
        /// Keep one message in this many; 1 = all, whatever the settings say
        #[arg(long, value_name = "N", allow_hyphen_values = true)]
        every: Option<String>,
    },
    /// Stop capturing a topic
    Unwatch {
        #[command(flatten)]
        topics: TopicChoice,
    },
    /// Pin publishers of a topic; messages from others are quarantined
    Pin(PinArguments),
    /// List pinned publishers, and alarms about others
    Pins {
        /// Only this topic, or the topics that match this pattern
        #[arg(long, value_name = "TOPIC")]
        topic: Option<String>,
        /// Only the topics of this robot, as robot1 for /robot1/**
        #[arg(long, value_name = "NAME", conflicts_with = "topic")]
        robot: Option<String>,
    },
    /// Show over time where topics have records, losses or quarantined messages
    Coverage(CoverageArguments),
    /// Show the rule for each topic
    Rules,
    /// Unpin a publisher of a topic
    Unpin {
        /// Topic, or a pattern for several
        topic: String,
        /// Node name, such as /driver
        caller_id: String,
    },
    /// Messages held back because their publisher is not pinned: list, release, discard
    #[command(subcommand)]
    Quarantine(quarantine::QuarantineVerb),
}

/// Topics of one name, pattern or robot.
#[derive(Debug, Args)]
pub struct TopicChoice {
    /// Topic, such as /robot1/odom, or a pattern, such as /robot*/camera/**, which also covers topics that appear later
    #[arg(required_unless_present = "robot")]
    pub topic: Option<String>,
    /// All topics of this robot, as robot1 for /robot1/**
    #[arg(long, value_name = "NAME", conflicts_with = "topic")]
    pub robot: Option<String>,
}

impl TopicChoice {
    pub fn read(&self) -> Result<TopicPattern, Failure> {
        let topic = parse::topic(self.topic.as_deref(), self.robot.as_deref())?;
        topic.ok_or_else(|| parse::usage("name a topic, or a robot with --robot"))
    }
}

pub fn plan(verb: TopicsVerb, output: &Output) -> Result<Plan, Failure> {
    Ok(match verb {
        TopicsVerb::List => Plan::new(ROS, ProfileNeed::None, command::ListTopics),
        TopicsVerb::Watch { topics, type_name, rate, every } => {
            let (topic, type_name) = (topics.read()?, parse::optional(type_name.as_deref())?);
            let sampling = Sampling::read(rate.as_deref(), every.as_deref());
            let sampling = sampling.map_err(|error| input(error.to_string()))?;
            Plan::new(NEITHER, ProfileNeed::OpenAtSite, command::WatchTopic { topic, type_name, sampling })
        }
        TopicsVerb::Unwatch { topics } => Plan::kept(command::UnwatchTopic { topic: topics.read()? }),
        TopicsVerb::Pin(pin) => Plan::kept(quarantine::pin(&pin)?),
        TopicsVerb::Pins { topic, robot } => {
            Plan::kept(command::ListPins { topic: parse::topic(topic.as_deref(), robot.as_deref())? })
        }
        TopicsVerb::Coverage(coverage) => Plan::kept(coverage::question(&coverage, output)?),
        TopicsVerb::Rules => Plan::new(ROS, ProfileNeed::None, command::ShowPolicy),
        TopicsVerb::Unpin { topic, caller_id } => {
            Plan::kept(command::UnpinTopic { topic: parse::value(&topic)?, caller_id })
        }
        TopicsVerb::Quarantine(verb) => quarantine::plan(verb)?,
    })
}

/// Shows a topic's ROS only where there are topics of ROS 2.
pub fn list(rows: &[reply::TopicRow]) -> String {
    let second = rows.iter().any(|row| row.ros == 2);
    let row = |row: &reply::TopicRow| {
        let mut cells = vec![row.topic.clone()];
        cells.extend(second.then(|| row.ros.to_string()));
        cells.extend([
            or_dash(row.type_name.as_ref()),
            row.publishers.join(" "),
            or_dash(row.hz.map(|hz| format!("{hz:.1}"))),
            if row.left_out > 0 { format!("{} left out", row.left_out) } else { String::new() },
            watch(row),
            if row.alarm { "ALARM" } else { "" }.to_owned(),
            if row.simulated { "SIMULATED" } else { "" }.to_owned(),
        ]);
        cells
    };
    let mut head = vec!["topic", "type", "publishers", "Hz", "", "", "", ""];
    if second {
        head.insert(1, "ROS");
    }
    let unreached = |row: &reply::TopicRow| {
        let topic = row.topic.clone();
        row.unreached.clone().into_iter().map(move |one| format!("\n{topic} is not read from {one}"))
    };
    table(&head, rows.iter().map(row)) + &rows.iter().flat_map(unreached).collect::<String>()
}

/// By which pattern, and how many messages are kept.
fn watch(row: &reply::TopicRow) -> String {
    let by = row.watched_by.as_ref().map(|pattern| format!(" by {pattern}")).unwrap_or_default();
    let kept = if row.sampling.is_all() { String::new() } else { format!(", {}", row.sampling) };
    if row.watched { format!("watched{by}{kept}") } else { String::new() }
}
