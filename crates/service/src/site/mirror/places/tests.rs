//! A reader's places against a model: whatever a gateway, its chain and the reader's own watcher do in between, each record that the
//! reader may have comes, nothing is called complete before, and no owner waits for another one.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use proptest::prelude::*;

use super::*;
use crate::gateway::Code;
use crate::model::{RecordKind, RecorderId, TopicId};

const READER: u8 = 0;
/// Entries on a page of the model.
const PAGE: usize = 40;

fn owner(number: u8) -> Address {
    Address([number; 20])
}

/// A record of the model: whose, of which of two topics, sealed in which epoch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Record {
    owner: u8,
    topic: u8,
    epoch: u64,
    number: u64,
}

impl Record {
    fn digest(self) -> Digest {
        let mut digest = [self.owner; 32];
        digest[1] = self.topic;
        digest[2] = self.epoch.to_be_bytes()[7];
        digest[8..16].copy_from_slice(&self.number.to_be_bytes());
        Digest(digest)
    }

    fn of(digest: &Digest) -> Self {
        let bytes = digest.0;
        let number = u64::from_be_bytes(bytes[8..16].try_into().expect("eight"));
        Self { owner: bytes[0], topic: bytes[1], epoch: bytes[2].into(), number }
    }
}

/// A grant's event on the chain: whose, its name, and how many of the two topics; none ends it.
#[derive(Debug, Clone, Copy)]
struct Event {
    owner: u8,
    grant: u64,
    topics: u8,
}

fn right(chain: &[Event], owner: u8) -> Option<Event> {
    let own = Event { owner: READER, grant: 0, topics: 2 };
    let last = chain.iter().rev().find(|event| event.owner == owner).copied();
    if owner == READER { Some(own) } else { last.filter(|event| event.topics > 0) }
}

#[derive(Debug, Clone)]
enum Step {
    /// A number of an owner's records become verified.
    Verify(u8, u8, u16),
    /// The chain replaces blocks: this many of the newest are taken back.
    TakeBack(u16),
    /// What was taken back is verified again.
    VerifyAgain,
    /// One of the records was erased.
    Erase(u16),
    /// The gateway loses the bytes of an owner's newest records, and finds them again.
    Lose(u8, u16),
    Find,
    /// The reader's watcher does not get on, and does.
    Lag(bool),
    /// The owner seals under a next epoch, and its keys come.
    NextEpoch(u8),
    Keys(u8),
    /// A grant begins, widens or ends, and who has read that on the chain.
    Grant(u8, u8),
    GatewayReads,
    ReaderReads,
    /// The gateway's home is replaced by an older one.
    Restore,
    /// The reader's process ends: before he stored what he took of a page, or after.
    Restart(bool),
    /// He asks and takes, so often.
    Read(u8),
}

fn step() -> impl Strategy<Value = Step> {
    let sharer = 1u8..=3;
    prop_oneof![
        8 => (0u8..=3, 0u8..2, 1u16..150).prop_map(|(owner, topic, count)| Step::Verify(owner, topic, count)),
        2 => (1u16..100).prop_map(Step::TakeBack),
        1 => Just(Step::VerifyAgain),
        1 => any::<u16>().prop_map(Step::Erase),
        2 => (sharer.clone(), 1u16..400).prop_map(|(owner, count)| Step::Lose(owner, count)),
        1 => Just(Step::Find),
        2 => any::<bool>().prop_map(Step::Lag),
        2 => sharer.clone().prop_map(Step::NextEpoch),
        2 => sharer.clone().prop_map(Step::Keys),
        3 => (sharer, 0u8..=2).prop_map(|(owner, topics)| Step::Grant(owner, topics)),
        3 => Just(Step::GatewayReads),
        3 => Just(Step::ReaderReads),
        1 => Just(Step::Restore),
        2 => any::<bool>().prop_map(Step::Restart),
        9 => (1u8..12).prop_map(Step::Read),
    ]
}

