//! The slave API every ROS node serves: what the master and tools such as rosnode ask it. The answers are the same for
//! the capturing node and for the robots; the differences are in [`Node`].

use std::net::TcpListener;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::RosError;
use super::address::{authority, listen_address};
use super::xmlrpc::{Answer, OF_A_NODE, Server, Value};
use crate::model::clean;

/// One connection of a node, as `getBusInfo` reports it.
pub(super) struct BusLink {
    pub peer: String,
    pub outbound: bool,
    pub topic: String,
}

/// What a node reports about itself. Nothing here may block.
pub(super) trait Node: Send + Sync + 'static {
    /// URI of its master.
    fn master_uri(&self) -> String;
    /// Topics and types it subscribes to.
    fn subscriptions(&self) -> Vec<(String, String)>;
    /// Topics and types it publishes.
    fn publications(&self) -> Vec<(String, String)>;
    /// Its connections.
    fn links(&self) -> Vec<BusLink>;
    /// Somebody reports that the publishers of a topic have changed, and their URIs.
    fn publishers_changed(&self, topic: &str, publishers: &[&str]);
    /// Host and port where it serves a topic.
    fn outlet(&self, topic: &str) -> Option<(String, u16)>;
    /// Somebody asks it to shut down.
    fn shutdown_asked(&self, by: &str, reason: &str);
}

/// A node's running slave API.
pub(super) struct SlaveServer {
    pub uri: String,
    _server: Server,
}

impl SlaveServer {
    /// Serves `node` on a free port of `host`.
    pub fn start(host: &str, node: Arc<dyn Node>) -> Result<Self, RosError> {
        let listener = listen(host)?;
        let port = listener.local_addr().map_err(|error| RosError::system("listen", &error))?.port();
        let server = Server::start(listener, Arc::new(Slave(node)), OF_A_NODE)
            .map_err(|error| RosError::system("start a thread", &error))?;
        Ok(Self { uri: format!("http://{}/", authority(host, port)), _server: server })
    }
}

/// A listener on a free port of `host` only.
pub(super) fn listen(host: &str) -> Result<TcpListener, RosError> {
    let address = listen_address(host, Instant::now() + Duration::from_secs(2))?;
    TcpListener::bind(address).map_err(|error| RosError::OwnHost { host: clean(host, 80), reason: error.to_string() })
}

struct Slave(Arc<dyn Node>);

impl Answer for Slave {
    fn answer(&self, method: &str, params: &[Value]) -> Option<Value> {
        let node = &*self.0;
        Some(match method {
            "getPid" => success(Value::Int(i64::from(std::process::id()))),
            "getMasterUri" => success(node.master_uri().into()),
            "getSubscriptions" => success(pairs(node.subscriptions())),
            "getPublications" => success(pairs(node.publications())),
            "getBusStats" => success(Value::Array(vec![empty(), empty(), empty()])),
            "getBusInfo" => success(bus_info(node.links())),
            "publisherUpdate" => publisher_update(node, params),
            "requestTopic" => request_topic(node, params),
            "paramUpdate" => success(Value::Int(0)),
            "shutdown" => {
                node.shutdown_asked(text_at(params, 0), text_at(params, 1));
                success(Value::Int(0))
            }
            _ => return None,
        })
    }
}

fn text_at(params: &[Value], index: usize) -> &str {
    params.get(index).and_then(Value::as_text).unwrap_or_default()
}

fn empty() -> Value {
    Value::Array(Vec::new())
}

fn success(value: Value) -> Value {
    Value::Array(vec![Value::Int(1), "".into(), value])
}

fn failure(code: i64, reason: &str) -> Value {
    Value::Array(vec![Value::Int(code), reason.into(), Value::Int(0)])
}

fn pairs(pairs: Vec<(String, String)>) -> Value {
    pairs.into_iter().map(|(topic, type_name)| Value::Array(vec![topic.into(), type_name.into()])).collect()
}

fn bus_info(links: Vec<BusLink>) -> Value {
    let row = |(number, link): (i64, BusLink)| {
        Value::Array(vec![
            Value::Int(number),
            link.peer.into(),
            if link.outbound { "o" } else { "i" }.into(),
            "TCPROS".into(),
            link.topic.into(),
            Value::Bool(true),
        ])
    };
    (1..).zip(links).map(row).collect()
}

fn publisher_update(node: &dyn Node, params: &[Value]) -> Value {
    match params.get(1).and_then(Value::as_text) {
        Some(topic) => {
            let uris = params.get(2).and_then(Value::as_array).unwrap_or_default();
            let uris: Vec<&str> = uris.iter().filter_map(Value::as_text).collect();
            node.publishers_changed(topic, &uris);
            success(Value::Int(0))
        }
        None => failure(-1, "publisherUpdate needs a topic"),
    }
}

fn request_topic(node: &dyn Node, params: &[Value]) -> Value {
    let protocols = params.get(2).and_then(Value::as_array).unwrap_or_default();
    let tcpros =
        |protocol: &Value| protocol.as_array().and_then(<[Value]>::first).and_then(Value::as_text) == Some("TCPROS");
    if !protocols.iter().any(tcpros) {
        return failure(0, "only TCPROS is supported");
    }
    match node.outlet(text_at(params, 1)) {
        Some((host, port)) => success(Value::Array(vec!["TCPROS".into(), host.into(), Value::Int(i64::from(port))])),
        None => failure(0, "this topic is not published here"),
    }
}
