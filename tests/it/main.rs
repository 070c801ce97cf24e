//! The flows through the public interface: the program, the console in a pseudo-terminal, real peers. A file per
//! behaviour, and one binary for all, so that it is compiled once and its tests share the machine.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

#[path = "../support/mod.rs"]
mod support;

mod admission;
mod adoption;
mod agent;
mod alerts;
mod at_rest;
mod audit;
mod bags;
mod bags_altered;
mod bench;
mod bench_funder;
mod chain_commands;
mod chain_faults;
mod check;
mod command_line;
mod completing;
mod console;
mod console_journey;
mod console_line;
mod console_situations;
mod console_terminal;
mod contacts;
mod demo;
mod evidence;
mod faults;
mod fleet;
mod fleet_metrics;
mod foreign_proofs;
mod gateway;
mod identity;
mod incidents;
mod key_changes;
mod keys;
mod messages;
mod metrics;
mod newer_home;
mod node_forging;
mod packages;
mod places;
mod playing;
mod real_chain;
mod real_redis;
mod real_ros;
mod remote;
mod restart;
mod rights;
mod robots;
mod ros2;
mod ros2_capture;
mod ros2_fastdds;
mod ros2_losses;
mod ros2_playing;
mod sharing;
mod site_file;
mod status;
mod succession;
mod time_stamps;
mod units;
mod uploads_export;
mod vault_faults;
mod witnesses;
