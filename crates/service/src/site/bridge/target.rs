//! Where messages are played: a ROS 1 graph, with the descriptions of the original publishers, or a ROS 2 domain, with
//! their offers.

use std::collections::{BTreeMap, HashMap};
use std::time::{Duration, Instant};

use tokio::task::block_in_place;

use super::{NODE, is_under};
use crate::model::{Address, Timestamp, clean};
use crate::pipeline::importer;
use crate::reply::{Failure, PlayEnd, Result, internal, refused};
use crate::ros::recording::Encoding;
use crate::ros::recording::tags::CHANNEL;
use crate::ros::ros2::{Delivery, Offer, Offered, QUALITY, Ros2Publisher};
use crate::ros::{Advertised, Graph, GraphPublisher, RosError, md5sum};

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

const OTHER_ROS: &str = "it is of another ROS";

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

struct Topics {
    place: String,
    prefix: Option<String>,
    types: HashMap<String, (String, String)>,
    declined: HashMap<String, String>,
    patience: Duration,
}

impl Topics {
    fn new(place: String, prefix: Option<String>) -> Self {
        Self { place, prefix, types: HashMap::new(), declined: HashMap::new(), patience: WELCOME }
    }

    /// Whether the topic is new here.
    fn admit(&self, topic: &str, kind: (&str, &str)) -> Result<bool, Stop> {
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

    fn is_inside(&self, topic: &str) -> bool {
        self.prefix.as_ref().is_some_and(|prefix| is_under(prefix, topic))
    }

    fn announce<Done>(&mut self, act: impl FnOnce(Duration) -> Result<Done, RosError>) -> Result<Done> {
        let begun = Instant::now();
        let done = act(self.patience)?;
        self.patience = self.patience.saturating_sub(begun.elapsed());
        Ok(done)
    }

    fn publish(&mut self, topic: &str, (type_name, md5sum): (&str, &str)) {
        self.types.insert(topic.to_owned(), (type_name.to_owned(), md5sum.to_owned()));
    }
}

const ROS1_CLOCK: &str = "rosgraph_msgs/Clock";
const DEFINITION: &str = "# The time of the capture, as this is played\ntime clock\n";

fn clock_topic(topic: String) -> Advertised {
    Advertised {
        topic,
        type_name: ROS1_CLOCK.to_owned(),
        md5sum: md5sum(ROS1_CLOCK, DEFINITION).unwrap_or_default(),
        definition: DEFINITION.to_owned(),
        latching: false,
    }
}

fn clock_message(at: Timestamp) -> Vec<u8> {
    let (seconds, rest) = (at.0 / 1_000_000_000, at.0 % 1_000_000_000);
    let half = |number: u64| u32::try_from(number).unwrap_or(u32::MAX).to_le_bytes();
    [half(seconds), half(rest)].concat()
}

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

const MOST_LATCHED: usize = 64;

/// As `ros2 bag play --clock` offers it.
const ROS2_CLOCK: &str = "rosgraph_msgs/msg/Clock";
const CLOCK_OFFER: Offer = Offer { reliable: false, latched: false, depth: 1 };
const LITTLE: u16 = 1;

/// A latched topic keeps the last messages of each source.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct Way {
    topic: String,
    owner: Address,
    source: Option<u64>,
    encoding: u16,
    offer: Offer,
}

pub(super) struct Domain {
    topics: Topics,
    publisher: Ros2Publisher,
    ways: HashMap<Way, u32>,
}

fn way(about: &Offered, (owner, source): Source) -> Way {
    let source = about.offer.latched.then_some(source);
    Way { topic: about.name.clone(), owner, source, encoding: about.encoding, offer: about.offer }
}

impl Domain {
    pub fn new(publisher: Ros2Publisher, prefix: Option<String>) -> Self {
        let topics = Topics::new(format!("ROS 2 domain {}", publisher.domain()), prefix);
        Self { topics, publisher, ways: HashMap::new() }
    }

    fn begin(&mut self, about: &Offered, way: Way, size: usize, alone: bool) -> Result<(), Stop> {
        let publisher = &mut self.publisher;
        match self.topics.announce(|patience| publisher.advertise(about, size, (alone, !patience.is_zero())))? {
            Ok(writer) => {
                self.make_room(&way);
                self.topics.publish(&about.name, (&about.type_name, ""));
                self.ways.insert(way, writer);
                Ok(())
            }
            Err(declined) => {
                let advice = if declined.occupied { "; give a --prefix" } else { "" };
                let why = format!("{}{advice}", clean(&declined.reason, 300));
                if alone {
                    self.topics.declined.insert(about.name.clone(), why.clone());
                }
                Err(Stop::Refused(why))
            }
        }
    }

    /// Each restart of a publisher is a new source: withdraws the oldest.
    fn make_room(&mut self, way: &Way) {
        let alike = |other: &Way| other.source.is_some() && (&other.topic, other.owner) == (&way.topic, way.owner);
        let alike: Vec<u32> = self.ways.iter().filter(|(other, _)| alike(other)).map(|(_, writer)| *writer).collect();
        if let Some(oldest) = alike.iter().min().filter(|_| alike.len() >= MOST_LATCHED) {
            self.publisher.withdraw(*oldest);
            self.ways.retain(|_, writer| writer != oldest);
        }
    }
}

impl Target for Domain {
    fn name(&self) -> &str {
        &self.topics.place
    }

