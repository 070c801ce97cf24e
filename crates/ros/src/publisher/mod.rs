//! Nodes that serve topics over TCPROS: our own in this process, or rosrust in a program without keys, restarted when
//! it ends. The program gets a bounded number of messages before it confirms some; what it held when it ended counts as
//! missed.

mod outlet;

use std::io::{self, Write as _};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock};
use std::time::{Duration, Instant};
use std::{collections::BTreeMap, net::TcpStream, path::Path, thread::JoinHandle};

use outlet::Outlet;

use crate::child::{self, Declined, Errand, Run};
use crate::pipe::write::{Described, Order};
use crate::tcpros::{BusLink, ConnectionHeader, FrameReader, Node, Poll, SlaveServer, listen};
use crate::tcpros::{Endpoint, own_host};
use crate::xmlrpc::{CallError, Server, Value, call};
use crate::{Result, RosError, graph::master_error, lock, model::clean, pipe::LONGEST_PAYLOAD};

/// Limit of the master's answers, and of resolving names.
const PATIENCE: Duration = Duration::from_secs(2);

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Advertised {
    pub topic: String,
    /// `package/Type`
    pub type_name: String,
    /// 32 hex characters.
    pub md5sum: String,
    pub definition: String,
    /// Whether later subscribers get the last message of each source.
    pub latching: bool,
}

/// Leaves the graph when dropped.
pub trait GraphPublisher: Send + Sync {
    fn advertise(&mut self, topic: &Advertised, patience: Duration) -> Result<()>;

    /// A message of `source`; false if the topic is not announced, or nobody publishes now. May block where
    /// [`Self::may_block`].
    fn publish(&mut self, topic: &str, source: u64, body: &[u8]) -> bool;

    /// Whether the topic may have subscribers.
    fn is_heard(&self, _topic: &str) -> bool {
        true
    }

    /// Whether publishing may wait for a full pipe.
    fn may_block(&self) -> bool {
        false
    }

    /// Replaces a program that publishes, if it has ended.
    fn revive(&mut self) -> Result<()> {
        Ok(())
    }

    /// Whether a subscriber is so far behind that it soon loses messages.
    fn is_crowded(&self) -> bool;

    fn outrun(&self);

    fn come_back(&mut self) -> Result<()>;

    /// Drops the topics with their queues.
    fn cut(&mut self, topics: &[String]);

    /// Drops what came from a source, with the topic's queues; other sources go on publishing.
    fn silence(&mut self, topic: &str, source: u64);

    /// No more messages come; queued ones are still sent.
    fn leave(&self);

    /// Whether all queues are empty, after [`Self::leave`].
    fn is_sent(&self) -> bool;

    /// Messages that a subscriber missed because it read too slowly.
    fn missed(&self) -> u64;

    /// Ends without waiting. Returns all messages that a subscriber missed.
    fn end(self: Box<Self>) -> u64;
}

/// Bytes.
const LONGEST_REQUEST: usize = 64 << 10;

const MOST_SUBSCRIBERS: usize = 64;

const MOST_CONNECTIONS: usize = 1024;

struct Identity {
    name: String,
    host: String,
    /// Port that serves its topics, once it is open.
    port: OnceLock<u16>,
    master: Endpoint,
    outlets: Mutex<Vec<Arc<Outlet>>>,
    overflowed: AtomicU64,
    /// Threads that unregister topics at a master, perhaps a slow one.
    telling: Mutex<Vec<JoinHandle<()>>>,
    left: AtomicBool,
}

/// Unregisters and ends on drop, without sending its queues.
pub struct Publisher {
    identity: Arc<Identity>,
    slave: SlaveServer,
    _port: Server,
}

impl Publisher {
    pub fn start(master_uri: &str, given_host: Option<&str>, node_name: &str) -> Result<Self> {
        let master = Endpoint::of_master(master_uri)?;
        let host = own_host(given_host, &master, Instant::now() + PATIENCE)?;
        let listener = listen(&host)?;
        let identity = Arc::new(Identity {
            name: node_name.to_owned(),
            host,
            port: OnceLock::new(),
            master,
            outlets: Mutex::default(),
            overflowed: AtomicU64::new(0),
            telling: Mutex::default(),
            left: AtomicBool::new(false),
        });
        let known = Arc::clone(&identity);
        let port = Server::of("ros-port", listener, MOST_CONNECTIONS, move |stream| welcome(&known, stream))
            .map_err(|error| RosError::system("start a thread", &error))?;
        identity.port.get_or_init(|| port.port());
        let slave = SlaveServer::start(&identity.host, Arc::clone(&identity) as _)?;
        Ok(Self { identity, slave, _port: port })
    }

