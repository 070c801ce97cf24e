//! The participant that publishes in a ROS 2 domain, and its topics: each as its publishers offered it, unless that would
//! mix with somebody else's.

use std::collections::{BTreeMap, HashMap};
use std::time::{Duration, Instant};

use tokio::task::block_in_place;

use crate::model::{Address, ErrorKind, clean};
use crate::ros::ros2::{Delivery, Offer, Offered, Ros2Publisher};
use crate::service::reply::Failure;

/// How long playing waits for the subscribers known in the domain, in total; half of it is for finding them.
const WELCOME: Duration = Duration::from_secs(5);

/// The most topics of one playback, and of one latched topic the most publishers told apart.
const MOST_TOPICS: usize = 500;
const MOST_LATCHED: usize = 64;

/// How messages of one kind leave. A latched topic keeps the last messages of each source.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct Way {
    topic: String,
    owner: Address,
    source: Option<u64>,
    encoding: u16,
    offer: Offer,
}

/// The publishing end.
pub(super) struct Domain {
    name: String,
    publisher: Ros2Publisher,
    /// No name under it belongs to anybody else.
    prefix: Option<String>,
    is_captured: bool,
    /// Types of the published topics.
    types: HashMap<String, String>,
    ways: HashMap<Way, u32>,
    /// Topics that are not published, and why.
    declined: HashMap<String, String>,
    /// The remaining wait for subscribers.
    patience: Duration,
}

fn way(about: &Offered, owner: Address, source: u64) -> Way {
    let source = about.offer.latched.then_some(source);
    Way { topic: about.name.clone(), owner, source, encoding: about.encoding, offer: about.offer }
}

impl Domain {
    /// A participant in a domain; this site may capture from it or not.
    pub fn new(publisher: Ros2Publisher, prefix: Option<String>, is_captured: bool) -> Self {
        let name = format!("ROS 2 domain {}", publisher.domain());
        let (types, ways, declined) = (HashMap::new(), HashMap::new(), HashMap::new());
        Self { name, publisher, prefix, is_captured, types, ways, declined, patience: WELCOME }
    }

    /// Whether this site captures from it.
    pub fn is_captured(&self) -> bool {
        self.is_captured
    }

    /// Its name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Publishes a topic for a source of its messages, the first of `size` bytes; returns the reason if it cannot.
    ///
    /// # Errors
    /// If the program that publishes does not run.
    pub fn show(
        &mut self,
        about: &Offered,
        (owner, source): (Address, u64),
        size: usize,
    ) -> Result<Result<(), String>, Failure> {
        if let Some(why) = self.declined.get(&about.name) {
            return Ok(Err(why.clone()));
        }
        if let Some(reason) = self.publisher.broken() {
            let words = format!("nothing is published in {} now: {reason}; play again", self.name);
            return Err(Failure::new(ErrorKind::Unreachable, words));
        }
        let known = self.types.get(&about.name);
        if let Some(other) = known.filter(|known| **known != about.type_name) {
            return Ok(Err(format!("{} is already being played as {}", about.name, clean(other, 120))));
        }
        let way = way(about, owner, source);
        if self.ways.contains_key(&way) {
            return Ok(Ok(()));
        }
        if known.is_none() && self.types.len() >= MOST_TOPICS {
            return Ok(Err(format!("{MOST_TOPICS} topics are already being played; choose some with --topic")));
        }
        let alone = known.is_none() && !self.is_inside(&about.name);
        block_in_place(|| self.begin(about, way, size, alone))
    }

    fn is_inside(&self, topic: &str) -> bool {
        let of = |prefix: &String| topic.strip_prefix(prefix.as_str()).is_some_and(|rest| rest.starts_with('/'));
        self.prefix.as_ref().is_some_and(of)
    }

    fn begin(&mut self, about: &Offered, way: Way, size: usize, alone: bool) -> Result<Result<(), String>, Failure> {
        let begun = Instant::now();
        let announced = self.publisher.advertise(about, size, (alone, !self.patience.is_zero()))?;
        self.patience = self.patience.saturating_sub(begun.elapsed());
        match announced {
            Ok(writer) => {
                self.make_room(&way);
                self.types.insert(about.name.clone(), about.type_name.clone());
                self.ways.insert(way, writer);
                Ok(Ok(()))
            }
            Err(declined) => {
                let advice = if declined.occupied { "; give a --prefix" } else { "" };
                let why = format!("{}{advice}", clean(&declined.reason, 300));
                if alone {
                    self.declined.insert(about.name.clone(), why.clone());
                }
                Ok(Err(why))
            }
        }
    }

    /// A publisher that is restarted again and again is a new source each time: the oldest is taken back.
    fn make_room(&mut self, way: &Way) {
        let alike = |other: &&Way| other.source.is_some() && (&other.topic, other.owner) == (&way.topic, way.owner);
        let alike: BTreeMap<u32, Way> = self
            .ways
            .iter()
            .filter(|(other, _)| alike(other))
            .map(|(other, writer)| (*writer, other.clone()))
            .collect();
        if alike.len() < MOST_LATCHED {
            return;
        }
        if let Some((writer, oldest)) = alike.into_iter().next() {
            self.publisher.withdraw(writer);
            self.ways.remove(&oldest);
        }
    }

    /// Publishes one message of a published topic, with its encapsulation header.
    pub fn publish(&mut self, about: &Offered, (owner, source): (Address, u64), message: &[u8]) -> bool {
        let Some(writer) = self.ways.get(&way(about, owner, source)).copied() else { return false };
        // The pipe may be full for a moment.
        block_in_place(|| self.publisher.publish(writer, message))
    }

    /// Whether a subscriber is far behind.
    pub fn is_crowded(&self) -> bool {
        self.publisher.is_crowded()
    }

    /// Stops waiting for subscribers that are far behind now.
    pub fn outrun(&self) {
        self.publisher.outrun();
    }

    /// Starts a program that has ended anew.
    pub fn revive(&mut self) {
        drop(block_in_place(|| self.publisher.revive()));
    }

    /// Withdraws at once what an owner's messages have published.
    pub fn silence(&mut self, owner: Address) {
        let publisher = &mut self.publisher;
        block_in_place(|| {
            self.ways.retain(|way, writer| {
                if way.owner == owner {
                    publisher.withdraw(*writer);
                }
                way.owner != owner
            });
        });
        let ways = &self.ways;
        self.types.retain(|topic, _| ways.keys().any(|way| way.topic == *topic));
    }

    /// No more messages come; what is queued is still sent.
    pub fn leave(&self) {
        self.publisher.leave();
    }

    /// Whether subscribers have all that was queued.
    pub fn is_sent(&self) -> bool {
        self.publisher.is_sent()
    }

    /// Ends; what is still queued is not sent. What was withdrawn when a right ended is not among what was missed.
    pub fn finish(self, by_right: bool) -> Delivery {
        block_in_place(|| self.publisher.end(by_right))
    }
}
