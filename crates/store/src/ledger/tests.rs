//! The ledger's tests: individual behaviours here, random operations in `model`, random queries in `pages`.

mod ages;
mod anchors;
mod coverage;
mod directory;
mod engines;
mod erased;
mod erasures;
mod feed;
mod gaps;
mod glance;
mod groups;
mod incidents;
mod lease;
mod model;
mod numbered;
mod opened;
mod own_numbers;
mod pages;
mod quarantine;
mod rights;
pub(crate) mod server;
mod speed;
pub(crate) mod statements;

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use sm3::{Digest as _, Sm3};

pub(super) use self::numbered::numbered;
use super::*;
use crate::crypto::merkle::{Leaf, Tree};
use crate::model::RecordState::{Confirmed, Stored, Submitted, Verified};
use crate::model::{
    Address, Digest, ErrorKind, Hash, IncidentName, LossReason, ProfileName, PublicKey, RecordKind, RecordState,
    RecorderId, Signature, SignerId, Timestamp, TopicId, TopicPatterns,
};
use crate::notes::Revoking;
use crate::{Ciphertext, Usage};

/// A record of owner `owner` on topic `topic`; its digest is spread like a real one.
pub(crate) fn record(owner: u8, topic: u8, seq: u64) -> NewRecord {
    let name = [&[owner, topic][..], &seq.to_be_bytes()].concat();
    NewRecord {
        digest: Digest(Sm3::digest(&name).into()),
        owner: Address([owner; 20]),
        topic_id: TopicId([topic; 16]),
        seq,
        foreign: None,
        epoch: 1,
        kind: RecordKind::Data,
        signer: SignerId([owner; 32]),
        signature: Signature([7; 64]),
        filters: Vec::new(),
        topic: format!("/robot{topic}/odom"),
        type_name: "nav_msgs/Odometry".to_owned(),
        bytes: 100 + seq,
        captured_at: Timestamp(1_000 + seq),
        simulated: topic.is_multiple_of(2),
        state: RecordState::Stored,
        blob: None,
    }
}

/// Lost messages of owner 1 on `/odom`.
fn loss(reason: LossReason, count: u64) -> Loss {
    Loss {
        owner: Address([1; 20]),
        topic: "/odom".to_owned(),
        publisher: "/robot".to_owned(),
        reason,
        count,
        numbers: Some((1, 9)),
        first_at: Timestamp(5),
        last_at: Timestamp(6),
    }
}

fn sighting(record: &NewRecord, block: u64) -> Sighting {
    Sighting {
        owner: record.owner,
        digest: record.digest,
        transaction: Hash([9; 32]),
        block,
        block_hash: Hash([u8::try_from(block % 256).expect("small"); 32]),
    }
}

fn transaction(number: u8, digests: &[Digest]) -> NewTransaction {
    NewTransaction {
        hash: Hash([number; 32]),
        account: Address([1; 20]),
        nonce: u64::from(number),
        raw: vec![number; 100],
        purpose: "anchor".to_owned(),
        anchors: Anchors::Digests(digests.to_vec()),
    }
}

/// In a file, or on the server in tests that run there too.
pub(crate) fn open() -> (tempfile::TempDir, Ledger) {
    let home = tempfile::tempdir().expect("temporary directory");
    let ledger = open_in(&home, server::address(true));
    (home, ledger)
}

/// The newest of this test.
pub(crate) fn open_again(home: &tempfile::TempDir) -> Ledger {
    open_in(home, server::address(false))
}

fn open_in(home: &tempfile::TempDir, url: Option<String>) -> Ledger {
    let opened = match url {
        Some(url) => Ledger::on_server(&url, None),
        None => Ledger::open(&home.path().join("ledger.db")),
    };
    let ledger = opened.expect("opens");
    ledger.lease.take();
    ledger
}

fn state_of(ledger: &Ledger, record: &NewRecord) -> RecordState {
    ledger.records.find(record.digest).expect("read").expect("there").state
}

