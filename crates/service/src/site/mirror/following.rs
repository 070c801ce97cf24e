//! Follows a gateway's feed for one reader: what to ask for, what to do with what comes, and how far that is for good.

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

use tokio::task::block_in_place;

use super::{Broken, Joined, TICK};
use crate::event::{NoticeLevel, Part};
use crate::gateway::{Client, Code, Feed, FeedEntry, FeedPage, Fetched, Follow, GatewayError};
use crate::model::{Address, Digest, Fact, Hash};
use crate::pipeline::intake::{Accepted, Anchors, Intake, Wish, sources, wish};
use crate::pipeline::reader::Reader;
use crate::pipeline::{Network, Owner, PipelineError};
use crate::store::notes::{FeedTaken, FollowedOwner, TakenOfFeed};

/// How long the gateway may wait for something to tell.
const WAIT: Duration = Duration::from_secs(1);
/// How long the watcher here may lag behind the block of a proof before the record is for later.
const BEHIND: Duration = Duration::from_secs(3);
/// Records asked for at once.
const WINDOW: usize = 64;

/// Whether more can be read of what was passed by than before. Keys of later epochs are no such thing: what they open was kept
/// for later.
fn opens_more(known: &FollowedOwner, now: &FollowedOwner, epochs: &BTreeSet<u64>) -> bool {
    now.grant != known.grant || epochs.range(..=known.newest).count() as u64 > known.count
}

/// Where a reader is in a gateway's feed.
struct Place {
    note: TakenOfFeed,
    follow: Follow,
    known: BTreeMap<Address, FollowedOwner>,
    /// As it was stored last.
    saved: FeedTaken,
}

impl Place {
    fn of(note: TakenOfFeed, saved: FeedTaken) -> Self {
        let places = saved.owners.iter().map(|(owner, (_, number))| (*owner, *number)).collect();
        let (id, topics, recorders) = (saved.feed, Vec::new(), Vec::new());
        let follow = Follow::new(Feed { id, wait: WAIT, kind: None, topics, recorders, places });
        let known = saved.owners.iter().map(|(owner, (known, _))| (*owner, *known)).collect();
        Self { note, follow, known, saved }
    }

    /// What of it is stored: no number beyond `most`.
    fn taken(&self, most: u64) -> FeedTaken {
        let each = self.follow.places().iter().map(|(owner, number)| {
            let known = self.known.get(owner).copied().unwrap_or_default();
            (*owner, (known, (*number).min(most)))
        });
        FeedTaken { feed: self.follow.id(), owners: each.collect() }
    }
}

/// The most entries that wait for the chain here, or for a key.
const MOST_LATER: usize = 1024;
/// The first pause before they are tried again, and the longest.
const AGAIN: (Duration, Duration) = (Duration::from_millis(500), Duration::from_secs(60));

/// Entries that could not be dealt with when they came: the node here was behind, a key was not handed over yet, the gateway did not
/// have the bytes. The stored place stays before them, so nothing is lost with this memory, or beyond its bounds.
#[derive(Debug, Default)]
struct Later {
    entries: BTreeMap<Digest, FeedEntry>,
    /// The lowest number of those that did not fit.
    beyond: Option<u64>,
    again: Option<Instant>,
    pause: Duration,
}

impl Later {
    fn add(&mut self, entry: &FeedEntry, now: Instant) {
        if self.entries.len() < MOST_LATER || self.entries.contains_key(&entry.digest) {
            self.entries.insert(entry.digest, entry.clone());
        } else {
            self.beyond = Some(self.beyond.map_or(entry.number, |lowest| lowest.min(entry.number)));
        }
        if self.again.is_none() {
            self.pause = (self.pause * 2).clamp(AGAIN.0, AGAIN.1);
            self.again = Some(now + self.pause);
        }
    }

