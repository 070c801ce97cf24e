//! The site: the parts of one home and the open profiles that use them. One process of a home is the site; others join
//! it over the socket.

mod agent;
mod alerts;
mod audit;
mod backup;
mod bridge;
mod capture;
mod chain;
mod clock;
mod consoles;
mod contacts;
mod devices;
mod evidence;
mod figures;
mod gateway;
mod handle;
mod identity;
mod incidents;
mod leading;
mod mirror;
mod operators;
mod parts;
mod pins;
mod quarantine;
mod reading;
mod recordings;
mod sharing;
mod status;
mod storage;
mod supervision;
#[cfg(test)]
mod supervision_tests;
#[cfg(test)]
pub(crate) mod testing;

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, OnceLock};
use std::time::{Duration, Instant};

use alerts::Alerts;
use audit::Audit;
use backup::Backup;
use bridge::Bridge;
use capture::ros::RosSide;
use capture::{Capture, SealerThread, Watches};
use chain::administration::Administering;
use chain::connection::Connection;
use chain::link::Lanes;
use clock::Clock;
use contacts::Contacts;
use devices::Devices;
use devices::enrolled::Enrolments;
use evidence::{ChainProofs, Evidence, TimeStamps};
use gateway::Admissions;
use gateway::Gateway;
use identity::Profiles;
use incidents::Incidents;
use mirror::Joined;
use mirror::remote::Remote;
use operators::Operators;
use parts::Parts;
use pins::Pinning;
use quarantine::Quarantine;
use reading::Reading;
use recordings::Recordings;
use serde::{Deserialize, Serialize};
use sharing::Sharing;
use storage::Storage;
use supervision::Standstill;
use tokio::sync::{broadcast, mpsc};

pub use self::devices::enrolled::EnrolWishes;
pub use agent::{Agent, AgentEnd, AgentFigures, AgentWishes};
pub use capture::ros::RosState;
pub use chain::connection::is_bound;
pub use chain::link::NetworkState;
pub(crate) use consoles::{Claims, joiner};
pub use evidence::definition_of;
pub(crate) use gateway::{join_key, opened as opened_system_keys};
pub(crate) use identity::keyring_faults;
pub(crate) use leading::standing as lease_standing;
pub(crate) use operators::{Asker, Heard};
pub use reading::own::record_page;
pub(crate) use storage::{STORE_LOST, misses_store, other_gateway, store_loss};

use crate::client::{Call, Client};
use crate::config::Config;
use crate::crypto::unfinished;
use crate::model::{ProfileName, locked};
use crate::paths::Home;
use crate::pipeline::{Anchors, CapturedMessage, Losses, Owner, PinRules, Pins, Plant, Recorder, Rings};
use crate::reply::{Event, Failure, Result, internal};
use crate::store::{RESERVE_BYTES, Reserve, SiteLock};
#[cfg(test)]
pub(crate) use gateway::sealed as sealed_system_keys;

/// Between looks at what the store says of its database.
const LOOK: Duration = Duration::from_secs(2);
/// Longest wait for the nodes to leave the ROS graph.
const LEAVING: Duration = Duration::from_secs(2);
/// Longest wait for the embedded chain to close its file.
const CLOSING: Duration = Duration::from_secs(2);
/// Time for captured messages to be stored, counted from the beginning of the end.
const FLUSHING: Duration = Duration::from_secs(4);

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Needs {
    /// ROS master, robots, capture.
    pub ros: bool,
    pub chain: bool,
}

pub struct Site {
    pub plant: Plant,
    parts: Parts,
    rings: Arc<Rings<CapturedMessage>>,
    losses: Arc<Losses>,
    recorder: Arc<Recorder>,
    ros: Arc<RosSide>,
    sealer: Arc<SealerThread>,
    connection: Arc<Connection>,
    lanes: Arc<Lanes>,
    administering: Arc<Administering>,
    joined: Arc<Joined>,
    profiles: Arc<Profiles>,
    contacts: Arc<Contacts>,
    sharing: Arc<Sharing>,
    devices: Arc<Devices>,
    reading: Arc<Reading>,
    evidence: Arc<Evidence>,
    incidents: Arc<Incidents>,
    stamps: Arc<TimeStamps>,
    chain_proofs: Arc<ChainProofs>,
    bridge: Arc<Bridge>,
    capture: Arc<Capture>,
    recordings: Arc<Recordings>,
    pins: Arc<Pinning>,
    quarantine: Arc<Quarantine>,
    admissions: Arc<Admissions>,
    operators: Arc<Operators>,
    gateway: Arc<Gateway>,
    audit: Arc<Audit>,
    backup: Arc<Backup>,
    storage: Arc<Storage>,
    clock: Arc<Clock>,
    alerts: Arc<Alerts>,
    standstill: Arc<Standstill>,
    consoles: Mutex<consoles::Consoles>,
    guests: AtomicUsize,
    pub(crate) needs: Needs,
    ros_task: Mutex<Option<tokio::task::JoinHandle<()>>>,
    _lock: SiteLock,
}

