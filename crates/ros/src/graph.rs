//! Queries to a ROS master. Every call ends within [`PATIENCE`]; answers are untrusted, and only names are kept.

use std::collections::{BTreeMap, BTreeSet};
use std::net::TcpListener;
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use crate::tcpros::{Endpoint, connect, own_host, resolve};
use crate::xmlrpc::{CallError, Value, call};
use crate::{Result, RosError, model::clean};

pub const PATIENCE: Duration = Duration::from_millis(2500);

/// Types of an unchanged graph are queried again after this time: a node may return with another type.
const TYPES_HOLD: Duration = Duration::from_secs(5);

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TopicInfo {
    /// As the master gave it: clean it before it is shown.
    pub name: String,
    /// If the master knows one.
    pub type_name: Option<String>,
    pub publishers: Vec<String>,
    /// Number of subscribed nodes.
    pub subscribers: usize,
}

#[derive(Debug, Default)]
pub struct LastLook(Option<Types>);

/// The types of all topics, and the graph they were queried for.
#[derive(Debug)]
struct Types {
    state: Value,
    value: Value,
    asked: Instant,
}

impl Types {
    fn hold(&self, state: &Value) -> bool {
        self.state == *state && self.asked.elapsed() < TYPES_HOLD
    }
}

#[derive(Debug, Clone)]
pub struct Graph {
    master: Endpoint,
    node_name: String,
}

pub(super) fn master_error(master: &Endpoint, call: &'static str, error: CallError) -> RosError {
    let uri = master.to_string();
    match error {
        CallError::Connect(reason) | CallError::Broken(reason) => RosError::Unreachable { uri, reason },
        CallError::Protocol(reason) => RosError::Protocol { uri, reason: clean(&reason, 200) },
        CallError::Refused(reason) => RosError::Refused { uri, call, reason },
    }
}

fn rows(value: &Value) -> impl Iterator<Item = (&str, &Value)> {
    value.as_array().unwrap_or_default().iter().filter_map(|row| {
        let [name, rest] = row.as_array()? else { return None };
        Some((name.as_text()?, rest))
    })
}

fn merge(publishers: &Value, subscribers: &Value, types: &Value) -> Vec<TopicInfo> {
    let types: BTreeMap<&str, &str> =
        rows(types).filter_map(|(topic, type_name)| Some((topic, type_name.as_text()?))).collect();
    let mut topics: BTreeMap<&str, (Vec<String>, usize)> = BTreeMap::new();
    for (topic, nodes) in rows(publishers) {
        topics.entry(topic).or_default().0 = nodes.texts();
    }
    for (topic, nodes) in rows(subscribers) {
        topics.entry(topic).or_default().1 = nodes.as_array().unwrap_or_default().len();
    }
    let info = |(name, (publishers, subscribers)): (&str, _)| {
        let known = types.get(name).filter(|type_name| **type_name != "*");
        TopicInfo { name: name.to_owned(), type_name: known.map(|found| (*found).to_owned()), publishers, subscribers }
    };
    topics.into_iter().map(info).collect()
}

/// The nodes of one topic, as the master named them: clean the names before they are shown.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Presence {
    pub publishers: Vec<String>,
    pub subscribers: Vec<String>,
}

const MOST_NODES: usize = 20;
const EACH: Duration = Duration::from_millis(800);

/// A listed publisher that cannot be reached; its texts are cleaned.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Unreached {
    pub node: String,
    /// The host and port it stated.
    pub place: String,
    /// The reason, with a remedy if one is known.
    pub reason: String,
}

impl std::fmt::Display for Unreached {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} at {}: {}", self.node, self.place, self.reason)
    }
}

impl Graph {
    /// Sends nothing yet.
    pub fn new(master_uri: &str, node_name: &str) -> Result<Self> {
        Ok(Self::of(Endpoint::of_master(master_uri)?, node_name))
    }

    pub(crate) fn of(master: Endpoint, node_name: &str) -> Self {
        Self { master, node_name: node_name.to_owned() }
    }

    pub fn ping(&self) -> Result<()> {
        self.ask("getPid", Instant::now() + PATIENCE).map(drop)
    }

    pub fn topics(&self) -> Result<Vec<TopicInfo>> {
        self.topics_again(&mut LastLook::default())
    }

