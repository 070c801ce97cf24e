//! Mirrors a profile's records of the joined gateway here: follows the gateway's feed, takes in what is told there, and keeps the
//! place. A lost connection is opened again, with pauses that grow to five seconds.

mod following;
mod own_erasures;
mod places;
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

use crate::gateway::{Code, GatewayError};
use crate::model::Address;
use crate::pipeline::intake::{Anchors, sources};
use crate::pipeline::{Network, Owner, PipelineError};
use crate::service::event::NoticeLevel;
use crate::service::reply::Failure;
use following::Following;
use own_erasures::OwnErasures;
use places::Standing;
use remote::{Mirrored, Remote};

/// The first pause after a failure, and the longest.
const PAUSES: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(5));
/// A session as long as this says nothing of the next one.
const LONG: Duration = Duration::from_secs(10);
/// Interval between looks for something to do.
const TICK: Duration = Duration::from_millis(500);
/// How long a gateway that does not know its chain now is asked again without a word.
const QUIET: Duration = Duration::from_secs(15);

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
        let (mut pause, mut stale) = (PAUSES.0, None);
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
                remote.note(&owner.profile, Mirrored::Caught { lacks: false });
                tokio::time::sleep(TICK).await;
                continue;
            }
            let begun = Instant::now();
            let Err(broken) = self.mirror_round(remote, (&owner, &network), &mut told).await else { continue };
            if begun.elapsed() >= LONG {
                (pause, stale) = (PAUSES.0, None);
            }
            if broken.is_stale() && stale.get_or_insert_with(Instant::now).elapsed() < QUIET {
                remote.note(&owner.profile, Mirrored::Behind);
                self.rest(TICK).await;
                continue;
            }
            if !broken.is_stale() {
                stale = None;
            }
            self.tell_broken(remote, &owner, broken, pause);
            self.rest(pause).await;
            pause = (pause * 2).min(PAUSES.1);
        }
    }

    /// Waits for so long, or until the site ends.
    async fn rest(&self, pause: Duration) {
        tokio::select! {
            () = tokio::time::sleep(pause) => {}
            () = self.life.stopped() => {}
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

    /// One session: until it breaks, is used up, or the site ends.
    async fn mirror_round(
        self: &Arc<Self>,
        remote: &Remote,
        (owner, network): (&Arc<Owner>, &Network),
        told: &mut OwnErasures,
    ) -> Result<(), Broken> {
        told.connected();
        let keeper = remote.keeper(network)?;
        let mut client = remote.connect(&self.home, owner, network).await?;
        let anchors = Anchors::default();
        let mut following = Following::load(self, (owner, network), (keeper, &anchors))?;
        remote.note(&owner.profile, Mirrored::Behind);
        let mut rights = self.hub.feed.subscribe();
        let mut is_slow_told = false;
        let has_others =
            |followed: &BTreeSet<Address>| sources(network, owner).keys().any(|source| !followed.contains(source));
        // Where the chain is read anew, rights are judged by what is read then.
        let is_known = || self.link.network_now().is_none_or(|now| Arc::ptr_eq(&now.directory, &network.directory));
        let is_open = || !self.life.is_stopping() && self.owners.is_open(owner) && !owner.is_locked();
        while !client.is_spent() && is_open() && is_known() {
            rights.mark_unchanged();
            if following.adjust()? {
                remote.note(&owner.profile, Mirrored::Behind);
            }
            let followed = following.owners();
            let page = {
                let asking = following.next(&mut client);
                tokio::pin!(asking);
                loop {
                    tokio::select! {
                        page = &mut asking => break page?,
                        () = self.life.stopped() => return Ok(()),
                        Ok(()) = rights.changed() => {
                            // Somebody shares from now on: what is asked for next includes that.
                            if has_others(&followed) {
                                remote.note(&owner.profile, Mirrored::Behind);
                            }
                        }
                    }
                }
            };
            match following.take(&mut client, page).await? {
                Standing::Here { lacks } if !has_others(&followed) => {
                    remote.note(&owner.profile, Mirrored::Caught { lacks });
                }
                Standing::Arriving => remote.note(&owner.profile, Mirrored::Behind),
                Standing::Here { .. } | Standing::Reading => {}
            }
            self.tell_erasures(&mut client, (remote, owner, network), told).await?;
            let refused = following.refused();
            if !refused.is_empty() && !std::mem::replace(&mut is_slow_told, true) {
                self.tell_waiting(remote, owner, &refused);
            }
        }
        Ok(())
    }

    fn tell_waiting(&self, remote: &Remote, owner: &Owner, owners: &str) {
        let text = format!(
            "the gateway {} does not give '{}' the records of {owners} yet: its keeper may want their grant some blocks deeper \
             in the chain; retrying at least every ten seconds",
            remote.address(),
            owner.profile,
        );
        self.hub.notice(NoticeLevel::Warning, &text);
    }
}
