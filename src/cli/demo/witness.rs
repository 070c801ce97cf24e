//! An independent witness of what the robots sent: a second subscriber that keeps only hashes.

use std::collections::HashSet;
use std::sync::{Arc, Mutex, PoisonError};

use crate::crypto::sm3::sm3;
use crate::ros::{Capture, CaptureNotice, CaptureOptions, Message, MessageSink};
use crate::service::Failure;

#[derive(Default)]
struct Hashes {
    seen: Mutex<HashSet<[u8; 32]>>,
}

impl MessageSink for Hashes {
    fn accept(&self, message: Message) {
        self.seen.lock().unwrap_or_else(PoisonError::into_inner).insert(sm3(&[&message.body]));
    }

    fn notice(&self, _: CaptureNotice) {}
}

/// Watches picture topics beside the product.
pub struct Witness {
    hashes: Arc<Hashes>,
    _capture: Capture,
}

impl Witness {
    /// Begins to watch `topics`.
    ///
    /// # Errors
    /// Where no node can be started.
    pub fn start(master_uri: &str, topics: &[String]) -> Result<Self, Failure> {
        let hashes = Arc::new(Hashes::default());
        let options = CaptureOptions {
            master_uri: master_uri.to_owned(),
            own_host: None,
            node_name: "/authros_witness".to_owned(),
        };
        let capture = Capture::start(options, hashes.clone())?;
        for topic in topics.iter().filter_map(|topic| topic.parse().ok()) {
            capture.watch(topic, None);
        }
        Ok(Self { hashes, _capture: capture })
    }

    /// Whether a robot sent exactly this message.
    pub fn saw(&self, body: &[u8]) -> bool {
        self.hashes.seen.lock().unwrap_or_else(PoisonError::into_inner).contains(&sm3(&[body]))
    }
}
