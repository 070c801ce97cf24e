//! Data on the disk: space for it, how long it is kept, and whether it is intact after a crash.

mod erasing;
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
use crate::site::chain::link::Link;
use crate::site::identity::owners::Owners;
use crate::site::lifetime::Lifetime;
use crate::site::parts::Parts;
use crate::site::reading::Reading;
use crate::store::Reserve;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64};

/// The disk under a site.
pub(in crate::site) struct Storage {
    home: Home,
    config: Arc<Config>,
    plant: Plant,
    hub: Arc<Hub>,
    log: Arc<Log>,
    owners: Arc<Owners>,
    link: Arc<Link>,
    life: Arc<Lifetime>,
    /// Space for the states of records on a full disk.
    states: Reserve,
    reading: Arc<Reading>,
    /// Records are named one caller at a time.
    naming: tokio::sync::Mutex<()>,
    /// Whether named ciphertext may be left to delete.
    has_named: AtomicBool,
    /// How often owners elsewhere had something named, as of the last look; and how much of it incidents hold here.
    seen: (AtomicU64, AtomicU64),
}

impl Storage {
    /// From the shared parts.
    pub fn new(parts: &Parts, reading: &Arc<Reading>) -> Self {
        let Parts { home, config, plant, hub, log, owners, link, life, .. } = parts.clone();
        Self {
            home,
            config,
            plant,
            hub,
            log,
            owners,
            link,
            life,
            states: room::working_reserve(&parts.home, parts.config.disk_reserve),
            reading: Arc::clone(reading),
            naming: tokio::sync::Mutex::default(),
            has_named: AtomicBool::new(true),
            seen: (AtomicU64::new(0), AtomicU64::new(0)),
        }
    }
}
