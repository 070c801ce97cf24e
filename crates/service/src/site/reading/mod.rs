//! Records as shown to people: a profile's own and those that others share, listed, checked, opened and exported.

mod coverage;
mod names;
mod opened;
mod own;
mod shared;
mod statements;
pub(super) mod view;
use crate::config::Config;
use crate::pipeline::Plant;
use crate::pipeline::columns::Heads;
use crate::site::audit::Log;
use crate::site::chain::link::Link;
use crate::site::contacts::Contacts;
use crate::site::identity::owners::Owners;
use crate::site::parts::Parts;
use std::sync::Arc;

/// Records as people read them.
pub(in crate::site) struct Reading {
    config: Arc<Config>,
    plant: Plant,
    log: Arc<Log>,
    owners: Arc<Owners>,
    link: Arc<Link>,
    contacts: Arc<Contacts>,
    /// Heads of records opened for lists.
    heads: Heads,
}

impl Reading {
    /// From the shared parts.
    pub fn new(parts: &Parts, contacts: &Arc<Contacts>) -> Self {
        let Parts { config, plant, log, owners, link, .. } = parts.clone();
        Self { config, plant, log, owners, link, contacts: Arc::clone(contacts), heads: Heads::default() }
    }

    /// Forgets the heads that were opened for lists.
    pub fn forget(&self) {
        self.heads.forget();
    }
}
