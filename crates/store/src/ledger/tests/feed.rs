//! The feed against a model: a follower under random steps of a ledger gets each fact once, in order, and misses none.

use std::collections::{BTreeMap, BTreeSet};

use proptest::prelude::*;

use super::*;
use crate::crypto::merkle::Inclusion;
use crate::model::Fact;
use crate::snapshot::{Snapshot, renew_ledger};

const OWNER: Address = Address([1; 20]);
const RECORDS: u64 = 12;

pub(super) fn places(after: u64) -> FeedFilter {
    FeedFilter { places: vec![FeedPlace { owner: OWNER, after, topics: None }], ..FeedFilter::default() }
}

/// One change of a gateway's ledger, or of what its follower does.
#[derive(Debug, Clone)]
enum Step {
    /// A record becomes verified; they come in any order of blocks.
    Verify(u64),
    /// The chain replaced blocks: this many of the newest verified ones are taken back.
    TakeBack(usize),
    /// The bytes of a verified one are deleted.
    Erase(u64),
    /// The gateway's home is replaced by what it was at its last backup: restored, or rolled back by the keeper of its disk.
    Restore(bool),
    /// It is backed up.
    BackUp,
    /// The follower reads a page of at most this many.
    Read(usize),
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        6 => (1..=RECORDS).prop_map(Step::Verify),
        2 => (1usize..=5).prop_map(Step::TakeBack),
        2 => (1..=RECORDS).prop_map(Step::Erase),
        2 => any::<bool>().prop_map(Step::Restore),
        1 => Just(Step::BackUp),
        4 => (1usize..=4).prop_map(Step::Read),
    ]
}

/// What the ledger ought to tell.
#[derive(Clone, Default)]
struct Model {
    /// The facts that hold, by record, in the order in which they came to be so.
    facts: Vec<(u64, Fact)>,
    erased: BTreeSet<u64>,
}

impl Model {
    fn put(&mut self, number: u64, fact: Fact) {
        self.facts.retain(|(other, _)| *other != number);
        self.facts.push((number, fact));
    }
}

struct World {
    home: tempfile::TempDir,
    ledger: Ledger,
    model: Model,
    backup: Option<Model>,
    /// The follower: the feed and the place it knows, and what it has seen under this feed.
    id: [u8; 16],
    after: u64,
    seen: BTreeMap<u64, (u64, Fact)>,
}

impl World {
    fn new() -> Self {
        let (home, ledger) = open();
        ledger.records.append((1..=RECORDS).map(|seq| super::record(1, 1, seq)).collect()).expect("acknowledged");
        let (model, seen) = (Model::default(), BTreeMap::new());
        Self { home, ledger, model, backup: None, id: [0; 16], after: 0, seen }
    }

    fn change(&self, column: &'static str, value: u64, number: u64) {
        let digest = super::record(1, 1, number).digest;
        let sql = format!("UPDATE records SET {column} = ?1 WHERE digest = ?2");
        let value = value.cast_signed();
        let changed =
            self.ledger.database.write(move |session| Ok(session.connection.changed(&sql, (value, digest.0))?));
        changed.expect("changed");
    }

    fn file(&self, name: &str) -> std::path::PathBuf {
        self.home.path().join(name)
    }

    fn step(&mut self, step: &Step) {
        match step {
            Step::Verify(number) => {
                self.change("state", RecordState::Verified.code().into(), *number);
                if !self.model.facts.iter().any(|(other, _)| other == number) {
                    let fact = if self.model.erased.contains(number) { Fact::Erased } else { Fact::Verified };
                    self.model.put(*number, fact);
                }
            }
            Step::TakeBack(count) => {
                for _ in 0..*count {
                    if let Some((number, _)) = self.model.facts.pop() {
                        self.change("state", RecordState::Confirmed.code().into(), number);
                    }
                }
            }
            Step::Erase(number) => {
                if self.model.facts.iter().any(|(other, _)| other == number) && self.model.erased.insert(*number) {
                    self.change("deleted_at", 9, *number);
                    self.model.put(*number, Fact::Erased);
                }
            }
            Step::BackUp => {
                let (moment, ()) = Snapshot::of(&self.ledger, || Ok(())).expect("a moment");
                drop(std::fs::remove_file(self.file("backup.db")));
                moment.copy_to(&self.file("backup.db")).expect("copied");
                self.backup = Some(self.model.clone());
            }
            Step::Restore(is_renewed) => self.restore(*is_renewed),
            Step::Read(limit) => {
                self.read(*limit);
            }
        }
    }

