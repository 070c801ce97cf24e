//! Where messages are played: a ROS 1 graph, or a ROS 2 domain.

use tokio::task::block_in_place;

use super::pacer::{clock_message, clock_topic};
use super::second::Domain;
use super::stage::Stage;
use crate::model::{Address, Timestamp};
use crate::ros::Advertised;
use crate::ros::recording::Encoding;
use crate::ros::ros2::{Delivery, Offer, Offered};
use crate::service::reply::Failure;

/// The clock's type in ROS 2, and its offer, as `ros2 bag play --clock` makes it.
const CLOCK: &str = "rosgraph_msgs/msg/Clock";
const CLOCK_OFFER: Offer = Offer { reliable: false, latched: false, depth: 1 };
/// CDR, little-endian.
const LITTLE: u16 = 1;

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

/// The publishing end.
pub(super) enum Target {
    Graph(Box<Stage>),
    Domain(Box<Domain>),
}

/// The owner of a message, and which of her publishers it is of.
type Source = (Address, u64);

impl Target {
    /// Why messages of this encoding cannot be published here; there is no translation.
    pub fn objection(&self, encoding: Encoding) -> Option<&'static str> {
        match (self, encoding) {
            (Self::Graph(_), Encoding::Cdr { .. }) => Some("ROS 2 messages are not translated into ROS 1"),
            (Self::Domain(_), Encoding::Ros1) => Some("a message of ROS 1 is not translated into ROS 2"),
            (_, Encoding::Beside(_)) => Some(NO_MESSAGE),
            (Self::Graph(_), Encoding::Ros1) | (Self::Domain(_), Encoding::Cdr { .. }) => None,
        }
    }

    /// Whether this site captures from there.
    pub fn is_captured(&self) -> bool {
        match self {
            Self::Graph(stage) => stage.is_captured(),
            Self::Domain(domain) => domain.is_captured(),
        }
    }

    /// Its name for people.
    pub fn name(&self) -> &str {
        match self {
            Self::Graph(stage) => stage.uri(),
            Self::Domain(domain) => domain.name(),
        }
    }

    /// Publishes a topic for a source of its messages, the first of `size` bytes; returns the reason if it cannot.
    ///
    /// # Errors
    /// If master or child process do not answer.
    pub fn show(&mut self, form: &Form, source: Source, size: usize) -> Result<Result<(), String>, Failure> {
        match (self, form) {
            (Self::Graph(stage), Form::One(about)) => stage.show(about, source.0, source.1),
            (Self::Domain(domain), Form::Two(about)) => domain.show(about, source, size),
            (Self::Graph(_), Form::Two(_)) | (Self::Domain(_), Form::One(_)) => Ok(Err("it is of another ROS".into())),
        }
    }

    /// Publishes one message of a published topic.
    pub fn publish(&mut self, form: &Form, source: Source, body: &[u8]) -> bool {
        match (self, form) {
            (Self::Graph(stage), Form::One(about)) => stage.publish(&about.topic, source.1, body),
            (Self::Domain(domain), Form::Two(about)) => domain.publish(about, source, body),
            (Self::Graph(_), Form::Two(_)) | (Self::Domain(_), Form::One(_)) => false,
        }
    }

    fn clock(&self, topic: &str) -> Form {
        match self {
            Self::Graph(_) => Form::One(clock_topic(topic.to_owned())),
            Self::Domain(_) => {
                let (name, type_name) = (topic.to_owned(), CLOCK.to_owned());
                Form::Two(Offered { name, type_name, encoding: LITTLE, offer: CLOCK_OFFER })
            }
        }
    }

    /// Publishes the clock's topic, which is not a record's.
    ///
    /// # Errors
    /// See [`Self::show`].
    pub fn show_clock(&mut self, topic: &str) -> Result<Result<(), String>, Failure> {
        let form = self.clock(topic);
        self.show(&form, NOBODY, 0)
    }

    /// Tells the time.
    pub fn tell_time(&mut self, topic: &str, now: Timestamp) {
        let (form, time) = (self.clock(topic), clock_message(now));
        let message = match &form {
            Form::One(_) => time,
            Form::Two(_) => [LITTLE.to_be_bytes().as_slice(), &[0, 0], &time].concat(),
        };
        self.publish(&form, NOBODY, &message);
    }

    /// Whether a subscriber is far behind.
    pub fn is_crowded(&self) -> bool {
        match self {
            Self::Graph(stage) => stage.is_crowded(),
            Self::Domain(domain) => domain.is_crowded(),
        }
    }

    /// Stops waiting for subscribers that are far behind now.
    pub fn outrun(&self) {
        match self {
            Self::Graph(stage) => stage.outrun(),
            Self::Domain(domain) => domain.outrun(),
        }
    }

    /// Comes back after a master or a child process that ended; what is away is tried again later.
    pub fn come_back(&mut self) {
        match self {
            Self::Graph(stage) => stage.come_back(),
            Self::Domain(domain) => domain.revive(),
        }
    }

    /// Withdraws at once what an owner's messages have published.
    pub fn silence(&mut self, owner: Address) {
        match self {
            Self::Graph(stage) => stage.silence(owner),
            Self::Domain(domain) => domain.silence(owner),
        }
    }

    /// No more messages come; what is queued is still sent.
    pub fn leave(&self) {
        match self {
            Self::Graph(stage) => stage.leave(),
            Self::Domain(domain) => block_in_place(|| domain.leave()),
        }
    }

    /// Whether subscribers have all that was queued.
    pub fn is_sent(&self) -> bool {
        match self {
            Self::Graph(stage) => stage.is_sent(),
            Self::Domain(domain) => domain.is_sent(),
        }
    }

    /// Ends; what is still queued is not sent. Of so many messages returns how many were published, dropped and unconfirmed: in
    /// ROS 2, where subscribers acknowledge, what was dropped was not published.
    pub fn finish(self, handed_out: u64, by_right: bool) -> (u64, u64, u64) {
        match self {
            Self::Graph(stage) => (handed_out, stage.finish(by_right), 0),
            Self::Domain(domain) => {
                let Delivery { missed, unconfirmed } = domain.finish(by_right);
                let published = handed_out.saturating_sub(missed);
                (published, missed, unconfirmed.min(published))
            }
        }
    }
}

/// The owner of what is no record.
const NOBODY: Source = (Address([0; 20]), 0);