struct World {
    now: Instant,
    // The gateway.
    is_honest: bool,
    id: u8,
    head: u64,
    rows: Vec<(u64, Record, bool)>,
    aside: Vec<Record>,
    lost: BTreeSet<Record>,
    numbers: u64,
    epochs: BTreeMap<u8, u64>,
    // The chain, and how far each of them read it.
    chain: Vec<Event>,
    gateway_read: usize,
    reader_read: usize,
    // The reader.
    is_lagging: bool,
    keys: BTreeMap<u8, u64>,
    held: BTreeSet<Record>,
    places: Places,
    saved: FeedTaken,
}

impl World {
    fn new() -> Self {
        let epochs: BTreeMap<u8, u64> = (0..=3).map(|owner| (owner, 1)).collect();
        Self {
            now: Instant::now(),
            is_honest: true,
            id: 1,
            head: 0,
            rows: Vec::new(),
            aside: Vec::new(),
            lost: BTreeSet::new(),
            numbers: 0,
            keys: epochs.clone(),
            epochs,
            chain: Vec::new(),
            gateway_read: 0,
            reader_read: 0,
            is_lagging: false,
            held: BTreeSet::new(),
            places: Places::load(owner(READER), FeedTaken::default()),
            saved: FeedTaken::default(),
        }
    }

    fn put(&mut self, record: Record, is_erased: bool) {
        self.rows.retain(|(_, other, _)| *other != record);
        self.head += 1;
        self.rows.push((self.head, record, is_erased));
    }

    fn verify(&mut self, owner: u8, topic: u8, count: u16) {
        for _ in 0..count {
            self.numbers += 1;
            self.head += 1;
            self.rows.push((
                self.head,
                Record { owner, topic, epoch: self.epochs[&owner], number: self.numbers },
                false,
            ));
        }
    }

    fn step(&mut self, step: &Step) {
        match *step {
            Step::Verify(owner, topic, count) => self.verify(owner, topic, count),
            Step::TakeBack(count) => {
                let is_verified = |row: &mut (u64, Record, bool)| !row.2;
                let back = (0..count).map_while(|_| self.rows.pop_if(is_verified));
                self.aside.extend(back.map(|(_, record, _)| record));
            }
            Step::VerifyAgain => {
                let again = std::mem::take(&mut self.aside);
                again.into_iter().for_each(|record| self.put(record, false));
            }
            Step::Erase(which) => {
                if let Some((_, record, _)) = self.rows.get(usize::from(which) % self.rows.len().max(1)).copied() {
                    self.lost.remove(&record);
                    self.put(record, true);
                }
            }
            Step::Lose(owner, count) => {
                let of = self.rows.iter().rev().filter(|(_, record, is_erased)| record.owner == owner && !is_erased);
                self.lost.extend(of.take(count.into()).map(|(_, record, _)| *record));
            }
            Step::Find => self.lost.clear(),
            Step::Lag(is_lagging) => self.is_lagging = is_lagging,
            Step::NextEpoch(owner) => *self.epochs.entry(owner).or_default() += 1,
            Step::Keys(owner) => {
                self.keys.insert(owner, self.epochs[&owner]);
            }
            Step::Grant(owner, topics) => {
                let grant = self.chain.len() as u64 + 1;
                self.chain.push(Event { owner, grant, topics });
            }
            Step::GatewayReads => self.gateway_read = self.chain.len().min(self.gateway_read + 1),
            Step::ReaderReads => self.reader_read = self.chain.len().min(self.reader_read + 1),
            Step::Restore => {
                self.id += 1;
                self.rows.truncate(self.rows.len() / 2);
                self.head = self.rows.last().map_or(0, |(number, ..)| *number);
            }
            Step::Restart(is_within_a_page) => {
                if is_within_a_page {
                    self.round(false);
                }
                self.places = Places::load(owner(READER), self.saved.clone());
            }
            Step::Read(times) => (0..times).for_each(|_| self.round(true)),
        }
    }