    /// For repeated polling: while the graph is unchanged and all types are known, types are queried only now and then.
    pub fn topics_again(&self, last: &mut LastLook) -> Result<Vec<TopicInfo>> {
        let deadline = Instant::now() + PATIENCE;
        let state = self.ask("getSystemState", deadline)?;
        let types = match last.0.take().filter(|types| types.hold(&state)) {
            Some(types) => types,
            None => Types { value: self.ask("getTopicTypes", deadline)?, state, asked: Instant::now() },
        };
        let Some([publishers, subscribers, ..]) = types.state.as_array() else {
            let reason = "its system state has no publishers and subscribers".into();
            return Err(RosError::Protocol { uri: self.master.to_string(), reason });
        };
        let topics = merge(publishers, subscribers, &types.value);
        last.0 = Some(types).filter(|_| topics.iter().all(|topic| topic.type_name.is_some()));
        Ok(topics)
    }

    fn ask(&self, method: &'static str, deadline: Instant) -> Result<Value> {
        call(&self.master, method, &[self.node_name.as_str().into()], deadline)
            .map_err(|error| master_error(&self.master, method, error))
    }

    pub fn presence(&self, topic: &str) -> Result<Presence> {
        let state = self.ask("getSystemState", Instant::now() + PATIENCE)?;
        let nodes = |index: usize| {
            let of_state = state.as_array().and_then(|parts| parts.get(index));
            let found = of_state.and_then(|part| rows(part).find(|(name, _)| *name == topic));
            found.map(|(_, nodes)| nodes.texts()).unwrap_or_default()
        };
        Ok(Presence { publishers: nodes(0), subscribers: nodes(1) })
    }

    /// Whether another URI leads to this master, as far as names and addresses show.
    pub fn is_at(&self, uri: &str) -> bool {
        let Some(other) = Endpoint::parse(uri) else { return false };
        if other.port != self.master.port {
            return false;
        }
        let places = |endpoint: &Endpoint| resolve(&endpoint.host, endpoint.port, Instant::now() + PATIENCE);
        match (places(&self.master), places(&other)) {
            (Ok(ours), Ok(theirs)) => ours.iter().any(|place| {
                let is_loopback = place.ip().is_loopback();
                theirs.iter().any(|other| place == other || is_loopback && other.ip().is_loopback())
            }),
            _ => other.host == self.master.host,
        }
    }

    /// The number of publishers' addresses tried, and those that do not answer.
    pub fn unreached(&self) -> Result<(usize, Vec<Unreached>)> {
        let nodes: BTreeSet<String> = self.topics()?.into_iter().flat_map(|topic| topic.publishers).collect();
        let mut found = Vec::new();
        let tried = nodes.iter().take(MOST_NODES);
        let count = tried.len();
        for node in tried {
            if let Err((place, reason)) = self.try_node(node) {
                let (place, reason) = (clean(&place, 120), clean(&reason, 160));
                found.push(Unreached { node: clean(node, 120), place, reason });
            }
        }
        Ok((count, found))
    }

    /// The node that publishes the topic from this address.
    pub(crate) fn node_at(&self, topic: &str, place: &Endpoint) -> Option<String> {
        let nodes = self.presence(topic).ok()?.publishers;
        nodes.into_iter().take(MOST_NODES).find(|node| self.place_of(node).is_ok_and(|found| found == *place))
    }

    /// Where a node is, according to the master; otherwise whose fault it is, and the fault.
    fn place_of(&self, node: &str) -> Result<Endpoint, (String, String)> {
        let parameters = [self.node_name.as_str().into(), node.into()];
        let uri = call(&self.master, "lookupNode", &parameters, Instant::now() + PATIENCE)
            .map_err(|error| ("the master".to_owned(), master_error(&self.master, "lookupNode", error).to_string()))?;
        let uri = uri.as_text().unwrap_or_default().to_owned();
        Endpoint::parse(&uri).ok_or_else(|| (uri.clone(), "which is not an address".to_owned()))
    }

    fn try_node(&self, node: &str) -> Result<(), (String, String)> {
        let place = self.place_of(node)?;
        let connected = connect(&place.host, place.port, Instant::now() + EACH);
        connected.map(drop).map_err(|error| (place.authority(), error.to_string()))
    }

