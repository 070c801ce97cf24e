//! Records as shown to people: a profile's own and those that others share, listed, checked, opened and exported.

mod coverage;
mod names;
mod opened;
mod own;
mod shared;
mod statements;
pub(super) mod view;
use crate::config::Config;
use crate::model::{Address, Digest, ErrorKind, clean};
use crate::paths::Home;
use crate::pipeline::columns::Heads;
use crate::pipeline::{Network, Plant};
use crate::service::reply::Failure;
use crate::site::audit::Log;
use crate::site::blocking;
use crate::site::chain::connection::pin_of;
use crate::site::chain::link::Link;
use crate::site::contacts::Contacts;
use crate::site::identity::owners::Owners;
use crate::site::parts::Parts;
use std::collections::HashSet;
use std::sync::{Arc, Mutex};

/// Records as people read them.
pub(in crate::site) struct Reading {
    home: Home,
    config: Arc<Config>,
    plant: Plant,
    log: Arc<Log>,
    owners: Arc<Owners>,
    link: Arc<Link>,
    contacts: Arc<Contacts>,
    /// Heads of records opened for lists.
    heads: Heads,
    /// Records that have no names to learn for a reader.
    nameless: Mutex<HashSet<(Address, Digest)>>,
}

impl Reading {
    /// From the shared parts.
    pub fn new(parts: &Parts, contacts: &Arc<Contacts>) -> Self {
        let Parts { home, config, plant, log, owners, link, .. } = parts.clone();
        let (contacts, heads, nameless) = (Arc::clone(contacts), Heads::default(), Mutex::default());
        Self { home, config, plant, log, owners, link, contacts, heads, nameless }
    }

    /// The network; if its chain cannot be asked now, what this home kept of it, to read own records by.
    ///
    /// # Errors
    /// Why the link is down, if the home is bound to no chain yet.
    pub async fn network_or_kept(self: &Arc<Self>) -> Result<Network, Failure> {
        let failure = match self.link.network().await {
            Ok(_) if self.link.is_silent() => Failure::new(ErrorKind::Unreachable, "it did not answer when last asked"),
            Ok(network) => return Ok(network),
            Err(failure) => failure,
        };
        blocking(self, move |reading| match pin_of(&reading.home)? {
            Some(pin) => Ok(Network::kept(&reading.plant, pin, &clean(&failure.message, 400))?),
            None => Err(failure),
        })
        .await
    }

    /// Forgets the heads that were opened for lists.
    pub fn forget(&self) {
        self.heads.forget();
    }
}
