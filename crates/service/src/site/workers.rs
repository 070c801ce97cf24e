//! Starts the background tasks of a site: sealer, storer, watcher, anchorers, verifier.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::mpsc;

use super::audit::Audit;
use super::chain::lanes::Lanes;
use super::clock::Clock;
use super::quarantine::Quarantine;
use super::storage::Storage;
use super::{Needs, RosState, Site};
use crate::chain::ChainError;
use crate::model::{Address, Domain};
use crate::pipeline::adoption::{self, Word};
use crate::pipeline::anchorer::{Anchorer, Round};
use crate::pipeline::sealer::Sealer;
use crate::pipeline::stages::Stage;
use crate::pipeline::{Network, Owner, PipelineError, storer, verifier, watcher};
use crate::service::event::{NoticeLevel, Part};
use crate::service::hub::Hub;
use crate::service::reply::Failure;

/// The longest pause between two attempts to send what the chain is owed.
const LONGEST_REST: Duration = Duration::from_secs(8);

/// Starts all tasks that the run needs.
pub(super) fn start(
    site: &Arc<Site>,
    needs: Needs,
    opened: mpsc::UnboundedReceiver<Arc<Owner>>,
) -> Result<(), Failure> {
    site.supervisor.keep("news", &site.hub, Hub::run);
    site.supervisor.keep("audit", &site.audit, Audit::keep);
    site.supervisor.keep("quarantine", &site.quarantine, Quarantine::keep);
    site.supervisor.keep("room", &site.storage, Storage::keep_room);
    site.supervisor.keep("clock", &site.clock, Clock::keep);
    tokio::spawn(Arc::clone(&site.storage).check_after_crash());
    site.supervisor.keep("retention", &site.storage, Storage::keep_retention);
    begin_with_owners(site, opened);
    if needs.ros {
        seal_here(site)?;
        let here = |site: &Arc<Site>| !matches!(*site.ros.borrow(), RosState::Off);
        let task = site.supervisor.keep_while("ros", site, here, Site::keep_ros);
        *site.ros_task.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = Some(task);
    }
    if needs.chain {
        if !site.plant.vault.durable() {
            start_storer(site)?;
        }
        site.supervisor.keep("chain", site, Site::keep_connected);
        site.supervisor.keep("watcher", site, watch);
        site.supervisor.keep("verifier", site, verify);
        site.supervisor.keep("scrubber", &site.audit, Audit::keep_scrubbing);
        site.supervisor.keep("expiry", site, Site::expire_grants);
        site.supervisor.keep("parties", site, Site::keep_parties_known);
    }
    Ok(())
}

/// Begins what is done for each owner as it is opened.
fn begin_with_owners(site: &Arc<Site>, mut opened: mpsc::UnboundedReceiver<Arc<Owner>>) {
    let site = Arc::clone(site);
    tokio::spawn(async move {
        loop {
            tokio::select! {
                owner = opened.recv() => match owner {
                    Some(owner) => site.work_for(&owner),
                    None => return,
                },
                () = site.life.stopped() => return,
            }
        }
    });
}

/// Starts the sealer where this run has none yet: one that captures nothing still may import.
pub(super) fn seal_here(site: &Arc<Site>) -> Result<(), Failure> {
    let mut sealer = site.sealer.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    if sealer.is_none() && !site.rings.is_closed() {
        *sealer = Some(start_sealer(site)?);
    }
    Ok(())
}

fn start_sealer(site: &Arc<Site>) -> Result<std::thread::JoinHandle<()>, Failure> {
    let (plant, hub, losses) = (site.plant.clone(), Arc::clone(&site.hub), Arc::clone(&site.losses));
    let (rings, compression) = (Arc::clone(&site.rings), site.config.compression);
    site.supervisor.keep_thread("sealer", move || {
        let sealer = Sealer::new(plant.clone(), Arc::clone(&hub.sessions), Arc::clone(&losses));
        let mut sealer = if compression { sealer } else { sealer.without_compression() };
        sealer.run(&rings, &|| hub.stored.notify_waiters());
    })
}

