use super::*;

mod fixtures;
mod hostile;
mod loopback;
mod memory_desk;
mod vectors;

pub(super) use fixtures::{Member, context, greet, pair, sample_answers, sample_requests, sessions};