    /// What the gateway answers; nothing if it refuses all.
    fn page(&self, asked: &Feed) -> Option<FeedPage> {
        let chain = &self.chain[..self.gateway_read];
        let is_anew = asked.id != [self.id; 16] || asked.places.iter().any(|place| place.after > self.head);
        let (mut told, mut refused) = (BTreeMap::new(), Vec::new());
        for place in &asked.places {
            let right = right(chain, place.owner.0[0]).filter(|right| right.grant == place.grant);
            match right {
                Some(right) => {
                    told.insert(place.owner.0[0], (if is_anew { 0 } else { place.after }, right));
                }
                None => refused.push((place.owner, Code::NotAuthorised)),
            }
        }
        let first = told.values().map(|(after, _)| *after).min()?;
        let wanted = self.rows.iter().filter(|(number, record, _)| {
            *number > first
                && told.get(&record.owner).is_some_and(|(after, right)| number > after && record.topic < right.topics)
        });
        let entries: Vec<FeedEntry> = wanted.take(PAGE).map(|row| entry(*row)).collect();
        let upto = if entries.len() == PAGE { entries[PAGE - 1].number } else { self.head };
        Some(FeedPage { is_anew, ..FeedPage::new([self.id; 16], (self.head, upto), refused, entries) })
    }

    fn has_key(&self, record: Record) -> bool {
        let right = right(&self.chain[..self.reader_read], record.owner);
        right.is_some_and(|right| record.topic < right.topics) && record.epoch <= self.keys[&record.owner]
    }

    /// What becomes of a record that is asked for.
    fn fetch(&mut self, told: Told) {
        let record = Record::of(&told.digest);
        let is_told = self.rows.iter().any(|(_, other, _)| *other == record);
        let may = right(&self.chain[..self.gateway_read], record.owner).is_some_and(|one| record.topic < one.topics);
        if !may || self.lost.contains(&record) {
            self.places.wait(told, false, self.now);
        } else if self.is_lagging || !is_told {
            self.places.wait(told, true, self.now);
        } else {
            self.held.insert(record);
            self.places.done(&told);
        }
    }

    /// The reader asks and takes once, as `Following` does; where his process ends before it stores, he does not.
    fn round(&mut self, stores: bool) {
        self.now += Duration::from_millis(300);
        let rights = (0..=3).filter_map(|one| right(&self.chain[..self.reader_read], one));
        let sources: Sources =
            rights.map(|right| (owner(right.owner), (right.grant, (1..=self.keys[&right.owner]).collect()))).collect();
        self.places.adjust(&sources, Timestamp::now());
        let Some(asked) = self.places.asks(self.now).cloned() else { return };
        let page = self.page(&asked);
        for told in self.places.due(self.now) {
            match self.held.contains(&Record::of(&told.digest)) {
                true => self.places.done(&told),
                false => self.fetch(told),
            }
        }
        let page = page.expect("where all are refused the session ends");
        if !self.places.is_of_another(&page) {
            for entry in &page.entries {
                self.take(entry);
            }
            self.places.took(&page, self.now);
        }
        if stores {
            self.saved = self.places.taken();
        }
        let agree = self.is_honest && self.places.turn == Turn::Live && self.gateway_read == self.reader_read;
        if agree && self.places.standing(self.now) == (Standing::Here { lacks: false }) {
            let awake =
                |record: &Record| self.places.owners.get(&owner(record.owner)).is_some_and(|one| one.rests.is_none());
            let missing: Vec<Record> = self.missing().into_iter().filter(awake).collect();
            assert!(missing.is_empty(), "all was called complete without {missing:?}");
        }
    }