fn start_storer(site: &Arc<Site>) -> Result<(), Failure> {
    let (plant, hub, weak) = (site.plant.clone(), Arc::clone(&site.hub), Arc::downgrade(&site.life));
    let stopped = move || weak.upgrade().is_none_or(|life| life.is_stopping());
    site.supervisor.keep_thread("storer", move || {
        storer::run(&plant, &stopped, &|pause| std::thread::sleep(pause.min(Duration::from_secs(1))), &|| {
            hub.stored.notify_waiters()
        });
    })?;
    Ok(())
}

async fn watch(site: Arc<Site>) {
    let (mut seen, mut state) = (0, site.link.follow());
    while !site.life.is_stopping() {
        let Some(network) = site.link.network_now() else {
            if state.changed().await.is_err() {
                return;
            }
            continue;
        };
        let begun = Instant::now();
        let pause = match watcher::watch_round(&site.plant, &network).await {
            Ok(head) => {
                site.link.has_scanned(head.number);
                site.hub.stages.spent(Stage::Watch, begun.elapsed());
                site.link.answers(true);
                site.link.saw_head(head);
                if head.number != seen {
                    seen = head.number;
                    site.hub.changed(Part::Chain);
                    site.hub.confirmed.notify_one();
                }
                site.lanes.tend(&network).await;
                network.chain.next_block(head.number, watcher::PATIENCE).await.err().map(|error| error.to_string())
            }
            Err(PipelineError::Chain(error @ ChainError::Swapped { .. })) => {
                site.link.lose_chain(error.into());
                continue;
            }
            Err(error) => Some(error.to_string()),
        };
        if let Some(problem) = pause {
            site.link.answers(false);
            site.hub.notice(
                NoticeLevel::Error,
                &format!("the chain does not answer; anchoring waits, nothing is lost: {problem}"),
            );
            tokio::time::sleep(Duration::from_secs(2)).await;
        }
    }
}

async fn verify(site: Arc<Site>) {
    while !site.life.is_stopping() {
        tokio::select! {
            () = site.hub.confirmed.notified() => {}
            () = tokio::time::sleep(Duration::from_secs(1)) => {}
        }
        while let Some(network) = site.link.network_now() {
            let plant = site.plant.clone();
            let round = tokio::task::spawn_blocking(move || verifier::verify_round(&plant, &network)).await;
            match round {
                Ok(Ok(0)) => break,
                Ok(Ok(_)) => {}
                Ok(Err(error)) => {
                    // What a Redis does not do now its health says, and the one alert about it.
                    let is_told = matches!(&error, PipelineError::Store(error) if error.is_of_redis());
                    if !is_told {
                        let text = format!("records cannot be verified now, they wait: {error}");
                        site.hub.notice(NoticeLevel::Error, &text);
                    }
                    tokio::time::sleep(Duration::from_secs(1)).await;
                    break;
                }
                // A panic is the supervisor's to tell and to heal.
                Err(error) => return pass_on(error),
            }
        }
    }
}

/// Lets a panic of a part be the panic of the whole task.
fn pass_on(error: tokio::task::JoinError) {
    if let Ok(panic) = error.try_into_panic() {
        std::panic::resume_unwind(panic);
    }
}

/// One round; on an adopted chain nothing goes before the owner's word about that. `spoken` is where it was given.
async fn anchor_round(
    site: &Site,
    anchorer: &mut Anchorer,
    network: &Network,
    owner: &Owner,
    spoken: &mut Option<Domain>,
) -> Result<Round, Failure> {
    if *spoken != Some(network.domain) {
        if adoption::give_word(&site.plant, network, &site.sender, owner).await? == Word::OnItsWay {
            return Ok(Round { submitted: 0, next: Duration::from_millis(250) });
        }
        *spoken = Some(network.domain);
    }
    let lanes = site.lanes.of(owner, network)?;
    Ok(anchorer.round(&site.plant, network, &site.sender, owner, &lanes).await?)
}

