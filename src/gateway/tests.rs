use super::*;

mod fixtures;
mod flipped_bits;
mod hostile;
mod loopback;
mod memory_desk;
mod refusals;
mod vectors;

pub(super) use fixtures::{Member, context, greet, pair, sample_answers, sample_requests, sessions};