    fn objection(&self, encoding: Encoding) -> Option<&'static str> {
        match encoding {
            Encoding::Ros1 => Some("a message of ROS 1 is not translated into ROS 2"),
            Encoding::Beside(_) => Some(NO_MESSAGE),
            Encoding::Cdr { .. } => None,
        }
    }

    fn show(&mut self, form: &Form, source: Source, size: usize) -> Result<(), Stop> {
        let Form::Two(about) = form else { return Err(Stop::Refused(OTHER_ROS.to_owned())) };
        block_in_place(|| self.publisher.revive()).map_err(Failure::from)?;
        let is_new = self.topics.admit(&about.name, (&about.type_name, ""))?;
        let way = way(about, source);
        if self.ways.contains_key(&way) {
            return Ok(());
        }
        let alone = is_new && !self.topics.is_inside(&about.name);
        block_in_place(|| self.begin(about, way, size, alone))
    }

    fn publish(&mut self, form: &Form, source: Source, message: &[u8]) -> bool {
        let Form::Two(about) = form else { return false };
        let Some(writer) = self.ways.get(&way(about, source)).copied() else { return false };
        block_in_place(|| self.publisher.publish(writer, message))
    }

    fn clock(&self, topic: &str, now: Timestamp) -> (Form, Vec<u8>) {
        let (name, type_name) = (topic.to_owned(), ROS2_CLOCK.to_owned());
        let message = [LITTLE.to_be_bytes().as_slice(), &[0, 0], &clock_message(now)].concat();
        (Form::Two(Offered { name, type_name, encoding: LITTLE, offer: CLOCK_OFFER }), message)
    }

    fn is_crowded(&self) -> bool {
        self.publisher.is_crowded()
    }

    fn outrun(&self) {
        self.publisher.outrun();
    }

    fn come_back(&mut self) {
        drop(block_in_place(|| self.publisher.revive()));
    }

    fn silence(&mut self, owner: Address) {
        let (publisher, ways) = (&mut self.publisher, &mut self.ways);
        block_in_place(|| {
            ways.extract_if(|way, _| way.owner == owner).for_each(|(_, writer)| publisher.withdraw(writer));
        });
        self.topics.types.retain(|topic, _| ways.keys().any(|way| way.topic == *topic));
    }

    fn leave(&self) {
        block_in_place(|| self.publisher.leave());
    }

    fn is_sent(&self) -> bool {
        self.publisher.is_sent()
    }

    /// Subscribers acknowledge: what was dropped was not published.
    fn finish(self: Box<Self>, handed_out: u64, by_right: bool) -> (u64, u64, u64) {
        let Delivery { missed, unconfirmed } = block_in_place(|| self.publisher.end(by_right));
        let published = handed_out.saturating_sub(missed);
        (published, missed, unconfirmed.min(published))
    }
}

const USUAL: u32 = 10;
const LATCHED: u32 = 1;
const DEEPEST: u32 = 1000;

/// DDS publishers do not announce their depth; recordings do.
pub(super) fn offer(tags: &BTreeMap<String, String>) -> Offer {
    let profiles = tags.get(&format!("{CHANNEL}{QUALITY}")).map(String::as_str).unwrap_or_default();
    let said = |name: &str| first(profiles, name);
    let latched = match said("durability") {
        Some("transient_local" | "1") => true,
        Some("volatile" | "2") => false,
        _ => tags.contains_key(importer::LATCHING),
    };
    let reliable = !matches!(said("reliability"), Some("best_effort" | "2"));
    let usual = if latched { LATCHED } else { USUAL };
    let depth = match (said("history"), said("depth").and_then(|depth| depth.parse().ok())) {
        (Some("keep_all" | "2"), _) => DEEPEST,
        (_, Some(depth)) if depth > 0 => depth,
        _ => usual,
    };
    Offer { reliable, latched, depth: depth.min(DEEPEST) }
}

/// Profiles are a YAML list; only the first counts.
fn first<'a>(profiles: &'a str, name: &str) -> Option<&'a str> {
    let lines = profiles.lines().enumerate();
    let own = lines.take_while(|(place, line)| *place == 0 || !line.starts_with('-')).map(|(_, line)| line);
    own.filter_map(|line| line.trim_start_matches(['-', ' ']).split_once(':'))
        .find(|(key, _)| key.trim() == name)
        .map(|(_, value)| value.trim())
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

    fn of(profiles: &str, latching: bool) -> Offer {
        let mut tags = BTreeMap::from([("mcap.channel.offered_qos_profiles".to_owned(), profiles.to_owned())]);
        if latching {
            tags.insert("latching".into(), "yes".into());
        }
        offer(&tags)
    }

    #[test]
    fn profiles_of_recorders_old_and_new_are_understood() {
        // As rosbag2 writes them since Iron, and as it did before.
        let new = "- history: keep_last\n  depth: 5\n  reliability: best_effort\n  durability: volatile\n  deadline:\n    sec: \
                   9223372036\n    nsec: 854775807\n- history: keep_last\n  depth: 7\n  reliability: reliable\n";
        assert_eq!(of(new, false), Offer { reliable: false, latched: false, depth: 5 });
        let old = "- history: 1\n  depth: 3\n  reliability: 1\n  durability: 1\n  deadline:\n    sec: 0\n";
        assert_eq!(of(old, false), Offer { reliable: true, latched: true, depth: 3 });
        assert_eq!(of("- history: keep_all\n  depth: 0\n", false).depth, 1000);
        assert_eq!(of("- depth: 99999999\n", false).depth, 1000);
    }

    #[test]
    fn what_is_not_said_is_what_a_node_does() {
        let unknown = "- history: unknown\n  depth: 0\n  reliability: reliable\n  durability: transient_local\n";
        assert_eq!(of(unknown, true), Offer { reliable: true, latched: true, depth: 1 });
        assert_eq!(of("", false), Offer { reliable: true, latched: false, depth: 10 });
        assert_eq!(of("depth: x\nreliability: no", true), Offer { reliable: true, latched: true, depth: 1 });
    }
}
