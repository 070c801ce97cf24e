//! The console: its core, its screens and popups, what they are drawn with, and the one module that knows the terminal.

pub mod app;
pub mod popups;
pub mod screens;
pub mod term;
pub mod ui;

use authros_config as config;
use authros_model as model;
use authros_pipeline as pipeline;
use authros_ros as ros;
use authros_service as service;
use authros_store as store;
