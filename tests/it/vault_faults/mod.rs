//! Redis killed, full, altered, split over a cluster, and a disk without room: what was acknowledged is never lost,
//! what was not is counted, and the counts add up at every check.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

mod altered;
mod cluster;
mod disk;
mod field;
mod killed;
mod retention;
mod told;
