//! The site: master, chain, vault and pipeline of one home, and the open profiles that use them.
//!
//! `start` brings the parts up in the background; requests wait for the parts they need. One
//! process of a home is the site, further ones join it over the socket (`service::socket`).

mod agent;
mod audit;
mod backup;
mod capture;
mod chain;
mod clock;
mod contacts;
mod devices;
mod gateway;
mod handle;
mod identity;
mod lifetime;
mod mirror;
mod parts;
mod pins;
mod quarantine;
mod reading;
mod recordings;
mod sharing;
mod status;
mod storage;
mod supervision;
mod workers;

use std::collections::{BTreeSet, HashSet};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, RwLock};
use std::time::{Duration, Instant};

use tokio::sync::{broadcast, mpsc, watch};

pub use agent::{Agent, AgentEnd, AgentFigures, AgentWishes};
pub use capture::ros::RosState;
pub use chain::link::NetworkState;
pub use devices::enrolling::EnrolWishes;
pub(super) use devices::enrolling::Enrolled;
pub use reading::view::record_page;

use audit::{Audit, Log};
use backup::Backup;
use chain::lanes::Lanes;
use chain::link::Link;
use clock::Clock;
use contacts::Contacts;
use identity::owners::Owners;
use lifetime::Lifetime;
use parts::Parts;
use pins::Pinning;
use quarantine::Quarantine;
use reading::Reading;
use storage::Storage;
use supervision::Supervisor;

