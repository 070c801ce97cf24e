//! Publishes topics of ROS 1 for a site of AuthROS, in a process without keys.
//!
//! The node is `rosrust`, whose HTTP has known advisories; what to publish comes through a pipe ([`authros_pipe`]). The
//! site starts the program and supervises it.

use authros_pipe as pipe;

mod ear;
mod error;
mod outlet;
mod publish;
mod queue;

pub use error::RosrustError;
pub use publish::run;
