//! Starts the background tasks of a site: sealer, watcher, anchorers, verifier.

use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::mpsc;

use super::audit::Audit;
use super::capture::ros::RosSide;
use super::chain::administration::Administering;
use super::chain::connection::Connection;
use super::chain::lanes::Lanes;
use super::chain::link;
use super::clock::Clock;
use super::devices::Devices;
use super::evidence::{ChainProofs, TimeStamps};
use super::mirror::Joined;
use super::quarantine::Quarantine;
use super::sharing::Sharing;
use super::standstill::Standstill;
use super::storage::Storage;
use super::{Needs, NetworkState, Site};
use crate::chain::ChainError;
use crate::pipeline::anchorer::Anchorer;
use crate::pipeline::stages::Stage;
use crate::pipeline::{Owner, PipelineError, verifier, watcher};
use crate::service::event::{NoticeLevel, Part};
use crate::service::hub::Hub;
use crate::service::reply::{Failure, Result};

/// Shortest interval between looks at an owner's records: each queries all of the owner's topics.
const BETWEEN_LOOKS: Duration = Duration::from_millis(25);

/// Pause after a look, as a multiple of its length: with many topics a look is slow.
const TIMES_A_LOOK: u32 = 4;

pub(super) fn start(site: &Arc<Site>, needs: Needs, mut opened: mpsc::UnboundedReceiver<Arc<Owner>>) -> Result<()> {
    let supervisor = &site.parts.supervisor;
    supervisor.keep("news", &site.parts.hub, Hub::run);
    if site.parts.home.original().is_some() {
        // This site only reads: it captures, sends and keeps nothing.
        if needs.chain {
            supervisor.keep("chain", &site.connection, Connection::keep_connected);
        }
        return Ok(());
    }
    supervisor.keep("audit", &site.audit, Audit::keep);
    supervisor.keep("quarantine", &site.quarantine, Quarantine::keep);
    supervisor.keep("room", &site.storage, Storage::keep_room);
    supervisor.keep("clock", &site.clock, Clock::keep);
    tokio::spawn(Arc::clone(&site.storage).check_after_crash());
    supervisor.keep("retention", &site.storage, Storage::keep_retention);
    let starting = Arc::clone(site);
    tokio::spawn(async move {
        loop {
            tokio::select! {
                Some(owner) = opened.recv() => starting.work_for(&owner),
                () = starting.stopped() => return,
            }
        }
    });
    if needs.ros {
        site.sealer.begin()?;
        let task = supervisor.keep_while("ros", &site.ros, |ros| ros.is_wanted(), RosSide::keep);
        *site.ros_task.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = Some(task);
    }
    if needs.chain {
        supervisor.keep("chain", &site.connection, Connection::keep_connected);
        supervisor.keep("owners", site, resume_owners);
        supervisor.keep("watcher", site, watch);
        if site.stamps.is_wanted() {
            supervisor.keep("time stamps", &site.stamps, TimeStamps::keep);
        }
        supervisor.keep("chain proofs", &site.chain_proofs, ChainProofs::keep);
        supervisor.keep("verifier", site, verify);
        supervisor.keep("stages", &site.standstill, Standstill::keep);
        supervisor.keep("scrubber", &site.audit, Audit::keep_scrubbing);
        supervisor.keep("expiry", &site.sharing, Sharing::keep_settled);
        supervisor.keep("parties", &site.administering, Administering::keep_parties_known);
    }
    Ok(())
}

async fn watch(site: Arc<Site>) {
    let (mut seen, mut state) = (0, site.parts.link.follow());
    while !site.parts.life.is_stopping() {
        let Some(network) = site.parts.link.network_now() else {
            if state.changed().await.is_err() {
                return;
            }
            continue;
        };
        let begun = Instant::now();
        let pause = match watcher::watch_round(&site.plant, &network).await {
            Ok(head) => {
                // The head was requested when the round began at the earliest. Those waiting for its block look next.
                site.parts.link.saw_head(head, begun);
                site.parts.link.has_scanned(head.number);
                site.parts.hub.stages.spent(Stage::Watch, begun.elapsed());
                site.parts.link.answers(true);
                // Only a gateway needs this, and it costs a few requests.
                if site.gateway.is_serving() {
                    site.parts.link.measure(&network.chain).await;
                }
                if head.number != seen {
                    seen = head.number;
                    site.parts.hub.changed(Part::Chain);
                    site.parts.hub.confirmed.notify_one();
                }
                site.lanes.tend(&network).await;
                network.chain.next_block(head.number, watcher::PATIENCE).await.err().map(|error| away(&error))
            }
            Err(PipelineError::Chain(error @ ChainError::Swapped { .. })) => {
                site.parts.link.lose_chain(error.into());
                continue;
            }
            Err(error @ PipelineError::NodeBehind { .. }) => {
                Some(format!("the chain's node is behind; anchoring is paused, records are safe: {error}"))
            }
            Err(error) => Some(away(&error)),
        };
        if let Some(problem) = pause {
            site.parts.link.answers(false);
            site.parts.hub.notice_about(link::ABOUT, NoticeLevel::Error, &problem);
            tokio::time::sleep(Duration::from_secs(2)).await;
        }
    }
}

