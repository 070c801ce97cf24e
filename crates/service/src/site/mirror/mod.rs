//! Mirrors each gateway's records of a profile here: lists and fetches what is missing, then takes records as they come. A
//! lost connection is opened again, with pauses that grow to five seconds.

pub(super) mod comparing;
mod erased;
mod listing;
#[cfg(test)]
mod listing_tests;
mod missed;
mod own_erasures;
mod pace;
mod patience;
mod place;
mod remote;
pub(super) mod remotes;
mod subscribing;
mod telling;

use crate::paths::Home;
use crate::pipeline::Plant;
use crate::service::hub::Hub;
use crate::site::audit::Log;
use crate::site::chain::link::Link;
use crate::site::identity::owners::Owners;
use crate::site::lifetime::Lifetime;
use crate::site::parts::Parts;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::mpsc;
use tokio::task::block_in_place;

use super::supervision::Aborted;
use crate::gateway::{Client, Code, Entry, Fetched, GatewayError, Query, Selection, Standing, Stood};
use crate::model::{Address, Hash, Timestamp};
use crate::pipeline::mirror::{Anchors, Mirror, sources};
use crate::pipeline::{Network, Owner, PipelineError};
use crate::service::event::{NoticeLevel, Part};
use crate::service::reply::Failure;
use missed::Missed;
use own_erasures::OwnErasures;
use pace::Pace;
use patience::Patience;
use place::Place;
use remote::{Mirrored, Remote};
use remotes::Remotes;
use subscribing::{Refused, follow, subscribe};

/// The first pause after a failure, and the longest.
const PAUSES: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(5));
/// How often missing proofs are requested, and grants are looked at.
const TICK: Duration = Duration::from_millis(500);
/// Entries per page.
const PAGE: u16 = 500;
/// Digests checked at a time.
const CHECKED: usize = 500;
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
    remotes: Option<Arc<Remotes>>,
}

impl Joined {
    /// From the shared parts.
    pub fn new(parts: &Parts, remotes: Option<Arc<Remotes>>) -> Self {
        let Parts { home, plant, hub, log, owners, link, life, .. } = parts.clone();
        Self { home, plant, hub, log, owners, link, life, remotes }
    }
}

impl Joined {
    /// How many gateways this site joins.
    pub fn gateways(&self) -> usize {
        self.remotes.as_ref().map_or(0, |remotes| remotes.all().len())
    }

    /// Where the chain comes from, in words, if that is the other site.
    pub fn chain_text(&self) -> Option<String> {
        self.remotes.as_ref().map(|remotes| remotes.chain_text())
    }

    /// Mirrors a profile's records of the gateway at a place of the list until its owner is closed or the site ends.
    pub(super) async fn mirror(self: Arc<Self>, owner: Arc<Owner>, place: usize) {
        let Some(remote) = self.remotes.as_ref().and_then(|remotes| remotes.all().get(place)) else { return };
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
                    drop(std::fs::remove_file(remote.transport_key(&self.home, &owner.profile)));
                }
                error.into()
            }
            Broken::Other(failure) => failure,
        };
        let seconds = pause.as_secs();
        let text = format!(
            "records of '{}' are not arriving from the gateway {}, retry in {seconds} s: {}",
            owner.profile,
            crate::model::clean(remote.address(), 255),
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
        let (mut missed, mut refused) = (Missed::default(), Refused::new(refused, Instant::now()));
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
             chain; it is asked again, every ten seconds at the latest",
            crate::model::clean(remote.address(), 255),
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

    /// Lists the gateway's records of an owner, and fetches what is missing here.
    async fn catch_up(
        self: &Arc<Self>,
        client: &mut Client,
        mirror: &Mirror<'_>,
        (source, grant): (&Address, &Hash),
        missed: &mut Missed,
    ) -> Result<(), Broken> {
        let source = *source;
        let mut place = Place::load(&self.plant.ledger, mirror, (source, grant))?;
        let begin = place.begin(Timestamp::now());
        let from = Timestamp::from_seconds(begin);
        let selection = Selection::all(source);
        let mut query = Query { selection, from, until: Timestamp(u64::MAX), cursor: 0, limit: PAGE };
        let mut patience = Patience::default();
        loop {
            let page = match client.query(&query).await {
                // A grant ended meanwhile and the chain is going to say so, or it is asked for again.
                Err(GatewayError::Refused(Code::NotAuthorised)) => return Ok(()),
                page => page?,
            };
            let mut new = false;
            for entry in &page.entries {
                place.newest = place.newest.max(entry.captured_at.seconds());
                if mirror.wants(entry)? {
                    // What cannot be taken in is nothing new, however often it is handed over.
                    let was_here = self.has(entry)?;
                    self.fetch(client, mirror, (source, entry), missed).await?;
                    new |= !was_here && self.has(entry)?;
                }
            }
            let Some(next) = page.next else { break };
            query.cursor = next;
            if let Some(pause) = patience.after(page.entries.len(), new)? {
                tokio::time::sleep(pause).await;
            }
        }
        Ok(place.listed(begin, Timestamp::now()).save(&self.plant.ledger)?)
    }

    async fn fetch(
        &self,
        client: &mut Client,
        mirror: &Mirror<'_>,
        (source, entry): (Address, &Entry),
        missed: &mut Missed,
    ) -> Result<(), Broken> {
        match client.fetch(&entry.digest).await {
            Ok(record) => {
                if !self.take(mirror, source, entry, record).await? {
                    missed.add(source, entry, Instant::now());
                }
                Ok(())
            }
            Err(GatewayError::Erased(erased)) => self.take_erased(mirror, source, entry, *erased).await,
            Err(GatewayError::Refused(Code::NotFound | Code::NotAuthorised | Code::Tampered)) => Ok(()),
            Err(GatewayError::Crypto(error)) => {
                self.hub.notice(NoticeLevel::Error, &PipelineError::from(error).to_string());
                Ok(())
            }
            Err(error) => Err(error.into()),
        }
    }

    /// Fetches again the records that have a proof by now. Returns whether the gateway was asked anything.
    async fn settle_proofs(
        &self,
        client: &mut Client,
        mirror: &Mirror<'_>,
        sources: &BTreeMap<Address, Hash>,
    ) -> Result<bool, Broken> {
        let mut asked = false;
        for source in sources.keys() {
            let waiting = mirror.unproven(*source, CHECKED)?;
            if waiting.is_empty() {
                continue;
            }
            asked = true;
            let standings = client.check(&waiting).await?;
            let anchored = |stood: &Stood| matches!(stood.standing, Standing::Anchored | Standing::Verified);
            for (digest, _) in waiting.iter().zip(&standings.stood).filter(|(_, stood)| anchored(stood)) {
                match client.fetch(digest).await {
                    Ok(record) => {
                        if mirror.take(*source, *digest, record).await? {
                            self.hub.confirmed.notify_one();
                            self.hub.changed(Part::Uploads);
                        }
                    }
                    Err(
                        GatewayError::Erased(_)
                        | GatewayError::Refused(Code::NotFound | Code::NotAuthorised | Code::Tampered),
                    ) => {}
                    Err(error) => return Err(error.into()),
                }
            }
        }
        Ok(asked)
    }
}