#[test]
fn the_recorder_id_and_clean_flag_live_with_the_file() {
    let (home, ledger) = open();
    let recorder = ledger.records.recorder();
    let other = ledger.clone();
    ledger.records.append(vec![record(1, 1, 1)]).expect("acknowledged");
    ledger.close().expect("closed");
    assert_eq!(other.records.append(vec![record(1, 1, 2)]), Err(StoreError::Closed));
    assert_eq!(
        other.records.next_seq(Address([1; 20]), SignerId([1; 32]), TopicId([1; 16])),
        Ok(2),
        "reading still works"
    );
    let flag = |ledger: &Ledger| {
        ledger.database.read(|c| Ok(c.one("SELECT clean FROM about", [], |row| row.get::<bool>(0))?)).expect("flag")
    };
    assert!(flag(&other));
    let again = Ledger::open(&home.path().join("ledger.db")).expect("opens");
    assert_eq!(again.records.recorder(), recorder);
    assert!(flag(&again), "nothing was changed yet");
    again.records.append(vec![record(1, 1, 2)]).expect("acknowledged");
    assert!(!flag(&again));
    assert_ne!(open().1.records.recorder(), recorder);
}

#[test]
fn a_damaged_file_is_refused_after_an_unclean_end() {
    let (home, ledger) = open();
    let path = home.path().join("ledger.db");
    ledger.records.append((1..=500).map(|seq| record(1, 1, seq)).collect()).expect("acknowledged");
    ledger.clone().close().expect("closed");
    drop(ledger);
    let clean = std::fs::read(&path).expect("file");
    let connection = rusqlite::Connection::open(&path).expect("raw");
    connection.execute("UPDATE about SET clean = 0", []).expect("unclean");
    drop(connection);
    let mut bytes = std::fs::read(&path).expect("file");
    assert_eq!(bytes.len(), clean.len());
    let middle = bytes.len() / 2;
    bytes[middle..middle + 4096].fill(0xaa);
    std::fs::write(&path, bytes).expect("damaged");
    let error = Ledger::open(&path).expect_err("refused");
    assert_eq!(error.kind(), ErrorKind::Tampered, "{error}");
}

#[test]
fn appending_twice_changes_nothing_and_contradictions_are_refused() {
    let (_home, ledger) = open();
    let first = NewRecord { blob: Some(vec![1, 2, 3]), ..record(1, 1, 1) };
    ledger.records.append(vec![first.clone(), first.clone()]).expect("acknowledged");
    ledger.records.append(vec![first.clone()]).expect("idempotent");
    assert_eq!(ledger.counts.by_state(None).expect("counts").captured(), 1);
    assert_eq!(Ciphertext::of(&ledger).get(first.digest), Ok(Some(vec![1, 2, 3])));

    let twin = NewRecord { digest: Digest([5; 32]), ..record(1, 1, 1) };
    let renamed = NewRecord { topic: "/other".to_owned(), ..record(1, 1, 2) };
    for bad in [twin, renamed] {
        let refused = ledger.records.append(vec![record(1, 2, 1), bad]);
        assert!(matches!(refused, Err(StoreError::Conflict { .. })), "{refused:?}");
        assert_eq!(
            ledger.records.next_seq(Address([1; 20]), SignerId([1; 32]), TopicId([2; 16])),
            Ok(1),
            "all or none"
        );
    }
    let mined = NewRecord { state: RecordState::Mined, ..record(1, 1, 2) };
    assert!(matches!(ledger.records.append(vec![mined]), Err(StoreError::IllegalEdge { .. })));
    let huge = NewRecord { seq: u64::MAX, ..record(1, 1, 2) };
    let refused = ledger.records.append(vec![huge]);
    assert!(
        matches!(&refused, Err(StoreError::Conflict { detail, .. }) if detail.contains("not one of 1 to 2^40")),
        "{refused:?}"
    );
}

