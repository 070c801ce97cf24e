//! Who publishes in a graph of ROS 1: this process, or the program in which rosrust runs.

use std::time::{Duration, Instant};

use super::{Advertised, Publisher};
use crate::ros::{RosError, RosrustPublisher};

/// A publishing node, by one of the two.
pub enum GraphPublisher {
    /// Our own, in this process.
    Own(Publisher),
    /// rosrust, in a process without keys.
    Rosrust(Box<RosrustPublisher>),
}

impl GraphPublisher {
    /// Announces a topic, and waits for the subscribers that the master knows, at most for `patience`.
    ///
    /// # Errors
    /// If the master does not answer or refuses, or the program does not run.
    pub fn advertise(&mut self, topic: &Advertised, patience: Duration) -> Result<(), RosError> {
        match self {
            Self::Own(publisher) => {
                let known = publisher.advertise(topic)?;
                let begun = Instant::now();
                while publisher.subscribers(&topic.topic) < known && begun.elapsed() < patience {
                    std::thread::sleep(Duration::from_millis(5));
                }
                Ok(())
            }
            Self::Rosrust(publisher) => publisher.advertise(topic, !patience.is_zero()),
        }
    }

    /// Sends a message to all subscribers of an announced topic, as one of `source`; false if it is not announced, or
    /// nobody publishes now. May block where [`Self::may_block`].
    pub fn publish(&mut self, topic: &str, source: u64, body: &[u8]) -> bool {
        match self {
            Self::Own(publisher) => publisher.publish(topic, source, body),
            Self::Rosrust(publisher) => publisher.publish(topic, source, body),
        }
    }

    /// Whether publishing may wait, for a pipe that is full.
    pub fn may_block(&self) -> bool {
        match self {
            Self::Own(_) => false,
            Self::Rosrust(_) => true,
        }
    }

    /// The number of the process that publishes, if it is not this one.
    pub fn process(&self) -> Option<u32> {
        match self {
            Self::Own(_) => None,
            Self::Rosrust(publisher) => publisher.process(),
        }
    }

    /// Why nothing is published now, if that is so.
    pub fn broken(&self) -> Option<String> {
        match self {
            Self::Own(_) => None,
            Self::Rosrust(publisher) => publisher.broken(),
        }
    }

    /// Whether a subscriber is so far behind that more messages would soon be dropped.
    pub fn is_crowded(&self) -> bool {
        match self {
            Self::Own(publisher) => publisher.is_crowded(),
            Self::Rosrust(publisher) => publisher.is_crowded(),
        }
    }

    /// Stops waiting for the subscribers that are behind now, until they have caught up.
    pub fn outrun(&self) {
        match self {
            Self::Own(publisher) => publisher.outrun(),
            Self::Rosrust(publisher) => publisher.outrun(),
        }
    }

    /// Comes back: our own registers all topics again, rosrust is started anew if it has ended.
    ///
    /// # Errors
    /// If the master does not answer or refuses, or the program does not start.
    pub fn come_back(&mut self) -> Result<(), RosError> {
        match self {
            Self::Own(publisher) => publisher.register_again(),
            Self::Rosrust(publisher) => publisher.revive(),
        }
    }

    /// Withdraws topics at once: what is queued for their subscribers is no longer sent.
    pub fn cut(&mut self, topics: &[String]) {
        match self {
            Self::Own(publisher) => publisher.cut(topics),
            Self::Rosrust(publisher) => topics.iter().for_each(|topic| publisher.withdraw(topic)),
        }
    }

    /// Drops at once what came from a source, including the topic's queues; other sources go on publishing it.
    pub fn silence(&mut self, topic: &str, source: u64) {
        match self {
            Self::Own(publisher) => publisher.silence(topic, source),
            Self::Rosrust(publisher) => publisher.silence(topic, source),
        }
    }

    /// No more messages come; queued ones are still sent.
    pub fn leave(&self) {
        match self {
            Self::Own(publisher) => publisher.leave(),
            Self::Rosrust(publisher) => publisher.leave(),
        }
    }

    /// Whether everything queued has been sent, after [`Self::leave`].
    pub fn is_sent(&self) -> bool {
        match self {
            Self::Own(publisher) => publisher.is_sent(),
            Self::Rosrust(publisher) => publisher.is_sent(),
        }
    }

    /// Total messages that a subscriber missed because it read too slowly.
    pub fn missed(&self) -> u64 {
        match self {
            Self::Own(publisher) => publisher.overflowed(),
            Self::Rosrust(publisher) => publisher.missed(),
        }
    }

    /// Ends without further waiting. Returns the total messages that a subscriber missed.
    pub fn end(self) -> u64 {
        match self {
            Self::Own(publisher) => publisher.end(),
            Self::Rosrust(publisher) => publisher.end(),
        }
    }
}
