//! One published topic: its subscribers, each with a queue and a writing thread of its own, so that
//! a slow one holds up nobody; what a subscriber cannot take is dropped from its queue and counted.

use std::collections::VecDeque;
use std::io::Write as _;
use std::net::{Shutdown, TcpStream};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::definitions::sum_of;
use crate::ros::slave::BusLink;
use crate::ros::tcpros::ConnectionHeader;

/// The most a queue holds, bytes.
const LONGEST_QUEUE: usize = 32 << 20;

/// How long a subscriber gets for the rest of its queue at the end.
const FAREWELL: Duration = Duration::from_secs(1);

/// A published topic.
pub(super) struct Outlet {
    topic: String,
    type_name: &'static str,
    definition: String,
    md5sum: String,
    published: AtomicU64,
    overflowed: AtomicU64,
    subscribers: Mutex<Vec<Arc<Subscriber>>>,
}

struct Subscriber {
    name: String,
    stream: TcpStream,
    queue: Mutex<Queue>,
    changed: Condvar,
}

#[derive(Default)]
struct Queue {
    frames: VecDeque<Arc<Vec<u8>>>,
    bytes: usize,
    /// No more frames come.
    closing: bool,
    /// All is sent or will never be.
    done: bool,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Outlet {
    pub fn new(topic: String, type_name: &'static str, definition: String) -> Self {
        let md5sum = sum_of(type_name, &definition);
        Self {
            topic,
            type_name,
            definition,
            md5sum,
            published: AtomicU64::new(0),
            overflowed: AtomicU64::new(0),
            subscribers: Mutex::default(),
        }
    }

    pub fn topic(&self) -> &str {
        &self.topic
    }

    pub fn type_name(&self) -> &'static str {
        self.type_name
    }

    pub fn published(&self) -> u64 {
        self.published.load(Ordering::SeqCst)
    }

    pub fn overflowed(&self) -> u64 {
        self.overflowed.load(Ordering::SeqCst)
    }

    /// Sends `body` to all subscribers there are.
    pub fn publish(&self, body: &[u8]) {
        let Ok(length) = u32::try_from(body.len()) else { return };
        let frame = Arc::new([length.to_le_bytes().as_slice(), body].concat());
        let mut subscribers = lock(&self.subscribers);
        self.published.fetch_add(1, Ordering::SeqCst);
        subscribers.retain(|subscriber| match subscriber.push(&frame) {
            Some(dropped) => {
                self.overflowed.fetch_add(dropped, Ordering::SeqCst);
                true
            }
            None => false,
        });
    }

    /// Why a subscriber's connection header does not fit this topic.
    pub fn objection(&self, header: &ConnectionHeader) -> Option<String> {
        let fits = |key: &str, ours: &str| header.get(key).is_none_or(|theirs| theirs == ours || theirs == "*");
        if !fits("md5sum", &self.md5sum) {
            return Some(format!("the md5sum of {} is {}", self.topic, self.md5sum));
        }
        (!fits("type", self.type_name)).then(|| format!("{} is of type {}", self.topic, self.type_name))
    }

    /// Our connection header.
    pub fn header(&self, node_name: &str) -> ConnectionHeader {
        ConnectionHeader::new([
            ("callerid", node_name),
            ("topic", self.topic.as_str()),
            ("type", self.type_name),
            ("md5sum", self.md5sum.as_str()),
            ("message_definition", self.definition.as_str()),
            ("latching", "0"),
        ])
    }

    /// Takes in a subscriber whose handshake is done.
    pub fn add(&self, name: String, stream: TcpStream) -> std::io::Result<()> {
        let subscriber = Arc::new(Subscriber { name, stream, queue: Mutex::default(), changed: Condvar::new() });
        let writer = Arc::clone(&subscriber);
        std::thread::Builder::new().name("robot-writer".into()).spawn(move || writer.write_all())?;
        lock(&self.subscribers).push(subscriber);
        Ok(())
    }

    pub fn links(&self) -> Vec<BusLink> {
        let link = |subscriber: &Arc<Subscriber>| BusLink {
            peer: subscriber.name.clone(),
            outbound: true,
            topic: self.topic.clone(),
        };
        lock(&self.subscribers).iter().map(link).collect()
    }

