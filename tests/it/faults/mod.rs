//! Faults around and inside the product: kills, failing disks, failing tasks, slow and absent peers, clocks. Whatever
//! happens, nothing acknowledged is lost, nothing is anchored twice, and the conservation law holds.
#![allow(clippy::print_stdout, reason = "figures that the run shows")]
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

mod bad_weather;
mod kill;
mod script;
mod storage;
mod supervision;
