//! Reads and publishes ROS 2 topics by rustdds for a site of AuthROS, in a process without keys.

use authros_pipe as pipe;

mod capture;
mod describing;
mod error;
mod farewell;
mod graph;
mod handover;
mod member;
mod publish;
mod quality;
mod reading;
mod threads;

pub use capture::run;
pub use error::Ros2Error;
pub use farewell::bury;
pub use publish::run as publish;