/// From a ROS graph to the store.
struct Intake {
    rings: Arc<Rings<CapturedMessage>>,
    losses: Arc<Losses>,
    recorder: Arc<Recorder>,
    pins: Arc<Pinning>,
    ros: Arc<RosSide>,
    watches: Arc<Watches>,
    sealer: Arc<SealerThread>,
}

impl Intake {
    fn of(parts: &Parts, needs: Needs) -> Self {
        let Parts { config, plant, hub, .. } = parts;
        let memory = usize::try_from(config.capture_memory).unwrap_or(usize::MAX);
        let (rings, losses) = (Arc::new(Rings::new(memory)), Arc::new(Losses::default()));
        let rules = PinRules { mode: config.pin_mode, listed: config.publishers.clone() };
        let judges = Arc::new(Pins::new(&plant.ledger, hub.clone(), rules));
        let recorder = Recorder::new(Arc::clone(&rings), Arc::clone(&losses), hub.clone());
        let recorder = recorder.with_pins(Arc::clone(&judges)).with_rules(config.topic_rules.clone());
        let (recorder, pins) = (Arc::new(recorder), Arc::new(Pinning { parts: parts.clone(), pins: judges }));
        let ros = Arc::new(RosSide::new(parts, &recorder, needs.ros));
        let watches = Arc::new(Watches::new(parts, &recorder, &ros));
        let sealer = Arc::new(SealerThread::new(parts, &rings, &losses));
        Self { rings, losses, recorder, pins, ros, watches, sealer }
    }
}

/// Owners and readers: what they share, and through which gateways.
struct Circle {
    contacts: Arc<Contacts>,
    reading: Arc<Reading>,
    enrolments: Arc<Enrolments>,
    connection: Arc<Connection>,
    joined: Arc<Joined>,
    sharing: Arc<Sharing>,
    admissions: Arc<Admissions>,
    gateway: Arc<Gateway>,
}

impl Circle {
    fn of(parts: &Parts, intake: &Intake, reserve: &Arc<Reserve>) -> Result<Self> {
        let remote = |site| Remote::new(site, &parts.home, parts.plant.provider).map(Arc::new);
        let remote = parts.config.site.as_ref().map(remote).transpose()?;
        let connection = Arc::new(Connection::new(parts, remote.clone()));
        let joined = Arc::new(Joined { parts: parts.clone(), remote: remote.clone() });
        let contacts = Arc::new(Contacts::new(parts));
        let (reading, enrolments) = (Arc::new(Reading::new(parts, &contacts)), Arc::new(Enrolments::new(parts)));
        let admissions = Arc::new(Admissions::new(parts, &contacts));
        let sharing = Arc::new(Sharing {
            parts: parts.clone(),
            contacts: Arc::clone(&contacts),
            enrolments: Arc::clone(&enrolments),
            joined: Arc::clone(&joined),
            reserve: Arc::clone(reserve),
            rings: Arc::clone(&intake.rings),
            ros: Arc::clone(&intake.ros),
            begun: Mutex::default(),
            missing: Mutex::default(),
        });
        let gateway = Arc::new(Gateway {
            parts: parts.clone(),
            sharing: Arc::clone(&sharing),
            admissions: Arc::clone(&admissions),
            anchors: Anchors::default(),
            serving: Mutex::default(),
            remote,
            passed_on: OnceLock::new(),
        });
        Ok(Self { contacts, reading, enrolments, connection, joined, sharing, admissions, gateway })
    }

    fn profiles(&self, intake: &Intake) -> Profiles {
        Profiles {
            parts: self.sharing.parts.clone(),
            connection: Arc::clone(&self.connection),
            sharing: Arc::clone(&self.sharing),
            enrolments: Arc::clone(&self.enrolments),
            gateway: Arc::clone(&self.gateway),
            reading: Arc::clone(&self.reading),
            pins: Arc::clone(&intake.pins),
            recorder: Arc::clone(&intake.recorder),
            watches: Arc::clone(&intake.watches),
        }
    }
}

