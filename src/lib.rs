//! AuthROS: robot data shared under proof. See ARCHITECTURE.md for the crates.

pub mod cli;

pub use authros_chain as chain;
pub use authros_config as config;
pub use authros_config::paths;
pub use authros_console::{app, popups, screens, term, ui};
pub use authros_crypto as crypto;
pub use authros_evidence as evidence;
pub use authros_gateway as gateway;
pub use authros_model as model;
pub use authros_pipeline as pipeline;
pub use authros_ros as ros;
pub use authros_service as service;
pub use authros_store as store;
