//! The site: master, chain, vault and pipeline of one home, and the open profiles that use them.
//!
//! `start` brings the parts up in the background; requests wait for the parts they need. One
//! process of a home is the site, further ones join it over the socket (`service::socket`).

mod adoption;
mod agent;
mod audit;
mod backing_up;
mod beat;
mod capture;
mod chain_link;
mod clock;
mod contacts;
mod devices;
mod disk;
mod enrolling;
mod epochs;
mod exposure;
mod figures;
mod foreseeing;
mod gateway;
mod handle;
mod identity;
mod integrity;
mod keys;
mod lanes;
mod mirror;
mod naming;
mod opening;
mod operating;
mod overdue;
mod owners;
mod pairs;
mod pins;
mod policy;
mod quarantine;
mod record_audit;
mod recordings;
mod refusals;
mod remote;
mod retaining;
mod revoking;
mod robots;
mod sharing;
mod statements;
mod status;
mod succession;
mod supervision;
mod telling;
mod topics;
mod uploads;
mod view;
mod viewing;
mod workers;

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, RwLock};
use std::time::{Duration, Instant};

use tokio::sync::{broadcast, mpsc, watch};

pub use agent::{Agent, AgentEnd, AgentFigures, AgentWishes};
pub use chain_link::NetworkState;
pub use enrolling::EnrolWishes;
pub(super) use enrolling::Enrolled;
pub use robots::RosState;
pub use view::record_page;

use super::client::{Call, Client};
use super::event::{Event, Part};
use super::failure::internal;
use super::hub::Hub;
use super::reply::Failure;
use crate::chain::BlockRef;
use crate::config::Config;
use crate::crypto::provider;
use crate::model::{Address, ProfileName};
use crate::paths::Home;
use crate::pipeline::columns::Heads;
use crate::pipeline::recorder::CapturedMessage;
use crate::pipeline::ring::Rings;
use crate::pipeline::sender::Policy;
use crate::pipeline::{CaptureSession, Losses, Owner, PinRules, Pins, Plant, Recorder, Sender};
use crate::store::{AuditLog, RESERVE_BYTES, Reserve, SiteLock, open_vault};

/// How long the nodes may take to leave the ROS graph.
const LEAVING: Duration = Duration::from_secs(2);
/// How long captured messages may take to be stored at the end, counted from its beginning.
const FLUSHING: Duration = Duration::from_secs(4);

/// Which parts this run needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Needs {
    /// ROS master, robots, capture.
    pub ros: bool,
    /// Chain, anchoring, verification.
    pub chain: bool,
}

/// Everything of a running site.
pub struct Site {
    pub(crate) home: Home,
    pub(crate) config: Config,
    /// Ledger, vault and provider, which all its workers share.
    pub plant: Plant,
    pub(crate) hub: Arc<Hub>,
    pub(crate) sender: Arc<Sender>,
    recorder: Arc<Recorder>,
    /// The gateway that this site serves, if it does.
    served_gateway: Mutex<Option<operating::Serving>>,
    pins: Arc<Pins>,
    /// Quarantine records are sealed one at a time.
    reporting: tokio::sync::Mutex<()>,
    rings: Arc<Rings<CapturedMessage>>,
    losses: Arc<Losses>,
    audit: AuditLog,
    /// Heads of records opened for lists.
    heads: Heads,
    refusals: refusals::Refusals,
    reserve: Reserve,
    /// Space for the states of records on a full disk.
    states: Reserve,
    /// Changes of the watch lists happen one at a time.
    watching: Mutex<()>,
    /// Changes of the address book happen one at a time.
    contacts: tokio::sync::Mutex<()>,
    owners: RwLock<BTreeMap<ProfileName, Arc<Owner>>>,
    consoles: Mutex<HashSet<ProfileName>>,
    captures: Mutex<Vec<(ProfileName, Arc<CaptureSession>)>>,
    recordings: recordings::Runs,
    /// How many look at every topic of the graph now.
    learning: AtomicUsize,
    network: watch::Sender<NetworkState>,
    scanned: watch::Sender<u64>,
    ros: watch::Sender<RosState>,
    stopping: watch::Sender<bool>,
    /// Set as soon as the site was told to end; background tasks are not begun again from then on.
    ending: AtomicBool,
    tasks: supervision::Tasks,
    chain_silent: AtomicBool,
    /// The newest head, and when the chain told it.
    head_seen: Mutex<Option<(Instant, BlockRef)>>,
    /// The gateway through which this site joins another one.
    remote: Option<remote::Remote>,
    guests: AtomicUsize,
    deploying: tokio::sync::Mutex<()>,
    /// Who may use the gateway of this home, as far as it was read; changes happen one at a time.
    admitted: RwLock<Option<BTreeSet<Address>>>,
    admitting: tokio::sync::Mutex<()>,
    witnesses: Mutex<lanes::Witnesses>,
    sealer: Mutex<Option<std::thread::JoinHandle<()>>>,
    ros_task: Mutex<Option<tokio::task::JoinHandle<()>>>,
    _lock: SiteLock,
}