    fn take(&mut self, entry: &FeedEntry) {
        let Some(newest) = self.places.newest(&entry.owner) else { return };
        let (told, record) = (Told::from(entry), Record::of(&entry.digest));
        if self.held.contains(&record) {
            self.places.done(&told);
        } else if self.has_key(record) {
            self.fetch(told);
        } else if record.epoch > newest {
            self.places.is_locked(told, self.now);
        } else {
            self.places.done(&told);
        }
    }

    /// What the gateway tells of, the reader has a key for, and is not here.
    fn missing(&self) -> Vec<Record> {
        let told = self.rows.iter().map(|(_, record, _)| *record);
        told.filter(|record| self.has_key(*record) && !self.held.contains(record)).collect()
    }

    /// Everything that kept the reader waiting is over.
    fn settle(&mut self) {
        self.step(&Step::VerifyAgain);
        self.lost.clear();
        self.is_lagging = false;
        self.keys = self.epochs.clone();
        (self.gateway_read, self.reader_read) = (self.chain.len(), self.chain.len());
        for _ in 0..2_000 {
            self.now += Duration::from_secs(61);
            self.round(true);
            if self.places.standing(self.now) == (Standing::Here { lacks: false }) {
                return;
            }
        }
        panic!("it never ends: {:?}", self.places);
    }
}

fn entry((number, record, is_erased): (u64, Record, bool)) -> FeedEntry {
    FeedEntry {
        number,
        fact: if is_erased { Fact::Erased } else { Fact::Verified },
        digest: record.digest(),
        owner: owner(record.owner),
        recorder: RecorderId([2; 16]),
        seq: record.number,
        topic_id: TopicId([record.topic; 16]),
        epoch: record.epoch,
        captured_at: Timestamp(4),
        length: 5,
        kind: RecordKind::Data,
        proof: Vec::new(),
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]
    #[test]
    fn a_reader_gets_all_that_he_may_have_and_nothing_is_called_complete_before(
        steps in prop::collection::vec(step(), 1..90)
    ) {
        let mut world = World::new();
        for step in &steps {
            world.step(step);
        }
        world.settle();
        prop_assert_eq!(world.missing(), Vec::new());
    }
}

/// Three owners share, and all of the chain was read by both.
fn shared() -> World {
    let mut world = World::new();
    (1..=3).for_each(|owner| world.step(&Step::Grant(owner, 2)));
    (world.gateway_read, world.reader_read) = (3, 3);
    world
}

#[test]
fn a_stuck_owner_keeps_no_other_one_waiting_and_pins_no_place() {
    let mut world = shared();
    world.verify(1, 0, 400);
    world.step(&Step::Lose(1, 400));
    (0..40).for_each(|_| world.round(true));
    assert_eq!(world.saved.owners[&owner(1)].waits.len(), MOST_WAITING);
    for _ in 0..20 {
        world.verify(2, 0, 1);
        world.verify(0, 1, 1);
        (0..2).for_each(|_| world.round(true));
        assert!(world.missing().iter().all(|record| record.owner == 1), "theirs come at once");
    }
    let places = |world: &World| world.saved.owners.values().map(|one| one.place).collect::<BTreeSet<_>>();
    assert_eq!(places(&world), [Some(world.head)].into(), "nobody reads what he knows again in the next session");
    world.now += FRESH;
    world.round(true);
    assert_eq!(world.places.standing(world.now), Standing::Here { lacks: true }, "it is said that some are missing");
}

#[test]
fn what_had_no_room_is_read_again_as_soon_as_there_is_room() {
    let mut world = shared();
    world.is_lagging = true;
    world.verify(1, 0, 900);
    (0..60).for_each(|_| world.round(true));
    assert!(world.saved.owners[&owner(1)].beyond.is_some());
    assert_eq!(world.places.standing(world.now), Standing::Arriving);
    world.is_lagging = false;
    (0..120).for_each(|_| world.round(true));
    assert_eq!((world.missing(), world.places.standing(world.now)), (Vec::new(), Standing::Here { lacks: false }));
}