#[test]
fn a_failing_job_leaves_its_neighbours_alone() {
    let (_home, ledger) = open();
    ledger.records.append(vec![record(1, 1, 1)]).expect("acknowledged");
    thread::scope(|scope| {
        for writer in 2..10u8 {
            let ledger = &ledger;
            scope.spawn(move || {
                for seq in 1..=40 {
                    ledger.records.append(vec![record(writer, 1, seq)]).expect("acknowledged");
                    let bad = NewRecord { digest: Digest([writer; 32]), ..record(1, 1, 1) };
                    ledger.records.append(vec![record(writer, 3, seq), bad]).expect_err("refused");
                }
            });
        }
    });
    let counts = ledger.counts.by_state(None).expect("counts");
    assert_eq!(counts.captured(), 1 + 8 * 40);
    assert_eq!(
        ledger.records.list(&RecordQuery { limit: 1_000, ..RecordQuery::default() }).expect("list").rows.len(),
        321
    );
}

#[test]
fn records_are_held_back_while_the_space_is_for_something_else() {
    let (_home, ledger) = open();
    let (one, other) = (ledger.records.hold(), ledger.records.hold());
    drop(one);
    assert!(matches!(ledger.records.append(vec![record(1, 1, 1)]), Err(StoreError::DiskFull { .. })));
    ledger.notes.write(&CopiedAt {}, &1).expect("everything else is written");
    drop(other);
    ledger.records.append(vec![record(1, 1, 1)]).expect("acknowledged");
}

#[test]
fn a_full_disk_acknowledges_nothing_and_takes_all_later() {
    let (_home, ledger) = open();
    ledger.records.append(vec![record(1, 1, 1)]).expect("acknowledged");
    let limit = |pages: i64| {
        ledger.database.write(move |session| {
            let file = session.connection.file().expect("a file");
            Ok(file.pragma_update_and_check(None, "max_page_count", pages, |_| Ok(()))?)
        })
    };
    limit(1).expect("no page more than there are");
    let large: Vec<NewRecord> =
        (2..=9).map(|seq| NewRecord { blob: Some(vec![1; 50_000]), ..record(1, 1, seq) }).collect();
    let error = ledger.records.append(large.clone()).expect_err("full");
    assert!(matches!(error, StoreError::DiskFull { .. }) && error.to_string().contains("ledger.db"), "{error}");
    assert_eq!(ledger.records.next_seq(Address([1; 20]), SignerId([1; 32]), TopicId([1; 16])), Ok(2));
    limit(1_000_000).expect("grown");
    ledger.records.append(large).expect("acknowledged");
    assert_eq!(ledger.counts.by_state(None).expect("counts").captured(), 9);
}

#[test]
fn all_files_are_private() {
    use std::os::unix::fs::PermissionsExt as _;
    let (home, ledger) = open();
    ledger.records.append(vec![record(1, 1, 1)]).expect("acknowledged");
    let modes = std::fs::read_dir(home.path())
        .expect("list")
        .map(|entry| entry.and_then(|entry| entry.metadata()).expect("file").permissions().mode() & 0o777);
    assert_eq!(modes.collect::<Vec<_>>(), [0o600; 3], "database, log and shared memory");
}

#[test]
fn a_panic_in_the_writer_is_an_error_to_its_caller_alone() {
    let (_home, ledger) = open();
    let answer: Result<(), _> = ledger.database.write(|_| panic!("on purpose"));
    assert!(answer.is_err(), "{answer:?}");
    ledger.records.append(vec![record(1, 1, 1)]).expect("the writer goes on");
}

fn confirmed(ledger: &Ledger, block: u64) -> usize {
    ledger.batches.confirm(block).expect("confirmed").len()
}

#[test]
fn a_record_walks_its_life_line() {
    let (_home, ledger) = open();
    let one = record(1, 1, 1);
    ledger.records.append(vec![one.clone()]).expect("acknowledged");
    let digests = [one.digest];
    let leap = ledger.records.advance(&digests, RecordState::Stored, RecordState::Verified);
    assert!(matches!(leap, Err(StoreError::IllegalEdge { .. })));
    ledger.lanes.submit(transaction(3, &digests)).expect("kept");
    ledger.lanes.submit(transaction(3, &digests)).expect("idempotent");
    let row = ledger.records.find(one.digest).expect("read").expect("there");
    assert_eq!((row.state, row.transaction), (RecordState::Submitted, Some(Hash([3; 32]))));
    assert_eq!(ledger.lanes.open_transactions(Address([1; 20])).expect("open").len(), 1);
    assert_eq!(ledger.batches.mined(&[sighting(&one, 10)]), Ok(1));
    assert_eq!(ledger.batches.mined(&[sighting(&one, 10)]), Ok(0));
    assert_eq!((confirmed(&ledger, 9), confirmed(&ledger, 10)), (0, 1));
    assert_eq!(ledger.records.advance(&digests, RecordState::Confirmed, RecordState::Verified), Ok(1));
    assert_eq!(
        ledger.records.advance(&digests, RecordState::Confirmed, RecordState::Verified),
        Ok(0),
        "compare and set"
    );
    let row = ledger.records.by_id(&one.digest.to_hex()[..16]).expect("read").expect("there");
    assert_eq!((row.state, row.block, row.transaction), (RecordState::Verified, Some(10), Some(Hash([9; 32]))));
    assert_eq!(row.block_hash, Some(Hash([10; 32])));
}

