//! AuthROS: robot data shared under proof. See ARCHITECTURE.md for the rooms.

pub mod app;
pub mod chain;
pub mod cli;
pub mod config;
pub mod crypto;
pub mod gateway;
pub mod model;
pub mod paths;
pub mod pipeline;
pub mod ros;
pub mod service;
pub mod store;
pub mod term;
pub mod ui;