    /// What is due. What has to wait on has to be added again.
    fn due(&mut self, now: Instant) -> Vec<FeedEntry> {
        match self.again {
            Some(again) if again <= now => {
                self.again = None;
                let mut due: Vec<FeedEntry> = std::mem::take(&mut self.entries).into_values().collect();
                due.sort_unstable_by_key(|entry| entry.number);
                due
            }
            Some(_) => Vec::new(),
            None => {
                // All of the last time were dealt with.
                self.pause = Duration::ZERO;
                Vec::new()
            }
        }
    }

    /// The number up to which all is dealt with.
    fn most(&self) -> u64 {
        let lowest = self.entries.values().map(|entry| entry.number).chain(self.beyond).min();
        lowest.map_or(u64::MAX, |number| number.saturating_sub(1))
    }
}

/// Pauses before the next page, by how many in a row brought nothing new.
const PAGES: [(usize, Duration); 2] = [(10_000, Duration::from_millis(100)), (100, Duration::from_millis(10))];
/// The shortest time between two pages without any entry.
const EMPTY: Duration = Duration::from_millis(100);

/// The reader's side of one session.
pub(super) struct Following<'a> {
    joined: &'a Joined,
    intake: Intake<'a>,
    reader: Reader<'a>,
    place: Place,
    later: Later,
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
        let taken = block_in_place(|| plant.ledger.notes.read(&note))?.unwrap_or_default();
        Ok(Self {
            joined,
            intake: Intake { plant, network, anchors, keeper, patience: BEHIND },
            reader: Reader { plant, network, reader: owner },
            place: Place::of(note, taken),
            later: Later::default(),
            idle: 0,
            asked: Instant::now(),
        })
    }

    /// Follows who shares now, and nobody else; anew where more can be read than before. Returns whether there is anything anew.
    ///
    /// # Errors
    /// Errors of the ledger.
    pub fn adjust(&mut self) -> Result<bool, PipelineError> {
        let mut is_anew = false;
        let sources = sources(self.reader.network, self.reader.reader);
        let gone: Vec<Address> =
            self.place.follow.places().keys().filter(|one| !sources.contains_key(one)).copied().collect();
        for owner in gone {
            self.place.follow.remove(&owner);
            self.place.known.remove(&owner);
        }
        for (owner, grant) in sources {
            let epochs = block_in_place(|| self.reader.epochs_of(owner))?;
            let (newest, count) = (epochs.last().copied().unwrap_or(0), epochs.len() as u64);
            let now = FollowedOwner { grant: beginning(&grant), newest, count };
            if self.place.known.get(&owner).is_none_or(|known| opens_more(known, &now, &epochs)) {
                self.place.follow.remove(&owner);
                is_anew = true;
            }
            self.place.follow.add(owner, 0);
            self.place.known.insert(owner, now);
        }
        Ok(is_anew)
    }

    /// The owners that are followed.
    pub fn owners(&self) -> BTreeSet<Address> {
        self.place.known.keys().copied().collect()
    }

    /// The next page; nothing if nobody is to be asked about now.
    ///
    /// # Errors
    /// [`GatewayError`].
    pub async fn next(&mut self, client: &mut Client) -> Result<Option<FeedPage>, GatewayError> {
        self.asked = Instant::now();
        let page = self.place.follow.next(client, WAIT).await?;
        if page.is_none() {
            tokio::time::sleep(TICK).await;
        }
        Ok(page)
    }

    /// Takes in what a page tells, and what is due of what had to wait. Returns whether that is all that the gateway has.
    ///
    /// # Errors
    /// If the connection breaks, or chain or store fail.
    pub async fn take(&mut self, client: &mut Client, page: Option<FeedPage>) -> Result<bool, Broken> {
        let due = self.later.due(Instant::now());
        self.take_all(client, &due).await?;
        let Some(page) = page else {
            self.save()?;
            return Ok(false);
        };
        if page.id != self.place.follow.id() {
            // Numbers of another feed.
            self.later = Later::default();
        }
        let is_new = self.take_all(client, &page.entries).await?;
        self.place.follow.took(&page, page.upto);
        self.save()?;
        let is_all = page.upto == page.head;
        self.pace(page.entries.is_empty(), is_new).await;
        Ok(is_all)
    }

    /// Keeps a gateway from wearing this site out with pages that bring nothing.
    async fn pace(&mut self, is_empty: bool, is_new: bool) {
        self.idle = if is_new { 0 } else { self.idle + 1 };
        let pause = match is_empty {
            true => EMPTY.checked_sub(self.asked.elapsed()),
            false => PAGES.iter().find(|(pages, _)| self.idle > *pages).map(|(_, pause)| *pause),
        };
        if let Some(pause) = pause {
            tokio::time::sleep(pause).await;
        }
    }

    /// Returns whether anything changed here.
    async fn take_all(&mut self, client: &mut Client, entries: &[FeedEntry]) -> Result<bool, Broken> {
        let mut wanted = Vec::new();
        for entry in entries {
            let newest = self.place.known.get(&entry.owner).map_or(0, |known| known.newest);
            match wish(&self.reader, entry, newest)? {
                Wish::Ask => wanted.push(entry),
                Wish::Later => self.later.add(entry, Instant::now()),
                Wish::Pass => {}
            }
        }
        let (mut left, mut changed) = (wanted.as_slice(), false);
        while !left.is_empty() {
            let digests: Vec<Digest> = left.iter().take(WINDOW).map(|entry| entry.digest).collect();
            let records = client.records(&digests).await?;
            let (asked, rest) = left.split_at(records.len().min(left.len()));
            for (entry, record) in asked.iter().zip(records) {
                changed |= self.take_one(entry, record).await?;
            }
            left = rest;
        }
        Ok(changed)
    }

    async fn take_one(&mut self, entry: &FeedEntry, record: Result<Fetched, GatewayError>) -> Result<bool, Broken> {
        let (reader, owner, digest) = (self.reader.reader, entry.owner, entry.digest);
        let accepted = match record {
            Ok(record) => self.intake.accept(reader, owner, digest, record).await?,
            Err(GatewayError::Erased(erased)) => self.intake.accept_erased(reader, owner, digest, *erased).await?,
            // Its owner does not state it: nothing is left that could be shown.
            Err(GatewayError::Refused(Code::NotFound)) if entry.fact == Fact::Erased => return Ok(false),
            // It has no bytes of it now, or its right is not clear to it.
            Err(GatewayError::Refused(Code::NotFound | Code::NotAuthorised | Code::Tampered)) => Accepted::Later,
            Err(GatewayError::Crypto(error)) => {
                self.joined.hub.notice(NoticeLevel::Error, &PipelineError::from(error).to_string());
                return Ok(false);
            }
            Err(error) => return Err(error.into()),
        };
        let hub = &self.joined.hub;
        match accepted {
            Accepted::Held(true) => {
                hub.changed(Part::Uploads);
                hub.changed(Part::Grants);
                hub.confirmed.notify_one();
                return Ok(true);
            }
            Accepted::Held(false) => {}
            // The others of a page need not wait for the same watcher again.
            Accepted::Later => self.later.add(entry, Instant::now()),
            // One bad record must not keep the others away.
            Accepted::Refused(refused) => hub.notice(NoticeLevel::Error, &refused.to_string()),
        }
        self.intake.patience = if self.later.entries.is_empty() { BEHIND } else { Duration::ZERO };
        Ok(false)
    }

    /// Stores how far all is dealt with.
    fn save(&mut self) -> Result<(), PipelineError> {
        let taken = self.place.taken(self.later.most());
        if taken != self.place.saved {
            block_in_place(|| self.joined.plant.ledger.notes.write(&self.place.note, &taken))?;
            self.place.saved = taken;
        }
        Ok(())
    }

    /// Whether the gateway refuses an owner's records for longer than it needs to see a block.
    pub fn is_refused_for_long(&self) -> bool {
        self.place.follow.longest_rest() >= Duration::from_secs(4)
    }

    /// The owners whose records it does not give, for people.
    pub fn refused(&self) -> String {
        self.place.follow.resting().map(ToString::to_string).collect::<Vec<_>>().join(", ")
    }
}

