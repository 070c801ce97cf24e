//! The gateway's own fixtures, for tests of what talks to a gateway.
#![allow(dead_code, reason = "the gateway's tests use the rest")]

#[path = "../../gateway/src/tests/fixtures.rs"]
mod fixtures;
#[path = "../../gateway/src/tests/memory_desk.rs"]
mod memory_desk;
#[path = "../../gateway/src/tests/stage.rs"]
mod stage;

pub(crate) use fixtures::{Member, context, notice_of, pair};
pub(crate) use stage::Stage;
