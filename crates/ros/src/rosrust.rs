//! Publishing in a graph of ROS 1 by rosrust, in a program without keys that is started here, and anew when it ends.
//!
//! It is handed a bounded number of messages before it confirms some; what it held when it ended counts as missed.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::model::clean;
use crate::pipe::LONGEST_PAYLOAD;
use crate::pipe::write::{Described, Order};
use crate::ros::address::{Endpoint, own_host};
use crate::ros::child::{self, Declined, Errand, Run};
use crate::ros::{Advertised, RosError};

/// The program in which rosrust runs.
const PROGRAM: &str = "authros-rosrust";
/// How long to wait for names.
const PATIENCE: Duration = Duration::from_secs(2);
/// How long the program may take to join the graph.
const JOINING: Duration = Duration::from_secs(10);
/// How long it may take to answer about a topic: it asks the master, and waits for subscribers.
const ANSWERING: Duration = Duration::from_secs(10);

/// An announced topic.
struct Announced {
    writer: u32,
    about: Advertised,
    /// The last message and its source, if the topic is latched.
    latched: Option<(u64, Arc<[u8]>)>,
}

/// A node that publishes. It leaves the graph when dropped, without waiting for subscribers.
pub struct RosrustPublisher {
    uri: String,
    errand: Errand,
    run: Run,
    announced: BTreeMap<String, Announced>,
    next: u32,
    /// What earlier runs of the program did not deliver.
    missed: u64,
}

impl RosrustPublisher {
    /// Starts a node at the master; it publishes nothing yet. `program` names the program if it is not beside this one.
    /// Blocks for a moment.
    ///
    /// # Errors
    /// [`RosError::NoRosrust`] if that program is missing, [`RosError::NotPublishedByRosrust`] if it cannot join the graph,
    /// [`RosError::Address`] for a bad URI, [`RosError::System`] if it does not start.
    pub fn start(
        master_uri: &str,
        given_host: Option<&str>,
        node_name: &str,
        program: Option<&Path>,
    ) -> Result<Self, RosError> {
        let found = child::find(PROGRAM, program);
        let program: PathBuf = found.map_err(|path| RosError::no_rosrust(&path))?;
        let master = Endpoint::parse(master_uri).ok_or_else(|| RosError::address(master_uri))?;
        let host = own_host(given_host, &master, Instant::now() + PATIENCE)?;
        let uri = master.to_string();
        // rosrust itself puts the slash before a name.
        let arguments = vec!["--node".to_owned(), node_name.trim_start_matches('/').to_owned()];
        let environment = vec![("ROS_MASTER_URI", uri.clone()), ("ROS_HOSTNAME", host)];
        let errand = Errand { program, arguments, environment };
        let run = Run::start(&errand, 0)?;
        let publisher = Self { uri, errand, run, announced: BTreeMap::new(), next: 1, missed: 0 };
        publisher.joined().map(|()| publisher)
    }

    fn joined(&self) -> Result<(), RosError> {
        match self.run.wait(JOINING, |state| state.joined.then_some(())) {
            Ok(Some(())) => Ok(()),
            Ok(None) => Err(self.failed("the program does not answer")),
            Err(reason) => Err(self.failed(&reason)),
        }
    }

    fn failed(&self, reason: &str) -> RosError {
        RosError::NotPublishedByRosrust { uri: clean(&self.uri, 120), reason: reason.to_owned() }
    }

    /// Announces a topic, and waits for the subscribers that the master knows, for a while, if `patient`. A topic already
    /// announced is unchanged.
    ///
    /// # Errors
    /// [`RosError::NotPublishedByRosrust`] if the program does not run, or the master refuses.
    pub fn advertise(&mut self, topic: &Advertised, patient: bool) -> Result<(), RosError> {
        if self.announced.contains_key(&topic.topic) {
            return Ok(());
        }
        let writer = self.announce(topic, patient)?;
        let announced = Announced { writer, about: topic.clone(), latched: None };
        self.announced.insert(topic.topic.clone(), announced);
        Ok(())
    }

    /// Has a topic announced under a new number.
    fn announce(&mut self, topic: &Advertised, patient: bool) -> Result<u32, RosError> {
        let writer = self.next;
        self.next = self.next.wrapping_add(1);
        let about = Described {
            name: topic.topic.clone(),
            type_name: topic.type_name.clone(),
            md5sum: topic.md5sum.clone(),
            latched: topic.latching,
        };
        let order = Order::Advertise { writer, topic: about, size: 0, alone: false, patient };
        self.run.order(&order, topic.definition.as_bytes()).map_err(|reason| self.failed(&reason))?;
        match self.run.wait(ANSWERING, |state| state.answers.remove(&writer)) {
            Ok(Some(Ok(()))) => Ok(writer),
            Ok(Some(Err(Declined { reason, .. }))) => Err(self.failed(&reason)),
            Ok(None) => {
                self.run.kill();
                Err(self.failed("the program does not answer"))
            }
            Err(reason) => Err(self.failed(&reason)),
        }
    }

