//! A ring on the disk: what comes back of it, what falls out, and what a crash leaves.

use super::*;
use crate::model::TopicPatterns;
use std::io::Write as _;

const SECOND: u64 = 1_000_000_000;
const CAMERA: &str = "/camera";
const LASER: &str = "/laser";

fn limits(seconds: u64, bytes: u64) -> RingLimits {
    RingLimits { time: Duration::from_secs(seconds), bytes }
}

fn ring(folder: &Path, limits: RingLimits) -> DiskRing {
    DiskRing::open(folder, limits, RecorderPrefix::ring([1; 7])).expect("a ring")
}

fn topic_id(topic: &str) -> TopicId {
    TopicId([topic.as_bytes()[1]; 16])
}

fn all(since: u64, until: u64) -> RingSpan {
    RingSpan { since: Timestamp(since), until: Timestamp(until), topics: TopicPatterns::default() }
}

/// A message at this time, with its definition where the file lacks it.
fn add(ring: &mut DiskRing, topic: &str, at: u64, length: usize) {
    let definition = (topic_id(topic), 1, Digest([9; 32]));
    ring.begin_round(length as u64 + 500, Timestamp(at)).expect("a round");
    let mut number = ring.next_number(topic_id(topic));
    let mut records = Vec::new();
    let mut one = |is_definition: bool, blob: Vec<u8>| {
        let record = RingRecord {
            digest: Digest([u8::try_from(number % 251).expect("small"); 32]),
            signature: Signature([3; 64]),
            topic: topic.to_owned(),
            type_name: "a/B".to_owned(),
            captured_at: Timestamp(at),
            is_definition,
            simulated: !is_definition,
            plain_length: 77,
            blob,
        };
        records.push((record, number, is_definition.then_some(definition), topic_id(topic)));
        number += 1;
    };
    if !ring.has_definition(&definition) {
        one(true, b"the definition".to_vec());
    }
    one(false, vec![5; length]);
    ring.append(&records).expect("appended");
}

fn found(ring: &DiskRing, span: &RingSpan) -> Vec<RingRecord> {
    ring.parts_of(span).into_iter().flat_map(|part| ring.select(part, span).expect("read")).collect()
}

fn times(records: &[RingRecord]) -> Vec<u64> {
    records.iter().filter(|record| !record.is_definition).map(|record| record.captured_at.0 / SECOND).collect()
}

fn now() -> u64 {
    Timestamp::now().0
}

#[test]
fn a_span_comes_back_as_it_went_in_after_the_process_was_killed() {
    let folder = tempfile::tempdir().expect("a folder");
    let begun = now() - 100 * SECOND;
    let mut first = ring(folder.path(), limits(3600, 1 << 24));
    for second in 0..20 {
        add(&mut first, CAMERA, begun + second * SECOND, 100);
        add(&mut first, LASER, begun + second * SECOND, 10);
    }
    assert_eq!((first.figures().messages, first.figures().fallen), (40, 0));
    // Nothing is closed or flushed, as with SIGKILL.
    std::mem::forget(first);
    let again = ring(folder.path(), limits(3600, 1 << 24));
    assert_eq!((again.figures().messages, again.figures().since), (40, Some(Timestamp(begun))));
    let span = RingSpan { topics: CAMERA.parse().expect("a pattern"), ..all(begun + 5 * SECOND, begun + 8 * SECOND) };
    let taken = found(&again, &span);
    let seconds = begun / SECOND;
    assert_eq!(times(&taken), [seconds + 5, seconds + 6, seconds + 7]);
    assert!(taken.iter().all(|record| record.topic == CAMERA));
    assert_eq!((taken[0].is_definition, &taken[0].blob[..]), (true, &b"the definition"[..]), "definitions go first");
    let message = &taken[1];
    assert_eq!((message.blob.clone(), message.simulated, message.plain_length), (vec![5; 100], true, 77));
    assert_eq!((message.type_name.as_str(), message.signature), ("a/B", Signature([3; 64])));
    assert_eq!(again.next_number(topic_id(CAMERA)), 1, "with a recorder of its own, numbers begin anew");
}

#[test]
fn a_ring_of_a_later_version_is_refused_and_kept() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut first = ring(folder.path(), limits(3600, 1 << 24));
    add(&mut first, CAMERA, now(), 100);
    drop(first);
    let (_, path) = list(folder.path()).expect("listed").into_iter().next().expect("a file");
    let mut bytes = fs::read(&path).expect("read");
    bytes[MAGIC.len() - 1] = 2;
    fs::write(&path, &bytes).expect("written");
    let opened = DiskRing::open(folder.path(), limits(3600, 1 << 24), RecorderPrefix::ring([1; 7]));
    let error = opened.map(drop).expect_err("a later version");
    assert!(matches!(error, StoreError::Newer { found: 2, known: 1, .. }), "{error}");
    assert_eq!(fs::read(&path).expect("read"), bytes, "nothing of it is cut off");
}

