//! Where messages are played: a ROS 1 graph, or a ROS 2 domain.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use super::is_under;
use crate::model::{Address, Timestamp, clean};
use crate::ros::recording::Encoding;
use crate::ros::ros2::Offered;
use crate::ros::{Advertised, RosError, md5sum};
use crate::service::failure::{internal, refused};
use crate::service::reply::{Failure, PlayEnd, Result};

/// How long playing waits for known subscribers, in total.
const WELCOME: Duration = Duration::from_secs(5);

const MOST_TOPICS: usize = 500;

pub(super) enum Form {
    One(Advertised),
    Two(Offered),
}

impl Form {
    pub fn topic(&self) -> &str {
        match self {
            Self::One(about) => &about.topic,
            Self::Two(about) => &about.name,
        }
    }
}

pub(super) const NO_MESSAGE: &str = "it is an attachment to a recording, not a message";

pub(super) const OTHER_ROS: &str = "it is of another ROS";

/// The owner of a message, and which of her publishers sent it.
pub(super) type Source = (Address, u64);

/// For messages that are no records.
pub(super) const NOBODY: Source = (Address([0; 20]), 0);

pub(super) enum Stop {
    Refused(String),
    Missing,
    Later,
    Ended(PlayEnd),
    Failed(Failure),
}

impl Stop {
    pub fn into_failure(self) -> Failure {
        match self {
            Self::Refused(why) => refused(why),
            Self::Failed(failure) => failure,
            Self::Missing | Self::Later | Self::Ended(_) => internal("it is not published now; play again"),
        }
    }
}

impl From<Failure> for Stop {
    fn from(failure: Failure) -> Self {
        Self::Failed(failure)
    }
}

pub(super) trait Target: Send + Sync {
    fn name(&self) -> &str;

    fn objection(&self, encoding: Encoding) -> Option<&'static str>;

    /// `size` is that of the first message.
    fn show(&mut self, form: &Form, source: Source, size: usize) -> Result<(), Stop>;

    fn publish(&mut self, form: &Form, source: Source, body: &[u8]) -> bool;

    fn clock(&self, topic: &str, now: Timestamp) -> (Form, Vec<u8>);

    fn is_crowded(&self) -> bool;

    fn outrun(&self);

    /// Reconnects to a master or child process that ended; the next call retries.
    fn come_back(&mut self);

    fn silence(&mut self, owner: Address);

    fn leave(&self);

    fn is_sent(&self) -> bool;

    /// Discards the queues; returns published, dropped and unconfirmed. Withdrawal by right does not count as dropped.
    fn finish(self: Box<Self>, handed_out: u64, by_right: bool) -> (u64, u64, u64);
}

pub(super) struct Topics {
    pub place: String,
    prefix: Option<String>,
    pub types: HashMap<String, (String, String)>,
    pub declined: HashMap<String, String>,
    patience: Duration,
}

impl Topics {
    pub fn new(place: String, prefix: Option<String>) -> Self {
        Self { place, prefix, types: HashMap::new(), declined: HashMap::new(), patience: WELCOME }
    }

    /// Whether the topic is new here.
    pub fn admit(&self, topic: &str, kind: (&str, &str)) -> Result<bool, Stop> {
        if let Some(why) = self.declined.get(topic) {
            return Err(Stop::Refused(why.clone()));
        }
        match self.types.get(topic) {
            Some((name, sum)) if (name.as_str(), sum.as_str()) == kind => Ok(false),
            Some((other, _)) => Err(Stop::Refused(format!("{topic} is already being played as {}", clean(other, 120)))),
            None if self.types.len() < MOST_TOPICS => Ok(true),
            None => {
                let why = format!("{MOST_TOPICS} topics are already being played; choose some with --topic");
                Err(Stop::Refused(why))
            }
        }
    }

    pub fn is_inside(&self, topic: &str) -> bool {
        self.prefix.as_ref().is_some_and(|prefix| is_under(prefix, topic))
    }

    pub fn announce<Done>(&mut self, act: impl FnOnce(Duration) -> Result<Done, RosError>) -> Result<Done> {
        let begun = Instant::now();
        let done = act(self.patience)?;
        self.patience = self.patience.saturating_sub(begun.elapsed());
        Ok(done)
    }

    pub fn publish(&mut self, topic: &str, (type_name, md5sum): (&str, &str)) {
        self.types.insert(topic.to_owned(), (type_name.to_owned(), md5sum.to_owned()));
    }
}

const CLOCK: &str = "rosgraph_msgs/Clock";
const DEFINITION: &str = "# The time of the capture, as this is played\ntime clock\n";

pub(super) fn clock_topic(topic: String) -> Advertised {
    Advertised {
        topic,
        type_name: CLOCK.to_owned(),
        md5sum: md5sum(CLOCK, DEFINITION).unwrap_or_default(),
        definition: DEFINITION.to_owned(),
        latching: false,
    }
}

pub(super) fn clock_message(at: Timestamp) -> Vec<u8> {
    let (seconds, rest) = (at.0 / 1_000_000_000, at.0 % 1_000_000_000);
    let half = |number: u64| u32::try_from(number).unwrap_or(u32::MAX).to_le_bytes();
    [half(seconds), half(rest)].concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_clock_is_ros_s_own() {
        // As `rosmsg md5 rosgraph_msgs/Clock` prints it.
        assert_eq!(clock_topic("/clock".into()).md5sum, "a9c97c1d230cfc112e270351a944ee47");
        assert_eq!(clock_message(Timestamp(3_000_000_007)), [3, 0, 0, 0, 7, 0, 0, 0]);
    }
}
