//! ROS 2: topics read by a separate program without keys, which is started, supervised and restarted here.
//!
//! Its reports are trusted no more than a peer's. Messages that a publisher sent and that never arrived are counted
//! here, by the publisher's own numbers, so that the count continues when the program has to be restarted.

mod descriptions;
mod identity;
mod numbers;
mod publisher;
mod publishing;
mod standing;
mod state;
mod supervision;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread::JoinHandle;

use crate::model::TopicName;
use crate::ros::child::{self, Errand};
use crate::ros::{MessageSink, RosError};
use supervision::Shared;

pub use crate::pipe::LONGEST_PAYLOAD as LONGEST_MESSAGE;
pub use crate::pipe::read::{Counts, Quality};
pub use crate::pipe::write::{Offer, Topic as Offered};
pub use crate::ros::child::Declined;
pub use publisher::{QUALITY, WRITER};
pub use publishing::{Delivery, Ros2Publisher};
pub use standing::{INVISIBLE, Reading, Standing};

/// The program that speaks ROS 2.
const PROGRAM: &str = "authros-ros2";

fn find(program: Option<&Path>) -> Result<PathBuf, RosError> {
    child::find(PROGRAM, program).map_err(|path| RosError::no_reader(&path))
}

/// Reading a domain, or publishing in it.
fn errand(program: &Path, domain: u16, publishes: bool) -> Errand {
    let arguments = ["--domain".to_owned(), domain.to_string()];
    let arguments = arguments.into_iter().chain(publishes.then(|| "--publish".to_owned())).collect();
    Errand { program: program.to_owned(), arguments, environment: Vec::new() }
}

/// A topic of the domain.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Ros2Topic {
    /// Its name.
    pub name: String,
    /// Its type, `package/msg/Type`.
    pub type_name: String,
    /// `RIHS01_` and 64 hex characters, if a publisher gave it.
    pub type_hash: Option<String>,
    /// What every publisher of it offers.
    pub quality: Quality,
    /// Names of its publishers: clean them before they are shown.
    pub publishers: Vec<String>,
}

impl Ros2Topic {
    /// The offer, in two words.
    pub fn quality_text(&self) -> String {
        let reliability = if self.quality.reliable { "reliable" } else { "best_effort" };
        let durability = if self.quality.latched { "transient_local" } else { "volatile" };
        format!("{reliability} {durability}")
    }
}

/// A running capture of a domain; leaves it when dropped.
pub struct Ros2Capture {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
}

impl Ros2Capture {
    /// Starts reading `domain`; nothing is watched yet. `program` names the program that reads if it is not beside this
    /// one.
    ///
    /// # Errors
    /// [`RosError::NoReader`] if that program is missing, [`RosError::System`] if no thread can be started.
    pub fn start(domain: u16, program: Option<&Path>, sink: Arc<dyn MessageSink>) -> Result<Self, RosError> {
        let program = find(program)?;
        let shared = Arc::new(Shared::new(domain, program, sink));
        let mut capture = Self { shared: Arc::clone(&shared), threads: Vec::new() };
        capture.threads.push(supervision::keep_reading(&shared)?);
        capture.threads.push(supervision::keep_watch(&shared)?);
        Ok(capture)
    }

    /// Captures a topic, whenever somebody publishes it.
    pub fn watch(&self, topic: &TopicName) {
        self.shared.watch(topic);
    }

    /// Stops capturing it.
    pub fn unwatch(&self, topic: &TopicName) {
        self.shared.unwatch(topic);
    }

    /// Captures the messages of a topic, or of all, that still wait for the identity of their publisher. Blocks like the sink.
    pub fn settle(&self, topic: Option<&str>) {
        self.shared.settle(topic);
    }

    /// The watched topics.
    pub fn watched(&self) -> Vec<TopicName> {
        self.shared.state().watched.iter().cloned().collect()
    }

    /// The topics with a publisher now, by name.
    pub fn topics(&self) -> Vec<Ros2Topic> {
        self.shared.state().topics()
    }

    /// Where it stands.
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
        self.shared.settle(None);
        self.shared.stop();
        for thread in self.threads.drain(..) {
            drop(thread.join());
        }
    }
}