#[test]
fn what_is_older_or_does_not_fit_falls_out_and_is_counted() {
    let folder = tempfile::tempdir().expect("a folder");
    let begun = now() - 1000 * SECOND;
    let mut by_time = ring(folder.path(), limits(160, 1 << 24));
    for second in 0..400 {
        add(&mut by_time, CAMERA, begun + second * SECOND, 50);
    }
    let figures = by_time.figures();
    assert_eq!(figures.messages + figures.fallen, 400, "never a hole");
    // A sixteenth more at most: files go as a whole.
    assert!((160..=172).contains(&figures.messages), "{figures:?}");
    let kept = times(&found(&by_time, &all(0, u64::MAX)));
    assert_eq!(kept.len() as u64, figures.messages);
    assert!(kept.windows(2).all(|two| two[1] == two[0] + 1), "the newest, without a gap");
    drop(by_time);
    let later = ring(folder.path(), limits(160, 1 << 24));
    assert_eq!((later.figures().messages, later.figures().fallen), (0, 400), "all of it is old by now");

    let folder = tempfile::tempdir().expect("a folder");
    let mut by_size = ring(folder.path(), limits(1_000_000, 1 << 20));
    let begun = now();
    for number in 0..200 {
        add(&mut by_size, LASER, begun + number, 20_000);
        let on_disk: u64 =
            list(folder.path()).expect("files").iter().map(|(_, path)| fs::metadata(path).expect("a file").len()).sum();
        assert!(on_disk <= 1 << 20 && by_size.figures().bytes == on_disk, "{on_disk}");
    }
    let figures = by_size.figures();
    assert_eq!(figures.messages + figures.fallen, 200);
    assert!(figures.messages >= 40, "{figures:?}");
    assert!(by_size.is_too_large(300_000) && !by_size.is_too_large(100_000));
    by_size.refuse(LASER);
    assert_eq!((by_size.figures().fallen, by_size.fallen()[LASER]), (figures.fallen + 1, figures.fallen + 1));
}

#[test]
fn at_any_moment_of_an_hour_the_last_five_minutes_are_there() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut ring = ring(folder.path(), limits(300, 1 << 24));
    let begun = now() / SECOND * SECOND - 4000 * SECOND;
    for second in 0..3600 {
        let at = begun + second * SECOND;
        add(&mut ring, CAMERA, at, 50);
        if second % 41 == 0 {
            let since = at.saturating_sub(300 * SECOND).max(begun);
            let expected: Vec<u64> = (since / SECOND..=at / SECOND).collect();
            assert_eq!(times(&found(&ring, &all(since, at + 1))), expected, "after {second} seconds");
        }
    }
    let figures = ring.figures();
    assert!(figures.fallen >= 3600 - 320 && figures.messages + figures.fallen == 3600, "{figures:?}");
}

#[test]
fn a_clock_that_jumps_empties_no_ring() {
    const DAY: u64 = 86_400 * SECOND;
    for (by, name) in [(i128::from(DAY), "ahead"), (-i128::from(DAY), "back")] {
        let folder = tempfile::tempdir().expect("a folder");
        let mut ring = ring(folder.path(), limits(160, 1 << 24));
        let begun = now() - 100 * SECOND;
        for second in 0..100 {
            add(&mut ring, CAMERA, begun + second * SECOND, 50);
        }
        let jumped = u64::try_from(i128::from(begun + 100 * SECOND) + by).expect("a time");
        ring.jumped(by, Timestamp(jumped));
        add(&mut ring, CAMERA, jumped, 50);
        assert_eq!(ring.figures().messages, 101, "{name}");
        // It ages as if the clock had not jumped: ten seconds a file.
        add(&mut ring, CAMERA, jumped + 110 * SECOND, 50);
        let left = ring.figures().messages;
        assert!((52..=63).contains(&left), "{name}: {left} left after 210 seconds");
        add(&mut ring, CAMERA, jumped + 175 * SECOND, 50);
        assert_eq!(ring.figures().messages, 2, "{name}: what came before the jump is gone");
    }
    // A machine that begins in 1970 and is set then: what is of the last start ages from now on.
    let folder = tempfile::tempdir().expect("a folder");
    let mut ring = ring(folder.path(), limits(160, 1 << 24));
    add(&mut ring, CAMERA, now(), 50);
    let set = now() + 3600 * SECOND;
    ring.jumped(i128::from(set), Timestamp(set));
    ring.tend(Timestamp(set + 159 * SECOND)).expect("tended");
    assert_eq!(ring.figures().messages, 1);
    ring.tend(Timestamp(set + 161 * SECOND)).expect("tended");
    assert_eq!(ring.figures().messages, 0);
    assert!(ring.now().0 >= set - 3600 * SECOND, "and the clock that did not jump moves nothing");
}

