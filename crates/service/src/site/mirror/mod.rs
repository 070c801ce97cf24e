//! Mirrors a profile's records of the joined gateway here: lists and fetches what is missing, then takes records as they
//! come. A lost connection is opened again, with pauses that grow to five seconds.

mod listing;
mod own_erasures;
mod pacing;
pub(super) mod remote;

use crate::paths::Home;
use crate::pipeline::Plant;
use crate::service::hub::Hub;
use crate::site::audit::Log;
use crate::site::chain::link::Link;
use crate::site::identity::Owners;
use crate::site::lifetime::Lifetime;
use crate::site::parts::Parts;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::mpsc;
use tokio::task::block_in_place;

use self::listing::{follow, subscribe};
use super::supervision::Aborted;
use crate::gateway::{Code, Entry, Fetched, GatewayError};
use crate::model::Address;
use crate::pipeline::mirror::{Anchors, Mirror, sources};
use crate::pipeline::{Network, Owner, PipelineError};
use crate::service::event::{NoticeLevel, Part};
use crate::service::reply::Failure;
use own_erasures::OwnErasures;
use pacing::{Missed, Pace};
use remote::{Mirrored, Remote};

/// The first pause after a failure, and the longest.
const PAUSES: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(5));
/// How often missing proofs are requested, and grants are looked at.
const TICK: Duration = Duration::from_millis(500);
/// Subscriptions of one connection; owners beyond that are listed now and then.
const SUBSCRIPTIONS: usize = 16;
/// How often owners without a subscription are listed.
const LISTING: Duration = Duration::from_secs(10);
/// How long a connection may be silent before it is tested.
const SILENCE: Duration = Duration::from_secs(30);
/// How long a gateway that does not know its chain now is asked again without a word.
const QUIET: Duration = Duration::from_secs(15);
/// Records that may wait to be stored.
const WAITING: usize = 64;

/// Why a mirror's round ended.
enum Broken {
    Gateway(GatewayError),
    Other(Failure),
}

impl From<GatewayError> for Broken {
    fn from(error: GatewayError) -> Self {
        Self::Gateway(error)
    }
}

impl From<PipelineError> for Broken {
    fn from(error: PipelineError) -> Self {
        Self::Other(error.into())
    }
}

impl From<Failure> for Broken {
    fn from(failure: Failure) -> Self {
        Self::Other(failure)
    }
}

impl Broken {
    /// The gateway does not know its chain as it is now, and tells nobody anything until it does.
    fn is_stale(&self) -> bool {
        matches!(self, Self::Gateway(GatewayError::Refused(Code::Stale)))
    }
}

/// The site that this one joins through its gateway, if it joins one.
pub(in crate::site) struct Joined {
    home: Home,
    plant: Plant,
    hub: Arc<Hub>,
    log: Arc<Log>,
    owners: Arc<Owners>,
    link: Arc<Link>,
    life: Arc<Lifetime>,
    remote: Option<Arc<Remote>>,
}

impl Joined {
    /// From the shared parts.
    pub fn new(parts: &Parts, remote: Option<Arc<Remote>>) -> Self {
        let Parts { home, plant, hub, log, owners, link, life, .. } = parts.clone();
        Self { home, plant, hub, log, owners, link, life, remote }
    }
}

impl Joined {
    /// Whether this site joins a gateway.
    pub fn joins(&self) -> bool {
        self.remote.is_some()
    }

    /// Where the chain comes from, in words, if that is the other site.
    pub fn chain_text(&self) -> Option<String> {
        self.remote.as_ref().map(|remote| remote.chain_text())
    }

    /// Mirrors a profile's records of the gateway until its owner is closed or the site ends.
    pub(super) async fn mirror(self: Arc<Self>, owner: Arc<Owner>) {
        let Some(remote) = &self.remote else { return };
        let (mut pause, mut stale, mut pace) = (PAUSES.0, None, Pace::default());
        let mut told = OwnErasures::default();
        remote.not_asked(&owner.profile);
        while !self.life.is_stopping() && self.owners.is_open(&owner) {
            let known = self.link.network_now();
            // d_E decrypts the transport key.
            let Some(network) = known.filter(|_| !owner.is_locked()) else {
                remote.not_asked(&owner.profile);
                tokio::time::sleep(TICK).await;
                continue;
            };
            if network.directory.identity(owner.address).is_err() {
                // Nobody can share with it, and the gateway does not know it.
                remote.note(&owner.profile, Mirrored::Caught);
                tokio::time::sleep(TICK).await;
                continue;
            }
            let begun = Instant::now();
            match self.mirror_round(remote, (&owner, &network), &mut told).await {
                Ok(()) => {
                    (pause, stale) = (PAUSES.0, None);
                    tokio::select! {
                        () = tokio::time::sleep(pace.after(begun.elapsed())) => {}
                        () = self.life.stopped() => return,
                    }
                }
                Err(broken) if broken.is_stale() && stale.get_or_insert_with(Instant::now).elapsed() < QUIET => {
                    remote.note(&owner.profile, Mirrored::Behind);
                    tokio::select! {
                        () = tokio::time::sleep(TICK) => {}
                        () = self.life.stopped() => return,
                    }
                }
                Err(broken) => {
                    if !broken.is_stale() {
                        stale = None;
                    }
                    self.tell_broken(remote, &owner, broken, pause);
                    tokio::select! {
                        () = tokio::time::sleep(pause) => {}
                        () = self.life.stopped() => return,
                    }
                    pause = (pause * 2).min(PAUSES.1);
                }
            }
        }
    }

