use super::*;

pub(crate) mod fixtures;
mod flipped_bits;
mod hostile;
mod loopback;
mod memory_desk;
mod refusals;
mod relaying;
#[allow(dead_code, reason = "the tests of other crates use the rest")]
mod stage;
mod vectors;

pub(crate) use fixtures::{Member, context, pair};
pub(super) use fixtures::{greet, network, notice_of, sample_answers, sample_requests, sessions};
