//! Starts the background tasks of a site: sealer, storer, watcher, anchorers, verifier.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::{Needs, Site};
use crate::chain::ChainError;
use crate::model::{Address, Domain};
use crate::pipeline::adoption::{self, Word};
use crate::pipeline::anchorer::{Anchorer, Round};
use crate::pipeline::sealer::Sealer;
use crate::pipeline::stages::Stage;
use crate::pipeline::{Network, Owner, PipelineError, storer, verifier, watcher};
use crate::service::event::{NoticeLevel, Part};
use crate::service::failure::internal;
use crate::service::reply::Failure;

/// The longest pause between two attempts to send what the chain is owed.
const LONGEST_REST: Duration = Duration::from_secs(60);

/// Starts all tasks that the run needs.
pub(super) fn start(site: &Arc<Site>, needs: Needs) -> Result<(), Failure> {
    tokio::spawn(Arc::clone(&site.hub).run());
    tokio::spawn(Arc::clone(site).keep_audit());
    tokio::spawn(Arc::clone(site).keep_quarantine());
    if needs.ros {
        start_sealer(site)?;
        let task = tokio::spawn(Arc::clone(site).keep_ros());
        *site.ros_task.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = Some(task);
    }
    if needs.chain {
        if !site.plant.vault.durable() {
            start_storer(site)?;
        }
        tokio::spawn(Arc::clone(site).keep_connected());
        tokio::spawn(watch(Arc::clone(site)));
        tokio::spawn(verify(Arc::clone(site)));
        tokio::spawn(Arc::clone(site).expire_grants());
        tokio::spawn(Arc::clone(site).keep_parties_known());
    }
    Ok(())
}

fn thread(name: &str, work: impl FnOnce() + Send + 'static) -> Result<std::thread::JoinHandle<()>, Failure> {
    let spawned = std::thread::Builder::new().name(name.to_owned()).spawn(work);
    spawned.map_err(|error| internal(format!("thread {name} cannot be started: {error}")))
}

fn start_sealer(site: &Arc<Site>) -> Result<(), Failure> {
    let mut sealer = Sealer::new(site.plant.clone(), Arc::clone(&site.hub.sessions));
    let (ring, hub) = (Arc::clone(&site.ring), Arc::clone(&site.hub));
    let handle = thread("sealer", move || sealer.run(&ring, &|| hub.stored.notify_waiters()))?;
    *site.sealer.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = Some(handle);
    Ok(())
}

fn start_storer(site: &Arc<Site>) -> Result<(), Failure> {
    let (plant, hub, weak) = (site.plant.clone(), Arc::clone(&site.hub), Arc::downgrade(site));
    let stopped = move || weak.upgrade().is_none_or(|site| site.is_stopping());
    thread("storer", move || {
        storer::run(&plant, &stopped, &|pause| std::thread::sleep(pause.min(Duration::from_secs(1))), &|| {
            hub.stored.notify_waiters()
        });
    })?;
    Ok(())
}

async fn watch(site: Arc<Site>) {
    let (mut seen, mut state) = (0, site.network.subscribe());
    while !site.is_stopping() {
        let Some(network) = site.network_now() else {
            if state.changed().await.is_err() {
                return;
            }
            continue;
        };
        let begun = Instant::now();
        let pause = match watcher::watch_round(&site.plant, &network).await {
            Ok(head) => {
                site.scanned.send_replace(head.number);
                site.hub.stages.spent(Stage::Watch, begun.elapsed());
                site.chain_answers(true);
                site.saw_head(head);
                if head.number != seen {
                    seen = head.number;
                    site.changed(Part::Chain);
                    site.hub.confirmed.notify_one();
                }
                site.tend_lanes(&network).await;
                network.chain.next_block(head.number, watcher::PATIENCE).await.err().map(|error| error.to_string())
            }
            Err(PipelineError::Chain(error @ ChainError::Swapped { .. })) => {
                site.lose_chain(error.into());
                continue;
            }
            Err(error) => Some(error.to_string()),
        };
        if let Some(problem) = pause {
            site.chain_answers(false);
            site.hub.notice(
                NoticeLevel::Error,
                &format!("the chain does not answer; anchoring waits, nothing is lost: {problem}"),
            );
            tokio::time::sleep(Duration::from_secs(2)).await;
        }
    }
}

async fn verify(site: Arc<Site>) {
    while !site.is_stopping() {
        tokio::select! {
            () = site.hub.confirmed.notified() => {}
            () = tokio::time::sleep(Duration::from_secs(1)) => {}
        }
        while let Some(network) = site.network_now() {
            let plant = site.plant.clone();
            let round = tokio::task::spawn_blocking(move || verifier::verify_round(&plant, &network)).await;
            match round {
                Ok(Ok(0)) => break,
                Ok(Ok(_)) => {}
                Ok(Err(error)) => {
                    site.hub.notice(NoticeLevel::Error, &format!("records cannot be verified now, they wait: {error}"));
                    tokio::time::sleep(Duration::from_secs(1)).await;
                    break;
                }
                Err(_) => return,
            }
        }
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
    let lanes = site.lanes(owner, network)?;
    Ok(anchorer.round(&site.plant, network, &site.sender, owner, &lanes).await?)
}

/// Anchors the records of one owner until the owner is closed or the site ends.
pub(super) async fn anchor(site: Arc<Site>, owner: Arc<Owner>) {
    let mut pause = Duration::from_millis(250);
    let mut anchorer = Anchorer::new(site.config.anchor_mode);
    let mut spoken = None;
    let mut scanned = site.scanned.subscribe();
    while !site.is_stopping() {
        let still_open = site.owner(&owner.profile).is_some_and(|other| Arc::ptr_eq(&other, &owner));
        if !still_open {
            return;
        }
        let Some(network) = site.network_now() else {
            tokio::time::sleep(Duration::from_millis(200)).await;
            continue;
        };
        let begun = Instant::now();
        match anchor_round(&site, &mut anchorer, &network, &owner, &mut spoken).await {
            Ok(round) => {
                site.hub.stages.spent(Stage::Anchor, begun.elapsed());
                pause = Duration::from_millis(250);
                if round.submitted > 0 {
                    site.changed(Part::Uploads);
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
                pause = (pause * 2).min(Duration::from_secs(10));
            }
        }
    }
}

impl Site {
    /// Sends what the chain is owed, and after a failure again with growing pauses.
    async fn expire_grants(self: Arc<Self>) {
        let mut resting: HashMap<Address, (Instant, Duration)> = HashMap::new();
        while !self.is_stopping() {
            tokio::select! {
                () = tokio::time::sleep(Duration::from_secs(1)) => {}
                () = self.stopped() => return,
            }
            let Some(network) = self.network_now() else { continue };
            for owner in self.all_owners() {
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
