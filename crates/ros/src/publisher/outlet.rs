//! One published topic and its subscribers, each with a bounded queue and its own writer thread, so that a slow one
//! delays nobody; messages beyond its queue are dropped and counted.

use std::net::{Shutdown, TcpStream};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};
use std::{collections::VecDeque, io::Write as _};

use super::Advertised;
use crate::lock;
use crate::tcpros::{BusLink, ConnectionHeader};

/// Sources whose last message a latching topic keeps.
const MOST_LATCHED: usize = 64;

pub(crate) struct Outlet {
    pub about: Advertised,
    overflowed: AtomicU64,
    audience: Mutex<Audience>,
}

#[derive(Default)]
struct Audience {
    subscribers: Vec<Arc<Subscriber>>,
    /// The last message of each source, if the topic is latching; the newest last.
    latched: Vec<(u64, Frame)>,
    /// A subscriber still shaking hands is too late.
    closed: bool,
}

impl Outlet {
    pub fn new(about: Advertised) -> Self {
        Self { about, overflowed: AtomicU64::new(0), audience: Mutex::default() }
    }

    pub fn overflowed(&self) -> u64 {
        self.overflowed.load(Ordering::SeqCst)
    }

    pub fn subscribers(&self) -> usize {
        lock(&self.audience).subscribers.len()
    }

    pub fn is_crowded(&self) -> bool {
        lock(&self.audience).subscribers.iter().any(|subscriber| subscriber.is_crowded())
    }

    pub fn outrun(&self) {
        lock(&self.audience).subscribers.iter().for_each(|subscriber| subscriber.outrun());
    }

    /// A latching topic keeps the last message of each source.
    pub fn publish(&self, source: u64, body: &[u8]) {
        let Ok(length) = u32::try_from(body.len()) else { return };
        let frame = Arc::new([length.to_le_bytes().as_slice(), body].concat());
        let mut audience = lock(&self.audience);
        let Audience { subscribers, latched, .. } = &mut *audience;
        subscribers.retain(|subscriber| {
            let dropped = subscriber.push(&frame);
            self.overflowed.fetch_add(dropped.unwrap_or(0), Ordering::SeqCst);
            dropped.is_some()
        });
        if self.about.latching {
            latched.retain(|(other, _)| *other != source);
            if latched.len() >= MOST_LATCHED {
                latched.remove(0);
            }
            latched.push((source, frame));
        }
    }

    /// Why a subscriber's connection header does not match this topic.
    pub fn objection(&self, header: &ConnectionHeader) -> Option<String> {
        let Advertised { topic, type_name, md5sum, .. } = &self.about;
        let fits = |key: &str, ours: &str| header.get(key).is_none_or(|theirs| theirs == ours || theirs == "*");
        if !fits("md5sum", md5sum) {
            return Some(format!("the md5sum of {topic} is {md5sum}"));
        }
        (!fits("type", type_name)).then(|| format!("{topic} is of type {type_name}"))
    }

    pub fn header(&self, node_name: &str) -> ConnectionHeader {
        let Advertised { topic, type_name, md5sum, definition, latching } = &self.about;
        ConnectionHeader::new([
            ("callerid", node_name),
            ("topic", topic),
            ("type", type_name),
            ("md5sum", md5sum),
            ("message_definition", definition),
            ("latching", if *latching { "1" } else { "0" }),
        ])
    }

    /// After the handshake; latched messages come first.
    pub fn add(&self, name: String, stream: TcpStream) -> std::io::Result<()> {
        let subscriber = Arc::new(Subscriber { name, stream, queue: Mutex::default(), changed: Condvar::new() });
        let writer = Arc::clone(&subscriber);
        std::thread::Builder::new().name("ros-writer".into()).spawn(move || writer.write_all())?;
        let mut audience = lock(&self.audience);
        if audience.closed {
            subscriber.close();
            return Ok(());
        }
        for (_, frame) in &audience.latched {
            self.overflowed.fetch_add(subscriber.push(frame).unwrap_or(0), Ordering::SeqCst);
        }
        audience.subscribers.push(subscriber);
        Ok(())
    }

    /// Drops one source's latched message, and all queues.
    pub fn silence(&self, source: u64) {
        let mut audience = lock(&self.audience);
        audience.latched.retain(|(other, _)| *other != source);
        audience.subscribers.iter().for_each(|subscriber| subscriber.forget());
    }

    pub fn links(&self) -> Vec<BusLink> {
        let link = |subscriber: &Arc<Subscriber>| BusLink {
            peer: subscriber.name.clone(),
            outbound: true,
            topic: self.about.topic.clone(),
        };
        lock(&self.audience).subscribers.iter().map(link).collect()
    }

