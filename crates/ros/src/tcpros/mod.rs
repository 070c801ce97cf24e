//! TCPROS on the wire: connection headers and length-prefixed frames. Who connects to whom, and what happens to the
//! frames, is up to capture and robots.

mod frame;
mod header;

pub(super) use frame::{FrameReader, Poll};
pub(super) use header::{ConnectionHeader, LONGEST_HEADER};

/// The longest message accepted, bytes.
pub const LONGEST_MESSAGE: usize = 64 << 20;