use super::client::{Call, Client};
use super::event::Event;
use super::failure::internal;
use super::hub::Hub;
use super::reply::Failure;
use crate::config::Config;
use crate::crypto::provider;
use crate::model::{Address, ProfileName};
use crate::paths::Home;
use crate::pipeline::recorder::CapturedMessage;
use crate::pipeline::ring::Rings;
use crate::pipeline::sender::Policy;
use crate::pipeline::{CaptureSession, Losses, Owner, PinRules, Pins, Plant, Recorder, Sender};
use crate::store::{RESERVE_BYTES, Reserve, SiteLock, open_vault};

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
    pub(crate) config: Arc<Config>,
    /// Ledger, vault and provider, which all its workers share.
    pub plant: Plant,
    pub(crate) hub: Arc<Hub>,
    pub(crate) sender: Arc<Sender>,
    recorder: Arc<Recorder>,
    /// The gateway that this site serves, if it does.
    served_gateway: Mutex<Option<gateway::status::Serving>>,
    contacts: Arc<Contacts>,
    pins: Arc<Pinning>,
    reading: Arc<Reading>,
    quarantine: Arc<Quarantine>,
    storage: Arc<Storage>,
    clock: Arc<Clock>,
    backup: Arc<Backup>,
    lanes: Arc<Lanes>,
    rings: Arc<Rings<CapturedMessage>>,
    losses: Arc<Losses>,
    life: Arc<Lifetime>,
    supervisor: Arc<Supervisor>,
    pub(crate) log: Arc<Log>,
    owners: Arc<Owners>,
    link: Arc<Link>,
    audit: Arc<Audit>,
    reserve: Arc<Reserve>,
    /// Changes of the watch lists happen one at a time.
    watching: Mutex<()>,
    consoles: Mutex<HashSet<ProfileName>>,
    captures: Mutex<Vec<(ProfileName, Arc<CaptureSession>)>>,
    recordings: recordings::Runs,
    /// How many look at every topic of the graph now.
    learning: AtomicUsize,
    ros: watch::Sender<RosState>,
    /// The gateway through which this site joins another one.
    remote: Option<mirror::remote::Remote>,
    guests: AtomicUsize,
    deploying: tokio::sync::Mutex<()>,
    /// Who may use the gateway of this home, as far as it was read; changes happen one at a time.
    admitted: RwLock<Option<BTreeSet<Address>>>,
    admitting: tokio::sync::Mutex<()>,
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
        let remote = config.site.as_ref().map(|site| mirror::remote::Remote::new(site, &home, provider)).transpose()?;
        let (events, _) = broadcast::channel(1024);
        let hub = Arc::new(Hub::new(events));
        let (ledger, copied) = storage::room::open_ledger(&home)?;
        let vault = open_vault(config.vault_url.as_deref(), &home.vault())?;
        let backlog = config.vault_backlog;
        let plant = Plant { ledger: ledger.clone(), vault, provider, observer: hub.clone(), backlog };
        let rings = Arc::new(Rings::new(usize::try_from(config.capture_memory).unwrap_or(usize::MAX)));
        let losses = Arc::new(Losses::default());
        let recorder = Recorder::new(Arc::clone(&rings), Arc::clone(&losses), hub.clone());
        let (reserve, reserved) = Reserve::open(&home.reserve(), RESERVE_BYTES);
        let rules = PinRules { mode: config.pin_mode, listed: config.publishers.clone() };
        let pins = Arc::new(Pins::new(ledger.clone(), hub.clone(), rules));
        let recorder = recorder.with_pins(Arc::clone(&pins)).with_rules(config.topic_rules.clone());
        let (config, reserve, life) = (Arc::new(config), Arc::new(reserve), Arc::new(Lifetime::new()));
        let supervisor = Arc::new(Supervisor::new(Arc::clone(&hub), Arc::clone(&life)));
        let sender = Arc::new(Sender::new(ledger.clone(), hub.clone(), Policy { cap: config.max_fee }));
        let log = Arc::new(Log::new(ledger, Arc::clone(&hub)));
        let (open, opened) = mpsc::unbounded_channel();
        let owners = Arc::new(Owners::new(home.clone(), open));
        let link = Arc::new(Link::new(Arc::clone(&hub), needs.chain));
        let audit = Audit {
            config: Arc::clone(&config),
            plant: plant.clone(),
            hub: Arc::clone(&hub),
            log: Arc::clone(&log),
            owners: Arc::clone(&owners),
            link: Arc::clone(&link),
            life: Arc::clone(&life),
            reserve: Arc::clone(&reserve),
        };
        let parts = Parts {
            home: home.clone(),
            config: Arc::clone(&config),
            plant: plant.clone(),
            hub: Arc::clone(&hub),
            log: Arc::clone(&log),
            owners: Arc::clone(&owners),
            link: Arc::clone(&link),
            life: Arc::clone(&life),
            supervisor: Arc::clone(&supervisor),
            sender: Arc::clone(&sender),
        };
        let contacts = Arc::new(Contacts::new(&parts));
        let reading = Arc::new(Reading::new(&parts, Arc::clone(&contacts)));
        let quarantine = Arc::new(Quarantine::new(&parts, Arc::clone(&reading)));
        let site = Arc::new(Self {
            recorder: Arc::new(recorder),
            contacts,
            pins: Arc::new(Pinning::new(&parts, pins)),
            reading,
            backup: Arc::new(Backup::new(&parts, Arc::clone(&quarantine))),
            quarantine,
            storage: Arc::new(Storage::new(&parts)),
            clock: Arc::new(Clock::new(&parts)),
            lanes: Arc::new(Lanes::new(&parts)),
            sender,
            life,
            supervisor,
            log,
            owners,
            link,
            audit: Arc::new(audit),
            served_gateway: Mutex::default(),
            reserve,
            watching: Mutex::default(),
            home,
            config,
            plant,
            hub,
            rings,
            losses,
            consoles: Mutex::default(),
            captures: Mutex::default(),
            recordings: Mutex::default(),
            learning: AtomicUsize::new(0),
            ros: watch::channel(if needs.ros { RosState::Starting } else { RosState::Off }).0,
            remote,
            guests: AtomicUsize::new(0),
            deploying: tokio::sync::Mutex::default(),
            admitted: RwLock::default(),
            admitting: tokio::sync::Mutex::default(),
            sealer: Mutex::default(),
            ros_task: Mutex::default(),
            _lock: lock,
        });
        site.warn_of_policy();
        if let Err(error) = reserved {
            let text = format!("no space could be set aside for a revoke on a full disk: {error}");
            site.hub.notice(super::event::NoticeLevel::Warning, &text);
        }
        workers::start(&site, needs, opened)?;
        if copied {
            tokio::spawn(Arc::clone(&site.storage).tell_of_copy());
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

    /// A joined process asks something; counted until the guard is dropped.
    pub(super) fn welcome(self: &Arc<Self>) -> Guest {
        self.guests.fetch_add(1, Ordering::AcqRel);
        Guest(Arc::clone(self))
    }

    /// Requests of joined processes that are not answered yet.
    pub fn guests(&self) -> usize {
        self.guests.load(Ordering::Acquire)
    }

    /// Waits until the site is ending.
    pub async fn stopped(&self) {
        self.life.stopped().await;
    }

    /// The chain, as soon as the first attempt has ended.
    ///
    /// # Errors
    /// Why the link is down.
    pub async fn chain(&self) -> Result<crate::chain::Chain, Failure> {
        self.link.chain().await
    }

    /// The network with its contract.
    ///
    /// # Errors
    /// Why the link is down, or that no contract is known yet.
    pub async fn network(&self) -> Result<crate::pipeline::Network, Failure> {
        self.link.network().await
    }

    /// The owner behind a profile that is unlocked here.
    ///
    /// # Errors
    /// That it is locked or not there.
    pub fn unlocked(&self, profile: &ProfileName) -> Result<Arc<Owner>, Failure> {
        self.owners.unlocked(profile)
    }

    /// Times of the line since the site began.
    pub fn stages(&self) -> &crate::pipeline::stages::Stages {
        &self.hub.stages
    }

    /// Keeps work for the whole site going until the site ends; aborting the handle ends it.
    pub(crate) fn supervise<Work, Run>(self: &Arc<Self>, name: &str, work: Work) -> tokio::task::JoinHandle<()>
    where
        Work: Fn(Arc<Self>) -> Run + Send + 'static,
        Run: Future<Output = ()> + Send + 'static,
    {
        self.supervisor.keep(name, self, work)
    }

    /// Ends the site within five seconds: no further capture, all captured messages acknowledged, files closed.
    pub async fn stop(self: Arc<Self>) {
        let begun = Instant::now();
        self.life.end();
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
        self.life.stop();
        self.link.set(NetworkState::Off);
        self.log.write_counted(None).await;
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
}

/// Does work for a part that waits for the disk, off the runtime's threads.
pub(crate) async fn blocking<Whose: Send + Sync + 'static, Done: Send + 'static>(
    part: &Arc<Whose>,
    work: impl FnOnce(&Whose) -> Result<Done, Failure> + Send + 'static,
) -> Result<Done, Failure> {
    let part = Arc::clone(part);
    let joined = tokio::task::spawn_blocking(move || work(&part)).await;
    joined.unwrap_or_else(|_| Err(internal("a background task of the site failed; please report what you did")))
}
