//! `robots`: what is asked of enrolled robots from their owner's site.

use std::io::Read as _;
use std::path::{Path, PathBuf};

use clap::Subcommand;

use super::connect::ProfileNeed;
use super::incidents::moment;
use super::parse;
use super::show::Question;
use super::verbs::{CHAIN, Plan};
use crate::crypto::LONGEST_POLICY;
use crate::model::{ErrorKind, Timestamp, clean};
use crate::service::Failure;
use crate::service::command::{ListRobots, PullRing, SetRobotPolicy, ShowRobot};
use crate::service::reply::{RingPullView, RobotRow, RobotTopicRow, RobotView};
use authros_output::table;

/// `robots …`
#[derive(Debug, Subcommand)]
pub enum RobotsVerb {
    /// Ask a robot for a span of its ring: what nobody watched, brought in like other records
    Pull {
        /// Its name, or the beginning of its device's id
        robot: String,
        /// Where the span begins: a time as 2026-11-21T08:30:00Z, a day, or so long ago, as 10m or -10m
        #[arg(long, value_name = "TIME", allow_hyphen_values = true, required_unless_present = "incident")]
        since: Option<String>,
        /// Where it ends, written in the same way [default: now]
        #[arg(long, value_name = "TIME", allow_hyphen_values = true)]
        until: Option<String>,
        /// Only these topics; * is any but /, ** any [default: all of the ring]
        #[arg(long = "topic", visible_alias = "topics", value_name = "PATTERN", num_args = 1.., value_delimiter = ',')]
        topics: Vec<String>,
        /// The span and topics of this incident, where they are not given
        #[arg(long, value_name = "NAME")]
        incident: Option<String>,
    },
    /// List the enrolled robots: last seen, what waits, which policy they work by
    List,
    /// Show one robot: policy, gateway, topics, losses
    Show {
        /// Its name, or the beginning of its device's id
        robot: String,
    },
    /// Show, set or clear what a robot is to capture; it hears of it with its next contact
    Policy {
        /// Its name, or the beginning of its device's id
        robot: String,
        /// Set it: a TOML file with [[watch]], [[topic]], ring.keep and ring.topics; - for standard input
        #[arg(long, value_name = "FILE", conflicts_with_all = ["clear", "show"])]
        set: Option<PathBuf>,
        /// Clear it: the robot's own settings count again
        #[arg(long, conflicts_with = "show")]
        clear: bool,
        /// Show it [default]
        #[arg(long)]
        show: bool,
    },
}

/// What is asked.
///
/// # Errors
/// What is wrong with the arguments.
pub fn plan(verb: RobotsVerb) -> Result<Plan, Failure> {
    let question: Question = match verb {
        RobotsVerb::Pull { robot, since, until, topics, incident } => PullRing {
            name: robot,
            since: since.as_deref().map(moment).transpose()?,
            until: until.as_deref().map(moment).transpose()?,
            topics: parse::values(&topics)?,
            incident: incident.as_deref().map(parse::value).transpose()?,
        }
        .into(),
        RobotsVerb::List => ListRobots.into(),
        RobotsVerb::Policy { robot, clear: true, .. } => SetRobotPolicy { name: robot, text: String::new() }.into(),
        RobotsVerb::Policy { robot, set: Some(file), .. } => {
            SetRobotPolicy { name: robot, text: policy_of(&file)? }.into()
        }
        RobotsVerb::Show { robot } => ShowRobot { name: robot }.into(),
        // To show is what is done unless something else is asked.
        RobotsVerb::Policy { robot, show: _show, .. } => ShowRobot { name: robot }.into(),
    };
    Ok(Plan::new(CHAIN, ProfileNeed::Unlocked, question))
}

/// The text of a file, read no further than a policy may be long.
fn policy_of(file: &Path) -> Result<String, Failure> {
    let shown = clean(&file.display().to_string(), 200);
    let unread = |error: std::io::Error| Failure::new(ErrorKind::Input, format!("{shown} cannot be read: {error}"));
    let mut text = String::new();
    let most = LONGEST_POLICY as u64 + 1;
    if file.as_os_str() == "-" {
        std::io::stdin().take(most).read_to_string(&mut text).map_err(unread)?;
    } else {
        std::fs::File::open(file).map_err(unread)?.take(most).read_to_string(&mut text).map_err(unread)?;
    }
    if text.trim().is_empty() {
        let why = format!("{shown} is empty; `robots policy ROBOT --clear` gives a robot back its own settings");
        return Err(Failure::new(ErrorKind::Input, why));
    }
    Ok(text)
}

/// All robots.
pub fn all(robots: &[RobotRow]) -> String {
    if robots.is_empty() {
        return "no robots; enrol one with `authros agent enrol`".to_owned();
    }
    let row = |robot: &RobotRow| {
        vec![
            robot.name.to_string(),
            or_dash(robot.last_seen),
            robot.address.clone().unwrap_or_else(|| "-".to_owned()),
            robot.waiting.to_string(),
            if robot.wanted == 0 { "-".to_owned() } else { robot.wanted.to_string() },
            robot.running.map_or_else(|| "-".to_owned(), |version| version.to_string()),
            robot.standing.clone(),
            robot.drift_since.map_or_else(String::new, |since| format!("drift since {since}")),
        ]
    };
    let rows: Vec<Vec<String>> = robots.iter().map(row).collect();
    table(&["robot", "last seen", "gateway", "waiting", "wanted", "runs", "policy", ""], &rows)
}

/// One robot.
pub fn one(view: &RobotView) -> String {
    let row = &view.row;
    let wanted = match (row.wanted, view.set_at) {
        (0, _) => "no policy was set".to_owned(),
        (version, at) => format!("policy {version}, set {}: {}", or_dash(at), row.standing),
    };
    let mut lines = vec![
        format!("robot '{}', device {}", row.name, row.device),
        format!("last seen {}; {} of its records wait here", or_dash(row.last_seen), row.waiting),
        wanted,
    ];
    lines.extend(row.running.map(|running| format!("it works by version {running}")));
    lines.extend(row.drift_since.map(|since| format!("drift since {since}")));
    lines.extend(view.refused.iter().map(|why| format!("it refused: {why}")));
    lines.extend(view.overruled.iter().map(|what| format!("overruled on the robot: {what}")));
    lines
        .extend(view.gateway.iter().flat_map(|gateway| &gateway.addresses).map(|address| format!("gateway {address}")));
    let counts = |topic: &RobotTopicRow| {
        let [records, verified, waiting, lost] =
            [topic.records, topic.verified, topic.waiting, topic.lost].map(|count| count.to_string());
        vec![topic.topic.clone(), records, verified, waiting, lost]
    };
    let rows: Vec<Vec<String>> = view.topics.iter().map(counts).collect();
    if !rows.is_empty() {
        lines.push(table(&["topic", "messages", "verified", "waiting", "lost"], &rows));
    }
    if !view.policy.is_empty() {
        lines.push(format!("\n{}", view.policy.trim_end()));
    }
    lines.join("\n")
}

fn or_dash(at: Option<Timestamp>) -> String {
    at.map_or_else(|| "-".to_owned(), |at| at.to_string())
}

/// What was asked of a ring.
pub fn pulled(view: &RingPullView) -> String {
    let topics = if view.topics.is_empty() { "all its topics".to_owned() } else { view.topics.join(", ") };
    format!(
        "robot '{}' is asked for what its ring has of {topics} from {} to {}; it hears of it with its next contact, and sends \
         what is still there",
        view.robot, view.since, view.until
    )
}