    fn restore(&mut self, is_renewed: bool) {
        let Some(model) = self.backup.clone() else { return };
        self.ledger.clone().close().expect("closed");
        let restored = self.file("restored.db");
        std::fs::copy(self.file("backup.db"), &restored).expect("copied");
        if is_renewed {
            renew_ledger(&restored).expect("renewed");
        }
        let folder = tempfile::tempdir_in(self.home.path()).expect("a folder").keep();
        let path = folder.join("ledger.db");
        std::fs::rename(restored, &path).expect("moved");
        (self.ledger, self.model) = (Ledger::open(&path).expect("opens"), model);
    }

    /// Reads one page as a follower does; returns whether it is at the head.
    fn read(&mut self, limit: usize) -> bool {
        let page = self.ledger.feed.page(&self.id, &places(self.after), limit).expect("read");
        self.id = page.id;
        if page.is_anew {
            self.after = 0;
            self.seen.clear();
        }
        let mut last = self.after;
        for row in &page.rows {
            assert!(row.number > last && row.number <= page.upto, "in order, and each number once");
            last = row.number;
            self.seen.insert(row.placed.row.seq, (row.number, row.fact));
        }
        self.after = self.after.max(page.upto);
        page.upto == page.head
    }

    /// What the follower saw last of each record that is still told of, in the order of its numbers.
    fn told(&self) -> Vec<(u64, Fact)> {
        let holds = |record: &u64| self.model.facts.iter().any(|(other, _)| other == record);
        let mut told: Vec<_> = self.seen.iter().filter(|(record, _)| holds(record)).collect();
        told.sort_by_key(|(_, (number, _))| *number);
        told.into_iter().map(|(record, (_, fact))| (*record, *fact)).collect()
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn a_follower_gets_each_fact_once_in_order_and_misses_none(steps in prop::collection::vec(step(), 1..60)) {
        let mut world = World::new();
        for step in &steps {
            world.step(step);
        }
        while !world.read(3) {}
        prop_assert_eq!(world.told(), world.model.facts.clone());
    }
}

#[test]
fn a_follower_who_read_on_past_a_row_that_was_taken_back_reads_an_older_copy_anew() {
    let mut world = World::new();
    for step in [Step::Verify(1), Step::BackUp, Step::TakeBack(1), Step::Read(1), Step::Restore(false)] {
        world.step(&step);
    }
    while !world.read(3) {}
    assert_eq!(world.told(), [(1, Fact::Verified)]);
}

#[test]
fn a_page_is_cut_by_owner_topic_recorder_and_kind_and_says_how_far_it_looked() {
    let (_home, ledger) = open();
    let mut records = Vec::new();
    for (owner, topic) in [(1, 1), (1, 2), (2, 3)] {
        records.extend((1..=2).map(|seq| super::record(owner, topic, seq)));
    }
    let notice = NewRecord { kind: RecordKind::Key, ..super::record(1, 4, 1) };
    let digests: Vec<Digest> = records.iter().map(|record| record.digest).collect();
    ledger.records.append([records, vec![notice]].concat()).expect("acknowledged");
    ledger
        .database
        .write(move |session| {
            for digest in &digests {
                let sql = "UPDATE records SET state = ?1 WHERE digest = ?2";
                session.connection.changed(sql, (RecordState::Verified.code(), digest.0))?;
            }
            Ok(())
        })
        .expect("verified");
    let id = ledger.feed.page(&[0; 16], &places(0), 0).expect("read").id;
    let of = |filter: &FeedFilter, limit: usize| {
        let page = ledger.feed.page(&id, filter, limit).expect("read");
        let rows: Vec<(u64, Fact)> = page.rows.iter().map(|row| (row.number, row.fact)).collect();
        (rows, page.upto, page.head)
    };
    let facts = |numbers: std::ops::RangeInclusive<u64>| numbers.map(|number| (number, Fact::Verified));
    // The notice has the first number, from the moment it was stored.
    let all: Vec<_> = std::iter::once((1, Fact::Stored)).chain(facts(2..=5)).collect();
    assert_eq!(of(&places(0), 9), (all.clone(), 7, 7));
    assert_eq!(of(&places(0), 2), (all[..2].to_vec(), 2, 7));
    assert_eq!(of(&places(3), 9), (all[3..].to_vec(), 7, 7));
    assert_eq!(of(&places(99), 9).0, all, "beyond the head is the beginning");
    let is_anew = |id, after| ledger.feed.page(&id, &places(after), 9).expect("read").is_anew;
    assert_eq!((is_anew(id, 7), is_anew(id, 8), is_anew([3; 16], 7)), (false, true, true));
    let mut scoped = places(0);
    scoped.places[0].topics = Some(vec![TopicId([2; 16])]);
    assert_eq!(of(&scoped, 9), (facts(4..=5).collect(), 7, 7));
    let keys = FeedFilter { kind: Some(RecordKind::Key), ..places(0) };
    assert_eq!(of(&keys, 9).0, [(1, Fact::Stored)]);
    let other = FeedFilter { recorders: vec![RecorderId([9; 16])], ..places(0) };
    assert_eq!(of(&other, 9), (Vec::new(), 7, 7));
    let own = FeedFilter { recorders: vec![ledger.records.recorder().of_signer(&SignerId([1; 32]))], ..places(0) };
    assert_eq!(of(&own, 9).0, all);
    let mut both = places(4);
    both.places.push(FeedPlace { owner: Address([2; 20]), after: 0, topics: None });
    assert_eq!(of(&both, 9).0, facts(5..=7).collect::<Vec<_>>(), "each owner has a place of its own");
}

#[test]
fn a_notice_whose_block_is_taken_back_is_told_again_and_so_is_an_erasure_that_is_stated_anew() {
    let (_home, ledger) = open();
    let notice = NewRecord { kind: RecordKind::Key, ..super::record(1, 4, 1) };
    let message = super::record(1, 1, 1);
    ledger.records.append(vec![message.clone(), notice.clone()]).expect("acknowledged");
    let put = |column: &'static str, value: i64, digest: Digest| {
        let sql = format!("UPDATE records SET {column} = ?1 WHERE digest = ?2");
        ledger
            .database
            .write(move |session| Ok(session.connection.changed(&sql, (value, digest.0))?))
            .expect("changed");
    };
    let mut feed = (ledger.feed.page(&[0; 16], &places(0), 0).expect("read").id, 0);
    let mut told = || {
        let page = ledger.feed.page(&feed.0, &places(feed.1), 9).expect("read");
        feed.1 = page.upto;
        page.rows.iter().map(|row| (row.placed.row.digest, row.fact)).collect::<Vec<_>>()
    };
    assert_eq!(told(), [(notice.digest, Fact::Stored)]);
    for (state, wanted) in [
        (RecordState::Verified, vec![(notice.digest, Fact::Verified)]),
        (RecordState::Mined, vec![(notice.digest, Fact::Stored)]),
        (RecordState::Verified, vec![(notice.digest, Fact::Verified)]),
        // Altered here: there is nothing to be had of it.
        (RecordState::Tampered, Vec::new()),
    ] {
        put("state", state.code().into(), notice.digest);
        assert_eq!(told(), wanted, "{state:?}");
    }
    put("state", RecordState::Verified.code().into(), message.digest);
    put("state", RecordState::Mined.code().into(), message.digest);
    assert_eq!(told(), [], "a message waits for the chain");
    put("state", RecordState::Verified.code().into(), message.digest);
    put("deleted_at", 9, message.digest);
    let erased = [(message.digest, Fact::Erased)];
    assert_eq!(told(), erased);
    let stated = |key: u8| StatedErasure { digest: message.digest, statement: vec![key], account: None };
    for key in [1, 2] {
        ledger.erasures.keep(vec![stated(key)]).expect("kept");
        assert_eq!((told(), told()), (erased.to_vec(), Vec::new()), "by key {key}");
    }
}