/// A request of a joined process.
pub(super) struct Guest(Arc<Site>);

impl Drop for Guest {
    fn drop(&mut self) {
        self.0.guests.fetch_sub(1, Ordering::AcqRel);
    }
}

impl Site {
    /// Opens ledger and vault and starts the parts needed.
    ///
    /// # Errors
    /// Where ledger or vault cannot be opened; chain and master come up (or fail) later.
    pub fn start(home: Home, config: Config, lock: SiteLock, needs: Needs) -> Result<Arc<Self>, Failure> {
        // Robots are where the gateway is.
        let needs = Needs { ros: needs.ros && config.site.is_none(), ..needs };
        let provider = provider(config.provider);
        let remote = config.site.as_ref().map(|site| remote::Remote::new(site, &home, provider)).transpose()?;
        let (events, _) = broadcast::channel(1024);
        let hub = Arc::new(Hub::new(events));
        let (ledger, copied) = disk::open_ledger(&home)?;
        let vault = open_vault(config.vault_url.as_deref(), &home.vault())?;
        let backlog = config.vault_backlog;
        let plant = Plant { ledger: ledger.clone(), vault, provider, observer: hub.clone(), backlog };
        let rings = Arc::new(Rings::new(usize::try_from(config.capture_memory).unwrap_or(usize::MAX)));
        let losses = Arc::new(Losses::default());
        let recorder = Recorder::new(Arc::clone(&rings), Arc::clone(&losses), hub.clone());
        let (reserve, reserved) = Reserve::open(&home.reserve(), RESERVE_BYTES);
        let states = disk::working_reserve(&home, config.disk_reserve);
        let rules = PinRules { mode: config.pin_mode, listed: config.publishers.clone() };
        let pins = Arc::new(Pins::new(ledger.clone(), hub.clone(), rules));
        let recorder = recorder.with_pins(Arc::clone(&pins)).with_rules(config.topic_rules.clone());
        let site = Arc::new(Self {
            recorder: Arc::new(recorder),
            pins,
            reporting: tokio::sync::Mutex::default(),
            sender: Arc::new(Sender::new(ledger, hub.clone(), Policy { cap: config.max_fee })),
            audit: AuditLog::new(plant.ledger.clone()),
            heads: Heads::default(),
            refusals: refusals::Refusals::default(),
            served_gateway: Mutex::default(),
            reserve,
            states,
            watching: Mutex::default(),
            contacts: tokio::sync::Mutex::default(),
            home,
            config,
            plant,
            hub,
            rings,
            losses,
            owners: RwLock::default(),
            consoles: Mutex::default(),
            captures: Mutex::default(),
            recordings: Mutex::default(),
            learning: AtomicUsize::new(0),
            network: watch::channel(if needs.chain { NetworkState::Connecting } else { NetworkState::Off }).0,
            scanned: watch::channel(0).0,
            ros: watch::channel(if needs.ros { RosState::Starting } else { RosState::Off }).0,
            stopping: watch::channel(false).0,
            ending: AtomicBool::new(false),
            tasks: supervision::Tasks::default(),
            chain_silent: AtomicBool::new(false),
            head_seen: Mutex::default(),
            remote,
            guests: AtomicUsize::new(0),
            deploying: tokio::sync::Mutex::default(),
            admitted: RwLock::default(),
            admitting: tokio::sync::Mutex::default(),
            witnesses: Mutex::default(),
            sealer: Mutex::default(),
            ros_task: Mutex::default(),
            _lock: lock,
        });
        site.warn_of_policy();
        if let Err(error) = reserved {
            let text = format!("no space could be set aside for a revoke on a full disk: {error}");
            site.hub.notice(super::event::NoticeLevel::Warning, &text);
        }
        workers::start(&site, needs)?;
        if copied {
            tokio::spawn(Arc::clone(&site).tell_of_copy());
        }
        Ok(site)
    }

    fn warn_of_policy(&self) {
        for warning in self.plant.vault.policy_warnings() {
            self.hub.notice(super::event::NoticeLevel::Warning, &warning);
        }
    }

    /// A client of this site, in this process.
    pub fn client(self: &Arc<Self>, profile: ProfileName) -> Client {
        let (calls, receiver) = mpsc::unbounded_channel();
        tokio::spawn(Arc::clone(self).serve(receiver));
        Client::new(profile, calls, self.hub.events().clone())
    }

