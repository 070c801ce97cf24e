//! The pipe between a site and a child process that talks to the outside in its place.
//!
//! A frame is a head as JSON and a payload as raw bytes. Both lengths are checked before memory is taken, and memory
//! grows only with what has arrived: neither side trusts the other. [`read`] contains what a child that reads ROS 2 says,
//! [`write`] what one that publishes says.

mod error;
mod frame;
pub mod read;
pub mod write;

pub use error::PipeError;
pub use frame::{LONGEST_HEAD, LONGEST_PAYLOAD, receive, send};

/// The version of the protocol; a child and a site of different versions part at once.
pub const VERSION: u32 = 1;