    fn tell_broken(&self, remote: &Remote, owner: &Owner, broken: Broken, pause: Duration) {
        let failure = match broken {
            Broken::Gateway(error) => {
                // The chain has other keys by now than those the transport key was allocated under: allocate again.
                if matches!(error, GatewayError::Refused(Code::NotRegistered)) {
                    drop(std::fs::remove_file(self.home.transport_key(&owner.profile)));
                }
                error.into()
            }
            Broken::Other(failure) => failure,
        };
        let seconds = pause.as_secs();
        let text = format!(
            "records of '{}' are not arriving from the gateway {}, retry in {seconds} s: {}",
            owner.profile,
            remote.address(),
            failure.message
        );
        self.hub.notice(NoticeLevel::Error, &text);
        remote.note(&owner.profile, Mirrored::Failed(failure));
    }

    /// Until the connection breaks, or somebody begins or ceases to share.
    async fn mirror_round(
        self: &Arc<Self>,
        remote: &Remote,
        (owner, network): (&Arc<Owner>, &Network),
        told: &mut OwnErasures,
    ) -> Result<(), Broken> {
        told.connected();
        let keeper = remote.keeper(network)?;
        let mirror =
            Mirror { plant: &self.plant, network, reader: owner.as_ref(), keeper, anchors: Anchors::default() };
        let mut client = remote.connect(&self.home, owner, network).await?;
        let sources = sources(network, owner);
        // Subscribed before listing, so that nothing falls in between.
        let (feed, mut fed) = mpsc::channel(WAITING);
        let subscriber = remote.connect(&self.home, owner, network).await?;
        let live: Vec<Address> = sources.keys().copied().take(SUBSCRIPTIONS).collect();
        let (subscriber, refused) = subscribe(subscriber, &live).await?;
        let _feeding = Aborted(tokio::spawn(follow(subscriber, feed)));
        remote.note(&owner.profile, Mirrored::Behind);
        let (mut missed, mut refused) = (Missed::default(), listing::Refused::new(refused, Instant::now()));
        for source in &sources {
            self.catch_up(&mut client, &mirror, source, &mut missed).await?;
        }
        remote.note(&owner.profile, Mirrored::Caught);
        let (mut listed, mut heard) = (Instant::now(), Instant::now());
        loop {
            tokio::select! {
                next = fed.recv() => {
                    let next = next.unwrap_or(Err(GatewayError::Closed));
                    if matches!(next, Err(GatewayError::Refused(Code::NotAuthorised))) {
                        // Somebody no longer shares: begin again with those who do.
                        remote.note(&owner.profile, Mirrored::Behind);
                        tokio::time::sleep(TICK).await;
                        return Ok(());
                    }
                    let (entry, record) = next?;
                    let taken = match mirror.wants(&entry)? {
                        true => self.take(&mirror, entry.owner, &entry, record).await?,
                        // Here already; or the gateway knows of a grant that the chain here does not show yet.
                        false => self.has(&entry)?,
                    };
                    if !taken {
                        missed.add(entry.owner, &entry, Instant::now());
                    }
                }
                () = tokio::time::sleep(TICK) => {}
                () = self.life.stopped() => return Ok(()),
            }
            let others = crate::pipeline::mirror::sources(network, owner) != sources;
            if others || client.is_spent() || refused.is_given(&mut client, Instant::now()).await? {
                remote.note(&owner.profile, Mirrored::Behind);
                return Ok(());
            }
            if let Some(owners) = refused.is_late() {
                self.tell_waiting(remote, owner, owners);
            }
            self.tell_erasures(&mut client, (remote, owner, network), told).await?;
            if self.settle_proofs(&mut client, &mirror, &sources).await? {
                heard = Instant::now();
            }
            for (source, entry) in missed.due(Instant::now()) {
                if mirror.wants(&entry)? {
                    self.fetch(&mut client, &mirror, (source, &entry), &mut missed).await?;
                } else if !self.has(&entry)? {
                    missed.add(source, &entry, Instant::now());
                }
            }
            if listed.elapsed() >= LISTING {
                for source in sources.iter().filter(|(source, _)| !live.contains(source)) {
                    self.catch_up(&mut client, &mirror, source, &mut missed).await?;
                }
                listed = Instant::now();
            }
            if heard.elapsed() >= SILENCE {
                client.ping().await?;
                heard = Instant::now();
            }
        }
    }

    fn tell_waiting(&self, remote: &Remote, owner: &Owner, owners: &BTreeSet<Address>) {
        let owners: Vec<String> = owners.iter().map(ToString::to_string).collect();
        let text = format!(
            "the gateway {} does not give '{}' the records of {} yet: its keeper may want their grant some blocks deeper in the \
             chain; retrying at least every ten seconds",
            remote.address(),
            owner.profile,
            owners.join(", ")
        );
        self.hub.notice(NoticeLevel::Warning, &text);
    }

    /// Returns `false` if the chain here does not know enough yet to take it in.
    async fn take(
        &self,
        mirror: &Mirror<'_>,
        source: Address,
        entry: &Entry,
        record: Fetched,
    ) -> Result<bool, PipelineError> {
        match mirror.take(source, entry.digest, record).await {
            Ok(true) => {
                self.hub.changed(Part::Uploads);
                self.hub.changed(Part::Grants);
                self.hub.confirmed.notify_one();
                Ok(true)
            }
            Ok(false) => self.has(entry),
            // One bad record must not keep the others away.
            Err(error @ (PipelineError::NotTakenIn { .. } | PipelineError::Crypto(_))) => {
                self.hub.notice(NoticeLevel::Error, &error.to_string());
                Ok(true)
            }
            Err(error) => Err(error),
        }
    }

    fn has(&self, entry: &Entry) -> Result<bool, PipelineError> {
        Ok(block_in_place(|| self.plant.ledger.record(entry.digest))?.is_some())
    }
}