#[test]
fn submitting_refuses_what_is_not_ready_and_a_taken_nonce() {
    let (_home, ledger) = open();
    let (one, two) = (record(1, 1, 1), record(1, 1, 2));
    ledger.records.append(vec![one.clone(), two.clone()]).expect("acknowledged");
    ledger.batches.mined(&[sighting(&two, 4)]).expect("seen");
    let refused = ledger.lanes.submit(transaction(3, &[one.digest, two.digest]));
    assert_eq!(refused, Err(StoreError::NotReady { digest: two.digest, found: "mined" }));
    assert_eq!(state_of(&ledger, &one), RecordState::Stored, "all or none");
    ledger.lanes.submit(transaction(3, &[one.digest])).expect("kept");
    let other = NewTransaction { hash: Hash([4; 32]), ..transaction(3, &[]) };
    assert!(matches!(ledger.lanes.submit(other), Err(StoreError::Transaction { .. })));
    let unknown = ledger.lanes.close_transactions(vec![(Hash([8; 32]), TransactionOutcome::Replaced)]);
    assert!(matches!(unknown, Err(StoreError::Transaction { .. })));
}

#[test]
fn a_failed_transaction_gives_its_records_back() {
    let (_home, ledger) = open();
    let (one, two) = (record(1, 1, 1), record(1, 1, 2));
    ledger.records.append(vec![one.clone(), two.clone()]).expect("acknowledged");
    ledger.lanes.submit(transaction(3, &[one.digest, two.digest])).expect("kept");
    let bumped = NewTransaction { nonce: 3, ..transaction(4, &[one.digest]) };
    ledger.lanes.replace_transaction(Hash([3; 32]), bumped).expect("replaced");
    assert_eq!((state_of(&ledger, &one), state_of(&ledger, &two)), (RecordState::Submitted, RecordState::Stored));
    let old = ledger.lanes.transaction(Hash([3; 32])).expect("read").expect("there");
    assert_eq!((old.state, old.replaced_by), (TransactionState::Replaced, Some(Hash([4; 32]))));
    let reason = "paused\u{1b}[2J".to_owned();
    ledger.lanes.close_transactions(vec![(Hash([4; 32]), TransactionOutcome::Reverted { reason })]).expect("closed");
    let row = ledger.records.find(one.digest).expect("read").expect("there");
    assert_eq!((row.state, row.transaction), (RecordState::Stored, None));
    let reason = ledger.lanes.transaction(Hash([4; 32])).expect("read").expect("there").reason;
    assert_eq!(reason.as_deref(), Some("paused\u{fffd}[2J"));
}

