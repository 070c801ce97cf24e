//! Reads and publishes ROS 2 topics for a site of AuthROS, in a process without keys.
//!
//! The network code is `rustdds`; its output leaves through a pipe ([`authros_pipe`]). The site starts the program,
//! supervises it and counts losses.

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