impl Site {
    /// Begins what is done for each open owner, until the owner is closed or the site ends.
    pub(super) fn work_for(self: &Arc<Self>, owner: &Arc<Owner>) {
        let (name, given) = (&owner.profile, Arc::clone(owner));
        self.supervisor.keep_while(&format!("anchorer {name}"), self, while_open(self, owner), move |site| {
            anchor(site, Arc::clone(&given))
        });
        if self.config.lanes > 1 {
            let given = Arc::clone(owner);
            let work = move |lanes: Arc<Lanes>| lanes.keep_witnesses(Arc::clone(&given));
            self.supervisor.keep_while(&format!("witnesses {name}"), &self.lanes, while_open(self, owner), work);
        }
        if self.remote.is_some() {
            let given = Arc::clone(owner);
            let work = move |site: Arc<Site>| site.mirror(Arc::clone(&given));
            self.supervisor.keep_while(&format!("mirror {name}"), self, while_open(self, owner), work);
        }
    }
}

/// Whether work for an owner is still wanted.
fn while_open<Whose>(site: &Site, owner: &Arc<Owner>) -> impl Fn(&Arc<Whose>) -> bool + Send + 'static {
    let (owners, owner) = (Arc::clone(&site.owners), Arc::clone(owner));
    move |_| owners.is_open(&owner)
}

/// Anchors the records of one owner until the owner is closed or the site ends.
async fn anchor(site: Arc<Site>, owner: Arc<Owner>) {
    let mut pause = Duration::from_millis(250);
    let mut anchorer = Anchorer::new(site.config.anchor_mode);
    let mut spoken = None;
    let mut scanned = site.link.scans();
    while !site.life.is_stopping() {
        let still_open = site.owners.is_open(&owner);
        if !still_open {
            return;
        }
        let Some(network) = site.link.network_now() else {
            tokio::time::sleep(Duration::from_millis(200)).await;
            continue;
        };
        let begun = Instant::now();
        match anchor_round(&site, &mut anchorer, &network, &owner, &mut spoken).await {
            Ok(round) => {
                site.hub.stages.spent(Stage::Anchor, begun.elapsed());
                pause = Duration::from_millis(250);
                if round.submitted > 0 {
                    site.hub.changed(Part::Uploads);
                }
                if !round.next.is_zero() {
                    tokio::select! {
                        () = site.hub.stored.notified() => {}
                        // A block may have freed a lane.
                        _ = scanned.changed() => {}
                        () = tokio::time::sleep(round.next) => {}
                    }
                }
            }
            Err(error) => {
                site.hub.notice(
                    NoticeLevel::Error,
                    &format!("records of {} wait to be anchored: {}", owner.profile, error.message),
                );
                tokio::time::sleep(pause).await;
                pause = (pause * 2).min(Duration::from_secs(5));
            }
        }
    }
}

impl Site {
    /// Sends what the chain is owed, and after a failure again with growing pauses.
    async fn expire_grants(self: Arc<Self>) {
        let mut resting: HashMap<Address, (Instant, Duration)> = HashMap::new();
        while !self.life.is_stopping() {
            if !self.life.beat(Duration::from_secs(1)).await {
                return;
            }
            let Some(network) = self.link.network_now() else { continue };
            // What is overdue needs keys that a locked keyring does not have; keys sealed ahead hold without them.
            for owner in self.owners.all().into_iter().filter(|owner| !owner.is_locked()) {
                if resting.get(&owner.address).is_some_and(|(until, _)| Instant::now() < *until) {
                    continue;
                }
                let Err(failure) = self.settle_overdue(&owner, &network).await else {
                    resting.remove(&owner.address);
                    continue;
                };
                let pause = resting.get(&owner.address).map_or(Duration::from_secs(2), |(_, pause)| *pause * 2);
                let pause = pause.min(LONGEST_REST);
                resting.insert(owner.address, (Instant::now() + pause, pause));
                self.hub.notice(
                    NoticeLevel::Error,
                    &format!("the end of a grant of {} is not on the chain yet: {}", owner.profile, failure.message),
                );
            }
        }
    }
}
