//! Publishes topics of ROS 1 for a site of AuthROS, in a process without keys: rosrust's HTTP has known advisories.

use authros_pipe as pipe;

mod ear;
mod error;
mod outlet;
mod publish;
mod queue;

pub use error::RosrustError;
pub use publish::run;