    /// No more messages and no more subscribers come; the queues run empty.
    pub fn leave(&self) {
        let mut audience = lock(&self.audience);
        audience.closed = true;
        audience.latched.clear();
        audience.subscribers.iter().for_each(|subscriber| subscriber.close());
    }

    pub fn is_sent(&self) -> bool {
        lock(&self.audience).subscribers.iter().all(|subscriber| lock(&subscriber.queue).done)
    }

    pub fn close(&self, patience: Duration) {
        let deadline = Instant::now() + patience;
        if patience.is_zero() {
            lock(&self.audience).subscribers.iter().for_each(|subscriber| subscriber.forget());
        }
        self.leave();
        self.end(deadline);
    }

    /// At the deadline, or when everything is sent; counts the rest.
    pub fn end(&self, deadline: Instant) {
        let subscribers = std::mem::take(&mut lock(&self.audience).subscribers);
        for subscriber in &subscribers {
            self.overflowed.fetch_add(subscriber.wait(deadline), Ordering::SeqCst);
        }
    }
}

/// Bytes; a single longer message is accepted nevertheless.
const LONGEST_QUEUE: usize = 32 << 20;

/// A message behind its length, shared by all subscribers.
pub(super) type Frame = Arc<Vec<u8>>;

pub(super) struct Subscriber {
    pub name: String,
    stream: TcpStream,
    queue: Mutex<Queue>,
    changed: Condvar,
}

#[derive(Default)]
struct Queue {
    frames: VecDeque<Frame>,
    bytes: usize,
    closing: bool,
    /// Everything is sent or never will be.
    done: bool,
    /// It was too slow; nobody waits for it until it has caught up.
    slow: bool,
}

impl Subscriber {
    /// How many older frames were dropped for this one; `None` if the subscriber is gone.
    pub fn push(&self, frame: &Frame) -> Option<u64> {
        let mut queue = lock(&self.queue);
        if queue.done || queue.closing {
            return None;
        }
        queue.bytes += frame.len();
        queue.frames.push_back(Arc::clone(frame));
        let mut dropped = 0;
        while queue.bytes > LONGEST_QUEUE && queue.frames.len() > 1 {
            let oldest = queue.frames.pop_front()?;
            queue.bytes -= oldest.len();
            dropped += 1;
        }
        self.changed.notify_all();
        Some(dropped)
    }

    pub fn is_crowded(&self) -> bool {
        let queue = lock(&self.queue);
        !queue.done && !queue.slow && queue.bytes > LONGEST_QUEUE / 2
    }

    pub fn outrun(&self) {
        let mut queue = lock(&self.queue);
        queue.slow |= queue.bytes > LONGEST_QUEUE / 2;
    }

    pub fn forget(&self) {
        let mut queue = lock(&self.queue);
        queue.frames.clear();
        queue.bytes = 0;
    }

    pub fn write_all(&self) {
        while let Some(frame) = self.next() {
            if (&self.stream).write_all(&frame).is_err() {
                break;
            }
        }
        // It may be closed already.
        let _ = self.stream.shutdown(Shutdown::Both);
        lock(&self.queue).done = true;
        self.changed.notify_all();
    }

    fn next(&self) -> Option<Frame> {
        let idle = |queue: &mut Queue| queue.frames.is_empty() && !queue.closing;
        let mut queue = self.changed.wait_while(lock(&self.queue), idle).unwrap_or_else(PoisonError::into_inner);
        let frame = queue.frames.pop_front()?;
        queue.bytes -= frame.len();
        queue.slow &= queue.bytes > LONGEST_QUEUE / 4;
        Some(frame)
    }

    pub fn close(&self) {
        lock(&self.queue).closing = true;
        self.changed.notify_all();
    }

    /// How many messages were not sent by `deadline`.
    pub fn wait(&self, deadline: Instant) -> u64 {
        let patience = deadline.saturating_duration_since(Instant::now());
        let waited = self.changed.wait_timeout_while(lock(&self.queue), patience, |queue| !queue.done);
        let (queue, waited) = waited.unwrap_or_else(PoisonError::into_inner);
        if waited.timed_out() {
            // Wakes the writer from a write that a hung subscriber never accepts.
            let _ = self.stream.shutdown(Shutdown::Both);
            return queue.frames.len() as u64;
        }
        0
    }
}

#[cfg(test)]
mod tests {
    use super::LONGEST_QUEUE;
    use super::*;
    use std::io::Read as _;
    use std::net::TcpListener;

    const PATIENCE: Duration = Duration::from_secs(1);

