//! The pipe between a site and a child process that talks to the network. Neither side trusts the other.

mod error;
mod frame;
pub mod read;
pub mod write;

pub use error::PipeError;
pub use frame::{LONGEST_HEAD, LONGEST_PAYLOAD, receive, send};

/// A child and a site of different versions part.
pub const VERSION: u32 = 1;
