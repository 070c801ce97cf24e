//! The pipe between a site and a child process that speaks with the outside in its stead.
//!
//! A frame is a head as JSON and a payload as raw bytes. Both lengths are checked before memory is taken, and memory
//! grows only with what has arrived: neither side trusts the other. [`read`] carries what a child of ROS 2 says.

mod error;
mod frame;
pub mod read;

pub use error::PipeError;
pub use frame::{LONGEST_HEAD, LONGEST_PAYLOAD, receive, send};

/// The version of what is said; child and site of different versions part at once.
pub const VERSION: u32 = 1;