    /// Hands out a message of one of a topic's sources; false if the topic is not announced or nobody publishes now.
    pub fn publish(&mut self, topic: &str, source: u64, message: &[u8]) -> bool {
        let Some(announced) = self.announced.get_mut(topic) else { return false };
        if message.len() > LONGEST_PAYLOAD as usize {
            return false;
        }
        if announced.about.latching {
            announced.latched = Some((source, message.into()));
        }
        self.run.publish(&Order::<Described>::Publish { writer: announced.writer }, message)
    }

    /// Takes a topic back at once; what is queued for its subscribers is no longer sent.
    pub fn withdraw(&mut self, topic: &str) {
        if let Some(announced) = self.announced.remove(topic) {
            self.tell_withdrawn(announced.writer);
        }
    }

    fn tell_withdrawn(&self, writer: u32) {
        // A program that cannot be told has ended, or is killed, and nothing of this is announced anew.
        drop(self.run.order(&Order::<Described>::Withdraw { writer }, &[]));
    }

    /// Drops at once what came from a source, including the topic's queue; other sources go on publishing it.
    pub fn silence(&mut self, topic: &str, source: u64) {
        let Some(announced) = self.announced.remove(topic) else { return };
        self.tell_withdrawn(announced.writer);
        let latched = announced.latched.filter(|(of, _)| *of != source);
        let writer = match self.announce(&announced.about, false) {
            Ok(writer) => {
                if let Some((_, message)) = &latched {
                    self.run.publish(&Order::<Described>::Publish { writer }, message);
                }
                writer
            }
            Err(_) => {
                // Started anew, it announces the topic again.
                self.run.kill();
                announced.writer
            }
        };
        self.announced.insert(topic.to_owned(), Announced { writer, about: announced.about, latched });
    }

    /// Whether more messages should wait for subscribers that are behind, or for the program.
    pub fn is_crowded(&self) -> bool {
        self.run.is_crowded()
    }

    /// Waits no longer for subscribers that are behind now.
    pub fn outrun(&self) {
        drop(self.run.order(&Order::<Described>::Outrun, &[]));
    }

    /// Whether its program can open no file and no local socket.
    pub fn is_confined(&self) -> bool {
        self.run.is_confined()
    }

    /// The number of the process in which rosrust runs.
    pub fn process(&self) -> Option<u32> {
        self.run.process()
    }

    /// Why nothing is published now, if that is so.
    pub fn broken(&self) -> Option<String> {
        self.run.broken()
    }

    /// Starts the program anew if it has ended, with all topics and what was latched.
    pub fn revive(&mut self) -> Result<(), RosError> {
        if self.run.broken().is_none() {
            return Ok(());
        }
        let run = Run::start(&self.errand, 0)?;
        self.missed += self.run.missed();
        self.run = run;
        let done = self.joined().and_then(|()| self.announce_again());
        if done.is_err() {
            // It is tried again only if it has ended.
            self.run.kill();
        }
        done
    }

    fn announce_again(&mut self) -> Result<(), RosError> {
        let topics: Vec<Advertised> = self.announced.values().map(|announced| announced.about.clone()).collect();
        for topic in topics {
            let writer = self.announce(&topic, false)?;
            let Some(announced) = self.announced.get_mut(&topic.topic) else { continue };
            announced.writer = writer;
            if let Some((_, message)) = &announced.latched {
                self.run.publish(&Order::<Described>::Publish { writer }, message);
            }
        }
        Ok(())
    }

    /// No more messages come; queued ones are still sent.
    pub fn leave(&self) {
        drop(self.run.order(&Order::<Described>::Leave, &[]));
    }

    /// Whether subscribers have everything, after [`Self::leave`], or nobody sends it any more.
    pub fn is_sent(&self) -> bool {
        self.run.has_left() || self.run.broken().is_some()
    }

    /// Messages that a subscriber, or every one, missed, or may have missed.
    pub fn missed(&self) -> u64 {
        self.missed + self.run.missed()
    }

    /// Leaves the graph. Returns the total messages that subscribers missed; those still queued are among them.
    pub fn end(self) -> u64 {
        let queued = if self.run.broken().is_some() { 0 } else { self.run.unconfirmed().0 };
        self.missed() + queued as u64
    }
}

#[cfg(test)]
mod tests;
