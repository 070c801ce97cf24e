use super::*;

mod fixtures;
mod hostile;
mod loopback;
mod memory_desk;
mod vectors;

pub(crate) use fixtures::{Member, context, pair};
pub(super) use fixtures::{greet, sample_answers, sample_requests, sessions};
pub(crate) use loopback::Stage;
