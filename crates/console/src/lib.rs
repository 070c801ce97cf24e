//! The console: its state and the pure update, the drawing, and the one module that knows the terminal.

pub mod app;
pub mod term;
pub mod ui;

use authros_config as config;
use authros_model as model;
use authros_pipeline as pipeline;
use authros_ros as ros;
use authros_service as service;
use authros_store as store;