#[test]
fn a_record_whose_block_was_taken_back_follows_its_gateway_into_another_batch() {
    let (_home, ledger) = open();
    let foreign = Some(Foreign { recorder: RecorderId([9; 16]), keeper: Address([5; 20]) });
    let brought = NewRecord { foreign, ..super::record(1, 4, 1) };
    ledger.records.append(vec![brought.clone()]).expect("acknowledged");
    let take = |root: u8, block: u64| {
        ledger.trail.walk_to((block, Hash([root; 32])), Vec::new()).expect("walked");
        let (root, count, block_hash) = (Hash([root; 32]), 2, Hash([root; 32]));
        let inclusion = Inclusion { index: 0, count, path: vec![Hash([7; 32])], root };
        let transaction = Hash([root.0[0] + 1; 32]);
        let anchor = RootSighting { account: Address([5; 20]), root, count, transaction, block, block_hash };
        ledger.batches.take_in(brought.digest, inclusion, anchor)
    };
    let found = || {
        let placed = ledger.records.placed(brought.digest).expect("read").expect("here");
        (placed.row.state, placed.row.block, placed.place.expect("a place").inclusion.root)
    };
    assert_eq!(take(20, 10), Ok(true));
    assert_eq!(found(), (RecordState::Mined, Some(10), Hash([20; 32])));
    assert_eq!(take(30, 11), Ok(false), "its place stands");
    ledger.batches.take_back(10).expect("taken back");
    ledger.trail.walk_back((9, Hash([1; 32]))).expect("walked");
    assert_eq!(take(30, 12), Ok(true));
    assert_eq!(found(), (RecordState::Mined, Some(12), Hash([30; 32])));
}

server::on_a_server! {
    a_page_is_cut_by_owner_topic_recorder_and_kind_and_says_how_far_it_looked, a_notice_whose_block_is_taken_back_is_told_again_and_so_is_an_erasure_that_is_stated_anew, a_record_whose_block_was_taken_back_follows_its_gateway_into_another_batch,
}
