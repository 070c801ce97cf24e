//! The node that publishes, and what it shows: each topic as its publishers described it, unless that would mix with
//! somebody else's.

use std::collections::{BTreeMap, HashMap};
use std::time::{Duration, Instant};

use tokio::task::block_in_place;

use super::NODE;
use crate::crypto::Sm3Hasher;
use crate::model::{Address, clean};
use crate::ros::{Advertised, Graph, Publisher};
use crate::service::reply::Failure;

/// How long playing waits for subscribers that the master knows, in all.
const WELCOME: Duration = Duration::from_secs(5);

/// How the nodes that capture are named.
const CAPTURING: &str = "/authros_";

/// A topic that is shown.
struct Shown {
    about: Advertised,
    /// Whose messages by which source.
    sources: BTreeMap<u64, Address>,
}

/// The publishing end.
pub(super) struct Stage {
    uri: String,
    graph: Graph,
    publisher: Publisher,
    prefixed: bool,
    shown: HashMap<String, Shown>,
    /// Topics that are not shown, and why not.
    declined: HashMap<String, String>,
    /// What is left of the wait for subscribers.
    patience: Duration,
}

/// Where a message comes from.
pub(super) fn source_of(owner: Address, caller_id: &str) -> u64 {
    let mut hasher = Sm3Hasher::new();
    hasher.update(&owner.0);
    hasher.update(caller_id.as_bytes());
    let digest = hasher.finish();
    digest.first_chunk().map_or(0, |first| u64::from_be_bytes(*first))
}

impl Stage {
    pub fn new(uri: String, graph: Graph, publisher: Publisher, prefixed: bool) -> Self {
        let (shown, declined) = (HashMap::new(), HashMap::new());
        Self { uri, graph, publisher, prefixed, shown, declined, patience: WELCOME }
    }

    /// The master.
    pub fn uri(&self) -> &str {
        &self.uri
    }

    /// Shows a topic for a source of its messages; why not, where it cannot be shown so.
    ///
    /// # Errors
    /// Where the master does not answer.
    pub fn show(&mut self, about: &Advertised, owner: Address, source: u64) -> Result<Result<(), String>, Failure> {
        if let Some(why) = self.declined.get(&about.topic) {
            return Ok(Err(why.clone()));
        }
        if let Some(shown) = self.shown.get_mut(&about.topic) {
            if (&shown.about.type_name, &shown.about.md5sum) != (&about.type_name, &about.md5sum) {
                return Ok(Err(format!("{} is played as {} already", about.topic, clean(&shown.about.type_name, 120))));
            }
            shown.sources.insert(source, owner);
            return Ok(Ok(()));
        }
        block_in_place(|| self.begin(about, owner, source))
    }

    fn begin(&mut self, about: &Advertised, owner: Address, source: u64) -> Result<Result<(), String>, Failure> {
        if let Some(why) = self.occupied(&about.topic)? {
            self.declined.insert(about.topic.clone(), why.clone());
            return Ok(Err(why));
        }
        let known = self.publisher.advertise(about)?;
        let begun = Instant::now();
        while self.publisher.subscribers(&about.topic) < known && begun.elapsed() < self.patience {
            std::thread::sleep(Duration::from_millis(5));
        }
        self.patience = self.patience.saturating_sub(begun.elapsed());
        let shown = Shown { about: about.clone(), sources: BTreeMap::from([(source, owner)]) };
        self.shown.insert(about.topic.clone(), shown);
        Ok(Ok(()))
    }

    /// Why a name cannot be used without a prefix: a robot's own topic would get messages of another one.
    fn occupied(&self, topic: &str) -> Result<Option<String>, Failure> {
        if self.prefixed {
            return Ok(None);
        }
        let nodes = self.graph.presence(topic)?;
        let of_playing = |node: &&String| node.starts_with(NODE);
        let captures = |node: &&String| node.starts_with(CAPTURING) && !of_playing(node);
        if let Some(node) = nodes.publishers.iter().find(|node| !of_playing(node)) {
            let node = clean(node, 120);
            return Ok(Some(format!("{topic} is published by {node} there already; give a --prefix")));
        }
        let capturing = nodes.subscribers.iter().find(captures);
        Ok(capturing.map(|node| format!("{topic} is captured by {} there; give a --prefix", clean(node, 120))))
    }

    /// Shows a topic that is no record's, `/clock`.
    ///
    /// # Errors
    /// As [`Self::show`].
    pub fn show_plain(&mut self, about: &Advertised) -> Result<Result<(), String>, Failure> {
        self.show(about, Address([0; 20]), 0)
    }

    /// Publishes one message of a topic that is shown.
    pub fn publish(&self, topic: &str, source: u64, body: &[u8]) -> bool {
        self.publisher.publish(topic, source, body)
    }

    /// Whether a subscriber is far behind.
    pub fn is_crowded(&self) -> bool {
        self.publisher.is_crowded()
    }

    /// Registers all topics once more; a master that is away is tried again later.
    pub fn register_again(&self) {
        drop(block_in_place(|| self.publisher.register_again()));
    }

    /// Takes back at once what an owner's messages have shown.
    pub fn silence(&mut self, owner: Address) {
        let publisher = &self.publisher;
        self.shown.retain(|topic, shown| {
            let theirs: Vec<u64> =
                shown.sources.iter().filter(|(_, other)| **other == owner).map(|(source, _)| *source).collect();
            if theirs.is_empty() {
                return true;
            }
            shown.sources.retain(|_, other| *other != owner);
            if shown.sources.is_empty() {
                block_in_place(|| publisher.cut(topic));
                return false;
            }
            theirs.iter().for_each(|source| publisher.silence(topic, *source));
            true
        });
    }

    /// Ends, with what is queued or, after the end of a right, without it; messages that subscribers did not get.
    pub fn finish(self, at_once: bool) -> u64 {
        block_in_place(|| {
            if at_once {
                let dropped = self.publisher.overflowed();
                self.shown.keys().for_each(|topic| self.publisher.cut(topic));
                return dropped;
            }
            self.publisher.finish()
        })
    }
}