/// A joined process's request.
pub(super) struct Guest(Arc<Site>);

impl Drop for Guest {
    fn drop(&mut self) {
        self.0.guests.fetch_sub(1, Ordering::AcqRel);
    }
}

/// Removes leftovers of killed processes: copies of a backup, which no erasure knows, and replacement files.
fn sweep(home: &Home) {
    unfinished::sweep_below(home.root());
    for (_, place) in home.outside() {
        let folder = if place.is_dir() { Some(place) } else { place.parent() };
        drop(folder.map(unfinished::sweep));
    }
}

impl Site {
    /// Opens the store and starts the needed parts; chain and master come up, or fail, later.
    pub fn start(home: Home, config: Config, lock: SiteLock, needs: Needs) -> Result<Arc<Self>> {
        // Robots are where the gateway is, and a gateway on a server captures nothing.
        let needs = Needs { ros: needs.ros && config.site.is_none() && config.store_url.is_none(), ..needs };
        sweep(&home);
        let (parts, opened, copied) = Parts::open(home, config, needs.chain)?;
        let (reserve, reserved) = Reserve::open(&parts.home.reserve(), RESERVE_BYTES);
        let site = Arc::new(Self::assemble(parts, &Arc::new(reserve), lock, needs)?);
        if let Err(error) = reserved {
            site.parts.hub.warn(&format!("no space could be reserved for a revoke on a full disk: {error}"));
        }
        leading::start(&site, needs, opened)?;
        if copied {
            tokio::spawn(Arc::clone(&site.storage).tell_of_copy());
        }
        Ok(site)
    }

    /// Builds the features over the shared parts.
    fn assemble(parts: Parts, reserve: &Arc<Reserve>, lock: SiteLock, needs: Needs) -> Result<Self> {
        let of = &parts;
        let intake = Intake::of(of, needs);
        let circle = Circle::of(of, &intake, reserve)?;
        let (lanes, stamps) = (Arc::new(Lanes::new(of)), Arc::new(TimeStamps::new(of)));
        let profiles = Arc::new(circle.profiles(&intake));
        let Intake { rings, losses, recorder, pins, ros, watches, sealer } = intake;
        let Circle { contacts, reading, enrolments, connection, joined, sharing, admissions, gateway } = circle;
        let capture = Arc::new(Capture::new(of, &recorder, &losses, &ros, &watches, &profiles, &pins));
        let evidence = Arc::new(Evidence::new(of, &reading, &stamps));
        let quarantine = Arc::new(Quarantine::new(of, &reading));
        Ok(Self {
            recordings: Arc::new(Recordings {
                parts: parts.clone(),
                contacts: Arc::clone(&contacts),
                reading: Arc::clone(&reading),
                capture: Arc::clone(&capture),
                profiles: Arc::clone(&profiles),
                sealer: Arc::clone(&sealer),
                rings: Arc::clone(&rings),
                evidence: Arc::clone(&evidence),
                claims: Arc::default(),
            }),
            devices: Arc::new(Devices::new(parts.clone(), Arc::clone(&sharing), enrolments)),
            administering: Arc::new(Administering { parts: parts.clone(), contacts: Arc::clone(&contacts) }),
            audit: Arc::new(Audit::new(of, reserve)),
            backup: Arc::new(Backup { parts: parts.clone(), quarantine: Arc::clone(&quarantine) }),
            evidence,
            incidents: Arc::new(Incidents { parts: parts.clone() }),
            stamps,
            chain_proofs: Arc::new(ChainProofs::new(of)),
            bridge: Arc::new(Bridge::new(of, &contacts, &ros)),
            storage: Arc::new(Storage::new(of, &reading)),
            clock: Arc::new(Clock { parts: parts.clone() }),
            alerts: Arc::new(Alerts::new(of)),
            standstill: Arc::new(Standstill {
                parts: parts.clone(),
                lanes: Arc::clone(&lanes),
                judge: Mutex::default(),
            }),
            operators: Arc::new(Operators { parts: parts.clone() }),
            plant: parts.plant.clone(),
            parts,
            rings,
            losses,
            recorder,
            ros,
            sealer,
            connection,
            lanes,
            joined,
            profiles,
            contacts,
            sharing,
            reading,
            capture,
            pins,
            quarantine,
            admissions,
            gateway,
            consoles: Mutex::default(),
            guests: AtomicUsize::new(0),
            needs,
            ros_task: Mutex::default(),
            _lock: lock,
        })
    }

