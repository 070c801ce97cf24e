//! The node that publishes, and its topics: each as its publishers described it, unless that would mix with somebody
//! else's.

use std::collections::{BTreeMap, HashMap};
use std::time::{Duration, Instant};

use tokio::task::block_in_place;

use super::NODE;
use crate::crypto::Sm3Hasher;
use crate::model::{Address, ErrorKind, clean};
use crate::ros::{Advertised, Graph, GraphPublisher};
use crate::service::reply::Failure;

/// How long playing waits for the subscribers known to the master, in total.
const WELCOME: Duration = Duration::from_secs(5);

/// The most topics of one playback.
const MOST_TOPICS: usize = 500;

/// The name prefix of the nodes that capture.
const CAPTURING: &str = "/authros_";

/// A published topic.
struct Shown {
    about: Advertised,
    /// The owner and source of its messages.
    sources: BTreeMap<u64, Address>,
}

/// The publishing end.
pub(super) struct Stage {
    uri: String,
    graph: Graph,
    publisher: GraphPublisher,
    /// No name under it belongs to anybody else.
    prefix: Option<String>,
    is_captured: bool,
    shown: HashMap<String, Shown>,
    /// Topics that are not published, and why.
    declined: HashMap<String, String>,
    /// The remaining wait for subscribers.
    patience: Duration,
}

/// The source of a message.
pub(super) fn source_of(owner: Address, caller_id: &str) -> u64 {
    let mut hasher = Sm3Hasher::new();
    hasher.update(&owner.0);
    hasher.update(caller_id.as_bytes());
    let digest = hasher.finish();
    digest.first_chunk().map_or(0, |first| u64::from_be_bytes(*first))
}

impl Stage {
    /// A node in a graph; this site may capture from the graph or not.
    pub fn new(
        uri: String,
        graph: Graph,
        publisher: GraphPublisher,
        prefix: Option<String>,
        is_captured: bool,
    ) -> Self {
        let (shown, declined) = (HashMap::new(), HashMap::new());
        Self { uri, graph, publisher, prefix, is_captured, shown, declined, patience: WELCOME }
    }

    /// Whether this site captures from the graph.
    pub fn is_captured(&self) -> bool {
        self.is_captured
    }

    /// The master.
    pub fn uri(&self) -> &str {
        &self.uri
    }

    /// Publishes a topic for a source of its messages; returns the reason if it cannot.
    ///
    /// # Errors
    /// If the master does not answer, or the program that publishes does not run.
    pub fn show(&mut self, about: &Advertised, owner: Address, source: u64) -> Result<Result<(), String>, Failure> {
        if let Some(why) = self.declined.get(&about.topic) {
            return Ok(Err(why.clone()));
        }
        if let Some(reason) = self.publisher.broken() {
            let words = format!("nothing is published at {} now: {reason}; play again", clean(&self.uri, 120));
            return Err(Failure::new(ErrorKind::Unreachable, words));
        }
        if let Some(shown) = self.shown.get_mut(&about.topic) {
            if (&shown.about.type_name, &shown.about.md5sum) != (&about.type_name, &about.md5sum) {
                return Ok(Err(format!(
                    "{} is already being played as {}",
                    about.topic,
                    clean(&shown.about.type_name, 120)
                )));
            }
            shown.sources.insert(source, owner);
            return Ok(Ok(()));
        }
        if self.shown.len() >= MOST_TOPICS {
            return Ok(Err(format!("{MOST_TOPICS} topics are already being played; choose some with --topic")));
        }
        block_in_place(|| self.begin(about, owner, source))
    }

    fn begin(&mut self, about: &Advertised, owner: Address, source: u64) -> Result<Result<(), String>, Failure> {
        if let Some(why) = self.occupied(&about.topic)? {
            self.declined.insert(about.topic.clone(), why.clone());
            return Ok(Err(why));
        }
        let begun = Instant::now();
        self.publisher.advertise(about, self.patience)?;
        self.patience = self.patience.saturating_sub(begun.elapsed());
        let shown = Shown { about: about.clone(), sources: BTreeMap::from([(source, owner)]) };
        self.shown.insert(about.topic.clone(), shown);
        Ok(Ok(()))
    }

    /// Why a name cannot be used without a prefix: a robot's own topic would get messages of another one.
    fn occupied(&self, topic: &str) -> Result<Option<String>, Failure> {
        let is_inside = |prefix: &String| topic.strip_prefix(prefix.as_str()).is_some_and(|rest| rest.starts_with('/'));
        if self.prefix.as_ref().is_some_and(is_inside) {
            return Ok(None);
        }
        let nodes = self.graph.presence(topic)?;
        let of_playing = |node: &&String| node.starts_with(NODE);
        let captures = |node: &&String| node.starts_with(CAPTURING) && !of_playing(node);
        if let Some(node) = nodes.publishers.iter().find(|node| !of_playing(node)) {
            let node = clean(node, 120);
            return Ok(Some(format!("{topic} is already published there by {node}; give a --prefix")));
        }
        let capturing = nodes.subscribers.iter().find(captures);
        Ok(capturing.map(|node| format!("{topic} is captured there by {}; give a --prefix", clean(node, 120))))
    }

    /// Publishes one message of a published topic.
    pub fn publish(&mut self, topic: &str, source: u64, body: &[u8]) -> bool {
        if self.publisher.may_block() {
            return block_in_place(|| self.publisher.publish(topic, source, body));
        }
        self.publisher.publish(topic, source, body)
    }

    /// Whether a subscriber is far behind.
    pub fn is_crowded(&self) -> bool {
        self.publisher.is_crowded()
    }

    /// Stops waiting for subscribers that are far behind now.
    pub fn outrun(&self) {
        self.publisher.outrun();
    }

    /// Comes back after a master or a program that ended; what is away is tried again later.
    pub fn come_back(&mut self) {
        drop(block_in_place(|| self.publisher.come_back()));
    }

    /// Withdraws at once what an owner's messages have published.
    pub fn silence(&mut self, owner: Address) {
        let (mut cut, mut silenced) = (Vec::new(), Vec::new());
        self.shown.retain(|topic, shown| {
            let theirs = shown.sources.iter().filter(|(_, other)| **other == owner);
            let theirs: Vec<(String, u64)> = theirs.map(|(source, _)| (topic.clone(), *source)).collect();
            shown.sources.retain(|_, other| *other != owner);
            let is_over = shown.sources.is_empty();
            if is_over {
                cut.push(topic.clone());
            } else {
                silenced.extend(theirs);
            }
            !is_over
        });
        block_in_place(|| {
            silenced.iter().for_each(|(topic, source)| self.publisher.silence(topic, *source));
            self.publisher.cut(&cut);
        });
    }

    /// No more messages come; what is queued is still sent.
    pub fn leave(&self) {
        block_in_place(|| self.publisher.leave());
    }

    /// Whether subscribers have all that was queued.
    pub fn is_sent(&self) -> bool {
        self.publisher.is_sent()
    }

    /// Ends; what is still queued is not sent. Returns the number of messages that subscribers did not get, without
    /// those withdrawn when a right ended.
    pub fn finish(mut self, by_right: bool) -> u64 {
        block_in_place(|| {
            if by_right {
                let dropped = self.publisher.missed();
                self.publisher.cut(&self.shown.into_keys().collect::<Vec<String>>());
                return dropped;
            }
            self.publisher.end()
        })
    }
}
