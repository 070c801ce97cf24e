use super::*;

mod fixtures;
mod hostile;
mod loopback;
mod memory_desk;
mod relaying;
mod vectors;

pub(super) use fixtures::{Member, context, greet, network, pair, sample_answers, sample_requests, sessions};
