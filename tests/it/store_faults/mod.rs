//! A store altered, a disk without room, and Redis in front of it killed, stopped, flushed, full, lying, split over a
//! cluster or behind a wrong certificate: what was acknowledged is never lost, what was not is counted, nothing false is
//! shown, and the counts add up at every check.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

mod altered;
mod cache;
mod cache_servers;
mod damaged;
mod disk;
mod field;
mod retention;