    pub fn client(self: &Arc<Self>, profile: ProfileName) -> Client {
        let (calls, receiver) = mpsc::unbounded_channel();
        tokio::spawn(Arc::clone(self).serve(receiver, Claims::default()));
        Client::new(profile, calls, self.parts.hub.events().clone())
    }

    /// Answers calls until their sender is gone, then frees the consoles claimed through it.
    pub(super) async fn serve(self: Arc<Self>, mut calls: mpsc::UnboundedReceiver<Call>, claims: Claims) {
        while let Some(Call { request, answer }) = calls.recv().await {
            let (site, claims) = (Arc::clone(&self), Arc::clone(&claims));
            tokio::spawn(async move {
                // Nobody may be waiting for the answer any more.
                drop(answer.send(site.answer(request, &claims).await));
            });
        }
        self.release(&claims);
    }

    pub fn events(&self) -> broadcast::Receiver<Event> {
        self.parts.hub.events().subscribe()
    }

    /// Counts a joined process's request until the guard is dropped.
    pub(super) fn welcome(self: &Arc<Self>) -> Guest {
        self.guests.fetch_add(1, Ordering::AcqRel);
        Guest(Arc::clone(self))
    }

    /// Unanswered requests of joined processes.
    pub fn guests(&self) -> usize {
        self.guests.load(Ordering::Acquire)
    }

    pub async fn stopped(&self) {
        self.parts.life.stopped().await;
    }

    /// Returns when its database was restored to an earlier time: this process knows what is not there any more.
    pub async fn outdated(&self) -> Failure {
        loop {
            if let Some(error) = self.plant.ledger.restored_meanwhile() {
                return error.into();
            }
            tokio::time::sleep(LOOK).await;
        }
    }

    pub async fn chain(&self) -> Result<crate::chain::Chain> {
        self.parts.link.chain().await
    }

    pub async fn network(&self) -> Result<crate::pipeline::Network> {
        self.parts.link.network().await
    }

    pub fn unlocked(&self, profile: &ProfileName) -> Result<Arc<Owner>> {
        self.parts.owners.unlocked(profile)
    }

    pub async fn ros_uri(&self) -> Result<String> {
        self.ros.uri().await
    }

    pub fn place(&self) -> Home {
        self.parts.home.clone()
    }

    pub(crate) fn home(&self) -> &Home {
        &self.parts.home
    }

    pub(crate) fn config(&self) -> &Config {
        &self.parts.config
    }

    pub fn stages(&self) -> &crate::pipeline::stages::Stages {
        &self.parts.hub.stages
    }

    /// Keeps work for the whole site running until the site ends; aborting the handle ends it.
    pub(crate) fn supervise<Work, Run>(self: &Arc<Self>, name: &str, work: Work) -> tokio::task::JoinHandle<()>
    where
        Work: Fn(Arc<Self>) -> Run + Send + 'static,
        Run: Future<Output = ()> + Send + 'static,
    {
        self.parts.supervisor.keep(name, self, work)
    }

    /// Ends the site within five seconds: capture stops, captured messages are acknowledged, files closed.
    pub async fn stop(self: Arc<Self>) {
        let begun = Instant::now();
        self.parts.life.end();
        let ros = locked(&self.ros_task).take();
        self.ros.leave(ros, LEAVING).await;
        if !self.sealer.finish(FLUSHING.saturating_sub(begun.elapsed())).await {
            // The store cannot be written, and the process must still end.
            self.parts.hub.alarm(&format!(
                "{} or more captured messages could not be stored before shutdown; they were never acknowledged; check \
                 the disk before the next start",
                self.rings.depth().0
            ));
        }
        let chain = self.parts.link.connected();
        self.parts.life.stop();
        self.parts.link.set(NetworkState::Off);
        self.parts.log.write_counted(None).await;
        if let Some(chain) = chain {
            drop(tokio::time::timeout(CLOSING, chain.end()).await);
        }
        let Plant { ledger, ciphertext, .. } = self.plant.clone();
        let close = move || {
            ciphertext.close();
            ledger.close()
        };
        drop(tokio::task::spawn_blocking(close).await);
    }
}

/// Runs work that waits for the disk off the runtime's threads.
pub(crate) async fn blocking<Whose: Send + Sync + 'static, Done: Send + 'static>(
    part: &Arc<Whose>,
    work: impl FnOnce(&Whose) -> Result<Done> + Send + 'static,
) -> Result<Done> {
    let part = Arc::clone(part);
    let joined = tokio::task::spawn_blocking(move || work(&part)).await;
    joined.unwrap_or_else(|_| Err(internal("a background task of the site failed; please report this")))
}