fn away(error: &dyn std::fmt::Display) -> String {
    format!("the chain does not answer; anchoring is paused, records are safe: {error}")
}

async fn verify(site: Arc<Site>) {
    while !site.parts.life.is_stopping() {
        tokio::select! {
            () = site.parts.hub.confirmed.notified() => {}
            () = tokio::time::sleep(Duration::from_secs(1)) => {}
        }
        while let Some(network) = site.parts.link.network_now() {
            let plant = site.plant.clone();
            let round = tokio::task::spawn_blocking(move || verifier::verify_round(&plant, &network)).await;
            match round {
                Ok(Ok(0)) => break,
                Ok(Ok(_)) => {}
                Ok(Err(error)) => {
                    site.parts.hub.alarm(&format!("records cannot be verified at the moment and are waiting: {error}"));
                    tokio::time::sleep(Duration::from_secs(1)).await;
                    break;
                }
                // The supervisor reports a panic and recovers.
                Err(error) => return pass_on(error),
            }
        }
    }
}

/// Turns a panic of a part into a panic of the whole task.
fn pass_on(error: tokio::task::JoinError) {
    if let Ok(panic) = error.try_into_panic() {
        std::panic::resume_unwind(panic);
    }
}

impl Site {
    pub(super) fn work_for(self: &Arc<Self>, owner: &Arc<Owner>) {
        self.keep_for(owner, "anchorer", self, anchor);
        if self.parts.config.lanes > 1 {
            self.keep_for(owner, "lanes", &self.lanes, Lanes::keep_extra);
        }
        self.keep_for(owner, "courier", &self.devices, Devices::keep_attending);
        if self.joined.remote.is_some() {
            self.keep_for(owner, "mirror", &self.joined, Joined::mirror);
        }
    }

    /// Keeps work for an owner running until the owner is closed or the site ends.
    fn keep_for<Whose, Work, Run>(&self, owner: &Arc<Owner>, name: &str, part: &Arc<Whose>, work: Work)
    where
        Whose: Send + Sync + 'static,
        Work: Fn(Arc<Whose>, Arc<Owner>) -> Run + Send + 'static,
        Run: Future<Output = ()> + Send + 'static,
    {
        let name = format!("{name} {}", owner.profile);
        let (owners, owner, given) = (Arc::clone(&self.parts.owners), Arc::clone(owner), Arc::clone(owner));
        let is_wanted = move |_: &Arc<Whose>| owners.is_open(&owner);
        self.parts.supervisor.keep_while(&name, part, is_wanted, move |part| work(part, Arc::clone(&given)));
    }
}

/// Resumes at each open owner's state on the chain, whenever the network comes up.
async fn resume_owners(site: Arc<Site>) {
    let mut state = site.parts.link.follow();
    while !site.parts.life.is_stopping() {
        tokio::select! {
            up = state.wait_for(|state| matches!(state, NetworkState::Up(_))) => if up.is_err() { return },
            () = site.parts.life.stopped() => return,
        }
        for owner in site.parts.owners.all() {
            if let Err(failure) = site.profiles.resume(&owner).await {
                site.parts.hub.alarm(&failure.message);
            }
        }
        if state.changed().await.is_err() {
            return;
        }
    }
}

/// Anchors one owner's records until the owner is closed or the site ends.
async fn anchor(site: Arc<Site>, owner: Arc<Owner>) {
    let mut pause = Duration::from_millis(250);
    let mut anchorer = Anchorer::new(site.parts.config.anchor_mode);
    let mut scanned = site.parts.link.scans();
    while !site.parts.life.is_stopping() && site.parts.owners.is_open(&owner) {
        let Some(network) = site.parts.link.network_now() else {
            tokio::time::sleep(Duration::from_millis(200)).await;
            continue;
        };
        // Subscribed before the round, so that nothing stored meanwhile is missed.
        let stored = site.parts.hub.stored.notified();
        let begun = Instant::now();
        let round = async {
            let lanes = site.lanes.of(&owner, &network)?;
            let (sender, account) = (&site.parts.sender, owner.address);
            Ok::<_, Failure>(anchorer.round(&site.plant, &network, sender, account, &lanes).await?)
        };
        match round.await {
            Ok(round) => {
                site.parts.hub.stages.spent(Stage::Anchor, begun.elapsed());
                pause = Duration::from_millis(250);
                if round.submitted > 0 {
                    site.parts.hub.changed(Part::Uploads);
                }
                if !round.next.is_zero() {
                    let look = if round.submitted == 0 { begun.elapsed() } else { Duration::ZERO };
                    let rest = round.next.min(BETWEEN_LOOKS.max(look * TIMES_A_LOOK));
                    tokio::time::sleep(rest).await;
                    tokio::select! {
                        () = stored => {}
                        // A block may have freed a lane.
                        _ = scanned.changed() => {}
                        () = tokio::time::sleep(round.next.saturating_sub(rest)) => {}
                    }
                }
            }
            Err(error) => {
                let why = format!("records of {} are waiting to be anchored: {}", owner.profile, error.message);
                link::tell_trouble(&site.parts.hub, error.kind, &why);
                tokio::time::sleep(pause).await;
                pause = (pause * 2).min(Duration::from_secs(5));
            }
        }
    }
}
