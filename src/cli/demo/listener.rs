//! What the robots sent, heard independently: a second subscriber that keeps only hashes.

use std::collections::HashSet;
use std::path::Path;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::crypto::sm3::sm3;
use crate::ros::ros2::Ros2Capture;
use crate::ros::{Capture, CaptureNotice, CaptureOptions, Message, MessageSink};
use crate::service::Failure;

/// How long the listener may take to receive from a robot, or lag behind the product.
const PATIENCE: Duration = Duration::from_secs(60);

#[derive(Default)]
struct Hashes {
    seen: Mutex<HashSet<[u8; 32]>>,
    heard: Mutex<HashSet<Arc<str>>>,
    more: Condvar,
}

impl MessageSink for Hashes {
    fn accept(&self, message: Message) {
        self.heard.lock().unwrap_or_else(PoisonError::into_inner).insert(Arc::clone(&message.topic));
        self.seen.lock().unwrap_or_else(PoisonError::into_inner).insert(sm3(&[&message.body]));
        self.more.notify_all();
    }

    fn notice(&self, _: CaptureNotice) {}
}

/// Keeps listening until it is dropped.
enum Ear {
    One(#[expect(dead_code, reason = "ends with it")] Capture),
    Two(#[expect(dead_code, reason = "ends with it")] Ros2Capture),
}

/// Watches picture topics beside the product.
pub struct Listener {
    hashes: Arc<Hashes>,
    topics: Vec<String>,
    _ear: Ear,
}

impl Listener {
    /// Begins to watch `topics`.
    ///
    /// # Errors
    /// If no node can be started.
    pub fn start(master_uri: &str, topics: &[String]) -> Result<Self, Failure> {
        let hashes = Arc::new(Hashes::default());
        let options = CaptureOptions {
            master_uri: master_uri.to_owned(),
            own_host: None,
            node_name: "/authros_listener".to_owned(),
        };
        let capture = Capture::start(options, hashes.clone())?;
        for topic in topics.iter().filter_map(|topic| topic.parse().ok()) {
            capture.watch(topic, None);
        }
        Ok(Self { hashes, topics: topics.to_vec(), _ear: Ear::One(capture) })
    }

    /// The same in a ROS 2 domain, by a program of its own.
    ///
    /// # Errors
    /// If that program is missing.
    pub fn start_in(domain: u16, program: Option<&Path>, topics: &[String]) -> Result<Self, Failure> {
        let hashes = Arc::new(Hashes::default());
        let capture = Ros2Capture::start(domain, program, hashes.clone())?;
        for topic in topics.iter().filter_map(|topic| topic.parse().ok()) {
            capture.watch(&topic);
        }
        Ok(Self { hashes, topics: topics.to_vec(), _ear: Ear::Two(capture) })
    }

    /// Waits until something was received on every topic, so that nothing captured from now on is missed.
    pub fn listen(&self) {
        let end = Instant::now() + PATIENCE;
        let heard =
            |topic: &String| self.hashes.heard.lock().unwrap_or_else(PoisonError::into_inner).contains(topic.as_str());
        let deaf = || !self.topics.iter().all(heard);
        while deaf() && Instant::now() < end {
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Whether a robot sent exactly this message; one not received yet is waited for.
    pub fn saw(&self, body: &[u8]) -> bool {
        let (digest, end) = (sm3(&[body]), Instant::now() + PATIENCE);
        let mut seen = self.hashes.seen.lock().unwrap_or_else(PoisonError::into_inner);
        while !seen.contains(&digest) {
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return false;
            }
            seen = self.hashes.more.wait_timeout(seen, left).unwrap_or_else(PoisonError::into_inner).0;
        }
        true
    }
}