fn beginning(grant: &Hash) -> u64 {
    grant.0.first_chunk().map_or(0, |first| u64::from_be_bytes(*first))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::expect_used, reason = "a test fails by panicking")]

    use super::*;
    use crate::model::{Domain, RecordKind, RecorderId, Timestamp, TopicId};

    const ALICE: Address = Address([1; 20]);

    fn entry(number: u64) -> FeedEntry {
        let mut digest = [0; 32];
        digest[..8].copy_from_slice(&number.to_be_bytes());
        FeedEntry {
            number,
            fact: Fact::Verified,
            digest: Digest(digest),
            owner: ALICE,
            recorder: RecorderId([2; 16]),
            seq: number,
            topic_id: TopicId([3; 16]),
            epoch: 1,
            captured_at: Timestamp(4),
            length: 5,
            kind: RecordKind::Data,
            proof: Vec::new(),
        }
    }

    #[test]
    fn a_place_is_kept_up_to_what_waits() {
        let owner = FollowedOwner { grant: 7, newest: 3, count: 2 };
        let taken = |number| FeedTaken { feed: [9; 16], owners: [(ALICE, (owner, number))].into() };
        let note = TakenOfFeed { domain: Domain([4; 32]), keeper: Address([8; 20]), reader: ALICE };
        let place = Place::of(note, taken(90));
        assert_eq!((place.follow.id(), place.follow.places()[&ALICE]), ([9; 16], 90));
        assert_eq!((place.taken(u64::MAX), place.taken(40)), (taken(90), taken(40)), "what waits is told again");
    }

    #[test]
    fn a_feed_is_read_anew_for_another_grant_and_for_keys_of_earlier_epochs() {
        let known = FollowedOwner { grant: 7, newest: 3, count: 1 };
        let now = |grant, epochs: &[u64]| {
            let epochs: BTreeSet<u64> = epochs.iter().copied().collect();
            let newest = epochs.last().copied().unwrap_or(0);
            opens_more(&known, &FollowedOwner { grant, newest, count: epochs.len() as u64 }, &epochs)
        };
        assert!(now(8, &[3]) && now(7, &[2, 3]));
        assert!(!now(7, &[3]) && !now(7, &[3, 4]), "what a later one opens was kept for later");
    }

    #[test]
    fn what_has_to_wait_is_tried_after_pauses_that_grow_and_begin_anew() {
        let (mut later, mut now) = (Later::default(), Instant::now());
        assert!(later.due(now).is_empty());
        let mut pauses = Vec::new();
        for _ in 0..9 {
            later.add(&entry(5), now);
            later.add(&entry(5), now);
            assert_eq!(later.most(), 4);
            let asked = now;
            while later.due(now).is_empty() {
                now += Duration::from_millis(250);
            }
            pauses.push((now - asked).as_millis());
        }
        assert_eq!(pauses, [500, 1_000, 2_000, 4_000, 8_000, 16_000, 32_000, 60_000, 60_000]);
        assert!(later.due(now).is_empty() && later.most() == u64::MAX, "it was dealt with");
        later.add(&entry(6), now);
        assert_eq!(later.due(now + AGAIN.0).len(), 1, "another one is tried soon");
    }

    #[test]
    fn endless_records_that_have_to_wait_fill_no_memory_and_none_is_lost() {
        let (mut later, now) = (Later::default(), Instant::now());
        (1..=4_000).for_each(|number| later.add(&entry(number), now));
        assert_eq!(later.due(now + AGAIN.1).len(), MOST_LATER);
        assert_eq!(later.most(), MOST_LATER as u64, "the next session is told the others again");
    }
}
