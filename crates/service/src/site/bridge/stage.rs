//! Publishes in a ROS 1 graph with the descriptions of the original publishers.

use std::collections::{BTreeMap, HashMap};

use tokio::task::block_in_place;

use super::NODE;
use super::target::{Form, NO_MESSAGE, OTHER_ROS, Source, Stop, Target, Topics, clock_message, clock_topic};
use crate::model::{Address, Timestamp, clean};
use crate::ros::recording::Encoding;
use crate::ros::{Graph, GraphPublisher};
use crate::service::reply::{Failure, Result};

const CAPTURING: &str = "/authros_";

pub(super) struct Stage {
    topics: Topics,
    graph: Graph,
    publisher: Box<dyn GraphPublisher>,
    sources: HashMap<String, BTreeMap<u64, Address>>,
}

impl Stage {
    pub fn new(uri: String, graph: Graph, publisher: Box<dyn GraphPublisher>, prefix: Option<String>) -> Self {
        Self { topics: Topics::new(uri, prefix), graph, publisher, sources: HashMap::new() }
    }

    /// Without a prefix, a robot's own topic would receive foreign messages.
    fn occupied(&self, topic: &str) -> Result<Option<String>> {
        if self.topics.is_inside(topic) {
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
}

impl Target for Stage {
    fn name(&self) -> &str {
        &self.topics.place
    }

    fn objection(&self, encoding: Encoding) -> Option<&'static str> {
        match encoding {
            Encoding::Cdr { .. } => Some("ROS 2 messages are not translated into ROS 1"),
            Encoding::Beside(_) => Some(NO_MESSAGE),
            Encoding::Ros1 => None,
        }
    }

    fn show(&mut self, form: &Form, (owner, source): Source, _: usize) -> Result<(), Stop> {
        let Form::One(about) = form else { return Err(Stop::Refused(OTHER_ROS.to_owned())) };
        let (topic, kind) = (&about.topic, (about.type_name.as_str(), about.md5sum.as_str()));
        block_in_place(|| self.publisher.revive()).map_err(Failure::from)?;
        let is_new = self.topics.admit(topic, kind)?;
        if is_new {
            if let Some(why) = block_in_place(|| self.occupied(topic))? {
                self.topics.declined.insert(topic.clone(), why.clone());
                return Err(Stop::Refused(why));
            }
            let publisher = &mut self.publisher;
            block_in_place(|| self.topics.announce(|patience| publisher.advertise(about, patience)))?;
            self.topics.publish(topic, kind);
        }
        self.sources.entry(topic.clone()).or_default().insert(source, owner);
        Ok(())
    }

    fn publish(&mut self, form: &Form, (_, source): Source, body: &[u8]) -> bool {
        let Form::One(about) = form else { return false };
        if self.publisher.may_block() {
            return block_in_place(|| self.publisher.publish(&about.topic, source, body));
        }
        self.publisher.publish(&about.topic, source, body)
    }

    fn clock(&self, topic: &str, now: Timestamp) -> (Form, Vec<u8>) {
        (Form::One(clock_topic(topic.to_owned())), clock_message(now))
    }

    fn is_crowded(&self) -> bool {
        self.publisher.is_crowded()
    }

    fn outrun(&self) {
        self.publisher.outrun();
    }

    fn come_back(&mut self) {
        drop(block_in_place(|| self.publisher.come_back()));
    }

    fn silence(&mut self, owner: Address) {
        let (mut cut, publisher) = (Vec::new(), &mut self.publisher);
        block_in_place(|| {
            self.sources.retain(|topic, sources| {
                let theirs: Vec<u64> = sources.extract_if(.., |_, other| *other == owner).map(|(id, _)| id).collect();
                if sources.is_empty() {
                    cut.push(topic.clone());
                } else {
                    theirs.into_iter().for_each(|source| publisher.silence(topic, source));
                }
                !sources.is_empty()
            });
            publisher.cut(&cut);
        });
        self.topics.types.retain(|topic, _| self.sources.contains_key(topic));
    }

    fn leave(&self) {
        block_in_place(|| self.publisher.leave());
    }

    fn is_sent(&self) -> bool {
        self.publisher.is_sent()
    }

    fn finish(self: Box<Self>, handed_out: u64, by_right: bool) -> (u64, u64, u64) {
        let Self { mut publisher, sources, .. } = *self;
        let dropped = block_in_place(|| {
            if by_right {
                let dropped = publisher.missed();
                publisher.cut(&sources.into_keys().collect::<Vec<String>>());
                return dropped;
            }
            publisher.end()
        });
        (handed_out, dropped, 0)
    }
}
