//! The flows of `authros-bench`: its files have the promised shape, and its counts are right. No time is judged.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

mod figures;
mod funder;
mod support;