#[test]
fn a_reorg_reopens_own_transactions_and_stores_the_rest_again() {
    let (_home, ledger) = open();
    let all: Vec<NewRecord> = (1..=4).map(|seq| record(1, 1, seq)).collect();
    ledger.records.append(all.clone()).expect("acknowledged");
    ledger.lanes.submit(transaction(9, &[all[0].digest])).expect("kept");
    let block_hash = Hash([20; 32]);
    let mined = TransactionOutcome::Mined { block: 20, block_hash, gas_used: Some(52_000) };
    ledger.lanes.close_transactions(vec![(Hash([9; 32]), mined)]).expect("closed");
    let foreign = Sighting { transaction: Hash([77; 32]), ..sighting(&all[1], 20) };
    ledger
        .batches
        .mined(&[sighting(&all[0], 20), foreign, sighting(&all[2], 19), sighting(&all[3], 20)])
        .expect("seen");
    ledger.batches.confirm(20).expect("confirmed");
    ledger.records.advance(&[all[3].digest], RecordState::Confirmed, RecordState::Verified).expect("verified");
    assert_eq!(ledger.batches.take_back(20), Ok((3, 1)));
    let states: Vec<_> = all.iter().map(|record| state_of(&ledger, record)).collect();
    assert_eq!(states, [Submitted, Stored, Confirmed, Submitted]);
    assert_eq!(ledger.lanes.open_transactions(Address([1; 20])).expect("open").len(), 1);
    assert_eq!(ledger.batches.mined(&[sighting(&all[0], 21)]), Ok(1), "and it is mined again");
}

#[test]
fn ids_are_prefixes_of_digests() {
    let (_home, ledger) = open();
    let mut twins = [record(1, 1, 1), record(1, 1, 2)];
    twins[1].digest = twins[0].digest;
    twins[1].digest.0[31] ^= 1;
    ledger.records.append(twins.to_vec()).expect("acknowledged");
    let id = twins[0].digest.to_hex();
    assert!(matches!(ledger.records.by_id(&id[..16]), Err(StoreError::Ambiguous(_))));
    assert!(matches!(ledger.records.by_id(&id[..4]), Err(StoreError::Ambiguous(_))));
    assert_eq!(ledger.records.by_id(&id).expect("read").expect("there").seq, 1);
    assert_eq!(ledger.records.by_id(&"0".repeat(17)), Ok(None));
    for bad in ["", "12", "0x34567890123456", &"g".repeat(16), &"0".repeat(65)] {
        assert!(matches!(ledger.records.by_id(bad), Err(StoreError::Id(_))), "{bad}");
    }
}

#[test]
fn of_changes_of_a_note_at_once_none_is_lost() {
    let (_home, ledger) = open();
    let (note, notes) = (Revoking { owner: Address([1; 20]) }, &ledger.notes);
    let add = |name: u8| {
        notes.change(&note, |owed| {
            owed.push(Address([name; 20]));
            Ok::<_, StoreError>(())
        })
    };
    std::thread::scope(|scope| {
        for name in 1..=8 {
            scope.spawn(move || (0..5).for_each(|_| add(name).expect("changed")));
        }
    });
    let owed = notes.read(&note).expect("read").expect("there");
    for name in 1..=8 {
        assert_eq!(owed.iter().filter(|other| **other == Address([name; 20])).count(), 5, "{owed:?}");
    }
    let refused = notes.change(&note, |owed| {
        owed.clear();
        Err::<(), _>(StoreError::Closed)
    });
    assert_eq!(refused, Err(StoreError::Closed));
    assert_eq!(notes.read(&note), Ok(Some(owed)));
}

#[test]
fn a_note_is_replaced_only_as_it_was_read() {
    let (_home, ledger) = open();
    let (note, notes) = (Revoking { owner: Address([1; 20]) }, &ledger.notes);
    let [one, two] = [1, 2].map(|name| vec![Address([name; 20])]);
    assert_eq!(notes.replace(&note, Some(&one), &two), Ok(false), "there is none yet");
    assert_eq!(notes.replace(&note, None, &one), Ok(true));
    assert_eq!(notes.replace(&note, None, &two), Ok(false), "somebody was first");
    assert_eq!(notes.replace(&note, Some(&two), &two), Ok(false), "it says something else");
    assert_eq!(notes.read(&note), Ok(Some(one.clone())));
    assert_eq!(notes.replace(&note, Some(&one), &two), Ok(true));
    assert_eq!(notes.read(&note), Ok(Some(two)));
}

