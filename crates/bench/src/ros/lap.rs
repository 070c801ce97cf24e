//! One publisher, one load, once: a master and subscribers of its own, messages at a held pace, and what arrived.

use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::usage::{processor_seconds, processor_seconds_of};
use authros_model::TopicName;
use authros_ros::{
    Advertised, Capture, CaptureNotice, CaptureOptions, EmbeddedMaster, Graph, GraphPublisher, Message, MessageSink,
    Publisher, RosrustPublisher,
};
use authros_service::Failure;
use authros_service::failure::internal;

/// The names of the publishers.
pub const OWN: &str = "own";
pub const ROSRUST: &str = "rosrust";

const TOPIC: &str = "/bench";
/// How long is waited for subscribers, and for messages after the last one that came.
const PATIENCE: Duration = Duration::from_secs(5);
/// A text and its number before it; the length of the text comes first.
const LEAST: usize = 12;

/// What is published.
#[derive(Debug, Clone, Copy)]
pub struct Load {
    /// For people.
    pub name: &'static str,
    /// Of one message.
    pub bytes: usize,
    /// Messages a second.
    pub per_second: u32,
}

/// What came of it.
#[derive(Debug)]
pub struct Lap {
    /// From the order to publish to the last byte, microseconds, for each message that arrived.
    pub times: Vec<f64>,
    /// Messages published.
    pub published: u64,
    /// What the publisher says was dropped.
    pub dropped: u64,
    /// Processor time of this process and the publisher's, seconds.
    pub processor: f64,
}

/// When messages were published, microseconds since the beginning, by number.
struct Clock {
    begun: Instant,
    sent: Vec<AtomicU64>,
}

impl Clock {
    fn now(&self) -> u64 {
        u64::try_from(self.begun.elapsed().as_nanos()).unwrap_or(u64::MAX)
    }
}

/// What one subscriber heard.
struct Heard {
    clock: Arc<Clock>,
    times: Mutex<Vec<f64>>,
}

impl MessageSink for Heard {
    fn accept(&self, message: Message) {
        let now = self.clock.now();
        let index =
            message.body.get(4..LEAST).and_then(|bytes| bytes.first_chunk()).map(|bytes| u64::from_le_bytes(*bytes));
        let sent = index.and_then(|index| self.clock.sent.get(usize::try_from(index).ok()?));
        let Some(sent) = sent else { return };
        let passed = Duration::from_nanos(now.saturating_sub(sent.load(Ordering::Acquire)));
        self.times.lock().unwrap_or_else(PoisonError::into_inner).push(passed.as_secs_f64() * 1e6);
    }

    fn notice(&self, _notice: CaptureNotice) {}
}

/// Publishes for `length`.
///
/// # Errors
/// If a part does not start.
pub fn run(by: &str, load: &Load, length: Duration, subscribers: u16, program: Option<&Path>) -> Result<Lap, Failure> {
    let count = (length.as_secs_f64() * f64::from(load.per_second)).ceil().max(1.0);
    let period = length.div_f64(count);
    let count = usize::try_from(length.as_nanos().div_ceil(period.as_nanos().max(1))).unwrap_or(1).max(1);
    let clock = Arc::new(Clock { begun: Instant::now(), sent: (0..count).map(|_| AtomicU64::new(0)).collect() });
    let master = EmbeddedMaster::start()?;
    let (heard, captures) = listen(&master, &clock, subscribers)?;
    let mut publisher = match by {
        ROSRUST => {
            GraphPublisher::Rosrust(Box::new(RosrustPublisher::start(master.uri(), None, "/bench_mouth", program)?))
        }
        _ => GraphPublisher::Own(Publisher::start(master.uri(), None, "/bench_mouth")?),
    };
    publisher.advertise(&about(), PATIENCE)?;
    let process = publisher.process().map(|process| process.to_string());
    let used = || processor_seconds() + process.as_deref().map_or(0.0, processor_seconds_of);
    let (before, began) = (used(), Instant::now());
    let mut body = vec![b'x'; load.bytes.max(LEAST)];
    let text = u32::try_from(body.len() - 4).unwrap_or(u32::MAX);
    body[..4].copy_from_slice(&text.to_le_bytes());
    let mut published = 0;
    for (at, sent) in clock.sent.iter().enumerate() {
        let due = period.saturating_mul(u32::try_from(at).unwrap_or(u32::MAX));
        std::thread::sleep(due.saturating_sub(began.elapsed()));
        body[4..LEAST].copy_from_slice(&(at as u64).to_le_bytes());
        sent.store(clock.now(), Ordering::Release);
        published += u64::from(publisher.publish(TOPIC, 0, &body));
    }
    wait(&heard, published);
    let processor = used() - before;
    let dropped = publisher.end();
    drop(captures);
    let taken = |heard: &Arc<Heard>| std::mem::take(&mut *heard.times.lock().unwrap_or_else(PoisonError::into_inner));
    Ok(Lap { times: heard.iter().flat_map(taken).collect(), published, dropped, processor })
}

type Listeners = (Vec<Arc<Heard>>, Vec<Capture>);

/// Subscribers that the master knows.
fn listen(master: &EmbeddedMaster, clock: &Arc<Clock>, subscribers: u16) -> Result<Listeners, Failure> {
    let topic: TopicName = TOPIC.parse().map_err(|_| internal("the topic's name"))?;
    let (mut all, mut captures) = (Vec::new(), Vec::new());
    for number in 0..subscribers {
        let heard = Arc::new(Heard { clock: Arc::clone(clock), times: Mutex::default() });
        let node_name = format!("/bench_ear{number}");
        let options = CaptureOptions { master_uri: master.uri().to_owned(), own_host: None, node_name };
        let capture = Capture::start(options, Arc::clone(&heard) as Arc<dyn MessageSink>)?;
        capture.watch(topic.clone(), None);
        all.push(heard);
        captures.push(capture);
    }
    let (graph, begun) = (Graph::new(master.uri(), "/bench_look")?, Instant::now());
    while graph.presence(TOPIC)?.subscribers.len() < usize::from(subscribers) {
        if begun.elapsed() >= PATIENCE {
            return Err(internal("the subscribers' registration"));
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    Ok((all, captures))
}

/// Waits until everybody has everything, or nothing more comes.
fn wait(heard: &[Arc<Heard>], published: u64) {
    let count = || {
        let of = |heard: &Arc<Heard>| heard.times.lock().unwrap_or_else(PoisonError::into_inner).len() as u64;
        heard.iter().map(of).sum::<u64>()
    };
    let (mut last, mut since) = (count(), Instant::now());
    while last < published * heard.len() as u64 && since.elapsed() < PATIENCE {
        std::thread::sleep(Duration::from_millis(10));
        let now = count();
        if now != last {
            (last, since) = (now, Instant::now());
        }
    }
}

fn about() -> Advertised {
    Advertised {
        topic: TOPIC.to_owned(),
        type_name: "std_msgs/String".to_owned(),
        md5sum: "992ce8a1687cec8c8bd883ec73ca41d1".to_owned(),
        definition: "string data\n".to_owned(),
        latching: false,
    }
}
