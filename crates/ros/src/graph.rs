//! Queries to a ROS master: whether it is there, which topics exist. Every call ends within [`PATIENCE`], whatever the
//! master does; its answers are untrusted and only names are kept.

mod presence;
mod reach;

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use super::RosError;
use super::address::Endpoint;
use super::xmlrpc::{CallError, Value, call};
use crate::model::clean;

pub use presence::Presence;
pub use reach::Unreached;

/// The longest a query may take.
pub const PATIENCE: Duration = Duration::from_millis(2500);

/// How long the types of an unchanged graph are not queried again: a node may have come back with another type.
const TYPES_HOLD: Duration = Duration::from_secs(5);

/// A topic as the master knows it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TopicInfo {
    /// Its name, as the master gave it: clean it before it is shown.
    pub name: String,
    /// Its type, if the master knows one.
    pub type_name: Option<String>,
    /// Names of the nodes that publish it.
    pub publishers: Vec<String>,
    /// How many nodes subscribe to it.
    pub subscribers: usize,
}

/// The master's last answer, for [`Graph::topics_again`].
#[derive(Debug, Default)]
pub struct LastLook {
    types: Option<Types>,
}

/// The types of all topics, and the graph they were queried for.
#[derive(Debug)]
struct Types {
    state: Value,
    value: Value,
    asked: Instant,
}

impl Types {
    /// Whether they need not be queried again.
    fn hold(&self, state: &Value) -> bool {
        self.state == *state && self.asked.elapsed() < TYPES_HOLD
    }
}

/// A ROS master, queried without keeping a connection open.
#[derive(Debug, Clone)]
pub struct Graph {
    master: Endpoint,
    node_name: String,
}

impl Graph {
    /// The master at `master_uri`, queried in the name of the node `node_name`. Nothing is sent yet.
    ///
    /// # Errors
    /// [`RosError::Address`] if the URI is not `http://HOST:PORT`.
    pub fn new(master_uri: &str, node_name: &str) -> Result<Self, RosError> {
        let master = Endpoint::parse(master_uri).ok_or_else(|| RosError::address(master_uri))?;
        Ok(Self { master, node_name: node_name.to_owned() })
    }

    pub(crate) fn of(master: Endpoint, node_name: &str) -> Self {
        Self { master, node_name: node_name.to_owned() }
    }

    /// Whether a master answers.
    ///
    /// # Errors
    /// [`RosError::Unreachable`] if nothing answers, [`RosError::Protocol`] if it is not a master.
    pub fn ping(&self) -> Result<(), RosError> {
        self.ask("getPid", Instant::now() + PATIENCE).map(drop)
    }

    /// All topics with a publisher or subscriber, by name.
    ///
    /// # Errors
    /// See [`Graph::ping`], and [`RosError::Refused`] if the master refuses.
    pub fn topics(&self) -> Result<Vec<TopicInfo>, RosError> {
        self.topics_again(&mut LastLook::default())
    }

    /// [`Graph::topics`] for repeated polling: while the graph is as it was in the `last` answer and all types were
    /// known, types are queried only now and then.
    ///
    /// # Errors
    /// See [`Graph::topics`].
    pub fn topics_again(&self, last: &mut LastLook) -> Result<Vec<TopicInfo>, RosError> {
        let deadline = Instant::now() + PATIENCE;
        let state = self.ask("getSystemState", deadline)?;
        let types = match last.types.take().filter(|types| types.hold(&state)) {
            Some(types) => types,
            None => Types { value: self.ask("getTopicTypes", deadline)?, state, asked: Instant::now() },
        };
        let Some([publishers, subscribers, ..]) = types.state.as_array() else {
            return Err(RosError::Protocol {
                uri: self.master.to_string(),
                reason: "its system state has no publishers and subscribers".into(),
            });
        };
        let topics = merge(publishers, subscribers, &types.value);
        last.types = Some(types).filter(|_| topics.iter().all(|topic| topic.type_name.is_some()));
        Ok(topics)
    }

    fn ask(&self, method: &'static str, deadline: Instant) -> Result<Value, RosError> {
        call(&self.master, method, &[self.node_name.as_str().into()], deadline)
            .map_err(|error| master_error(&self.master, method, error))
    }
}

/// The meaning of a failed call to the master.
pub(super) fn master_error(master: &Endpoint, call: &'static str, error: CallError) -> RosError {
    let uri = master.to_string();
    match error {
        CallError::Connect(reason) | CallError::Broken(reason) => RosError::Unreachable { uri, reason },
        CallError::Protocol(reason) => RosError::Protocol { uri, reason: clean(&reason, 200) },
        CallError::Refused(reason) => RosError::Refused { uri, call, reason },
    }
}

/// Pairs of (topic, nodes).
fn rows(value: &Value) -> impl Iterator<Item = (&str, &Value)> {
    value.as_array().unwrap_or_default().iter().filter_map(|row| match row.as_array() {
        Some([name, rest]) => Some((name.as_text()?, rest)),
        _ => None,
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
    let known = |name: &str| types.get(name).filter(|type_name| **type_name != "*").map(|found| (*found).to_owned());
    topics
        .into_iter()
        .map(|(name, (publishers, subscribers))| TopicInfo {
            name: name.to_owned(),
            type_name: known(name),
            publishers,
            subscribers,
        })
        .collect()
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
