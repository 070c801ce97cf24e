//! Faults of a real chain: whatever it does, no record is lost, none is anchored twice, and the states are true.
//!
//! The chain is queried by plain JSON-RPC, independently of the program: its contents are compared with what the
//! program says.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

mod answers;
mod evidence;
mod field;
mod kept_keys;
mod lagging;
mod merkle_proof;
mod mining;
mod prices;
mod reorganisation;
mod same_account;
mod wiped;
mod wrong_numbers;

/// Why a test of this file is skipped.
const NO_NODE: &str = "no anvil; tests/run installs it into target/peers";