#[test]
fn keys_that_come_later_open_however_much_was_sealed_before() {
    let mut world = shared();
    world.step(&Step::NextEpoch(1));
    world.verify(1, 0, 1_000);
    (0..40).for_each(|_| world.round(true));
    assert_eq!(world.places.standing(world.now), Standing::Arriving, "they may come any moment");
    world.now += FRESH;
    world.round(true);
    assert_eq!(world.places.standing(world.now), Standing::Here { lacks: true });
    world.step(&Step::Restart(false));
    world.step(&Step::Keys(1));
    (0..200).for_each(|_| world.round(true));
    assert_eq!((world.missing(), world.places.standing(world.now)), (Vec::new(), Standing::Here { lacks: false }));
}

#[test]
fn what_waits_of_a_grant_that_ended_is_forgotten_and_rows_of_nobody_asked_about_are_not_kept() {
    let mut world = shared();
    world.is_lagging = true;
    world.verify(1, 0, 300);
    (0..20).for_each(|_| world.round(true));
    world.step(&Step::Grant(1, 0));
    world.step(&Step::ReaderReads);
    world.round(true);
    assert!(!world.saved.owners.contains_key(&owner(1)) && world.places.due(world.now + AGAIN).is_empty());
    let stranger = entry((9, Record { owner: 9, topic: 0, epoch: 9, number: 9 }, false));
    world.take(&stranger);
    world.places.is_locked(Told::from(&stranger), world.now);
    assert!(!world.places.wait(Told::from(&stranger), true, world.now));
    assert!(!world.places.taken().owners.contains_key(&owner(9)));
}

#[test]
fn a_wider_grant_is_not_followed_while_the_gateway_goes_by_the_narrow_one() {
    let mut world = World::new();
    world.step(&Step::Grant(1, 1));
    world.step(&Step::Grant(1, 2));
    (world.gateway_read, world.reader_read) = (1, 2);
    world.verify(1, 1, 90);
    (0..20).for_each(|_| world.round(true));
    assert_eq!(world.saved.owners[&owner(1)].place, None, "he is not told by that one");
    world.gateway_read = 2;
    world.now += RESTS.1;
    (0..20).for_each(|_| world.round(true));
    assert_eq!((world.missing(), world.held.len()), (Vec::new(), 90));
}

#[test]
fn all_is_read_again_after_a_week_and_nobody_waits_for_that() {
    let mut world = shared();
    world.verify(1, 0, 200);
    // A gateway that leaves out what it has, and says that this is all.
    world.is_honest = false;
    let hidden = std::mem::take(&mut world.rows);
    (0..9).for_each(|_| world.round(true));
    world.rows = hidden;
    (0..9).for_each(|_| world.round(true));
    assert_eq!(world.held.len(), 0, "it tells of them no more");
    world.places.begun = Timestamp(world.places.begun.0 - ANEW - 1);
    (0..2).for_each(|_| world.round(true));
    assert_eq!(world.places.standing(world.now), Standing::Here { lacks: false });
    (0..20).for_each(|_| world.round(true));
    assert_eq!(world.held.len(), 200);
}

#[test]
fn who_is_refused_and_what_waits_rest_longer_each_time() {
    let now = Instant::now();
    let mut one = Followed::default();
    let rests: Vec<u128> = (0..6)
        .map(|_| {
            one.rest(now);
            one.rests.expect("it rests").1.as_millis()
        })
        .collect();
    assert_eq!(rests, [500, 1_000, 2_000, 4_000, 8_000, 10_000]);
    let told = Told { owner: owner(1), digest: Digest([1; 32]), number: 5, is_erased: false };
    let pauses: Vec<u128> = (0..9)
        .map(|_| {
            one.wait(told, false, (MOST_WAITING, now));
            one.trials[&told.digest].pause.as_millis()
        })
        .collect();
    assert_eq!(pauses, [500, 1_000, 2_000, 4_000, 8_000, 16_000, 32_000, 60_000, 60_000]);
}
