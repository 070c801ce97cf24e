//! Publishing in a ROS 2 domain, by a program without keys that is started here, and anew when it ends.
//!
//! It is handed a bounded number of messages before it confirms some; what it held when it ended counts as missed.

use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use super::{Offered, errand, find};
use crate::pipe::LONGEST_PAYLOAD;
use crate::pipe::write::Order;
use crate::ros::RosError;
use crate::ros::child::{Declined, Run};

/// How long the program may take to join the domain.
const JOINING: Duration = Duration::from_secs(10);
/// How long it may take to answer about a topic: it looks around first, and waits for subscribers.
const ANSWERING: Duration = Duration::from_secs(10);
/// The most bytes of latched messages kept for a program that has to be started anew.
const MOST_LATCHED: usize = 128 << 20;

/// What became of the messages handed out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Delivery {
    /// Messages that a subscriber missed, or did not acknowledge.
    pub missed: u64,
    /// Messages that nobody is known to have: some subscribers do not acknowledge, or could not any more.
    pub unconfirmed: u64,
}

/// An announced topic.
struct Announced {
    topic: Offered,
    size: u32,
    /// Its last messages, if it is latched.
    latched: VecDeque<Arc<[u8]>>,
}

/// A participant that publishes. It leaves the domain when dropped, without waiting for subscribers.
pub struct Ros2Publisher {
    domain: u16,
    program: PathBuf,
    run: Run,
    announced: BTreeMap<u32, Announced>,
    next: u32,
    latched_bytes: usize,
    /// What earlier runs of the program did not deliver.
    earlier: Delivery,
}

impl Ros2Publisher {
    /// Joins `domain`; `program` names the program that does it if it is not beside this one. Blocks for a moment.
    ///
    /// # Errors
    /// [`RosError::NoReader`] if that program is missing, [`RosError::NotPublished`] if it cannot join the domain,
    /// [`RosError::System`] if it does not start.
    pub fn start(domain: u16, program: Option<&Path>) -> Result<Self, RosError> {
        let program = find(program)?;
        let run = Run::start(&errand(&program, domain, true), domain)?;
        let (announced, earlier) = (BTreeMap::new(), Delivery::default());
        let publisher = Self { domain, program, run, announced, next: 1, latched_bytes: 0, earlier };
        publisher.joined().map(|()| publisher)
    }

    fn joined(&self) -> Result<(), RosError> {
        match self.run.wait(JOINING, |state| state.joined.then_some(())) {
            Ok(Some(())) => Ok(()),
            Ok(None) => Err(self.failed("the program that publishes does not answer")),
            Err(reason) => Err(self.failed(&reason)),
        }
    }

    fn failed(&self, reason: &str) -> RosError {
        RosError::NotPublished { domain: self.domain, reason: reason.to_owned() }
    }

    /// Whether its program can open no file and no local socket.
    pub fn is_confined(&self) -> bool {
        self.run.is_confined()
    }

    /// The domain.
    pub fn domain(&self) -> u16 {
        self.domain
    }

    /// Announces a topic whose first message has `size` bytes, and waits for the subscribers that are known if `patient`.
    /// Refused, with the reason, if it is no ROS 2 topic, or somebody else publishes it and it is to be `alone`.
    ///
    /// # Errors
    /// [`RosError::NotPublished`] if the program does not run.
    pub fn advertise(
        &mut self,
        topic: &Offered,
        size: usize,
        (alone, patient): (bool, bool),
    ) -> Result<Result<u32, Declined>, RosError> {
        let writer = self.next;
        self.next = self.next.wrapping_add(1);
        let size = u32::try_from(size).unwrap_or(u32::MAX);
        self.order(&Order::Advertise { writer, topic: topic.clone(), size, alone, patient }, &[])?;
        match self.run.wait(ANSWERING, |state| state.answers.remove(&writer)) {
            Ok(Some(Ok(()))) => {
                let announced = Announced { topic: topic.clone(), size, latched: VecDeque::new() };
                self.announced.insert(writer, announced);
                Ok(Ok(writer))
            }
            Ok(Some(Err(declined))) => Ok(Err(declined)),
            Ok(None) => {
                self.run.kill();
                Err(self.failed("the program that publishes does not answer"))
            }
            Err(reason) => Err(self.failed(&reason)),
        }
    }

