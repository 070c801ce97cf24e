//! Data on the disk: space for it, how long it is kept, and whether it is intact after a crash.

mod integrity;
mod retention;
pub(super) mod room;
#[cfg(test)]
mod tests;
use crate::config::Config;
use crate::paths::Home;
use crate::pipeline::Plant;
use crate::service::hub::Hub;
use crate::site::audit::Log;
use crate::site::identity::owners::Owners;
use crate::site::lifetime::Lifetime;
use crate::site::parts::Parts;
use crate::store::Reserve;
use std::sync::Arc;

/// The disk under a site.
pub(in crate::site) struct Storage {
    home: Home,
    config: Arc<Config>,
    plant: Plant,
    hub: Arc<Hub>,
    log: Arc<Log>,
    owners: Arc<Owners>,
    life: Arc<Lifetime>,
    /// Space for the states of records on a full disk.
    states: Reserve,
}

impl Storage {
    /// From the shared parts.
    pub fn new(parts: &Parts) -> Self {
        let Parts { home, config, plant, hub, log, owners, life, .. } = parts.clone();
        Self {
            home,
            config,
            plant,
            hub,
            log,
            owners,
            life,
            states: room::working_reserve(&parts.home, parts.config.disk_reserve),
        }
    }
}
