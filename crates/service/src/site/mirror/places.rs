//! A reader's places in a gateway's feed: progress per owner, what waits, and what is reread. No owner waits for
//! another: each has its own place, room and pauses.

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

use crate::gateway::feed::{FeedId, MOST_OWNERS};
use crate::gateway::{Feed, FeedEntry, FeedPage, Place};
use crate::model::{Address, Digest, Fact, Timestamp};
use crate::store::notes::{FeedTaken, FollowedOwner, TakenOfOwner};

/// How long the gateway may wait for news.
const WAIT: Duration = Duration::from_secs(1);
const MOST_WAITING: usize = 256;
/// First pause before a retry, and the longest.
const PAUSES: (Duration, Duration) = (Duration::from_millis(500), Duration::from_secs(60));
/// The longest for records that only wait for the chain here.
const NEAR: Duration = Duration::from_secs(10);
/// How long a missing record is expected any moment.
const FRESH: Duration = Duration::from_secs(30);
/// How often records beyond the room are tried although the waiting ones do not come.
const AGAIN: Duration = Duration::from_secs(600);
/// First pause before asking again about an owner whom the gateway refuses, and the longest.
const RESTS: (Duration, Duration) = (Duration::from_millis(500), Duration::from_secs(10));
/// Nanoseconds between complete rereads: a gateway may have passed over what it has by now.
const ANEW: u64 = 7 * 24 * 3_600 * 1_000_000_000;

/// Sharers, with the beginning of the grant's transaction and the epochs with keys here.
pub(super) type Sources = BTreeMap<Address, (u64, BTreeSet<u64>)>;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Told {
    pub owner: Address,
    pub digest: Digest,
    pub number: u64,
    pub is_erased: bool,
}

