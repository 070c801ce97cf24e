//! ROS: the embedded master, the graph, simulated robots, capture of topics, decoding of messages, recordings.
//! All network code uses timeouts and caps; peers are untrusted.
#![doc = include_str!("../README.md")]

use crate as ros;
use authros_crypto as crypto;
use authros_model as model;
use authros_pipe as pipe;

use std::sync::{Mutex, MutexGuard, PoisonError};

mod address;
pub mod bag;
pub mod capture;
mod child;
mod error;
pub mod graph;
pub mod master;
pub mod mcap;
pub mod message;
mod publisher;
pub mod readable;
pub mod recording;
pub mod robot;
pub mod ros2;
pub mod rosbag2;
mod tcpros;
mod xmlrpc;

pub use capture::{Capture, CaptureNotice, CaptureOptions, Message, MessageSink, Origin, Rival, TopicCapture};
pub use child::UNCONFINED;
pub(crate) use error::Result;
pub use error::RosError;
pub use graph::{Graph, LastLook, TopicInfo};
pub use master::EmbeddedMaster;
pub use message::{Definition, Limits, Value, md5sum};
pub use publisher::{Advertised, GraphPublisher, Publisher, RosrustPublisher};
pub use robot::{DomainFleet, Fleet, FleetOptions, MOST_ROBOTS};

/// A lock that survives a panicking thread: the data are plain counters and lists.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod readme_tests;
#[cfg(test)]
mod tests;
