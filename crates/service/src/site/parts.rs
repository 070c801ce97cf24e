//! What the features of a site share.

use std::sync::Arc;

use tokio::sync::{broadcast, mpsc};

use super::audit::Log;
use super::chain::link::Link;
use super::identity::Owners;
use super::leading::worker_name;
use super::lifetime::Lifetime;
use super::progress::Runs;
use super::storage::{may_hold, open_ledger, open_on_server};
use super::supervision::Supervisor;
use crate::chain::{Policy, check_embedded_chain};
use crate::config::Config;
use crate::crypto::provider;
use crate::paths::Home;
use crate::pipeline::{Owner, Plant, Sender};
use crate::service::hub::Hub;
use crate::service::reply::Result;
use crate::store::{CacheSettings, Ciphertext, Claim, Ledger};

#[derive(Clone)]
pub(super) struct Parts {
    pub home: Home,
    pub config: Arc<Config>,
    pub plant: Plant,
    pub hub: Arc<Hub>,
    pub log: Arc<Log>,
    pub owners: Arc<Owners>,
    pub link: Arc<Link>,
    pub life: Arc<Lifetime>,
    pub supervisor: Arc<Supervisor>,
    pub sender: Arc<Sender>,
    pub runs: Runs,
}

/// Receives each owner as it is opened.
pub(super) type Opened = mpsc::UnboundedReceiver<Arc<Owner>>;

impl Parts {
    /// Opens the store of a home; the last value says whether the home is a copy of another, or its database was restored.
    pub fn open(home: Home, config: Config, needs_chain: bool) -> Result<(Self, Opened, bool)> {
        let (events, _) = broadcast::channel(1024);
        let hub = Arc::new(Hub::new(events));
        // An older program changes nothing in a newer home: all files are checked before the first is opened.
        Ledger::check_version(&home.ledger())?;
        check_embedded_chain(&home.chain())?;
        let (ledger, copied) = match &config.store_url {
            Some(url) => open_on_server(&home, url, config.store_roots.as_deref(), needs_chain)?,
            None => open_ledger(&home)?,
        };
        // What begins now depends on who holds it.
        if needs_chain {
            let claim = if may_hold(&ledger, &home)? { Claim::Take } else { Claim::Nothing };
            ledger.lease.beat(&worker_name(None), claim)?;
        }
        let ciphertext = match &config.cache_url {
            Some(url) => {
                let settings = CacheSettings { url: url.clone(), roots: config.cache_roots.clone() };
                Ciphertext::cached(&ledger, &settings)?
            }
            None => Ciphertext::of(&ledger),
        };
        let provider = provider(config.provider);
        let plant = Plant { ledger: ledger.clone(), ciphertext, provider, observer: hub.clone() };
        let life = Arc::new(Lifetime::new());
        let (open, opened) = mpsc::unbounded_channel();
        let parts = Self {
            supervisor: Arc::new(Supervisor::new(Arc::clone(&hub), Arc::clone(&life))),
            log: Arc::new(Log::new(ledger.audit.clone(), Arc::clone(&hub))),
            owners: Arc::new(Owners::new(home.clone(), open)),
            link: Arc::new(Link::new(Arc::clone(&hub), needs_chain)),
            sender: Arc::new(Sender::new(ledger, hub.clone(), Policy { cap: config.max_fee, floor: config.min_price })),
            home,
            config: Arc::new(config),
            plant,
            hub,
            life,
            runs: Runs::default(),
        };
        Ok((parts, opened, copied))
    }

    /// Whether this is a gateway's home whose records are in a database.
    pub fn is_on_server(&self) -> bool {
        self.config.store_url.is_some()
    }

    /// Whether the chain is known only from a gateway's word.
    pub fn is_joined(&self) -> bool {
        self.config.site.is_some()
    }
}