impl From<&FeedEntry> for Told {
    fn from(entry: &FeedEntry) -> Self {
        let FeedEntry { owner, digest, number, fact, .. } = *entry;
        Self { owner, digest, number, is_erased: fact == Fact::Erased }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Standing {
    /// Something is still to be read, or expected any moment.
    Arriving,
    /// The next page decides.
    Reading,
    /// All that the gateway gives is here; `lacks` if it lists records that it does not give.
    Here { lacks: bool },
}

/// Without `again`, as after loading, it is due immediately.
#[derive(Debug, Clone, Copy, Default)]
struct Trial {
    since: Option<Instant>,
    again: Option<Instant>,
    pause: Duration,
}

#[derive(Debug, Default)]
struct Followed {
    taken: TakenOfOwner,
    trials: BTreeMap<Digest, Trial>,
    /// Last reread of what had no room.
    went_back: Option<Instant>,
    /// Since when a key is missing.
    locked_since: Option<Instant>,
    /// The last page about it reached the feed's end.
    is_at_head: bool,
    /// End of the pause before the gateway is asked about it, and its length.
    rests: Option<(Instant, Duration)>,
}

fn is_fresh(since: Option<Instant>, now: Instant) -> bool {
    since.is_some_and(|since| now.saturating_duration_since(since) < FRESH)
}

impl Followed {
    /// Rereads everything, which also meets what waits.
    fn read_anew(&mut self) {
        let (known, place) = (self.taken.known, self.taken.place);
        self.taken = TakenOfOwner { known, place, back: Some(0), ..TakenOfOwner::default() };
        self.trials.clear();
        self.locked_since = None;
    }

    /// Rereads from a row on.
    fn read_again(&mut self, number: u64) {
        let before = number.saturating_sub(1);
        self.taken.back = Some(self.taken.back.map_or(before, |back| back.min(before)));
        self.taken.is_again = false;
    }

    /// Takes over what is known now; returns whether something is reread.
    fn adjust(&mut self, grant: u64, epochs: &BTreeSet<u64>) -> bool {
        let known = self.taken.known;
        let now = FollowedOwner { grant, newest: epochs.last().copied().unwrap_or(0), count: epochs.len() as u64 };
        self.taken.known = now;
        // Later epochs do not make passed-over rows readable: what they open was noted.
        if now.grant != known.grant || epochs.range(..=known.newest).count() as u64 > known.count {
            self.read_anew();
            return true;
        }
        let unlocked = self.taken.locked.filter(|_| now.newest > known.newest);
        if let Some(number) = unlocked {
            (self.taken.locked, self.locked_since) = (None, None);
            self.read_again(number);
        }
        unlocked.is_some()
    }

    /// Goes back for records beyond the room once there is room, and from time to time.
    fn go_back(&mut self, room: usize, now: Instant) {
        let is_due = || self.went_back.is_none_or(|went| now.saturating_duration_since(went) >= AGAIN);
        let may = self.taken.back.is_none() && (self.taken.waits.len() <= room / 2 || is_due());
        if let Some(number) = self.taken.beyond.filter(|_| may) {
            self.taken.beyond = None;
            self.went_back = Some(now);
            self.read_again(number);
        }
    }

    /// Queues a record; `is_near` if it only waits for the chain here. Returns whether it is new in the queue.
    fn wait(&mut self, told: Told, is_near: bool, (room, now): (usize, Instant)) -> bool {
        let is_new = !self.taken.waits.contains_key(&told.digest);
        if is_new && self.taken.waits.len() >= room {
            let number = told.number;
            self.taken.beyond = Some(self.taken.beyond.map_or(number, |lowest| lowest.min(number)));
            self.went_back.get_or_insert(now);
            return true;
        }
        self.taken.waits.insert(told.digest, told.is_erased);
        let trial = self.trials.entry(told.digest).or_default();
        if is_new || is_near {
            trial.since.get_or_insert(now);
        }
        trial.pause = (trial.pause * 2).clamp(PAUSES.0, if is_near { NEAR } else { PAUSES.1 });
        trial.again = Some(now + trial.pause);
        is_new
    }

    fn took(&mut self, turn: Turn, page: &FeedPage) {
        self.rests = None;
        let (taken, is_last) = (&mut self.taken, page.upto == page.head);
        match turn {
            Turn::Live => {
                taken.place = Some(taken.place.unwrap_or(0).max(page.upto));
                self.is_at_head = is_last;
            }
            Turn::Back => {
                let Some(back) = taken.back.map(|back| back.max(page.upto)) else { return };
                if taken.place.is_none() && is_last {
                    (taken.place, self.is_at_head) = (Some(back), true);
                }
                taken.back = Some(back).filter(|back| taken.place.is_none_or(|place| *back < place));
            }
        }
    }

    fn rest(&mut self, now: Instant) {
        let before = self.rests.map_or(RESTS.0 / 2, |(_, pause)| pause);
        let pause = (before * 2).min(RESTS.1);
        (self.rests, self.is_at_head) = (Some((now + pause, pause)), false);
    }

    /// Something is expected any moment.
    fn is_arriving(&self, now: Instant) -> bool {
        (self.taken.back.is_some() && !self.taken.is_again)
            || is_fresh(self.locked_since, now)
            || self.trials.values().any(|trial| is_fresh(trial.since, now))
    }

    fn lacks(&self) -> bool {
        !self.taken.waits.is_empty() || self.taken.beyond.is_some() || self.taken.locked.is_some()
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Turn {
    Live,
    Back,
}

#[derive(Debug)]
pub(super) struct Places {
    reader: Address,
    feed: FeedId,
    begun: Timestamp,
    owners: BTreeMap<Address, Followed>,
    turn: Turn,
    asked: Feed,
}

impl Places {
    pub fn load(reader: Address, taken: FeedTaken) -> Self {
        let owners = taken.owners.into_iter().map(|(owner, taken)| (owner, Followed { taken, ..Followed::default() }));
        let (feed, begun, owners) = (taken.feed, taken.begun, owners.collect());
        Self { reader, feed, begun, owners, turn: Turn::Live, asked: Feed::of(reader) }
    }

    pub fn taken(&self) -> FeedTaken {
        let owners = self.owners.iter().map(|(owner, one)| (*owner, one.taken.clone())).collect();
        FeedTaken { feed: self.feed, begun: self.begun, owners }
    }

    pub fn adjust(&mut self, sources: &Sources, time: Timestamp) -> bool {
        self.owners.retain(|owner, _| sources.contains_key(owner));
        let is_due = time.0.saturating_sub(self.begun.0) > ANEW;
        if is_due {
            self.begun = time;
            for one in self.owners.values_mut().filter(|one| one.taken.place.is_some() && one.taken.back.is_none()) {
                one.read_anew();
                one.taken.is_again = true;
            }
        }
        let mut is_more = false;
        for (owner, (grant, epochs)) in sources {
            let one = self.owners.entry(*owner).or_insert_with(|| {
                is_more = true;
                let taken = TakenOfOwner { back: Some(0), ..TakenOfOwner::default() };
                Followed { taken, ..Followed::default() }
            });
            is_more |= one.adjust(*grant, epochs);
        }
        is_more
    }

    pub fn owners(&self) -> BTreeSet<Address> {
        self.owners.keys().copied().collect()
    }

    /// Room per owner for waiting records; less with many owners.
    fn room(&self) -> usize {
        (16 * MOST_WAITING / self.owners.len().max(1)).clamp(16, MOST_WAITING)
    }

    fn of(&self, turn: Turn, now: Instant) -> Vec<Place> {
        let awake = self.owners.iter().filter(|(_, one)| one.rests.is_none_or(|(until, _)| until <= now));
        let places = awake.filter_map(|(owner, one)| {
            let after = if turn == Turn::Live { one.taken.place } else { one.taken.back }?;
            Some(Place { owner: *owner, after, grant: one.taken.known.grant })
        });
        let mut places: Vec<Place> = places.collect();
        // The furthest behind come first if one request cannot hold all.
        places.sort_by_key(|place| place.after);
        places
    }

    /// The next request; `None` if every owner rests.
    pub fn asks(&mut self, now: Instant) -> Option<&Feed> {
        let room = self.room();
        self.owners.values_mut().for_each(|one| one.go_back(room, now));
        let (live, back) = (self.of(Turn::Live, now), self.of(Turn::Back, now));
        let live_own = live.iter().find(|place| place.owner == self.reader).copied();
        let may_wait = back.is_empty() && live.len() < MOST_OWNERS;
        let is_back = live.is_empty() || (self.turn == Turn::Live && !back.is_empty());
        let (turn, mut places) = if is_back { (Turn::Back, back) } else { (Turn::Live, live) };
        if places.is_empty() {
            return None;
        }
        // The reader's own are never refused: a request about others alone might be, and end the session.
        let own = live_own.filter(|own| !places.iter().any(|place| place.owner == own.owner));
        places.truncate(MOST_OWNERS - 1);
        places.extend(own);
        let rest = self.owners.values().filter_map(|one| one.rests.map(|(until, _)| until)).min();
        let most = rest.map_or(WAIT, |until| until.saturating_duration_since(now).min(WAIT));
        let wait = if may_wait { most } else { Duration::ZERO };
        self.turn = turn;
        self.asked = Feed { id: self.feed, wait, places, ..self.asked.clone() };
        Some(&self.asked)
    }

    /// The last request was a short look for new rows while others are reread.
    pub fn is_look_between(&self) -> bool {
        self.turn == Turn::Live && self.asked.wait.is_zero()
    }

    /// Whether a page is of another feed: then it counts for nothing, and everything is read anew.
    pub fn is_of_another(&mut self, page: &FeedPage) -> bool {
        self.feed = page.id;
        if page.is_anew {
            self.begun = Timestamp::now();
            for one in self.owners.values_mut() {
                one.taken.place = None;
                one.read_anew();
            }
        }
        page.is_anew
    }

    /// Newest epoch with keys here; `None` if the owner is not followed.
    pub fn newest(&self, owner: &Address) -> Option<u64> {
        self.owners.get(owner).map(|one| one.taken.known.newest)
    }

    pub fn done(&mut self, told: &Told) {
        if let Some(one) = self.owners.get_mut(&told.owner) {
            one.taken.waits.remove(&told.digest);
            one.trials.remove(&told.digest);
        }
    }

    /// Queues a record; returns whether it is new in the queue.
    pub fn wait(&mut self, told: Told, is_near: bool, now: Instant) -> bool {
        let room = self.room();
        self.owners.get_mut(&told.owner).is_some_and(|one| one.wait(told, is_near, (room, now)))
    }

    /// The key of a record has not arrived yet.
    pub fn is_locked(&mut self, told: Told, now: Instant) {
        if let Some(one) = self.owners.get_mut(&told.owner) {
            one.taken.locked = Some(one.taken.locked.map_or(told.number, |lowest| lowest.min(told.number)));
            one.locked_since.get_or_insert(now);
        }
    }

    pub fn due(&self, now: Instant) -> Vec<Told> {
        let due = |one: &Followed, digest: &Digest| {
            let trial = one.trials.get(digest).copied().unwrap_or_default();
            trial.again.is_none_or(|again| again <= now)
        };
        let of = |(owner, one): (&Address, &Followed)| -> Vec<Told> {
            let told = |(digest, erased): (&Digest, &bool)| {
                due(one, digest).then_some(Told { owner: *owner, digest: *digest, number: 0, is_erased: *erased })
            };
            one.taken.waits.iter().filter_map(told).collect()
        };
        self.owners.iter().flat_map(of).take(MOST_WAITING).collect()
    }

    /// Everything on a page is dealt with.
    pub fn took(&mut self, page: &FeedPage, now: Instant) {
        let refused: BTreeSet<Address> = page.refused.iter().map(|(owner, _)| *owner).collect();
        let turn = self.turn;
        for place in &self.asked.places {
            match self.owners.get_mut(&place.owner) {
                Some(one) if refused.contains(&place.owner) => one.rest(now),
                Some(one) => one.took(turn, page),
                None => {}
            }
        }
    }

    /// Owners whom the gateway refuses keep nobody waiting.
    pub fn standing(&self, now: Instant) -> Standing {
        let awake = || self.owners.values().filter(|one| one.rests.is_none_or(|(until, _)| until <= now));
        if awake().any(|one| one.is_arriving(now)) {
            Standing::Arriving
        } else if self.turn == Turn::Live && awake().all(|one| one.is_at_head) {
            Standing::Here { lacks: self.owners.values().any(Followed::lacks) }
        } else {
            Standing::Reading
        }
    }

    /// Owners refused for longer than the gateway needs to see a block.
    pub fn long_refused(&self) -> impl Iterator<Item = &Address> {
        let long = |one: &Followed| one.rests.is_some_and(|(_, pause)| pause >= Duration::from_secs(4));
        self.owners.iter().filter(move |(_, one)| long(one)).map(|(owner, _)| owner)
    }
}

#[cfg(test)]
mod tests;
