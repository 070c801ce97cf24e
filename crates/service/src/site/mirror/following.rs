//! Follows a gateway's feed for one reader: asks for what comes next, takes it in, and stores how far that is.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use tokio::task::block_in_place;

use super::places::{Places, Standing, Told};
use super::{Broken, Joined, TICK};
use crate::event::{NoticeLevel, Part};
use crate::gateway::{Client, Code, FeedPage, Fetched, GatewayError, Place};
use crate::model::{Address, Digest, Timestamp};
use crate::pipeline::intake::{Accepted, Anchors, Intake, Wish, is_wanted, sources, wish};
use crate::pipeline::reader::Reader;
use crate::pipeline::{Network, Owner, PipelineError};
use crate::store::notes::{FeedTaken, TakenOfFeed};

/// How long the watcher here may lag behind the block of a proof before the record is for later.
const BEHIND: Duration = Duration::from_secs(3);
/// Records asked for at once.
const WINDOW: usize = 64;
/// Pauses before the next page, by how many in a row brought nothing new.
const PAGES: [(usize, Duration); 2] = [(10_000, Duration::from_millis(100)), (100, Duration::from_millis(10))];
/// The shortest time between two pages without any entry.
const EMPTY: Duration = Duration::from_millis(100);

/// The reader's side of one session.
pub(super) struct Following<'a> {
    joined: &'a Joined,
    intake: Intake<'a>,
    reader: Reader<'a>,
    note: TakenOfFeed,
    places: Places,
    /// As it was stored last.
    saved: FeedTaken,
    /// Pages in a row that brought nothing new: a feed of what is here already may be long and honest.
    idle: usize,
    asked: Instant,
}

impl<'a> Following<'a> {
    /// From where it was.
    ///
    /// # Errors
    /// Errors of the ledger.
    pub fn load(
        joined: &'a Joined,
        (owner, network): (&'a Owner, &'a Network),
        (keeper, anchors): (Address, &'a Anchors),
    ) -> Result<Self, PipelineError> {
        let note = TakenOfFeed { domain: network.domain, keeper, reader: owner.address };
        let plant = &joined.plant;
        let saved = block_in_place(|| plant.ledger.notes.read(&note))?.unwrap_or_default();
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

    /// Follows who shares now, and nobody else; again where more can be read than before. Returns whether more may come for that.
    ///
    /// # Errors
    /// Errors of the ledger.
    pub fn adjust(&mut self) -> Result<bool, PipelineError> {
        let each = sources(self.reader.network, self.reader.reader).into_iter().map(|(owner, grant)| {
            let epochs = block_in_place(|| self.reader.epochs_of(owner))?;
            Ok((owner, (Place::grant_of(&grant), epochs)))
        });
        let sources = each.collect::<Result<_, PipelineError>>()?;
        Ok(self.places.adjust(&sources, Timestamp::now()))
    }

    /// The owners that are followed.
    pub fn owners(&self) -> BTreeSet<Address> {
        self.places.owners()
    }

    /// The next page; nothing if nobody is to be asked about now.
    ///
    /// # Errors
    /// [`GatewayError`].
    pub async fn next(&mut self, client: &mut Client) -> Result<Option<FeedPage>, GatewayError> {
        self.asked = Instant::now();
        let Some(asked) = self.places.asks(self.asked) else {
            tokio::time::sleep(TICK).await;
            return Ok(None);
        };
        client.feed(asked).await.map(Some)
    }

    /// Takes in what a page tells, and what is due of what had to wait. Returns how the reader stands then.
    ///
    /// # Errors
    /// If the connection breaks, or chain or store fail.
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

    /// Keeps a gateway from wearing this site out with pages that bring nothing.
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

    /// What is due of what had to wait, and is not here by another way.
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

    /// What to ask for of a page. Of owners that nobody follows nothing is believed.
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
        let (reader, hub, Told { owner, digest, .. }) = (self.reader.reader, &self.joined.hub, told);
        let accepted = match record {
            Ok(record) => self.intake.accept(reader, owner, digest, record).await?,
            Err(GatewayError::Erased(erased)) => self.intake.accept_erased(reader, owner, digest, *erased).await?,
            // Its owner does not state it: nothing is left that could be shown, and when that changes the feed tells it anew.
            Err(GatewayError::Refused(Code::NotFound)) if told.is_erased => Accepted::Held(false),
            // It has no bytes of it now, or cannot read them, or its right is not clear to it.
            Err(GatewayError::Refused(_)) => {
                self.places.wait(told, false, Instant::now());
                return Ok(false);
            }
            Err(GatewayError::Crypto(error)) => {
                if self.places.wait(told, false, Instant::now()) {
                    hub.notice(NoticeLevel::Error, &PipelineError::from(error).to_string());
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
                hub.notice(NoticeLevel::Error, &refused.to_string());
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

    /// Stores how far all is dealt with.
    fn save(&mut self) -> Result<(), PipelineError> {
        let taken = self.places.taken();
        if taken != self.saved {
            block_in_place(|| self.joined.plant.ledger.notes.write(&self.note, &taken))?;
            self.saved = taken;
        }
        Ok(())
    }

    /// The owners whose records the gateway refuses for longer than it needs to see a block, for people.
    pub fn refused(&self) -> String {
        self.places.long_refused().map(ToString::to_string).collect::<Vec<_>>().join(", ")
    }
}
