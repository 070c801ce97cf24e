//! A publishing ROS node: its registration at the master, its slave API, and the TCPROS port
//! where subscribers shake hands before they are handed to an outlet.

use std::io::{self, Write as _};
use std::net::{TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::PATIENCE;
use super::outlet::Outlet;
use super::subscriber::lock;
use crate::model::clean;
use crate::ros::RosError;
use crate::ros::address::Endpoint;
use crate::ros::graph::master_error;
use crate::ros::slave::{BusLink, Node, SlaveServer, listen};
use crate::ros::tcpros::{ConnectionHeader, FrameReader, Poll};
use crate::ros::xmlrpc::{CallError, Value, call};

/// The longest connection header of a subscriber, bytes.
const LONGEST_REQUEST: usize = 64 << 10;

/// The most subscribers of one topic.
const MOST_SUBSCRIBERS: usize = 64;

/// The most connections of one node.
const MOST_CONNECTIONS: usize = 1024;

/// The node's state as seen by the slave API and the TCPROS port.
struct Identity {
    name: String,
    host: String,
    port: u16,
    master: Endpoint,
    outlets: Mutex<Vec<Arc<Outlet>>>,
    /// Of withdrawn topics.
    overflowed: AtomicU64,
    /// Threads that tell a master, perhaps a slow one, what is no longer published.
    telling: Mutex<Vec<JoinHandle<()>>>,
    left: AtomicBool,
}

/// A running node.
pub(crate) struct PublisherNode {
    identity: Arc<Identity>,
    slave: SlaveServer,
    stopping: Arc<AtomicBool>,
    accepting: Option<JoinHandle<()>>,
}

impl PublisherNode {
    pub fn start(master: Endpoint, host: &str, name: String, outlets: Vec<Arc<Outlet>>) -> Result<Self, RosError> {
        let listener = listen(host)?;
        let port = listener.local_addr().map_err(|error| RosError::system("listen", &error))?.port();
        let (outlets, overflowed) = (Mutex::new(outlets), AtomicU64::new(0));
        let (telling, left, host_name) = (Mutex::default(), AtomicBool::new(false), host.to_owned());
        let identity = Identity { name, host: host_name, port, master, outlets, overflowed, telling, left };
        let identity = Arc::new(identity);
        let stopping = Arc::new(AtomicBool::new(false));
        let slave = SlaveServer::start(host, Arc::clone(&identity) as _)?;
        let (seen, known) = (Arc::clone(&stopping), Arc::clone(&identity));
        let accepting = std::thread::Builder::new()
            .name("ros-port".into())
            .spawn(move || accept_all(&listener, &seen, &known))
            .map_err(|error| RosError::system("start a thread", &error))?;
        let node = Self { identity, slave, stopping, accepting: Some(accepting) };
        node.register_all()?;
        Ok(node)
    }

    pub fn outlets(&self) -> Vec<Arc<Outlet>> {
        self.identity.outlets()
    }

    pub fn outlet_of(&self, topic: &str) -> Option<Arc<Outlet>> {
        self.identity.outlet_of(topic)
    }

    /// Registers another topic; returns how many subscribers the master knows.
    pub fn advertise(&self, outlet: Arc<Outlet>) -> Result<usize, RosError> {
        let known = self.outlet_of(outlet.topic());
        let outlet = known.unwrap_or_else(|| {
            lock(&self.identity.outlets).push(Arc::clone(&outlet));
            outlet
        });
        self.register(&outlet)
    }

    /// Registers all topics (again).
    pub fn register_all(&self) -> Result<(), RosError> {
        self.outlets().iter().try_for_each(|outlet| self.register(outlet).map(drop))
    }

    fn register(&self, outlet: &Outlet) -> Result<usize, RosError> {
        let about = [outlet.topic(), outlet.type_name()];
        let deadline = Instant::now() + PATIENCE;
        let answer = self.identity.tell_master("registerPublisher", &about, &self.slave.uri, deadline);
        let answer = answer.map_err(|error| master_error(&self.identity.master, "registerPublisher", error))?;
        Ok(answer.as_array().map_or(0, <[Value]>::len))
    }

    /// Total messages that subscribers missed.
    pub fn overflowed(&self) -> u64 {
        let now: u64 = self.outlets().iter().map(|outlet| outlet.overflowed()).sum();
        now + self.identity.overflowed.load(Ordering::SeqCst)
    }

    /// Withdraws topics: no subscriber gets any more of them, however late the master hears of it.
    pub fn withdraw(&self, topics: &[String]) {
        let is_meant = |outlet: &Arc<Outlet>| topics.iter().any(|topic| topic == outlet.topic());
        let gone: Vec<Arc<Outlet>> = self.outlets().into_iter().filter(is_meant).collect();
        lock(&self.identity.outlets).retain(|outlet| !is_meant(outlet));
        for outlet in &gone {
            outlet.close(Duration::ZERO);
            self.identity.overflowed.fetch_add(outlet.overflowed(), Ordering::SeqCst);
        }
        self.tell_gone(&gone);
    }

    /// No more messages come; subscribers get what is queued.
    pub fn leave(&self) {
        if self.identity.left.swap(true, Ordering::SeqCst) {
            return;
        }
        let outlets = self.outlets();
        outlets.iter().for_each(|outlet| outlet.leave());
        self.tell_gone(&outlets);
    }

    /// Whether the queues are empty.
    pub fn is_sent(&self) -> bool {
        self.outlets().iter().all(|outlet| outlet.is_sent())
    }

    /// Unregisters, and sends what is queued, with one deadline for all.
    pub fn close(&self, patience: Duration) {
        self.leave();
        let deadline = Instant::now() + patience;
        while Instant::now() < deadline && !self.is_sent() {
            std::thread::sleep(Duration::from_millis(5));
        }
        self.outlets().iter().for_each(|outlet| outlet.end(deadline));
        self.finish_telling();
    }

    /// Unregisters, without waiting for a slow master.
    fn tell_gone(&self, outlets: &[Arc<Outlet>]) {
        let topics: Vec<String> = outlets.iter().map(|outlet| outlet.topic().to_owned()).collect();
        let (identity, uri) = (Arc::clone(&self.identity), self.slave.uri.clone());
        let deadline = Instant::now() + PATIENCE;
        let told = std::thread::Builder::new().name("ros-leaving".into()).spawn(move || {
            for topic in topics {
                let is_open = identity.outlet_of(&topic).is_some() && !identity.left.load(Ordering::SeqCst);
                if !is_open {
                    // A master that is gone has forgotten the publisher too.
                    let _ = identity.tell_master("unregisterPublisher", &[&topic], &uri, deadline);
                }
            }
        });
        // Without a thread the master notices the node's end through its slave API.
        lock(&self.identity.telling).extend(told.ok());
    }

    fn finish_telling(&self) {
        let telling = std::mem::take(&mut *lock(&self.identity.telling));
        for told in telling {
            let _ = told.join();
        }
    }
}

impl Drop for PublisherNode {
    fn drop(&mut self) {
        for outlet in self.outlets() {
            outlet.close(Duration::ZERO);
        }
        self.stopping.store(true, Ordering::SeqCst);
        // Accepting blocks: connecting to ourselves wakes it.
        let woken = TcpStream::connect((self.identity.host.as_str(), self.identity.port)).is_ok();
        if let Some(accepting) = self.accepting.take().filter(|_| woken) {
            let _ = accepting.join();
        }
        self.finish_telling();
    }
}

impl Identity {
    fn outlets(&self) -> Vec<Arc<Outlet>> {
        lock(&self.outlets).clone()
    }

    fn outlet_of(&self, topic: &str) -> Option<Arc<Outlet>> {
        lock(&self.outlets).iter().find(|outlet| outlet.topic() == topic).cloned()
    }

    fn tell_master(&self, method: &str, middle: &[&str], uri: &str, deadline: Instant) -> Result<Value, CallError> {
        let texts = std::iter::once(self.name.as_str()).chain(middle.iter().copied());
        let params: Vec<Value> = texts.chain([uri]).map(Value::text).collect();
        call(&self.master, method, &params, deadline)
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
        self.outlets().iter().map(|outlet| (outlet.topic().to_owned(), outlet.type_name().to_owned())).collect()
    }

    fn links(&self) -> Vec<BusLink> {
        self.outlets().iter().flat_map(|outlet| outlet.links()).collect()
    }

    fn publishers_changed(&self, _topic: &str, _publishers: &[&str]) {}

    fn outlet(&self, topic: &str) -> Option<(String, u16)> {
        self.outlet_of(topic).map(|_| (self.host.clone(), self.port))
    }

    fn shutdown_asked(&self, _by: &str, _reason: &str) {}
}

fn accept_all(listener: &TcpListener, stopping: &AtomicBool, identity: &Arc<Identity>) {
    while !stopping.load(Ordering::SeqCst) {
        let Ok((stream, _)) = listener.accept() else {
            std::thread::sleep(Duration::from_millis(20));
            continue;
        };
        if stopping.load(Ordering::SeqCst) || identity.links().len() >= MOST_CONNECTIONS {
            continue;
        }
        let identity = Arc::clone(identity);
        // Without a thread, or with a broken handshake, the subscriber's connection is closed.
        let _ = std::thread::Builder::new().name("ros-handshake".into()).spawn(move || welcome(&identity, stream));
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
    let Some(outlet) = identity.outlet_of(topic) else {
        return refuse("this topic is not published here");
    };
    if outlet.subscribers() >= MOST_SUBSCRIBERS {
        return refuse("this topic has too many subscribers");
    }
    if let Some(objection) = outlet.objection(&request) {
        return refuse(&objection);
    }
    (&stream).write_all(&outlet.header(&identity.name).to_bytes())?;
    stream.set_write_timeout(None)?;
    outlet.add(clean(request.get("callerid").unwrap_or("unnamed"), 120), stream)
}
