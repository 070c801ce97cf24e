//! Where messages are played: a ROS 1 graph, or a ROS 2 domain.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use super::names::is_under;
use crate::model::{Address, ErrorKind, Timestamp, clean};
use crate::ros::recording::Encoding;
use crate::ros::ros2::Offered;
use crate::ros::{Advertised, RosError};
use crate::service::failure::{internal, refused};
use crate::service::reply::{Failure, PlayEnd};

/// How long playing waits for the subscribers known there, in total.
const WELCOME: Duration = Duration::from_secs(5);

/// The most topics of one playback.
const MOST_TOPICS: usize = 500;

/// A topic as it is published.
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

/// Why what a recording holds beside its messages is not played.
pub(super) const NO_MESSAGE: &str = "it is an attachment to a recording, not a message";

/// Why a form is not published by the other kind of target.
pub(super) const OTHER_ROS: &str = "it is of another ROS";

/// The owner of a message, and which of her publishers it is of.
pub(super) type Source = (Address, u64);

/// The owner of what is no record.
pub(super) const NOBODY: Source = (Address([0; 20]), 0);

/// Why a record is not played.
pub(super) enum Stop {
    /// A check or the target refuses it.
    Refused(String),
    /// Its bytes are gone.
    Missing,
    /// It cannot be checked or published now.
    Later,
    /// The playback is over.
    Ended(PlayEnd),
    /// Something else does not work: chain, store, master or child process.
    Failed(Failure),
}

impl Stop {
    /// For what is no record.
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
    /// Its name for people.
    fn name(&self) -> &str;

    /// Why messages of this encoding cannot be published here; there is no translation.
    fn objection(&self, encoding: Encoding) -> Option<&'static str>;

    /// Publishes a topic for a source of its messages, the first of `size` bytes.
    fn show(&mut self, form: &Form, source: Source, size: usize) -> Result<(), Stop>;

    /// Publishes one message of a published topic.
    fn publish(&mut self, form: &Form, source: Source, body: &[u8]) -> bool;

    /// The clock's topic under this name, and its message for a time.
    fn clock(&self, topic: &str, now: Timestamp) -> (Form, Vec<u8>);

    /// Whether a subscriber is far behind.
    fn is_crowded(&self) -> bool;

    /// Stops waiting for subscribers that are far behind now.
    fn outrun(&self);

    /// Comes back after a master or a child process that ended; what is away is tried again later.
    fn come_back(&mut self);

    /// Withdraws at once what an owner's messages have published.
    fn silence(&mut self, owner: Address);

    /// No more messages come; what is queued is still sent.
    fn leave(&self);

    /// Whether subscribers have all that was queued.
    fn is_sent(&self) -> bool;

    /// Ends; what is still queued is not sent. Of so many messages returns how many were published, dropped and unconfirmed.
    /// What was withdrawn when a right ended is not among what was dropped.
    fn finish(self: Box<Self>, handed_out: u64, by_right: bool) -> (u64, u64, u64);
}

/// What is known of the topics of one target.
pub(super) struct Topics {
    /// The target's name for people.
    pub place: String,
    /// No name under it belongs to anybody else.
    prefix: Option<String>,
    /// Type and MD5 sum of those that are published.
    types: HashMap<String, (String, String)>,
    /// Those that are not published, and why.
    declined: HashMap<String, String>,
    /// The remaining wait for subscribers.
    patience: Duration,
}

impl Topics {
    pub fn new(place: String, prefix: Option<String>) -> Self {
        Self { place, prefix, types: HashMap::new(), declined: HashMap::new(), patience: WELCOME }
    }

    /// Whether a topic of this type and MD5 sum is new here. `broken` says why nothing is published now.
    pub fn admit(&self, topic: &str, kind: (&str, &str), broken: Option<String>) -> Result<bool, Stop> {
        if let Some(why) = self.declined.get(topic) {
            return Err(Stop::Refused(why.clone()));
        }
        if let Some(reason) = broken {
            let words = format!("nothing is published in {} now: {reason}; play again", clean(&self.place, 120));
            return Err(Failure::new(ErrorKind::Unreachable, words).into());
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

    /// Whether nobody else can have this topic.
    pub fn is_inside(&self, topic: &str) -> bool {
        self.prefix.as_ref().is_some_and(|prefix| is_under(prefix, topic))
    }

    /// Announces something, with what is left of the time to wait for subscribers.
    pub fn announce<Done>(&mut self, act: impl FnOnce(Duration) -> Result<Done, RosError>) -> Result<Done, Failure> {
        let begun = Instant::now();
        let done = act(self.patience)?;
        self.patience = self.patience.saturating_sub(begun.elapsed());
        Ok(done)
    }

    pub fn publish(&mut self, topic: &str, (type_name, md5sum): (&str, &str)) {
        self.types.insert(topic.to_owned(), (type_name.to_owned(), md5sum.to_owned()));
    }

    /// It is not, in this playback.
    pub fn decline(&mut self, topic: &str, why: &str) {
        self.declined.insert(topic.to_owned(), why.to_owned());
    }

    /// Keeps those that are still published.
    pub fn retain(&mut self, is_published: impl Fn(&str) -> bool) {
        self.types.retain(|topic, _| is_published(topic));
    }
}