    /// Lets the queues run empty, but not for ever, and ends the connections.
    pub fn close(&self) {
        let subscribers = std::mem::take(&mut *lock(&self.subscribers));
        let deadline = Instant::now() + FAREWELL;
        for subscriber in &subscribers {
            subscriber.close();
        }
        for subscriber in &subscribers {
            subscriber.wait(deadline);
        }
    }
}

impl Subscriber {
    /// Queues a frame; how many older ones had to go for it, `None` where the subscriber is gone.
    fn push(&self, frame: &Arc<Vec<u8>>) -> Option<u64> {
        let mut queue = lock(&self.queue);
        if queue.done || queue.closing {
            return None;
        }
        queue.bytes += frame.len();
        queue.frames.push_back(Arc::clone(frame));
        let mut dropped = 0;
        while queue.bytes > LONGEST_QUEUE {
            let oldest = queue.frames.pop_front()?;
            queue.bytes -= oldest.len();
            dropped += 1;
        }
        self.changed.notify_all();
        Some(dropped)
    }

    fn write_all(&self) {
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

    fn next(&self) -> Option<Arc<Vec<u8>>> {
        let idle = |queue: &mut Queue| queue.frames.is_empty() && !queue.closing;
        let mut queue = self.changed.wait_while(lock(&self.queue), idle).unwrap_or_else(PoisonError::into_inner);
        let frame = queue.frames.pop_front()?;
        queue.bytes -= frame.len();
        Some(frame)
    }

    fn close(&self) {
        lock(&self.queue).closing = true;
        self.changed.notify_all();
    }

    fn wait(&self, deadline: Instant) {
        let patience = deadline.saturating_duration_since(Instant::now());
        let waited = self.changed.wait_timeout_while(lock(&self.queue), patience, |queue| !queue.done);
        if waited.unwrap_or_else(PoisonError::into_inner).1.timed_out() {
            // Wakes the writer from a write that a hung subscriber never takes.
            let _ = self.stream.shutdown(Shutdown::Both);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::definitions::{ODOMETRY, odometry_definition};
    use super::*;
    use std::io::Read as _;
    use std::net::TcpListener;

    fn outlet() -> Outlet {
        Outlet::new("/t".into(), ODOMETRY, odometry_definition())
    }

    fn connection() -> (TcpStream, TcpStream) {
        let listener = TcpListener::bind("127.0.0.1:0").expect("bind");
        let near = TcpStream::connect(listener.local_addr().expect("address")).expect("connect");
        (near, listener.accept().expect("accept").0)
    }

    #[test]
    fn only_fitting_subscribers_are_welcome() {
        let outlet = outlet();
        let objection =
            |md5sum, type_name| outlet.objection(&ConnectionHeader::new([("md5sum", md5sum), ("type", type_name)]));
        assert_eq!(objection("*", "*"), None);
        assert_eq!(objection("cd5e73d190d741a2f92e81eda573aca7", ODOMETRY), None);
        assert!(objection("00000000000000000000000000000000", ODOMETRY).is_some());
        assert!(objection("*", "sensor_msgs/Imu").is_some());
    }

    #[test]
    fn what_is_queued_is_sent_before_the_end() {
        let outlet = outlet();
        let (mut near, far) = connection();
        outlet.add("/s".into(), far).expect("add");
        for number in 0..1000u32 {
            outlet.publish(&number.to_le_bytes());
        }
        outlet.close();
        let mut bytes = Vec::new();
        near.read_to_end(&mut bytes).expect("read");
        let expected: Vec<u8> = (0..1000u32).flat_map(|n| [4u32.to_le_bytes(), n.to_le_bytes()].concat()).collect();
        assert_eq!(bytes, expected);
        assert_eq!((outlet.published(), outlet.overflowed()), (1000, 0));
    }

    #[test]
    fn a_subscriber_that_does_not_read_holds_up_nobody_and_is_counted() {
        let outlet = outlet();
        let (_near, far) = connection();
        outlet.add("/s".into(), far).expect("add");
        let body = vec![0; 1 << 20];
        let frames = u64::try_from(LONGEST_QUEUE >> 20).expect("small") * 3;
        for _ in 0..frames {
            outlet.publish(&body);
        }
        assert_eq!(outlet.published(), frames);
        assert!(outlet.overflowed() > frames / 4, "{}", outlet.overflowed());
        outlet.close();
        assert!(outlet.links().is_empty());
    }
}