    /// The host this machine would give other nodes, or what is wrong with it; `given` is `ros.host` or ROS_HOSTNAME.
    pub fn own_name(&self, given: Option<&str>) -> Result<String, (String, String)> {
        let deadline = Instant::now() + PATIENCE;
        let host = own_host(given, &self.master, deadline)
            .map_err(|error| (given.unwrap_or_default().to_owned(), error.to_string()))?;
        let fault = |reason: String| (clean(&host, 120), reason);
        let places = resolve(&host, 0, deadline).map_err(|error| fault(format!("does not resolve: {error}")))?;
        // An address that can be listened on is this machine's.
        if !places.iter().any(|place| TcpListener::bind(place).is_ok()) {
            return Err(fault(format!("resolves to {places:?}, none of which belongs to this machine")));
        }
        let master_is_here = matches!(self.master.host.as_str(), "localhost" | "127.0.0.1" | "::1");
        if !master_is_here && places.iter().all(|place| place.ip().is_loopback()) {
            return Err(fault("resolves only to loopback, so other machines would connect to themselves".to_owned()));
        }
        Ok(host)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::TcpListener;

    #[test]
    fn types_are_kept_while_the_graph_is_as_it_was_and_not_for_ever() {
        let state = |name: &str| Value::Array(vec![name.into()]);
        let now = Instant::now();
        let types = Types { state: state("/a"), value: Value::Array(Vec::new()), asked: now };
        assert!(types.hold(&state("/a")));
        assert!(!types.hold(&state("/b")));
        let old = Types { asked: now.checked_sub(TYPES_HOLD * 2).expect("the machine is up for longer"), ..types };
        assert!(!old.hold(&state("/a")));
    }

    #[test]
    fn state_and_types_are_merged() {
        let nodes = |names: &[&str]| names.iter().copied().collect::<Value>();
        let row = |topic: &str, value: Value| Value::Array(vec![topic.into(), value]);
        let publishers = Value::Array(vec![row("/b", nodes(&["/n1", "/n2"])), Value::Int(3), row("/a", nodes(&[]))]);
        let subscribers = Value::Array(vec![row("/b", nodes(&["/s"])), row("/c", nodes(&["/s", "/t"]))]);
        let types = Value::Array(vec![row("/b", "std_msgs/String".into()), row("/c", "*".into())]);
        let topics = merge(&publishers, &subscribers, &types);
        let names: Vec<_> = topics.iter().map(|topic| topic.name.as_str()).collect();
        assert_eq!(names, ["/a", "/b", "/c"]);
        assert_eq!(topics[1].publishers, ["/n1", "/n2"]);
        assert_eq!(topics[1].type_name.as_deref(), Some("std_msgs/String"));
        assert_eq!((topics[2].type_name.as_deref(), topics[2].subscribers), (None, 2));
    }

    #[test]
    fn a_hung_or_absent_master_is_unreachable_and_named() {
        let listener = TcpListener::bind("127.0.0.1:0").expect("bind");
        let uri = format!("http://{}", listener.local_addr().expect("address"));
        let graph = Graph::new(&uri, "/test").expect("uri");
        let begun = Instant::now();
        let error = graph.topics().expect_err("it never answers");
        assert!(begun.elapsed() < PATIENCE * 2);
        assert!(matches!(&error, RosError::Unreachable { .. }) && error.to_string().contains(&uri), "{error}");
        drop(listener);
        assert!(matches!(graph.ping(), Err(RosError::Unreachable { .. })));
        assert!(matches!(Graph::new("localhost:11311", "/test"), Err(RosError::Address(_))));
    }
}

#[cfg(test)]
mod presence_tests {
    use super::*;
    use crate::ros::{EmbeddedMaster, Fleet, FleetOptions};

    #[test]
    fn a_topic_s_nodes_are_named_and_an_unknown_one_has_none() {
        let master = EmbeddedMaster::start().expect("master");
        let graph = Graph::new(master.uri(), "/test").expect("uri");
        let _fleet = Fleet::start(master.uri(), 1, FleetOptions::default()).expect("fleet");
        let presence = graph.presence("/robot1/odom").expect("asked");
        assert_eq!(presence.publishers, ["/robot1_sim"]);
        assert_eq!(graph.presence("/nobody").expect("asked"), Presence::default());
    }

    #[test]
    fn one_master_has_many_addresses() {
        let graph = Graph::new("http://127.0.0.1:11999/", "/test").expect("uri");
        assert!(graph.is_at("http://localhost:11999"));
        assert!(graph.is_at("http://127.0.0.1:11999/RPC2"));
        assert!(!graph.is_at("http://127.0.0.1:11998"));
        assert!(!graph.is_at("http://192.0.2.1:11999"));
        assert!(!graph.is_at("not a URI"));
    }
}