    /// Hands out a message, with its encapsulation header; false if the topic is not announced or nobody publishes now.
    pub fn publish(&mut self, writer: u32, message: &[u8]) -> bool {
        let Some(announced) = self.announced.get_mut(&writer) else { return false };
        if message.len() > LONGEST_PAYLOAD as usize {
            return false;
        }
        if announced.topic.offer.latched && message.len() <= MOST_LATCHED {
            self.latched_bytes += message.len();
            announced.latched.push_back(message.into());
            while announced.latched.len() > announced.topic.offer.depth.max(1) as usize
                || self.latched_bytes > MOST_LATCHED && !announced.latched.is_empty()
            {
                self.latched_bytes -= announced.latched.pop_front().map_or(0, |oldest| oldest.len());
            }
        }
        self.run.publish(&Order::<Offered>::Publish { writer }, message)
    }

    /// Takes a topic back at once; what is queued for its subscribers is no longer sent.
    pub fn withdraw(&mut self, writer: u32) {
        if let Some(announced) = self.announced.remove(&writer) {
            self.latched_bytes -= announced.latched.iter().map(|message| message.len()).sum::<usize>();
            // A program that cannot be told has ended, or is killed, and nothing of this is announced anew.
            drop(self.order(&Order::Withdraw { writer }, &[]));
        }
    }

    /// Whether more messages should wait for subscribers that are behind, or for the program.
    pub fn is_crowded(&self) -> bool {
        self.run.is_crowded()
    }

    /// Waits no longer for subscribers that are behind now.
    pub fn outrun(&self) {
        drop(self.order(&Order::Outrun, &[]));
    }

    /// Why nothing is published now, if that is so.
    pub fn broken(&self) -> Option<String> {
        self.run.broken()
    }

    /// Starts the program anew if it has ended, with all topics and what was latched.
    ///
    /// # Errors
    /// See [`Self::start`].
    pub fn revive(&mut self) -> Result<(), RosError> {
        if self.run.broken().is_none() {
            return Ok(());
        }
        let run = Run::start(&errand(&self.program, self.domain, true), self.domain)?;
        self.earlier = self.delivery();
        self.run = run;
        self.joined()?;
        for (writer, announced) in &self.announced {
            let (writer, topic, size) = (*writer, announced.topic.clone(), announced.size);
            // Its former self may still be seen as somebody else.
            self.order(&Order::Advertise { writer, topic, size, alone: false, patient: false }, &[])?;
            for message in &announced.latched {
                self.run.publish(&Order::<Offered>::Publish { writer }, message);
            }
        }
        Ok(())
    }

    /// No more messages come; queued ones are still sent.
    pub fn leave(&self) {
        drop(self.order(&Order::Leave, &[]));
    }

    /// Whether subscribers have everything, after [`Self::leave`], or nobody sends it any more.
    pub fn is_sent(&self) -> bool {
        self.run.has_left() || self.run.broken().is_some()
    }

    fn delivery(&self) -> Delivery {
        let Delivery { missed, unconfirmed } = self.earlier;
        Delivery { missed: missed + self.run.missed(), unconfirmed: unconfirmed + self.run.best_effort() }
    }

    /// Leaves the domain. What is queued or not acknowledged was missed; if a right to it has ended, nobody knows.
    pub fn end(self, by_right: bool) -> Delivery {
        let delivery = self.delivery();
        if self.run.broken().is_some() {
            return delivery;
        }
        let Delivery { missed, unconfirmed } = delivery;
        let open = self.run.unacknowledged() + self.run.unconfirmed().0 as u64;
        if by_right {
            return Delivery { missed, unconfirmed: unconfirmed + open };
        }
        Delivery { missed: missed + open, unconfirmed }
    }

    fn order(&self, order: &Order, payload: &[u8]) -> Result<(), RosError> {
        self.run.order(order, payload).map_err(|reason| self.failed(&reason))
    }
}

#[cfg(test)]
mod tests;