#[test]
fn a_name_goes_to_another_account_only_from_the_one_that_was_asked() {
    let (_home, ledger) = open();
    let name: ProfileName = "scout".parse().expect("a name");
    let of = |number: u8| KeptBinding {
        account: Address([number; 20]),
        signing: PublicKey([number; 64]),
        envelope: PublicKey([number; 64]),
        sealed_key: vec![number; 60],
        device: None,
    };
    let bind = |before: Option<u8>, number| ledger.bindings.bind(&name, before.map(|of| Address([of; 20])), of(number));
    assert_eq!(bind(None, 1), Ok(true));
    assert_eq!(bind(None, 2), Ok(false), "another worker was first");
    assert_eq!(bind(Some(2), 2), Ok(false));
    let account = || ledger.bindings.binding(&name).expect("read").map(|kept| kept.account);
    assert_eq!(account(), Some(Address([1; 20])));
    assert_eq!(bind(Some(1), 1), Ok(true), "a new key of the same account");
    assert_eq!(bind(Some(1), 2), Ok(true), "its successor");
    assert_eq!(account(), Some(Address([2; 20])));
}

#[test]
fn small_state_is_kept() {
    let (home, ledger) = open();
    ledger.notes.write(&CopiedAt {}, &1).expect("kept");
    ledger.notes.write(&CopiedAt {}, &2).expect("kept");
    ledger.trail.set_cursor(7, Hash([7; 32])).expect("kept");
    ledger.losses.count(vec![loss(LossReason::Memory, 3), loss(LossReason::Transport, 2)]).expect("kept");
    ledger.close().expect("closed");
    let ledger = Ledger::open(&home.path().join("ledger.db")).expect("opens");
    assert_eq!(ledger.notes.read(&CopiedAt {}), Ok(Some(2)));
    ledger.notes.forget(&CopiedAt {}, &1).expect("asked");
    assert_eq!(ledger.notes.read(&CopiedAt {}), Ok(Some(2)), "it says something else");
    ledger.notes.forget(&CopiedAt {}, &2).expect("dropped");
    assert_eq!(ledger.notes.read(&CopiedAt {}), Ok(None));
    assert_eq!(ledger.trail.cursor(), Ok(Some((7, Hash([7; 32])))));
    let counts = ledger.counts.by_state(None).expect("counts");
    assert_eq!((counts.captured(), counts.data_in(RecordState::Dropped), counts.pending()), (3, 3, 0));
    assert_eq!((counts.topics[0].dropped, counts.topics[0].missed, counts.topics[0].captured), (3, 2, 3));
    assert_eq!(ledger.losses.gaps(Address([1; 20]), 9).expect("gaps").len(), 2);
    assert_eq!(ledger.counts.by_state(Some(Address([2; 20]))), Ok(StateCounts::default()));
}

#[test]
fn a_path_is_read_as_it_was_kept_however_many_leaves_there_are() {
    for count in (1..=40).chain([63, 64, 65, 100]) {
        let (_home, ledger) = open();
        let all: Vec<NewRecord> = (1..=count).map(|seq| record(1, 1, seq)).collect();
        ledger.records.append(all.clone()).expect("acknowledged");
        let leaves = ledger.batches.stored_leaves(Address([1; 20]), 1_000).expect("leaves");
        let tree = Tree::new(Leaf::hashes(&leaves)).expect("a tree");
        let paths: Vec<_> = leaves.iter().enumerate().map(|(at, leaf)| (leaf.digest, tree.path(at))).collect();
        let batch = NewBatch { owner: Address([1; 20]), root: tree.root(), leaves: paths.clone() };
        ledger.batches.close(batch).expect("closed");
        let digests: Vec<Digest> = paths.iter().map(|(digest, _)| *digest).collect();
        let placed = ledger.records.placed_all(&digests).expect("placed");
        let audited = ledger.inspection.audit_page(0, Timestamp(0), 1_000).expect("a page").records;
        for (((leaf, (_, path)), placed), audited) in leaves.iter().zip(&paths).zip(placed).zip(audited) {
            let place = placed.and_then(|placed| placed.place).expect("a place").inclusion;
            assert_eq!(place.path, *path, "{count}");
            assert!(place.proves(leaf), "{count}");
            let audited = audited.expect("a row").place.and_then(|place| place.inclusion);
            assert_eq!(audited, Some(place), "{count}");
        }
    }
}

/// The state after a crash: the files as they are while the writer is in the middle of a transaction.
fn copy_files(from: &Path, to: &Path) {
    for suffix in ["", "-wal"] {
        let name = format!("ledger.db{suffix}");
        std::fs::copy(from.join(&name), to.join(&name)).expect("copied");
    }
}

