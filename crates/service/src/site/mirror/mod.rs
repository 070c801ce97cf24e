//! Mirrors a profile's records of the joined gateway: follows the gateway's feed, takes records in, and remembers the
//! place.

mod own_erasures;
mod places;
pub(super) mod remote;

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::{Duration, Instant};

use own_erasures::OwnErasures;
use remote::{Mirrored, Remote};
use tokio::task::block_in_place;

use self::places::{Places, Standing, Told};
use crate::gateway::{Client, Code, FeedPage, Fetched, GatewayError, Place};
use crate::model::{Address, Digest, Timestamp};
use crate::pipeline::intake::{Accepted, Intake, Wish, is_wanted, sources, wish};
use crate::pipeline::{Anchors, Network, Owner, PipelineError, Reader};
use crate::reply::{Failure, Part};
use crate::site::Parts;
use crate::store::notes::{FeedTaken, TakenOfFeed};

const PAUSES: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(5));
const LONG: Duration = Duration::from_secs(10);
/// Interval between looks for work.
const TICK: Duration = Duration::from_millis(500);
/// How long a gateway that lacks the chain's current state is retried silently.
const QUIET: Duration = Duration::from_secs(15);

#[derive(Debug, thiserror::Error)]
#[error(transparent)]
enum Broken {
    Gateway(#[from] GatewayError),
    Pipeline(#[from] PipelineError),
    Other(#[from] Failure),
}

impl Broken {
    /// The gateway lacks the chain's current state and refuses everybody until it has it.
    fn is_stale(&self) -> bool {
        matches!(self, Self::Gateway(GatewayError::Refused(Code::Stale)))
    }
}

/// The other site that this one joins through its gateway, if any.
pub(in crate::site) struct Joined {
    pub parts: Parts,
    pub remote: Option<Arc<Remote>>,
}

impl Joined {
    /// Where the chain comes from, if that is the other site.
    pub fn chain_text(&self) -> Option<String> {
        self.remote.as_ref().map(|remote| remote.chain_text())
    }

    /// Mirrors until the owner is closed or the site ends.
    pub async fn mirror(self: Arc<Self>, owner: Arc<Owner>) {
        let Some(remote) = &self.remote else { return };
        let (mut pause, mut stale) = (PAUSES.0, None);
        let mut told = OwnErasures::default();
        remote.not_asked(&owner.profile);
        while !self.parts.life.is_stopping() && self.parts.owners.is_open(&owner) {
            let known = self.parts.link.network_now();
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
                self.parts.life.rest(TICK).await;
                continue;
            }
            if !broken.is_stale() {
                stale = None;
            }
            self.tell_broken(remote, &owner, broken, pause);
            self.parts.life.rest(pause).await;
            pause = (pause * 2).min(PAUSES.1);
        }
    }

    fn tell_broken(&self, remote: &Remote, owner: &Owner, broken: Broken, pause: Duration) {
        let failure = match broken {
            Broken::Gateway(error) => {
                // The transport key was allocated under keys that the chain no longer has.
                if matches!(error, GatewayError::Refused(Code::NotRegistered)) {
                    drop(std::fs::remove_file(self.parts.home.transport_key(&owner.profile)));
                }
                error.into()
            }
            Broken::Pipeline(error) => error.into(),
            Broken::Other(failure) => failure,
        };
        let seconds = pause.as_secs();
        self.parts.hub.alarm(&format!(
            "records of '{}' are not arriving from the gateway {}, retry in {seconds} s: {}",
            owner.profile,
            remote.address(),
            failure.message
        ));
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
        let mut client = remote.connect(&self.parts.home, owner, network).await?;
        let anchors = Anchors::default();
        let mut following = Following::load(self, (owner, network), (keeper, &anchors))?;
        remote.note(&owner.profile, Mirrored::Behind);
        let mut rights = self.parts.hub.feed.subscribe();
        let mut is_slow_told = false;
        let has_others =
            |followed: &BTreeSet<Address>| sources(network, owner).keys().any(|source| !followed.contains(source));
        // When the chain is read anew, that reading judges rights.
        let is_known =
            || self.parts.link.network_now().is_none_or(|now| Arc::ptr_eq(&now.directory, &network.directory));
        let is_open = || !self.parts.life.is_stopping() && self.parts.owners.is_open(owner) && !owner.is_locked();
        while !client.is_spent() && is_open() && is_known() {
            rights.mark_unchanged();
            if following.adjust()? {
                remote.note(&owner.profile, Mirrored::Behind);
            }
            let followed = following.places.owners();
            let page = {
                let asking = following.next(&mut client);
                tokio::pin!(asking);
                loop {
                    tokio::select! {
                        page = &mut asking => break page?,
                        () = self.parts.life.stopped() => return Ok(()),
                        Ok(()) = rights.changed() => {
                            // A new sharer is part of the next request.
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
            "the gateway {} does not give '{}' the records of {owners} yet: it may require more confirmations of their \
             grant; retrying at least every ten seconds",
            remote.address(),
            owner.profile,
        );
        self.parts.hub.warn(&text);
    }
}

/// Longest lag of the watcher here behind the block of a proof; beyond it, the record is for later.
const BEHIND: Duration = Duration::from_secs(3);
const WINDOW: usize = 64;
/// Pauses before the next page, by the number of pages in a row without news.
const PAGES: [(usize, Duration); 2] = [(10_000, Duration::from_millis(100)), (100, Duration::from_millis(10))];
/// Shortest time between two empty pages.
const EMPTY: Duration = Duration::from_millis(100);

struct Following<'a> {
    joined: &'a Joined,
    intake: Intake<'a>,
    reader: Reader<'a>,
    note: TakenOfFeed,
    places: Places,
    saved: FeedTaken,
    /// Pages in a row without news: a feed of records already here may be long and honest.
    idle: usize,
    asked: Instant,
}

impl<'a> Following<'a> {
    pub fn load(
        joined: &'a Joined,
        (owner, network): (&'a Owner, &'a Network),
        (keeper, anchors): (Address, &'a Anchors),
    ) -> Result<Self, PipelineError> {
        let note = TakenOfFeed { domain: network.domain, keeper, reader: owner.address };
        let plant = &joined.parts.plant;
        let saved = plant.ledger.notes.read(&note)?.unwrap_or_default();
        Ok(Self {
            joined,
            intake: Intake { plant, network, anchors, keeper, patience: BEHIND },
            reader: Reader { plant, network, reader: owner },
            note,
            places: Places::load(owner.address, saved.clone()),
            saved,
            idle: 0,
            asked: Instant::now(),
        })
    }

    /// Follows exactly those who share now, and rereads where more became readable. Returns whether more may come.
    pub fn adjust(&mut self) -> Result<bool, PipelineError> {
        let each = sources(self.reader.network, self.reader.reader).into_iter().map(|(owner, grant)| {
            let epochs = block_in_place(|| self.reader.epochs_of(owner))?;
            Ok((owner, (Place::grant_of(&grant), epochs)))
        });
        let sources = each.collect::<Result<_, PipelineError>>()?;
        Ok(self.places.adjust(&sources, Timestamp::now()))
    }

    /// The next page; `None` if every owner rests.
    pub async fn next(&mut self, client: &mut Client) -> Result<Option<FeedPage>, GatewayError> {
        self.asked = Instant::now();
        let Some(asked) = self.places.asks(self.asked) else {
            tokio::time::sleep(TICK).await;
            return Ok(None);
        };
        client.feed(asked).await.map(Some)
    }

    /// Takes in a page and what is due of what waits; returns the reader's standing.
    pub async fn take(&mut self, client: &mut Client, page: Option<FeedPage>) -> Result<Standing, Broken> {
        let due = self.still_wanted()?;
        self.intake.patience = Duration::ZERO;
        self.take_all(client, &due).await?;
        if let Some(page) = page {
            let is_another = self.places.is_of_another(&page);
            let mut is_new = false;
            if !is_another {
                let wanted = self.wanted(&page)?;
                self.intake.patience = BEHIND;
                is_new = self.take_all(client, &wanted).await?;
                self.places.took(&page, Instant::now());
            }
            self.save()?;
            self.pace(is_another || page.entries.is_empty(), is_new).await;
        } else {
            self.save()?;
        }
        Ok(self.places.standing(Instant::now()))
    }

    /// Keeps a gateway from exhausting this site with pages without news.
    async fn pace(&mut self, is_empty: bool, is_new: bool) {
        if is_empty && self.places.is_look_between() {
            return;
        }
        self.idle = if is_new { 0 } else { self.idle + 1 };
        let pause = match is_empty {
            true => EMPTY.checked_sub(self.asked.elapsed()),
            false => PAGES.iter().find(|(pages, _)| self.idle > *pages).map(|(_, pause)| *pause),
        };
        if let Some(pause) = pause {
            tokio::time::sleep(pause).await;
        }
    }

    /// Due records that did not arrive another way.
    fn still_wanted(&mut self) -> Result<Vec<Told>, PipelineError> {
        let mut due = self.places.due(Instant::now());
        let rows = block_in_place(|| {
            self.reader.plant.ledger.records.find_all(&due.iter().map(|told| told.digest).collect::<Vec<_>>())
        })?;
        let mut rows = rows.iter();
        due.retain(|told| {
            let is_wanted = is_wanted(rows.next().and_then(Option::as_ref), told.is_erased);
            if !is_wanted {
                self.places.done(told);
            }
            is_wanted
        });
        Ok(due)
    }

    /// Records of a page to request. Nothing is believed about owners not followed.
    fn wanted(&mut self, page: &FeedPage) -> Result<Vec<Told>, PipelineError> {
        let mut wanted = Vec::new();
        for entry in &page.entries {
            let Some(newest) = self.places.newest(&entry.owner) else { continue };
            let told = Told::from(entry);
            match wish(&self.reader, entry, newest)? {
                Wish::Ask => wanted.push(told),
                Wish::Later => self.places.is_locked(told, Instant::now()),
                Wish::Pass => self.places.done(&told),
            }
        }
        Ok(wanted)
    }

    /// Returns whether anything changed here.
    async fn take_all(&mut self, client: &mut Client, wanted: &[Told]) -> Result<bool, Broken> {
        let (mut left, mut changed) = (wanted, false);
        while !left.is_empty() {
            let digests: Vec<Digest> = left.iter().take(WINDOW).map(|told| told.digest).collect();
            let records = client.records(&digests).await?;
            let (asked, rest) = left.split_at(records.len().min(left.len()));
            for (told, record) in asked.iter().zip(records) {
                changed |= self.take_one(*told, record).await?;
            }
            left = rest;
        }
        Ok(changed)
    }

    async fn take_one(&mut self, told: Told, record: Result<Fetched, GatewayError>) -> Result<bool, Broken> {
        let (reader, hub, Told { owner, digest, .. }) = (self.reader.reader, &self.joined.parts.hub, told);
        let accepted = match record {
            Ok(record) => self.intake.accept(reader, owner, digest, record).await?,
            Err(GatewayError::Erased(erased)) => self.intake.accept_erased(reader, owner, digest, *erased).await?,
            // Its owner has not stated it: nothing is left to show, and the feed reports any change.
            Err(GatewayError::Refused(Code::NotFound)) if told.is_erased => Accepted::Held(false),
            // The gateway has no bytes of it now, cannot read them, or is unsure of the right.
            Err(GatewayError::Refused(_)) => {
                self.places.wait(told, false, Instant::now());
                return Ok(false);
            }
            Err(GatewayError::Crypto(error)) => {
                if self.places.wait(told, false, Instant::now()) {
                    hub.alarm(&PipelineError::from(error).to_string());
                }
                return Ok(false);
            }
            Err(error) => return Err(error.into()),
        };
        match accepted {
            Accepted::Held(_) => self.places.done(&told),
            Accepted::Later => {
                self.places.wait(told, true, Instant::now());
                // The others need not wait for the same watcher again.
                self.intake.patience = Duration::ZERO;
            }
            // One bad record must not keep the others away.
            Accepted::Refused(ref refused) => {
                self.places.done(&told);
                hub.alarm(&refused.to_string());
            }
        }
        let is_new = matches!(accepted, Accepted::Held(true));
        if is_new {
            hub.changed(Part::Uploads);
            hub.changed(Part::Grants);
            hub.confirmed.notify_one();
        }
        Ok(is_new)
    }

    fn save(&mut self) -> Result<(), PipelineError> {
        let taken = self.places.taken();
        if taken != self.saved {
            self.joined.parts.plant.ledger.notes.write(&self.note, &taken)?;
            self.saved = taken;
        }
        Ok(())
    }

    /// Owners whose records the gateway refuses for longer than it needs to see a block.
    pub fn refused(&self) -> String {
        self.places.long_refused().map(ToString::to_string).collect::<Vec<_>>().join(", ")
    }
}
