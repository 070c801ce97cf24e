//! `received play`: shared records into a ROS graph or domain, until everything is played or something ends it.

use std::future::pending;

use clap::Args;

use super::connect::{Context, ProfileNeed};
use super::{parse, serve::until_done};
use crate::model::{ErrorKind, counted};
use crate::service::command::{Pace, Play, PlayWishes, StopPlay};
use crate::service::reply::{PlayEnd, PlayedView};
use crate::service::{Client, Failure, Needs};
use authros_output::{Output, table};

/// `received play …`
#[derive(Debug, Default, Args)]
pub struct PlayArguments {
    /// Only this owner's, by account or name [default: everyone who shares with this profile]
    #[arg(long, value_name = "ACCOUNT")]
    pub owner: Option<String>,
    /// Only topics matching this pattern; repeatable
    #[arg(long = "topic", value_name = "PATTERN")]
    pub topics: Vec<String>,
    /// Only topics of this robot, as robot1 for /robot1/**; repeatable
    #[arg(long = "robot", value_name = "NAME")]
    pub of_robots: Vec<String>,
    /// Captured at or after: 10m (ago), 18:00, "yesterday 18:00", "2026-11-27 18:00" or RFC 3339
    #[arg(long, value_name = "TIME", allow_hyphen_values = true)]
    pub since: Option<String>,
    /// Captured before; same format
    #[arg(long, value_name = "TIME", allow_hyphen_values = true)]
    pub until: Option<String>,
    /// Play records as they are verified, until Ctrl-C; earlier latched messages come first
    #[arg(long, conflicts_with_all = ["since", "until", "rate", "as_captured"])]
    pub follow: bool,
    /// Speed relative to the capture [default: as fast as possible]
    #[arg(long, value_name = "X", conflicts_with = "as_captured", allow_negative_numbers = true)]
    pub rate: Option<f64>,
    /// At the original speed (same as --rate 1)
    #[arg(long)]
    pub as_captured: bool,
    /// Also publish the capture time as /clock; needs --rate or --as-captured
    #[arg(long, conflicts_with = "follow")]
    pub clock: bool,
    /// Prefix for every topic, such as /shared/alice; required in the graph this site captures from
    #[arg(long, value_name = "NAME")]
    pub prefix: Option<String>,
    /// Another name for a topic, instead of the prefix; repeatable
    #[arg(long = "remap", value_name = "A:=B")]
    pub remaps: Vec<String>,
    /// The ROS master to play into [default: ros.master, else the site's own]
    #[arg(long, value_name = "URI", conflicts_with = "ros2")]
    pub to: Option<String>,
    /// The ROS 2 domain to play into, instead of a ROS 1 graph [default without a number: $ROS_DOMAIN_ID, else 0]
    // In place of the flag of every command, which names the domain to capture from.
    #[arg(long, value_name = "DOMAIN", num_args = 0..=1, default_missing_value = "")]
    pub ros2: Option<String>,
}

impl PlayArguments {
    fn wishes(&self, domain: Option<u16>, output: &Output) -> Result<PlayWishes, Failure> {
        let (owner, topics) = (parse::optional(self.owner.as_deref())?, parse::topics(&self.topics, &self.of_robots)?);
        let times = parse::Times::now(output);
        let (since, until) = (times.since(self.since.as_deref())?, times.until(self.until.as_deref())?);
        let (pace, clock, master) = (self.pace()?, self.clock, self.to.clone());
        let (prefix, remaps) = (parse::optional(self.prefix.as_deref())?, parse::values(&self.remaps)?);
        let domain = domain.filter(|_| self.ros2.is_some() && self.to.is_none());
        Ok(PlayWishes { owner, topics, since, until, pace, clock, prefix, remaps, master, domain })
    }

    fn pace(&self) -> Result<Pace, Failure> {
        match self.rate {
            _ if self.follow => Ok(Pace::Follow),
            _ if self.as_captured => Ok(Pace::AS_CAPTURED),
            Some(rate) => Pace::times(rate).map_err(|why| Failure::new(ErrorKind::Usage, why)),
            None => Ok(Pace::AtOnce),
        }
    }
}

pub async fn run(context: Context, arguments: PlayArguments, output: &Output) -> Result<u8, Failure> {
    let wishes = arguments.wishes(context.config.ros_domain, output)?;
    // A named graph needs no capturing node of ours.
    let is_named = wishes.master.is_some() || wishes.domain.is_some() || context.config.ros_master.is_some();
    let live = Needs { ros: !is_named, chain: true };
    let words = (
        "stopping; subscribers still receive what was played",
        "stopped before the subscribers had received everything",
    );
    let play = async |client: &Client| until_done(client, Play(wishes), StopPlay, words, output, pending()).await;
    let view = context.with(live, ProfileNeed::Unlocked, output, play).await?;
    output.result(&view, || text(&view));
    Ok(code(&view, output))
}

fn text(view: &PlayedView) -> String {
    let rows = view.topics.iter().map(|(topic, messages)| [topic.clone(), messages.to_string()]);
    let list = table(&["topic", "messages"], rows);
    format!("{list}\n{} published in {:.1} s", counted(view.published, "message"), view.seconds)
}

fn code(view: &PlayedView, output: &Output) -> u8 {
    if view.missing > 0 {
        output.note(&format!("authros: {} missing from the store: not published", counted(view.missing, "record")));
    }
    for (why, count) in &view.reasons {
        output.note(&format!("authros: {} not published: {why}", counted(*count, "record")));
    }
    if view.dropped > 0 {
        let words = "messages: they read too slowly, or did not acknowledge them";
        output.note(&format!("authros: subscribers missed {} {words}", view.dropped));
    }
    if view.unconfirmed > 0 {
        let words = "messages are unconfirmed: best-effort subscribers do not acknowledge and may have missed some; \
                     rosbag or rviz can subscribe as reliable";
        output.note(&format!("authros: {} of the published {words}", view.unconfirmed));
    }
    if let Some(why) = view.ended_by.cut_short() {
        output.note(&format!("authros: ended: {why}"));
    }
    if view.ended_by.is_by_right() {
        return ErrorKind::Refused.exit_code();
    }
    let whole = view.refused + view.missing + view.dropped == 0 && view.ended_by != PlayEnd::Site;
    let nothing = view.published == 0 && view.ended_by == PlayEnd::Whole;
    if whole && !nothing { 0 } else { ErrorKind::Incomplete.exit_code() }
}