    /// Answers calls until their sender is gone; consoles claimed through it are then free again.
    pub async fn serve(self: Arc<Self>, mut calls: mpsc::UnboundedReceiver<Call>) {
        let claims = handle::Claims::default();
        while let Some(Call { request, answer }) = calls.recv().await {
            let (site, claims) = (Arc::clone(&self), Arc::clone(&claims));
            tokio::spawn(async move {
                // Nobody waiting for the answer any more is no fault.
                drop(answer.send(site.handle(request, &claims).await));
            });
        }
        self.release(&claims);
    }

    /// Everything the site tells.
    pub fn events(&self) -> broadcast::Receiver<Event> {
        self.hub.events().subscribe()
    }

    pub(crate) fn changed(&self, part: Part) {
        self.hub.changed(part);
    }

    /// A joined process asks something; counted until the guard is dropped.
    pub(super) fn welcome(self: &Arc<Self>) -> Guest {
        self.guests.fetch_add(1, Ordering::AcqRel);
        Guest(Arc::clone(self))
    }

    /// Requests of joined processes that are not answered yet.
    pub fn guests(&self) -> usize {
        self.guests.load(Ordering::Acquire)
    }

    /// Whether the site is ending.
    pub fn is_stopping(&self) -> bool {
        *self.stopping.borrow()
    }

    /// Whether the site was told to end; it may still be storing what was captured.
    pub(super) fn is_ending(&self) -> bool {
        self.ending.load(Ordering::Acquire)
    }

    /// Waits until the site is ending.
    pub async fn stopped(&self) {
        let mut stopping = self.stopping.subscribe();
        // An error means that the site is gone, which is an end too.
        drop(stopping.wait_for(|stopping| *stopping).await);
    }

    /// Times of the line since the site began.
    pub fn stages(&self) -> &crate::pipeline::stages::Stages {
        &self.hub.stages
    }

    /// Ends the site within five seconds: no further capture, all captured messages acknowledged, files closed.
    pub async fn stop(self: Arc<Self>) {
        let begun = Instant::now();
        self.ending.store(true, Ordering::Release);
        self.ros.send_replace(RosState::Off);
        let ros = self.ros_task.lock().unwrap_or_else(std::sync::PoisonError::into_inner).take();
        if let Some(task) = ros {
            drop(tokio::time::timeout(LEAVING, task).await);
        }
        self.rings.close();
        let sealer = self.sealer.lock().unwrap_or_else(std::sync::PoisonError::into_inner).take();
        if let Some(thread) = sealer {
            let joined = tokio::task::spawn_blocking(move || thread.join());
            if tokio::time::timeout(FLUSHING.saturating_sub(begun.elapsed()), joined).await.is_err() {
                self.tell_unstored();
            }
        }
        self.stopping.send_replace(true);
        self.network.send_replace(NetworkState::Off);
        self.write_counted(None).await;
        let ledger = self.plant.ledger.clone();
        drop(tokio::task::spawn_blocking(move || ledger.close()).await);
    }

    /// Ledger or vault take nothing, and the process must end all the same.
    fn tell_unstored(&self) {
        let (messages, _) = self.rings.depth();
        let text = format!(
            "{messages} or more captured messages could not be stored before the end, they were never acknowledged; \
             see to disk and vault before the next start"
        );
        self.hub.notice(super::event::NoticeLevel::Error, &text);
    }

    pub(crate) fn owner(&self, profile: &ProfileName) -> Option<Arc<Owner>> {
        self.owners.read().unwrap_or_else(std::sync::PoisonError::into_inner).get(profile).cloned()
    }

    pub(crate) fn all_owners(&self) -> Vec<Arc<Owner>> {
        self.owners.read().unwrap_or_else(std::sync::PoisonError::into_inner).values().cloned().collect()
    }

    /// The owner behind a profile that is unlocked here.
    ///
    /// # Errors
    /// That it is locked or not there.
    pub fn unlocked(&self, profile: &ProfileName) -> Result<Arc<Owner>, Failure> {
        self.owner(profile).filter(|owner| !owner.is_locked()).ok_or_else(|| match self.home.keyring(profile).exists() {
            true => super::failure::refused(format!(
                "the keyring of profile '{profile}' is locked; unlock it with --passphrase-file or --passphrase-fd"
            )),
            false => super::failure::input(format!(
                "profile '{profile}' has no identity yet; make one with `authros --profile {profile} identity create`"
            )),
        })
    }

    pub(crate) async fn blocking<T: Send + 'static>(
        self: &Arc<Self>,
        work: impl FnOnce(&Self) -> Result<T, Failure> + Send + 'static,
    ) -> Result<T, Failure> {
        let site = Arc::clone(self);
        let joined = tokio::task::spawn_blocking(move || work(&site)).await;
        joined.unwrap_or_else(|_| Err(internal("a background task of the site failed; please report what you did")))
    }
}