#[test]
fn every_file_stands_alone_and_a_torn_or_foreign_one_hides_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut begun = ring(folder.path(), limits(3600, 1 << 20));
    let start = now();
    for number in 0..20 {
        add(&mut begun, CAMERA, start + number, 10_000);
    }
    let parts = begun.parts_of(&all(0, u64::MAX));
    assert!(parts.len() > 2, "{parts:?}");
    for part in &parts {
        let records = begun.select(*part, &all(0, u64::MAX)).expect("read");
        assert!(records[0].is_definition && !records[1].is_definition, "each file has its definitions");
    }
    drop(begun);
    let files = list(folder.path()).expect("files");
    let last = &files.last().expect("one").1;
    let whole = fs::metadata(last).expect("a file").len();
    // Half a record, as a machine without power leaves it; and a file that is none.
    let torn = [0, 1, 0, 0, 7, 7, 7].repeat(3);
    fs::OpenOptions::new().append(true).open(last).and_then(|mut file| file.write_all(&torn)).expect("written");
    files::atomic_write(&folder.path().join("0000000000000000.ring"), b"something else").expect("written");
    let again = ring(folder.path(), limits(3600, 1 << 20));
    assert_eq!(again.figures().messages, 20);
    assert_eq!(fs::metadata(last).expect("a file").len(), whole, "what was not whole is cut off");
    let file = fs::read(last).expect("a file");
    for cut in [1, 3, 9, 10, 40, 200] {
        let folder = tempfile::tempdir().expect("a folder");
        files::atomic_write(&folder.path().join("1.ring"), &file[..file.len() - cut]).expect("written");
        let cut = ring(folder.path(), limits(3600, 1 << 20));
        assert!(found(&cut, &all(0, u64::MAX)).iter().all(|record| !record.blob.is_empty()));
    }
}

#[test]
fn what_falls_out_is_gone_although_its_count_cannot_be_written() {
    let folder = tempfile::tempdir().expect("a folder");
    // As on a full disk: the count cannot be replaced.
    fs::create_dir(folder.path().join(FALLEN)).expect("in its way");
    fs::write(folder.path().join(format!("{}.ring", u64::MAX)), b"no file of ours").expect("written");
    let mut full = ring(folder.path(), limits(3600, 1 << 20));
    let start = now();
    for number in 0..20 {
        add(&mut full, CAMERA, start + number, 10_000);
    }
    assert!(list(folder.path()).expect("files").len() > 2);
    while full.shrink().expect("a file goes") {}
    assert!(list(folder.path()).expect("files").is_empty());
    let figures = full.figures();
    assert_eq!((figures.messages, figures.bytes, figures.fallen), (0, 0, 20));
    fs::remove_dir(folder.path().join(FALLEN)).expect("out of its way");
    add(&mut full, CAMERA, start, 10);
    assert!(full.shrink().expect("a file goes"));
    let again = ring(folder.path(), limits(3600, 1 << 20));
    assert_eq!(again.figures().fallen, 21, "the count caught up");
}

#[test]
fn what_comes_out_of_a_backup_ages_from_the_first_opening_on() {
    let folder = tempfile::tempdir().expect("a folder");
    let begun = now() - 10_000 * SECOND;
    let mut before = ring(folder.path(), limits(100_000, 1 << 24));
    for second in 0..20 {
        add(&mut before, CAMERA, begun + second * SECOND, 100);
    }
    drop(before);
    assert!(note_restored(folder.path()).expect("noted"));
    let opened = now();
    let mut again = ring(folder.path(), limits(160, 1 << 24));
    assert_eq!((again.figures().messages, again.figures().fallen), (20, 0), "hours old, and just out of the backup");
    assert_eq!(times(&found(&again, &all(0, u64::MAX))).len(), 20);
    add(&mut again, CAMERA, opened, 100);
    drop(again);
    // Opened again, and later: no new beginning.
    let mut again = ring(folder.path(), limits(160, 1 << 24));
    assert_eq!(again.figures().messages, 21);
    again.tend(Timestamp(opened + 150 * SECOND)).expect("tended");
    assert_eq!(again.figures().messages, 21);
    let last = now();
    again.tend(Timestamp(last + 161 * SECOND)).expect("tended");
    assert_eq!((again.figures().messages, again.figures().fallen), (0, 21), "all of it falls out once");
    // Numbers of files begin anew in an empty ring; these are no files of the backup.
    drop(again);
    let mut again = ring(folder.path(), limits(160, 1 << 24));
    add(&mut again, CAMERA, opened - 100 * SECOND, 100);
    again.tend(Timestamp(opened + 161 * SECOND)).expect("tended");
    assert_eq!(again.figures().messages, 0);

    // A note that cannot be read lets nothing fall out sooner.
    add(&mut again, CAMERA, opened - 100 * SECOND, 100);
    drop(again);
    fs::write(folder.path().join(RESTORED), [0xff, b'x']).expect("damaged");
    let again = ring(folder.path(), limits(60, 1 << 24));
    assert_eq!((again.figures().messages, again.figures().fallen), (1, 22));

    let nothing = tempfile::tempdir().expect("a folder");
    assert!(!note_restored(nothing.path()).expect("empty") && !note_restored(&nothing.path().join("x")).expect("none"));
}
