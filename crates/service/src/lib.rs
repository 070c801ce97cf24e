//! Command in, Event out. Console and command line talk only through [`Client`]; nothing here draws or prints.

use authros_chain as chain;
use authros_config as config;
use authros_config::paths;
use authros_crypto as crypto;
use authros_gateway as gateway;
use authros_model as model;
use authros_pipeline as pipeline;
use authros_ros as ros;
use authros_store as store;

pub mod accounts;
mod alerts;
pub mod client;
pub mod command;
pub mod completing;
pub mod doctor;
mod durability;
mod figures;
pub mod hub;
pub mod looking;
pub mod reply;
pub mod restoring;
pub mod site;
pub mod socket;
pub mod verification;
#[cfg(test)]
mod wire_tests;

pub use client::{Call, Client};
pub use command::{Ask, Command, GrantFrom, KeyKind, Request, SecretBytes, SecretText, UploadQuery};
pub use reply::{Event, Failure, NoticeLevel, Part, Reply};
pub use site::{
    Agent, AgentEnd, AgentFigures, AgentWishes, EnrolWishes, Needs, Site, definition_of, is_bound, record_page,
};