    fn outlet(latching: bool) -> Outlet {
        Outlet::new(Advertised {
            topic: "/t".into(),
            type_name: "nav_msgs/Odometry".into(),
            md5sum: "cd5e73d190d741a2f92e81eda573aca7".into(),
            definition: "uint32 n".into(),
            latching,
        })
    }

    fn connection() -> (TcpStream, TcpStream) {
        let listener = TcpListener::bind("127.0.0.1:0").expect("bind");
        let near = TcpStream::connect(listener.local_addr().expect("address")).expect("connect");
        (near, listener.accept().expect("accept").0)
    }

    fn frames(numbers: impl IntoIterator<Item = u32>) -> Vec<u8> {
        numbers.into_iter().flat_map(|n| [4u32.to_le_bytes(), n.to_le_bytes()].concat()).collect()
    }

    #[test]
    fn only_fitting_subscribers_are_welcome() {
        let outlet = outlet(false);
        let objection =
            |md5sum, type_name| outlet.objection(&ConnectionHeader::new([("md5sum", md5sum), ("type", type_name)]));
        assert_eq!(objection("*", "*"), None);
        assert_eq!(objection("cd5e73d190d741a2f92e81eda573aca7", "nav_msgs/Odometry"), None);
        assert!(objection("00000000000000000000000000000000", "nav_msgs/Odometry").is_some());
        assert!(objection("*", "sensor_msgs/Imu").is_some());
    }

    #[test]
    fn what_is_queued_is_sent_before_the_end() {
        let outlet = outlet(false);
        let (mut near, far) = connection();
        outlet.add("/s".into(), far).expect("add");
        for number in 0..1000u32 {
            outlet.publish(0, &number.to_le_bytes());
        }
        outlet.close(PATIENCE * 20);
        let mut bytes = Vec::new();
        near.read_to_end(&mut bytes).expect("read");
        assert_eq!(bytes, frames(0..1000));
        assert_eq!(outlet.overflowed(), 0);
    }

    #[test]
    fn a_late_subscriber_of_a_latching_topic_gets_the_last_message_of_each_source() {
        let (latching, plain) = (outlet(true), outlet(false));
        for outlet in [&latching, &plain] {
            [(7, 1u32), (9, 2), (7, 3)].iter().for_each(|(source, n)| outlet.publish(*source, &n.to_le_bytes()));
        }
        for (outlet, expected) in [(&latching, frames([2, 3])), (&plain, Vec::new())] {
            let (mut near, far) = connection();
            outlet.add("/late".into(), far).expect("add");
            outlet.close(PATIENCE * 20);
            let mut bytes = Vec::new();
            near.read_to_end(&mut bytes).expect("read");
            assert_eq!(bytes, expected);
        }
        assert_eq!(latching.header("/n").get("latching"), Some("1"));
    }

    #[test]
    fn a_source_that_is_silenced_is_not_latched_any_more() {
        let outlet = outlet(true);
        outlet.publish(7, &1u32.to_le_bytes());
        outlet.publish(9, &2u32.to_le_bytes());
        outlet.silence(7);
        let (mut near, far) = connection();
        outlet.add("/late".into(), far).expect("add");
        outlet.close(PATIENCE * 20);
        let mut bytes = Vec::new();
        near.read_to_end(&mut bytes).expect("read");
        assert_eq!(bytes, frames([2]));
    }

    #[test]
    fn a_subscriber_that_does_not_read_holds_up_nobody_and_is_counted() {
        let outlet = outlet(false);
        let (_near, far) = connection();
        outlet.add("/s".into(), far).expect("add");
        let body = vec![0; 1 << 20];
        let frames = u64::try_from(LONGEST_QUEUE >> 20).expect("small") * 3;
        for _ in 0..frames {
            outlet.publish(0, &body);
        }
        assert!(outlet.is_crowded());
        let dropped = outlet.overflowed();
        assert!(dropped > frames / 4, "{dropped}");
        outlet.close(Duration::from_millis(50));
        assert!(outlet.links().is_empty());
        assert!(outlet.overflowed() > dropped, "what was never sent is counted too");
    }

    #[test]
    fn a_message_longer_than_the_queue_is_sent_all_the_same() {
        let outlet = outlet(false);
        let (mut near, far) = connection();
        outlet.add("/s".into(), far).expect("add");
        let reading = std::thread::spawn(move || {
            let mut bytes = Vec::new();
            near.read_to_end(&mut bytes).map(|_| bytes.len())
        });
        outlet.publish(0, &vec![1; LONGEST_QUEUE + 8]);
        outlet.close(PATIENCE * 60);
        assert_eq!(reading.join().expect("read").ok(), Some(LONGEST_QUEUE + 12));
        assert_eq!(outlet.overflowed(), 0);
    }
}