    /// Returns how many subscribers the master knows. A topic already announced is unchanged.
    pub fn advertise(&self, topic: &Advertised) -> Result<usize> {
        let outlet = self.identity.outlet_of(&topic.topic).unwrap_or_else(|| {
            let outlet = Arc::new(Outlet::new(topic.clone()));
            lock(&self.identity.outlets).push(Arc::clone(&outlet));
            outlet
        });
        self.register(&outlet)
    }

    fn register(&self, outlet: &Outlet) -> Result<usize> {
        let about = [outlet.about.topic.as_str(), outlet.about.type_name.as_str()];
        let deadline = Instant::now() + PATIENCE;
        let answer = self.identity.tell_master("registerPublisher", &about, &self.slave.uri, deadline);
        let answer = answer.map_err(|error| master_error(&self.identity.master, "registerPublisher", error))?;
        Ok(answer.as_array().map_or(0, <[Value]>::len))
    }

    /// A message of `source`; false if the topic is not announced.
    pub fn publish(&self, topic: &str, source: u64, body: &[u8]) -> bool {
        let outlet = self.identity.outlet_of(topic);
        outlet.as_ref().inspect(|outlet| outlet.publish(source, body)).is_some()
    }

    pub fn subscribers(&self, topic: &str) -> usize {
        self.identity.outlet_of(topic).map_or(0, |outlet| outlet.subscribers())
    }