#[test]
fn whatever_was_acknowledged_is_there_after_a_crash() {
    let (home, ledger) = open();
    let stop = AtomicBool::new(false);
    thread::scope(|scope| {
        let (path, stop) = (home.path(), &stop);
        let appender = |writer: u8| {
            let ledger = ledger.clone();
            move || {
                let mut seq = 0;
                while !stop.load(Ordering::Relaxed) {
                    seq += 1;
                    let blob = Some(vec![writer; 3_000]);
                    ledger.records.append(vec![NewRecord { blob, ..record(writer, 1, seq) }]).expect("append");
                }
            }
        };
        let writers: Vec<_> = (1..=3).map(|writer| scope.spawn(appender(writer))).collect();
        for _ in 0..15 {
            thread::sleep(std::time::Duration::from_millis(7));
            let crash = tempfile::tempdir().expect("temporary directory");
            let acknowledged = (1..=3)
                .map(|w| ledger.records.next_seq(Address([w; 20]), SignerId([w; 32]), TopicId([1; 16])).expect("seq"));
            let acknowledged: Vec<u64> = acknowledged.collect();
            let (from, to) = (path.to_owned(), crash.path().to_owned());
            let copied = ledger.database.write(move |_| {
                copy_files(&from, &to);
                Ok(())
            });
            copied.expect("copied");
            let after = Ledger::open(&crash.path().join("ledger.db")).expect("opens");
            for (writer, next) in (1u8..).zip(acknowledged) {
                let found = after
                    .records
                    .next_seq(Address([writer; 20]), SignerId([writer; 32]), TopicId([1; 16]))
                    .expect("seq");
                assert!(found >= next, "writer {writer}: {found} after the crash, {next} before");
                for seq in 1..next {
                    let row = after.records.find(record(writer, 1, seq).digest).expect("read").expect("acknowledged");
                    assert_eq!(Ciphertext::of(&after).get(row.digest), Ok(Some(vec![writer; 3_000])));
                }
            }
        }
        stop.store(true, Ordering::Relaxed);
        writers.into_iter().for_each(|writer| writer.join().expect("no panic"));
    });
}

#[test]
fn who_waits_for_the_file_keeps_no_other_task_of_a_runtime_waiting() {
    let (_home, ledger) = open();
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).build().expect("a runtime");
    for is_writing in [false, true] {
        let (tell, told) = std::sync::mpsc::channel::<()>();
        let wait = move || told.recv_timeout(std::time::Duration::from_secs(20)).is_ok();
        let database = ledger.database.clone();
        let reading = runtime.spawn(async move {
            match is_writing {
                false => database.read(|_| Ok(wait())),
                true => database.write(move |_| Ok(wait())),
            }
        });
        // The only worker thread is with the file by then, or comes to it after this.
        std::thread::sleep(std::time::Duration::from_millis(50));
        let other = runtime.spawn(async move { tell.send(()) });
        assert_eq!(runtime.block_on(reading).expect("ends"), Ok(true), "writing: {is_writing}");
        assert_eq!(runtime.block_on(other).expect("ends"), Ok(()));
    }
}

server::on_a_server! {
    appending_twice_changes_nothing_and_contradictions_are_refused, a_failing_job_leaves_its_neighbours_alone,
    records_are_held_back_while_the_space_is_for_something_else, a_panic_in_the_writer_is_an_error_to_its_caller_alone,
    a_record_walks_its_life_line, submitting_refuses_what_is_not_ready_and_a_taken_nonce,
    a_failed_transaction_gives_its_records_back, a_reorg_reopens_own_transactions_and_stores_the_rest_again,
    ids_are_prefixes_of_digests, of_changes_of_a_note_at_once_none_is_lost, a_note_is_replaced_only_as_it_was_read,
    a_name_goes_to_another_account_only_from_the_one_that_was_asked,
    a_path_is_read_as_it_was_kept_however_many_leaves_there_are,
    who_waits_for_the_file_keeps_no_other_task_of_a_runtime_waiting,
}
