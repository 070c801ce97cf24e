//! A backup: complete, sealed, never overwriting another file, and of one moment.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use std::os::unix::fs::PermissionsExt as _;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use super::*;
use crate::crypto::sealed_stream::SealedReader;
use crate::model::{Digest, RecorderPrefix, RingLimits, RingSpan, Signature, Timestamp, TopicId, TopicPatterns};
use crate::site::testing::{Ground, PASSPHRASE, profile};
use crate::site::{Contacts, Reading};
use crate::store::{DiskRing, RingRecord};

fn backup(ground: &Ground) -> (Arc<Backup>, Arc<Quarantine>) {
    let contacts = Arc::new(Contacts::new(&ground.parts));
    let reading = Arc::new(Reading::new(&ground.parts, &contacts));
    let quarantine = Arc::new(Quarantine::new(&ground.parts, &reading));
    (Arc::new(Backup { parts: ground.parts.clone(), quarantine: Arc::clone(&quarantine) }), quarantine)
}

fn secret() -> SecretText {
    SecretText::new(PASSPHRASE.to_owned())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_back_up_is_written_once_for_its_owner_alone_and_not_into_the_home() {
    let ground = Ground::with(&[]);
    ground.owner("alice");
    let (backup, _) = backup(&ground);
    let (alice, file) = (profile("alice"), ground.folder.path().join("home.backup"));
    let inside = ground.parts.home.root().join("home.backup");
    let refused = backup.back_up(&alice, inside, secret()).await.expect_err("in the home");
    assert!(refused.message.contains("is inside the home itself"), "{}", refused.message);
    assert!(ground.audited("back up").is_empty());

    let view = backup.back_up(&alice, file.clone(), secret()).await.expect("written");
    assert_eq!(view.profiles, ["alice"]);
    let about = std::fs::metadata(&file).expect("there");
    assert_eq!(about.permissions().mode() & 0o777, 0o600);
    let bytes = std::fs::read(&file).expect("readable");
    assert!(!bytes.windows(5).any(|window| window == b"alice"), "sealed");
    let twice = backup.back_up(&alice, file.clone(), secret()).await.expect_err("never over another");
    assert!(twice.message.contains("exists"), "{}", twice.message);
    assert_eq!(std::fs::read(&file).expect("as before"), bytes);
    let outcomes: Vec<_> = ground.audited("back up").into_iter().map(|(_, outcome)| outcome).collect();
    assert_eq!(outcomes, ["begun", "done"]);
    let left: Vec<_> = std::fs::read_dir(ground.parts.home.root())
        .expect("the home")
        .flatten()
        .filter(|entry| entry.file_name().to_string_lossy().starts_with(unfinished::PREFIX))
        .collect();
    assert!(left.is_empty(), "{left:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_moment_waits_for_what_deletes_ciphertext() {
    let ground = Ground::with(&[]);
    ground.owner("alice");
    let (backup, quarantine) = backup(&ground);
    let file = ground.folder.path().join("home.backup");
    let quiet = quarantine.quiet().await;
    let mut running = Box::pin({
        let (backup, file) = (Arc::clone(&backup), file.clone());
        async move { backup.back_up(&profile("alice"), file, secret()).await }
    });
    // Until it is announced, which happens right before the moment.
    loop {
        tokio::select! {
            done = &mut running => panic!("ended while records were being deleted: {done:?}"),
            () = tokio::time::sleep(std::time::Duration::from_millis(20)) => {}
        }
        if !ground.audited("back up").is_empty() {
            break;
        }
    }
    let told = ground.parts.runs.of(&profile("alice"));
    assert_eq!((told.len(), told[0].step.as_str(), told[0].messages), (1, "copying into", 0));
    assert!(!file.exists());
    drop(quiet);
    running.await.expect("written now");
    assert!(ground.parts.runs.of(&profile("alice")).is_empty(), "it ended");
    assert!(file.exists());
}

const LIMITS: RingLimits = RingLimits { time: Duration::from_secs(3600), bytes: RingLimits::LEAST };

fn ring(folder: &Path) -> DiskRing {
    DiskRing::open(folder, LIMITS, RecorderPrefix::ring([1; 7])).expect("a ring")
}

/// A message whose bytes say which it is.
fn message(number: u64) -> RingRecord {
    RingRecord {
        digest: Digest([2; 32]),
        signature: Signature([3; 64]),
        topic: "/camera".to_owned(),
        type_name: "a/B".to_owned(),
        captured_at: Timestamp::now(),
        is_definition: false,
        simulated: false,
        plain_length: 1,
        blob: number.to_be_bytes().repeat(500),
    }
}

fn roll(ring: &mut DiskRing, number: u64) {
    let record = message(number);
    ring.begin_round(5_000, Timestamp::now()).expect("a round");
    ring.append(&[(record, number, None, TopicId([4; 16]))]).expect("appended");
}

/// The numbers of the messages of a ring, which must be whole.
fn numbers(ring: &DiskRing) -> Vec<u64> {
    let all = RingSpan { since: Timestamp(0), until: Timestamp(u64::MAX), topics: TopicPatterns::default() };
    let records = ring.parts_of(&all).into_iter().flat_map(|part| ring.select(part, &all).expect("read"));
    let number = |record: RingRecord| {
        let number = u64::from_be_bytes(record.blob[..8].try_into().expect("eight"));
        assert_eq!(record.blob, message(number).blob);
        number
    };
    records.map(number).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_back_up_carries_a_ring_that_rolls_meanwhile() {
    let ground = Ground::with(&[]);
    ground.owner("alice");
    let (backup, _) = backup(&ground);
    let mut rolling = ring(&ground.parts.home.ring());
    (1..=500).for_each(|number| roll(&mut rolling, number));
    let before = numbers(&rolling);
    assert!(before.len() > 100 && before[0] > 1, "it is full and rolls: {before:?}");
    let ended = Arc::new(AtomicBool::new(false));
    let roller = std::thread::spawn({
        let ended = Arc::clone(&ended);
        move || {
            let mut number = 500;
            while !ended.load(Ordering::Relaxed) {
                number += 1;
                roll(&mut rolling, number);
            }
            number
        }
    });
    let mut files = Vec::new();
    for name in ["one", "two", "three"] {
        let file = ground.folder.path().join(name);
        backup.back_up(&profile("alice"), file.clone(), secret()).await.expect("written");
        files.push(file);
    }
    ended.store(true, Ordering::Relaxed);
    let last = roller.join().expect("rolled");
    assert!(last > 1000, "all of it fell out meanwhile: {last}");
    for file in files {
        let passphrase = Passphrase::new(PASSPHRASE.to_owned()).expect("long enough");
        let opened = io::BufReader::new(File::open(&file).expect("written"));
        let mut sealed = SealedReader::open(opened, &passphrase).expect("opens");
        let folder = tempfile::tempdir().expect("a folder");
        archive::unpack(&mut sealed, folder.path()).expect("unpacked");
        let carried = numbers(&ring(&folder.path().join("ring")));
        assert!(!carried.is_empty() && carried.is_sorted(), "{carried:?}");
    }
}

#[test]
fn a_file_that_fell_out_since_the_folder_was_listed_is_no_failure() {
    let ground = Ground::with(&[]);
    let runs = &ground.parts.runs;
    let running = runs.begin(&profile("alice"), "a file", "writing", "files");
    let mut view = BackupView { file: String::new(), files: 0, bytes: 0, profiles: Vec::new(), notes: Vec::new() };
    let mut sealed = Vec::new();
    let mut small = Small { sealed: &mut sealed, view: &mut view, run: &running.run };
    let path = ground.folder.path().join("1.ring");
    std::fs::write(&path, b"soon gone").expect("written");
    let kind = std::fs::metadata(&path).expect("there").file_type();
    std::fs::remove_file(&path).expect("gone");
    small.entry("ring/1.ring", &path, kind).expect("it fell out");
    let missing = small.entry("keyring", &path, kind).expect_err("nothing else may be missing");
    assert_eq!(missing.kind(), io::ErrorKind::NotFound);
    assert!(sealed.is_empty() && view.files == 0);
}