    /// Unregisters, without waiting for a slow master.
    fn tell_gone(&self, outlets: &[Arc<Outlet>]) {
        let topics: Vec<String> = outlets.iter().map(|outlet| outlet.about.topic.clone()).collect();
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

impl GraphPublisher for Publisher {
    fn advertise(&mut self, topic: &Advertised, patience: Duration) -> Result<()> {
        let known = Self::advertise(self, topic)?;
        let begun = Instant::now();
        while self.subscribers(&topic.topic) < known && begun.elapsed() < patience {
            std::thread::sleep(Duration::from_millis(5));
        }
        Ok(())
    }

    fn publish(&mut self, topic: &str, source: u64, body: &[u8]) -> bool {
        Self::publish(self, topic, source, body)
    }

    fn is_heard(&self, topic: &str) -> bool {
        self.subscribers(topic) > 0
    }

    fn is_crowded(&self) -> bool {
        self.identity.outlets().iter().any(|outlet| outlet.is_crowded())
    }

    fn outrun(&self) {
        self.identity.outlets().iter().for_each(|outlet| outlet.outrun());
    }

    fn come_back(&mut self) -> Result<()> {
        self.identity.outlets().iter().try_for_each(|outlet| self.register(outlet).map(drop))
    }

    /// No subscriber gets any more of them, however late the master learns of it.
    fn cut(&mut self, topics: &[String]) {
        let is_meant = |outlet: &Arc<Outlet>| topics.contains(&outlet.about.topic);
        let gone: Vec<Arc<Outlet>> = self.identity.outlets().into_iter().filter(is_meant).collect();
        lock(&self.identity.outlets).retain(|outlet| !is_meant(outlet));
        for outlet in &gone {
            outlet.close(Duration::ZERO);
            self.identity.overflowed.fetch_add(outlet.overflowed(), Ordering::SeqCst);
        }
        self.tell_gone(&gone);
    }

    fn silence(&mut self, topic: &str, source: u64) {
        if let Some(outlet) = self.identity.outlet_of(topic) {
            outlet.silence(source);
        }
    }

    fn leave(&self) {
        if self.identity.left.swap(true, Ordering::SeqCst) {
            return;
        }
        let outlets = self.identity.outlets();
        outlets.iter().for_each(|outlet| outlet.leave());
        self.tell_gone(&outlets);
    }

    fn is_sent(&self) -> bool {
        self.identity.outlets().iter().all(|outlet| outlet.is_sent())
    }

    fn missed(&self) -> u64 {
        let now: u64 = self.identity.outlets().iter().map(|outlet| outlet.overflowed()).sum();
        now + self.identity.overflowed.load(Ordering::SeqCst)
    }

    fn end(self: Box<Self>) -> u64 {
        self.leave();
        self.identity.outlets().iter().for_each(|outlet| outlet.end(Instant::now()));
        self.finish_telling();
        self.missed()
    }
}

impl Drop for Publisher {
    fn drop(&mut self) {
        for outlet in self.identity.outlets() {
            outlet.close(Duration::ZERO);
        }
        self.finish_telling();
    }
}

impl Identity {
    fn outlets(&self) -> Vec<Arc<Outlet>> {
        lock(&self.outlets).clone()
    }

    fn outlet_of(&self, topic: &str) -> Option<Arc<Outlet>> {
        lock(&self.outlets).iter().find(|outlet| outlet.about.topic == topic).cloned()
    }

    fn tell_master(&self, method: &str, middle: &[&str], uri: &str, deadline: Instant) -> Result<Value, CallError> {
        let texts = std::iter::once(self.name.as_str()).chain(middle.iter().copied());
        let params: Vec<Value> = texts.chain([uri]).map(Value::from).collect();
        call(&self.master, method, &params, deadline)
    }
}

impl Node for Identity {
    fn master_uri(&self) -> String {
        self.master.to_string()
    }

    fn publications(&self) -> Vec<(String, String)> {
        let about = |outlet: &Arc<Outlet>| (outlet.about.topic.clone(), outlet.about.type_name.clone());
        self.outlets().iter().map(about).collect()
    }

    fn links(&self) -> Vec<BusLink> {
        self.outlets().iter().flat_map(|outlet| outlet.links()).collect()
    }

    fn outlet(&self, topic: &str) -> Option<(String, u16)> {
        self.outlet_of(topic).and(Some((self.host.clone(), *self.port.get()?)))
    }
}

fn welcome(identity: &Identity, stream: TcpStream) -> io::Result<()> {
    if identity.links().len() >= MOST_CONNECTIONS {
        return Ok(());
    }
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

const PROGRAM: &str = "authros-rosrust";

struct Announced {
    writer: u32,
    about: Advertised,
    /// The last message and its source, if the topic is latched.
    latched: Option<(u64, Arc<[u8]>)>,
}

pub struct RosrustPublisher {
    uri: String,
    run: Run,
    announced: BTreeMap<String, Announced>,
    next: u32,
    missed: u64,
}

impl RosrustPublisher {
    pub fn start(master_uri: &str, given_host: Option<&str>, node_name: &str, program: Option<&Path>) -> Result<Self> {
        let program = child::find(PROGRAM, program).map_err(RosError::NoRosrust)?;
        let master = Endpoint::of_master(master_uri)?;
        let host = own_host(given_host, &master, Instant::now() + PATIENCE)?;
        let uri = master.to_string();
        // rosrust itself puts the slash before a name.
        let arguments = vec!["--node".to_owned(), node_name.trim_start_matches('/').to_owned()];
        let environment = vec![("ROS_MASTER_URI", uri.clone()), ("ROS_HOSTNAME", host)];
        let errand = Errand { program, arguments, environment };
        let run = Run::start(&errand, 0)?;
        let publisher = Self { uri, run, announced: BTreeMap::new(), next: 1, missed: 0 };
        publisher.run.joined().map_err(|reason| publisher.failed(&reason))?;
        Ok(publisher)
    }

    fn failed(&self, reason: &str) -> RosError {
        RosError::NotPublishedByRosrust { uri: clean(&self.uri, 120), reason: reason.to_owned() }
    }

    fn announce(&mut self, topic: &Advertised, patient: bool) -> Result<u32> {
        let writer = self.next;
        self.next = self.next.wrapping_add(1);
        let about = Described {
            name: topic.topic.clone(),
            type_name: topic.type_name.clone(),
            md5sum: topic.md5sum.clone(),
            latched: topic.latching,
        };
        let order = Order::Advertise { writer, topic: about, size: 0, alone: false, patient };
        match self.run.announce(writer, &order, topic.definition.as_bytes()) {
            Ok(Ok(())) => Ok(writer),
            Ok(Err(Declined { reason, .. })) | Err(reason) => Err(self.failed(&reason)),
        }
    }

    fn tell_withdrawn(&self, writer: u32) {
        // A program that cannot be told has ended, or is killed, and announces none of this again.
        drop(self.run.order(&Order::<Described>::Withdraw { writer }, &[]));
    }

    /// Whether its program can open no file and no local socket.
    pub fn is_confined(&self) -> bool {
        self.run.state().confined
    }

    fn announce_again(&mut self) -> Result<()> {
        let topics: Vec<Advertised> = self.announced.values().map(|announced| announced.about.clone()).collect();
        for topic in topics {
            let writer = self.announce(&topic, false)?;
            let Some(announced) = self.announced.get_mut(&topic.topic) else { continue };
            announced.writer = writer;
            if let Some((_, message)) = &announced.latched {
                self.run.publish(writer, message);
            }
        }
        Ok(())
    }
}

impl GraphPublisher for RosrustPublisher {
    fn advertise(&mut self, topic: &Advertised, patience: Duration) -> Result<()> {
        if self.announced.contains_key(&topic.topic) {
            return Ok(());
        }
        let writer = self.announce(topic, !patience.is_zero())?;
        let announced = Announced { writer, about: topic.clone(), latched: None };
        self.announced.insert(topic.topic.clone(), announced);
        Ok(())
    }

    fn publish(&mut self, topic: &str, source: u64, message: &[u8]) -> bool {
        if self.revive().is_err() {
            return false;
        }
        let Some(announced) = self.announced.get_mut(topic) else { return false };
        if message.len() > LONGEST_PAYLOAD as usize {
            return false;
        }
        if announced.about.latching {
            announced.latched = Some((source, message.into()));
        }
        self.run.publish(announced.writer, message)
    }

    fn may_block(&self) -> bool {
        true
    }

    fn is_crowded(&self) -> bool {
        self.run.is_crowded()
    }

    fn outrun(&self) {
        drop(self.run.order(&Order::<Described>::Outrun, &[]));
    }

    fn come_back(&mut self) -> Result<()> {
        self.revive()
    }

    /// With all topics and latched messages.
    fn revive(&mut self) -> Result<()> {
        let next = self.run.successor().map_err(|reason| self.failed(&reason))?;
        let Some(next) = next else { return Ok(()) };
        self.missed = self.missed();
        self.run = next;
        // It is replaced only if it has ended.
        self.announce_again().inspect_err(|_| self.run.kill())
    }

    fn cut(&mut self, topics: &[String]) {
        for topic in topics {
            if let Some(announced) = self.announced.remove(topic) {
                self.tell_withdrawn(announced.writer);
            }
        }
    }

    fn silence(&mut self, topic: &str, source: u64) {
        let Some(announced) = self.announced.remove(topic) else { return };
        self.tell_withdrawn(announced.writer);
        let latched = announced.latched.filter(|(of, _)| *of != source);
        let writer = self.announce(&announced.about, false);
        if let (Ok(writer), Some((_, message))) = (&writer, &latched) {
            self.run.publish(*writer, message);
        }
        let writer = writer.unwrap_or_else(|_| {
            // The restarted program announces the topic again.
            self.run.kill();
            announced.writer
        });
        self.announced.insert(topic.to_owned(), Announced { writer, about: announced.about, latched });
    }

    fn leave(&self) {
        drop(self.run.order(&Order::<Described>::Leave, &[]));
    }

    fn is_sent(&self) -> bool {
        self.run.is_sent()
    }

    fn missed(&self) -> u64 {
        self.missed + self.run.state().missed()
    }

    /// Queued messages were missed too.
    fn end(self: Box<Self>) -> u64 {
        let queued = if self.run.broken().is_some() { 0 } else { self.run.state().unconfirmed().0 };
        self.missed() + queued as u64
    }
}

#[cfg(test)]
mod rosrust_tests;
#[cfg(test)]
mod tests;
