//! Publishers at a constant rate: `/loadN/data` (`sensor_msgs/CompressedImage`), each a ROS node of its own. Messages
//! delayed by a pause of the machine are sent after it.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use authros_model::Timestamp;
use authros_ros::robot::{COMPRESSED_IMAGE, compressed_image_definition};
use authros_ros::{Advertised, GraphPublisher as _, Publisher, md5sum};
use authros_service::Failure;
use authros_service::reply::internal;

use crate::account::message;

/// Messages prepared in advance, so that making them costs nothing.
const VARIANTS: usize = 16;

/// One publisher.
struct Node {
    publisher: Publisher,
    topic: String,
    published: AtomicU64,
}

/// Running publishers; they end on drop, sending what is queued for subscribers first.
pub struct Publishers {
    nodes: Vec<Arc<Node>>,
    stopping: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Publishers {
    /// Registers them at the master; nothing is sent before [`Publishers::begin`].
    ///
    /// # Errors
    /// Failures of master and sockets.
    pub fn start(master: &str, publishers: u16) -> Result<Self, Failure> {
        let definition = compressed_image_definition();
        let md5sum = md5sum(COMPRESSED_IMAGE, &definition)?;
        let node = |number: u16| {
            let topic = format!("/load{number}/data");
            let publisher = Publisher::start(master, None, &format!("/load{number}"))?;
            publisher.advertise(&Advertised {
                topic: topic.clone(),
                type_name: COMPRESSED_IMAGE.to_owned(),
                md5sum: md5sum.clone(),
                definition: definition.clone(),
                latching: false,
            })?;
            Ok(Arc::new(Node { publisher, topic, published: AtomicU64::new(0) }))
        };
        let nodes = (1..=publishers).map(node).collect::<Result<Vec<_>, Failure>>()?;
        Ok(Self { nodes, stopping: Arc::default(), threads: Vec::new() })
    }

    /// The topics.
    pub fn topics(&self) -> impl Iterator<Item = &str> {
        self.nodes.iter().map(|node| node.topic.as_str())
    }

    /// How many topics have a subscriber.
    pub fn heard(&self) -> usize {
        self.nodes.iter().filter(|node| node.publisher.subscribers(&node.topic) > 0).count()
    }

    /// Publishes messages of `bytes` each, `period` apart on every topic, with incompressible data.
    ///
    /// # Errors
    /// If a thread cannot be started, or there is no randomness.
    pub fn begin(&mut self, bytes: usize, period: Duration) -> Result<(), Failure> {
        let around = image(0, &[]).len();
        let variants: Result<Vec<_>, _> = (0..VARIANTS).map(|_| message(bytes.saturating_sub(around))).collect();
        let variants = Arc::new(variants?);
        let all = u32::try_from(self.nodes.len()).unwrap_or(u32::MAX).max(1);
        for (node, place) in self.nodes.iter().zip(0u32..) {
            let (stopping, node, variants) = (Arc::clone(&self.stopping), Arc::clone(node), Arc::clone(&variants));
            // Spread over the period, as if by independent robots.
            let first = Instant::now() + period * place / all;
            let work = move || publish(&node, &variants, first, period, &stopping);
            let thread = std::thread::Builder::new().name("load".into()).spawn(work);
            self.threads.push(thread.map_err(|error| internal(format!("a publisher's thread: {error}")))?);
        }
        Ok(())
    }

    /// Messages published so far.
    pub fn published(&self) -> u64 {
        self.nodes.iter().map(|node| node.published.load(Ordering::SeqCst)).sum()
    }

    /// How many of them did not fit into a subscriber's queue.
    pub fn overflowed(&self) -> u64 {
        self.nodes.iter().map(|node| node.publisher.missed()).sum()
    }

    /// Ends publishing; the nodes stay.
    pub fn end(&mut self) {
        self.stopping.store(true, Ordering::SeqCst);
        for thread in self.threads.drain(..) {
            thread.thread().unpark();
            // A thread that panicked leaves what it has published.
            drop(thread.join());
        }
    }
}

impl Drop for Publishers {
    fn drop(&mut self) {
        self.end();
    }
}

fn publish(node: &Node, variants: &[Vec<u8>], mut due: Instant, period: Duration, stopping: &AtomicBool) {
    for (seq, variant) in (0u32..).zip(variants.iter().cycle()) {
        while let Some(left) = due.checked_duration_since(Instant::now()).filter(|left| !left.is_zero()) {
            if stopping.load(Ordering::SeqCst) {
                return;
            }
            std::thread::park_timeout(left);
        }
        if stopping.load(Ordering::SeqCst) {
            return;
        }
        node.publisher.publish(&node.topic, 0, &image(seq, variant));
        node.published.fetch_add(1, Ordering::SeqCst);
        due += period;
    }
}

/// A `sensor_msgs/CompressedImage`: header, format, data.
fn image(seq: u32, data: &[u8]) -> Vec<u8> {
    let stamp = Timestamp::now();
    let seconds = u32::try_from(stamp.seconds()).unwrap_or(u32::MAX);
    let nanoseconds = u32::try_from(stamp.0 % 1_000_000_000).unwrap_or(0);
    let mut body = Vec::with_capacity(data.len() + 64);
    for number in [seq, seconds, nanoseconds] {
        body.extend_from_slice(&number.to_le_bytes());
    }
    for bytes in [b"load_camera", &b"jpeg"[..], data] {
        body.extend_from_slice(&u32::try_from(bytes.len()).unwrap_or(u32::MAX).to_le_bytes());
        body.extend_from_slice(bytes);
    }
    body
}
