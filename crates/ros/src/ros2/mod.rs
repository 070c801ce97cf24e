//! ROS 2: a program without keys reads the topics; it is started, supervised and restarted here, and trusted no more
//! than a peer. Lost messages are counted here by the publisher's own numbers, so that a restart does not end the
//! count.

mod identity;
mod publisher;
mod state;

use std::collections::{BTreeMap, VecDeque};
use std::io::{BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use state::{Outcome, State};

use crate::child::{self, Errand, Restarts, Run, Silence, TICK};
use crate::model::{TopicName, counted};
use crate::pipe::read::{Told, Wish};
use crate::pipe::{LONGEST_PAYLOAD, receive, send};
use crate::{CaptureNotice, MessageSink, Result, RosError, lock, pipe::write::Order};

pub use crate::pipe::LONGEST_PAYLOAD as LONGEST_MESSAGE;
pub use crate::pipe::read::{Counts, Quality};
pub use crate::pipe::write::{Offer, Topic as Offered};
pub use crate::ros::child::Declined;
pub use publisher::{QUALITY, WRITER};

const PROGRAM: &str = "authros-ros2";

fn errand(program: &Path, domain: u16, publishes: bool) -> Errand {
    let arguments = ["--domain".to_owned(), domain.to_string()];
    let arguments = arguments.into_iter().chain(publishes.then(|| "--publish".to_owned())).collect();
    // Returns rustdds's freed receive buffers to the system (decision 026).
    let environment = vec![("MALLOC_MMAP_THRESHOLD_", (128 << 10).to_string())];
    Errand { program: program.to_owned(), arguments, environment }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Ros2Topic {
    pub name: String,
    pub type_name: String,
    pub type_hash: Option<String>,
    /// What every publisher of it offers.
    pub quality: Quality,
    /// Clean the names before they are shown.
    pub publishers: Vec<String>,
}

impl Ros2Topic {
    /// In two words.
    pub fn quality_text(&self) -> String {
        let reliability = if self.quality.reliable { "reliable" } else { "best_effort" };
        let durability = if self.quality.latched { "transient_local" } else { "volatile" };
        format!("{reliability} {durability}")
    }
}

pub struct Ros2Capture {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
}

impl Ros2Capture {
    pub fn start(domain: u16, program: Option<&Path>, sink: Arc<dyn MessageSink>) -> Result<Self> {
        let program = child::find(PROGRAM, program).map_err(RosError::NoReader)?;
        let shared = Arc::new(Shared {
            domain,
            program,
            sink,
            state: Mutex::new(State::new(domain)),
            to_child: Mutex::default(),
            running: Mutex::default(),
            frames: AtomicU64::new(0),
            stopping: AtomicBool::new(false),
        });
        let mut capture = Self { shared, threads: Vec::new() };
        capture.keep("ros2", Shared::supervise)?;
        capture.keep("ros2 watch", Shared::watch_over)?;
        Ok(capture)
    }

    fn keep(&mut self, name: &str, work: fn(&Shared)) -> Result<()> {
        let shared = Arc::clone(&self.shared);
        let started = std::thread::Builder::new().name(name.to_owned()).spawn(move || work(&shared));
        self.threads.push(started.map_err(|error| RosError::system("start a thread for ROS 2", &error))?);
        Ok(())
    }

    pub fn watch(&self, topic: &TopicName) {
        let mut outcome = Outcome::default();
        if self.shared.state().watch(topic, &mut outcome) {
            self.shared.wish(&Wish::Watch { topic: topic.to_string() });
            self.shared.hand_on(outcome);
        }
    }

    pub fn unwatch(&self, topic: &TopicName) {
        let mut outcome = Outcome::default();
        if self.shared.state().unwatch(topic, Instant::now(), &mut outcome) {
            self.shared.hand_on(outcome);
            self.shared.wish(&Wish::Unwatch { topic: topic.to_string() });
        }
    }

    pub fn settle(&self, topic: Option<&str>) {
        let mut outcome = Outcome::default();
        self.shared.state().settle(Instant::now(), |name| topic.is_none_or(|topic| topic == name), &mut outcome);
        self.shared.hand_on(outcome);
    }

    pub fn watched(&self) -> Vec<TopicName> {
        self.shared.state().watched.iter().cloned().collect()
    }

    pub fn topics(&self) -> Vec<Ros2Topic> {
        self.shared.state().topics()
    }

    pub fn standing(&self) -> Standing {
        let state = self.shared.state();
        Standing {
            domain: self.shared.domain,
            reading: state.reading.clone(),
            counts: state.counts,
            restarts: state.restarts,
            confined: state.confined,
        }
    }
}

impl Drop for Ros2Capture {
    fn drop(&mut self) {
        self.settle(None);
        // The end of its pipe tells the program to leave.
        self.shared.stopping.store(true, Ordering::Release);
        lock(&self.shared.to_child).take();
        for thread in self.threads.drain(..) {
            drop(thread.join());
        }
    }
}

#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum Reading {
    /// Started, without a report or time for discovery yet.
    #[default]
    Looking,
    /// It reads.
    Up,
    /// It is being restarted.
    Down { reason: String },
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Standing {
    pub domain: u16,
    pub reading: Reading,
    pub counts: Counts,
    pub restarts: u64,
    /// Whether the program can open no file and no local socket; `None` before it says so.
    pub confined: Option<bool>,
}

/// Robots that cannot be seen from here, and the remedy.
pub const INVISIBLE: &str = "not visible from here: robots with another ROS_DOMAIN_ID, on another network, or using \
                             Fast DDS over shared memory only or with LARGE_DATA (FASTDDS_BUILTIN_TRANSPORTS), a \
                             Discovery Server, SROS2 or rmw_zenoh (`authros bag follow DIR` seals what they record)";

/// Why a participant may show no topics.
const HIDDEN: &str = "they are hidden by Fast DDS with FASTDDS_BUILTIN_TRANSPORTS=LARGE_DATA (unset it, or set UDPv4) \
                      and by SROS2; `authros bag follow DIR` seals what such a robot records";

impl Standing {
    pub fn text(&self) -> String {
        let Counts { participants, writers, foreign } = self.counts;
        let place = format!("ROS 2 domain {}", self.domain);
        let some = |number: u32, what: &str| counted(u64::from(number), what);
        let there = some(participants, "participant");
        match &self.reading {
            Reading::Down { reason } => format!("{place} cannot be read: {reason}"),
            Reading::Looking if participants == 0 => format!("{place}: discovering"),
            _ if participants == 0 => format!("{place}: no participants; {INVISIBLE}"),
            _ if writers == 0 && foreign > 0 => {
                format!("{place}: {there} and {} with non-ROS names, but no ROS 2 topics", some(foreign, "publisher"))
            }
            _ if writers == 0 => format!("{place}: {there}, but no topics; {HIDDEN}"),
            _ => format!("{place}: {there}, {} of ROS 2 topics", some(writers, "publisher")),
        }
    }

    /// Whether there is still no topic after discovery.
    pub fn is_empty(&self) -> bool {
        self.reading == Reading::Up && self.counts.writers == 0
    }
}

struct Shared {
    domain: u16,
    program: PathBuf,
    sink: Arc<dyn MessageSink>,
    state: Mutex<State>,
    to_child: Mutex<Option<ChildStdin>>,
    running: Mutex<Option<Child>>,
    frames: AtomicU64,
    stopping: AtomicBool,
}

impl Shared {
    fn state(&self) -> MutexGuard<'_, State> {
        lock(&self.state)
    }

    fn hand_on(&self, outcome: Outcome) {
        if self.is_stopping() {
            return;
        }
        outcome.wishes.iter().for_each(|wish| self.wish(wish));
        outcome.notices.into_iter().for_each(|notice| self.sink.notice(notice));
        outcome.messages.into_iter().for_each(|message| self.sink.accept(message));
        outcome.definitions.into_iter().for_each(|message| self.sink.define(message));
    }

    /// A program that misses it is restarted, and told then.
    fn wish(&self, wish: &Wish) {
        if let Some(to) = lock(&self.to_child).as_mut() {
            drop(send(to, wish, &[]).map(|()| to.flush()));
        }
    }

    fn is_stopping(&self) -> bool {
        self.stopping.load(Ordering::Acquire)
    }

    fn wait(&self, pause: Duration) {
        let begun = Instant::now();
        while begun.elapsed() < pause && !self.is_stopping() {
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// One run of the program; returns why it ended.
    fn run_once(&self) -> String {
        let (child, to, from) = match child::start(&errand(&self.program, self.domain, false)) {
            Ok(started) => started,
            Err(error) => return error.to_string(),
        };
        *lock(&self.running) = Some(child);
        *lock(&self.to_child) = Some(to);
        if self.is_stopping() {
            lock(&self.to_child).take();
        }
        // A later `watch` sends its topic itself; sending it twice does no harm.
        let watched: Vec<TopicName> = self.state().watched.iter().cloned().collect();
        watched.iter().for_each(|topic| self.wish(&Wish::Watch { topic: topic.to_string() }));
        let reason = self.read(&mut BufReader::with_capacity(256 << 10, from));
        lock(&self.to_child).take();
        // Not under the lock, which is needed to kill a silent program.
        let child = lock(&self.running).take();
        if let Some(mut child) = child {
            let has_left = if self.is_stopping() {
                child::end(&mut child)
            } else {
                drop(child.kill());
                child.wait().is_ok_and(|status| status.success())
            };
            let participants = std::mem::take(&mut self.state().participants);
            participants.into_iter().filter(|_| !has_left).for_each(|participant| participant.bury(&self.program));
        }
        reason
    }

    fn read(&self, from: &mut impl Read) -> String {
        loop {
            match receive::<Told>(from) {
                Ok(Some((told, payload))) => {
                    self.frames.fetch_add(1, Ordering::AcqRel);
                    let outcome = self.state().take(told, payload, Instant::now());
                    match outcome {
                        Ok(outcome) => self.hand_on(outcome),
                        Err(reason) => return reason,
                    }
                }
                Ok(None) => return "the program that reads it ended".to_owned(),
                Err(error) => return error.to_string(),
            }
        }
    }

    fn supervise(&self) {
        let mut restarts = Restarts::begin();
        while !self.is_stopping() {
            let reason = self.run_once();
            if self.is_stopping() {
                return;
            }
            let mut state = self.state();
            state.restarts += 1;
            let former = std::mem::replace(&mut state.reading, Reading::Down { reason: reason.clone() });
            drop(state);
            if !matches!(former, Reading::Down { .. }) {
                self.hand_on(Outcome { notices: vec![CaptureNotice::ReadingBroken { reason }], ..Outcome::default() });
            }
            self.wait(restarts.left());
            restarts.again();
        }
    }

    fn watch_over(&self) {
        let mut silence = Silence::default();
        while !self.is_stopping() {
            self.wait(TICK);
            if silence.is_too_long(self.frames.load(Ordering::Acquire)) {
                child::kill(&self.running);
            }
        }
        // The end of its pipe tells it to leave. One that stays and talks would hold up the caller that stops it.
        let begun = Instant::now();
        while begun.elapsed() < child::LEAVING && lock(&self.running).is_some() {
            std::thread::sleep(Duration::from_millis(20));
        }
        child::kill(&self.running);
    }
}

/// Bytes of latched messages kept for a restart.
const MOST_LATCHED: usize = 128 << 20;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Delivery {
    /// Messages that a subscriber missed, or did not acknowledge.
    pub missed: u64,
    /// Messages that nobody is known to have: some subscribers do not acknowledge, or no longer could.
    pub unconfirmed: u64,
}

struct Announced {
    topic: Offered,
    size: u32,
    /// The last messages, if it is latched.
    latched: VecDeque<Arc<[u8]>>,
}

pub struct Ros2Publisher {
    domain: u16,
    run: Run,
    announced: BTreeMap<u32, Announced>,
    next: u32,
    latched_bytes: usize,
    /// Deliveries of earlier runs of the program.
    earlier: Delivery,
}

impl Ros2Publisher {
    pub fn start(domain: u16, program: Option<&Path>) -> Result<Self> {
        let program = child::find(PROGRAM, program).map_err(RosError::NoReader)?;
        let run = Run::start(&errand(&program, domain, true), domain)?;
        let (announced, earlier) = (BTreeMap::new(), Delivery::default());
        let publisher = Self { domain, run, announced, next: 1, latched_bytes: 0, earlier };
        publisher.run.joined().map_err(|reason| publisher.failed(&reason))?;
        Ok(publisher)
    }

    fn failed(&self, reason: &str) -> RosError {
        RosError::NotPublished { domain: self.domain, reason: reason.to_owned() }
    }

    pub fn is_confined(&self) -> bool {
        self.run.state().confined
    }

    pub fn domain(&self) -> u16 {
        self.domain
    }

    /// Waits for known subscribers if `patient`. Refused if it is no ROS 2 topic, or if another node publishes it and
    /// it must be `alone`. `size` is that of its first message.
    pub fn advertise(
        &mut self,
        topic: &Offered,
        size: usize,
        (alone, patient): (bool, bool),
    ) -> Result<Result<u32, Declined>> {
        let writer = self.next;
        self.next = self.next.wrapping_add(1);
        let size = u32::try_from(size).unwrap_or(u32::MAX);
        let order = Order::Advertise { writer, topic: topic.clone(), size, alone, patient };
        let answer = self.run.announce(writer, &order, &[]).map_err(|reason| self.failed(&reason))?;
        if answer.is_ok() {
            self.announced.insert(writer, Announced { topic: topic.clone(), size, latched: VecDeque::new() });
        }
        Ok(answer.map(|()| writer))
    }

    /// `message` has its encapsulation header; false if the topic is not announced or nobody publishes now.
    pub fn publish(&mut self, writer: u32, message: &[u8]) -> bool {
        if self.revive().is_err() {
            return false;
        }
        let Some(announced) = self.announced.get_mut(&writer) else { return false };
        if message.len() > LONGEST_PAYLOAD as usize {
            return false;
        }
        if announced.topic.offer.latched && message.len() <= MOST_LATCHED {
            self.latched_bytes += message.len();
            announced.latched.push_back(message.into());
            while announced.latched.len() > announced.topic.offer.depth.max(1) as usize
                || self.latched_bytes > MOST_LATCHED && !announced.latched.is_empty()
            {
                self.latched_bytes -= announced.latched.pop_front().map_or(0, |oldest| oldest.len());
            }
        }
        self.run.publish(writer, message)
    }

    /// Drops the topic with its queue.
    pub fn withdraw(&mut self, writer: u32) {
        if let Some(announced) = self.announced.remove(&writer) {
            self.latched_bytes -= announced.latched.iter().map(|message| message.len()).sum::<usize>();
            // A program that cannot be told has ended, or is killed, and announces none of this again.
            drop(self.order(&Order::Withdraw { writer }, &[]));
        }
    }

    /// Whether more messages should wait for subscribers or for the program.
    pub fn is_crowded(&self) -> bool {
        self.run.is_crowded()
    }

    /// Stops waiting for subscribers that are behind.
    pub fn outrun(&self) {
        drop(self.order(&Order::Outrun, &[]));
    }

    /// Replaces the program if it has ended, with all topics and latched messages.
    pub fn revive(&mut self) -> Result<()> {
        let next = self.run.successor().map_err(|reason| self.failed(&reason))?;
        let Some(next) = next else { return Ok(()) };
        self.earlier = self.delivery();
        self.run = next;
        // It is replaced only if it has ended.
        self.announce_again().inspect_err(|_| self.run.kill())
    }

    fn announce_again(&self) -> Result<()> {
        for (writer, announced) in &self.announced {
            let (writer, topic, size) = (*writer, announced.topic.clone(), announced.size);
            // Its former run may still look like another node.
            self.order(&Order::Advertise { writer, topic, size, alone: false, patient: false }, &[])?;
            for message in &announced.latched {
                self.run.publish(writer, message);
            }
        }
        Ok(())
    }

    /// No more messages come; queued ones are still sent.
    pub fn leave(&self) {
        drop(self.order(&Order::Leave, &[]));
    }

    /// Whether subscribers have everything, after [`Self::leave`], or the program has ended.
    pub fn is_sent(&self) -> bool {
        self.run.is_sent()
    }

    fn delivery(&self) -> Delivery {
        let (Delivery { missed, unconfirmed }, state) = (self.earlier, self.run.state());
        Delivery { missed: missed + state.missed(), unconfirmed: unconfirmed + state.best_effort }
    }

    /// Queued and unacknowledged messages were missed; if a right to them has ended, nobody knows.
    pub fn end(self, by_right: bool) -> Delivery {
        let delivery = self.delivery();
        if self.run.broken().is_some() {
            return delivery;
        }
        let (Delivery { missed, unconfirmed }, state) = (delivery, self.run.state());
        let open = state.unacknowledged + state.unconfirmed().0 as u64;
        match by_right {
            true => Delivery { missed, unconfirmed: unconfirmed + open },
            false => Delivery { missed: missed + open, unconfirmed },
        }
    }

    fn order(&self, order: &Order, payload: &[u8]) -> Result<()> {
        self.run.order(order, payload).map_err(|reason| self.failed(&reason))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nobody_no_topics_and_other_names_are_told_apart() {
        let text = |participants, writers, foreign| {
            let counts = Counts { participants, writers, foreign };
            Standing { domain: 3, reading: Reading::Up, counts, restarts: 0, confined: None }.text()
        };
        for hidden in ["LARGE_DATA", "shared memory", "Discovery Server", "SROS2", "ROS_DOMAIN_ID"] {
            assert!(text(0, 0, 0).contains(hidden), "{hidden}");
        }
        assert!(text(0, 0, 0).starts_with("ROS 2 domain 3: no participants"));
        assert!(text(2, 0, 0).contains("2 participants, but no topics"));
        let hidden = text(1, 0, 0);
        assert!(hidden.contains("1 participant, but no topics") && hidden.contains("LARGE_DATA"), "{hidden}");
        assert!(text(2, 0, 1).contains("non-ROS names"));
        assert!(text(2, 5, 1).contains("5 publishers of ROS 2 topics"));
    }
}

#[cfg(test)]
mod publishing_tests;
