//! What the features of a site share; each takes from here what it needs.

use std::sync::Arc;

use super::audit::Log;
use super::chain::link::Link;
use super::identity::owners::Owners;
use super::lifetime::Lifetime;
use super::supervision::Supervisor;
use crate::config::Config;
use crate::paths::Home;
use crate::pipeline::{Plant, Sender};
use crate::service::hub::Hub;

/// The shared parts of one site.
#[derive(Clone)]
pub(super) struct Parts {
    pub home: Home,
    pub config: Arc<Config>,
    /// Ledger, vault and provider.
    pub plant: Plant,
    pub hub: Arc<Hub>,
    pub log: Arc<Log>,
    pub owners: Arc<Owners>,
    pub link: Arc<Link>,
    pub life: Arc<Lifetime>,
    pub supervisor: Arc<Supervisor>,
    /// Sends transactions.
    pub sender: Arc<Sender>,
}
