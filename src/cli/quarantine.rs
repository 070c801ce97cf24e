//! `topics pin` and `topics quarantine`: what their arguments mean, and their results for people.

use clap::{Args, Subcommand};

use super::{parse, plan::Plan, show::or_dash, topics::TopicChoice};
use crate::model::{ErrorKind, Publisher, counted};
use crate::service::Failure;
use crate::service::command::{DiscardHeld, Held, ListQuarantine, PinTopic, ReleaseHeld};
use crate::service::reply::{PinsView, QuarantineView};
use authros_output::table;

/// `topics pin …`
#[derive(Debug, Args)]
pub struct PinArguments {
    /// Which topics
    #[command(flatten)]
    pub topics: TopicChoice,
    /// Accepted publisher; repeatable [default: those being read now]
    #[arg(long = "publisher", value_name = "CALLER_ID@HOST:TYPE:MD5")]
    pub publishers: Vec<String>,
}

pub fn pin(arguments: &PinArguments) -> Result<PinTopic, Failure> {
    let publishers: Vec<Publisher> = parse::values(&arguments.publishers)?;
    Ok(PinTopic { topic: arguments.topics.read()?, publishers })
}

/// Which messages of the quarantine.
#[derive(Debug, Args)]
#[command(group(clap::ArgGroup::new("held").required(true).multiple(false)))]
pub struct HeldArguments {
    /// Record ids, as `topics quarantine list` shows them
    #[arg(group = "held", value_name = "ID")]
    pub ids: Vec<String>,
    /// All messages of this topic, or of those that match this pattern; also marks their alarms as seen
    #[arg(long, group = "held", value_name = "TOPIC")]
    pub topic: Option<String>,
    /// All messages of this robot's topics, as robot1 for /robot1/**; also marks their alarms as seen
    #[arg(long, group = "held", value_name = "NAME")]
    pub robot: Option<String>,
}

fn held_by(arguments: HeldArguments) -> Result<Held, Failure> {
    let topic = parse::topic(arguments.topic.as_deref(), arguments.robot.as_deref())?;
    Ok(Held { topic, ids: arguments.ids })
}

/// `topics quarantine …`
#[derive(Debug, Subcommand)]
pub enum QuarantineVerb {
    /// List quarantined messages, newest first
    List {
        /// Only this topic, or the topics that match this pattern
        #[arg(long, value_name = "TOPIC")]
        topic: Option<String>,
        /// Only the topics of this robot, as robot1 for /robot1/**
        #[arg(long, value_name = "NAME", conflicts_with = "topic")]
        robot: Option<String>,
        /// Maximum number of messages, 1 to 1000
        #[arg(long, value_name = "N", default_value_t = 100)]
        limit: usize,
    },
    /// Release messages: they are anchored like others
    Release {
        /// Which
        #[command(flatten)]
        held: HeldArguments,
    },
    /// Discard messages permanently; their digests and the count on the chain remain
    Discard {
        /// Which
        #[command(flatten)]
        held: HeldArguments,
        /// Confirm that they are discarded
        #[arg(long)]
        yes: bool,
    },
}

pub fn plan(verb: QuarantineVerb) -> Result<Plan, Failure> {
    Ok(match verb {
        QuarantineVerb::List { topic, robot, limit } => {
            Plan::kept(ListQuarantine { topic: parse::topic(topic.as_deref(), robot.as_deref())?, limit })
        }
        QuarantineVerb::Release { held } => Plan::unlocked(ReleaseHeld { held: held_by(held)? }),
        QuarantineVerb::Discard { held, yes: true } => Plan::unlocked(DiscardHeld { held: held_by(held)? }),
        QuarantineVerb::Discard { .. } => {
            return Err(Failure::new(ErrorKind::Usage, "a discarded message cannot be restored; add --yes to confirm"));
        }
    })
}

pub fn pins(view: &PinsView) -> String {
    let pins =
        view.pins.iter().map(|pin| [pin.topic.clone(), pin.publisher.to_string(), pin.source.clone(), or_dash(pin.at)]);
    let mut text = table(&["topic", "pinned publisher", "by", "since"], pins);
    if !view.alarms.is_empty() {
        let alarms = view.alarms.iter().map(|alarm| {
            let state = if alarm.open { "open" } else { "seen" }.to_owned();
            [alarm.topic.clone(), alarm.publisher.clone(), alarm.reason.clone(), state, alarm.at.to_string()]
        });
        text.push_str("\n\n");
        text.push_str(&table(&["topic", "suspect publisher", "why", "alarm", "at"], alarms));
    }
    text
}

pub fn held(view: &QuarantineView) -> String {
    let rows = view.records.iter().map(|held| {
        let (record, reason, publisher) = (&held.record, held.reason.clone(), held.publisher.clone());
        let captured = record.captured_at.in_milliseconds();
        [record.id.clone(), record.topic.clone(), record.seq.to_string(), reason, publisher, captured]
    });
    let list = table(&["id", "topic", "seq", "why", "publisher", "captured"], rows);
    format!("{list}\n{} in quarantine", counted(view.messages, "message"))
}
