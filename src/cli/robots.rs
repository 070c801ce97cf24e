//! `robots`: what is asked of enrolled robots from their owner's site.

use clap::Subcommand;

use super::connect::ProfileNeed;
use super::incidents::moment;
use super::parse;
use super::verbs::{CHAIN, Plan};
use crate::service::Failure;
use crate::service::command::PullRing;
use crate::service::reply::RingPullView;

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
}

/// What is asked.
///
/// # Errors
/// What is wrong with the arguments.
pub fn plan(verb: RobotsVerb) -> Result<Plan, Failure> {
    let RobotsVerb::Pull { robot, since, until, topics, incident } = verb;
    let question = PullRing {
        name: robot,
        since: since.as_deref().map(moment).transpose()?,
        until: until.as_deref().map(moment).transpose()?,
        topics: parse::values(&topics)?,
        incident: incident.as_deref().map(parse::value).transpose()?,
    };
    Ok(Plan::new(CHAIN, ProfileNeed::Unlocked, question))
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
