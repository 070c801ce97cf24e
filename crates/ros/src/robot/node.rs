//! A robot as a ROS node: its registration at the master, its slave API, and the TCPROS port
//! where subscribers shake hands before they are handed to an outlet.

use std::io::{self, Write as _};
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::outlet::Outlet;
use crate::model::clean;
use crate::ros::RosError;
use crate::ros::address::Endpoint;
use crate::ros::graph::master_error;
use crate::ros::slave::{BusLink, Node, SlaveServer, listen};
use crate::ros::tcpros::{ConnectionHeader, FrameReader, Poll};
use crate::ros::xmlrpc::{CallError, Value, call};

/// How long the master or a subscriber gets for an answer.
const PATIENCE: Duration = Duration::from_secs(2);

/// The longest connection header of a subscriber, bytes.
const LONGEST_REQUEST: usize = 64 << 10;

/// The most subscribers of one robot's topics.
const MOST_SUBSCRIBERS: usize = 64;

/// What the slave API and the TCPROS port know of the robot.
struct Identity {
    name: String,
    host: String,
    port: u16,
    master: Endpoint,
    outlets: Vec<Arc<Outlet>>,
}

/// A running node.
pub(super) struct RobotNode {
    identity: Arc<Identity>,
    slave: SlaveServer,
    stopping: Arc<AtomicBool>,
    accepting: Option<JoinHandle<()>>,
}

impl RobotNode {
    pub fn start(master: Endpoint, host: &str, name: String, outlets: Vec<Arc<Outlet>>) -> Result<Self, RosError> {
        let listener = listen(host)?;
        let port = listener.local_addr().map_err(|error| RosError::system("listen", &error))?.port();
        let identity = Arc::new(Identity { name, host: host.to_owned(), port, master, outlets });
        let stopping = Arc::new(AtomicBool::new(false));
        let slave = SlaveServer::start(host, Arc::clone(&identity) as _)?;
        let (seen, known) = (Arc::clone(&stopping), Arc::clone(&identity));
        let accepting = std::thread::Builder::new()
            .name("robot-port".into())
            .spawn(move || accept_all(&listener, &seen, &known))
            .map_err(|error| RosError::system("start a thread", &error))?;
        let node = Self { identity, slave, stopping, accepting: Some(accepting) };
        for outlet in &node.identity.outlets {
            node.tell_master("registerPublisher", &[outlet.topic(), outlet.type_name()])
                .map_err(|error| master_error(&node.identity.master, "registerPublisher", error))?;
        }
        Ok(node)
    }

    pub fn outlets(&self) -> impl Iterator<Item = &Arc<Outlet>> {
        self.identity.outlets.iter()
    }

    /// Unregisters, and sends what is queued.
    pub fn close(&self) {
        for outlet in &self.identity.outlets {
            // A master that is gone has forgotten the publisher as well.
            let _ = self.tell_master("unregisterPublisher", &[outlet.topic()]);
        }
        for outlet in &self.identity.outlets {
            outlet.close();
        }
    }

    fn tell_master(&self, method: &str, middle: &[&str]) -> Result<Value, CallError> {
        let texts = std::iter::once(self.identity.name.as_str()).chain(middle.iter().copied());
        let params: Vec<Value> = texts.chain([self.slave.uri.as_str()]).map(Value::text).collect();
        call(&self.identity.master, method, &params, Instant::now() + PATIENCE)
    }
}

impl Drop for RobotNode {
    fn drop(&mut self) {
        self.stopping.store(true, Ordering::SeqCst);
        // Accepting blocks: a connection of our own wakes it.
        let woken = TcpStream::connect((self.identity.host.as_str(), self.identity.port)).is_ok();
        if let Some(accepting) = self.accepting.take().filter(|_| woken) {
            let _ = accepting.join();
        }
        for outlet in &self.identity.outlets {
            outlet.close();
        }
    }
}

impl Node for Identity {
    fn master_uri(&self) -> String {
        self.master.to_string()
    }

    fn subscriptions(&self) -> Vec<(String, String)> {
        Vec::new()
    }

    fn publications(&self) -> Vec<(String, String)> {
        self.outlets.iter().map(|outlet| (outlet.topic().to_owned(), outlet.type_name().to_owned())).collect()
    }

    fn links(&self) -> Vec<BusLink> {
        self.outlets.iter().flat_map(|outlet| outlet.links()).collect()
    }

    fn publishers_changed(&self, _topic: &str, _publishers: &[&str]) {}

    fn outlet(&self, topic: &str) -> Option<(String, u16)> {
        self.outlets.iter().any(|outlet| outlet.topic() == topic).then(|| (self.host.clone(), self.port))
    }

    fn shutdown_asked(&self, _by: &str, _reason: &str) {}
}

fn accept_all(listener: &TcpListener, stopping: &AtomicBool, identity: &Arc<Identity>) {
    while !stopping.load(Ordering::SeqCst) {
        let Ok((stream, _)) = listener.accept() else {
            std::thread::sleep(Duration::from_millis(20));
            continue;
        };
        if stopping.load(Ordering::SeqCst) || identity.links().len() >= MOST_SUBSCRIBERS {
            continue;
        }
        let identity = Arc::clone(identity);
        // Without a thread, or with a broken handshake, the subscriber sees its connection closed.
        let _ = std::thread::Builder::new().name("robot-handshake".into()).spawn(move || welcome(&identity, stream));
    }
}

/// Shakes hands with a subscriber and hands it to its outlet.
fn welcome(identity: &Identity, stream: TcpStream) -> io::Result<()> {
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.set_write_timeout(Some(PATIENCE))?;
    let mut frames = FrameReader::new(&stream);
    let Poll::Frame(request) = frames.poll(LONGEST_REQUEST)? else { return Ok(()) };
    let request = ConnectionHeader::parse(&request).map_err(io::Error::other)?;
    let refuse = |reason: &str| (&stream).write_all(&ConnectionHeader::new([("error", reason)]).to_bytes());
    let topic = request.get("topic").unwrap_or_default();
    let Some(outlet) = identity.outlets.iter().find(|outlet| outlet.topic() == topic) else {
        return refuse("this topic is not published here");
    };
    if let Some(objection) = outlet.objection(&request) {
        return refuse(&objection);
    }
    (&stream).write_all(&outlet.header(&identity.name).to_bytes())?;
    stream.set_write_timeout(None)?;
    outlet.add(clean(request.get("callerid").unwrap_or("unnamed"), 120), stream)
}
