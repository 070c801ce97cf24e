//! From capture into the ring, and out of it into the outbox, when its owner asks.

use std::path::Path;
use std::sync::OnceLock;
use std::time::Duration;

use super::*;
use crate::crypto::{EpochKey, IndexKey, ProviderName, SealingKey, SmKeyPair, provider};
use crate::model::{Domain, RecordKind, RecordState, RecorderPrefix, RingLimits, Timestamp, Token, TopicPatterns};
use crate::pipeline::epoch::EpochKeys;
use crate::pipeline::fixture::{Notes, message};
use crate::pipeline::recorder::CapturedMessage;
use crate::pipeline::ring::Rings;
use crate::pipeline::sealer::Sealer;
use crate::pipeline::tests::body_of;
use crate::pipeline::{Author, CaptureSession, Losses, Recorder};
use crate::ros::MessageSink as _;
use crate::store::{Ciphertext, Ledger, RecordQuery, RecordRow};

const SECOND: u64 = 1_000_000_000;
const CAMERA: &str = "/camera";
const ODOM: &str = "/odom";

/// A robot with a ring: capture, sealer, outbox.
struct Robot {
    plant: Plant,
    notes: Arc<Notes>,
    author: Arc<Author>,
    keys: Arc<EpochKeys>,
    ring: SharedRing,
    rings: Arc<Rings<CapturedMessage>>,
    losses: Arc<Losses>,
    recorder: Recorder,
}

impl Robot {
    fn new(home: &Path) -> Self {
        let ours = provider(ProviderName::default());
        let notes = Arc::new(Notes::default());
        let ledger = Ledger::open(&home.join("ledger.db")).expect("ledger");
        let plant = Plant {
            ciphertext: Ciphertext::of(&ledger),
            ledger,
            provider: ours,
            observer: Arc::clone(&notes) as Arc<dyn crate::pipeline::Observer>,
        };
        let signing = SmKeyPair::generate(ours).expect("pair");
        let (key, index) = (SealingKey::Epoch(EpochKey::new([1; 32])), IndexKey::new([2; 32]));
        let keys = Arc::new(EpochKeys::new(Domain([3; 32]), (1, Token([4; 32])), signing, key, index));
        let author = Arc::new(Author::new(Address([5; 20])));
        author.seal_under(Arc::clone(&keys));
        let limits = RingLimits { time: Duration::from_secs(3600), bytes: 1 << 24 };
        let ring = DiskRing::open(&home.join("ring"), limits, RecorderPrefix::ring([6; 7])).expect("a ring");
        let (rings, losses) = (Arc::new(Rings::new(1 << 24)), Arc::new(Losses::default()));
        let recorder = Recorder::new(Arc::clone(&rings), Arc::clone(&losses), Arc::clone(&plant.observer));
        Self { plant, notes, author, keys, ring: Arc::new(Mutex::new(ring)), rings, losses, recorder }
    }

    /// Seals all that was captured; then nothing more is.
    fn seal(&self) {
        self.rings.close();
        let ring = Arc::new(OnceLock::new());
        assert!(ring.set(Arc::clone(&self.ring)).is_ok());
        let sealer = Sealer::new(self.plant.clone(), Arc::default(), Arc::clone(&self.losses));
        sealer.with_ring(ring).run(&self.rings, &|| {});
    }

    fn pull(&self, span: &RingSpan) -> Brought {
        ask(&self.plant.ledger.notes, 7, span).expect("noted");
        let mut pulls = Pulls::new(self.plant.clone(), Arc::clone(&self.ring), self.author.address);
        loop {
            match pulls.step().expect("a step") {
                Step::Idle => panic!("it was asked for"),
                Step::Moved(_) => {}
                Step::Done(done, brought) => {
                    assert_eq!((&done, pulls.step().expect("a step")), (span, Step::Idle));
                    return brought;
                }
            }
        }
    }

    fn rows(&self, kind: RecordKind) -> Vec<RecordRow> {
        let query = RecordQuery { kind: Some(kind), limit: 1000, ..RecordQuery::default() };
        self.plant.ledger.records.list(&query).expect("rows").rows
    }

    fn body(&self, row: &RecordRow) -> Vec<u8> {
        let blob = self.plant.ciphertext.get(row.digest).expect("read").expect("stored");
        body_of(self.plant.provider, &self.keys, row, &blob)
    }
}

fn span(since: u64, until: u64, topics: &str) -> RingSpan {
    RingSpan { since: Timestamp(since), until: Timestamp(until), topics: topics.parse().expect("patterns") }
}

#[test]
fn what_nobody_watched_is_in_the_ring_alone_until_it_is_asked_for() {
    let home = tempfile::tempdir().expect("a folder");
    let robot = Robot::new(home.path());
    let begun = Timestamp::now().0 - 60 * SECOND;
    let session = Arc::new(CaptureSession::unfollowed(&[ODOM.to_owned()], None, Vec::new()));
    robot.recorder.join(ODOM, &robot.author, None, &session);
    for topic in [CAMERA, ODOM] {
        robot.recorder.keep_in_ring(topic, &robot.author, true);
    }
    for second in 0..30u8 {
        for topic in [CAMERA, ODOM, "/nobody"] {
            let at = Timestamp(begun + u64::from(second) * SECOND);
            robot.recorder.accept(message(topic, at, vec![second; 40]));
        }
    }
    robot.seal();
    let own = robot.rows(RecordKind::Data);
    assert!(own.len() == 30 && own.iter().all(|row| row.topic == ODOM), "what is watched is not in the ring too");
    let figures = robot.ring.lock().expect("a ring").figures();
    assert_eq!((figures.messages, figures.fallen, figures.since), (30, 0, Some(Timestamp(begun))));

    let asked = span(begun + 10 * SECOND, begun + 20 * SECOND, CAMERA);
    let brought = robot.pull(&asked);
    assert_eq!((brought.messages, brought.topics), (10, BTreeSet::from([CAMERA.to_owned()])));
    let pulled: Vec<RecordRow> =
        robot.rows(RecordKind::Data).into_iter().filter(|row| row.recorder.is_ring()).collect();
    assert!(pulled.iter().all(|row| row.topic == CAMERA && row.state == RecordState::Stored), "they wait to be sent");
    let mut bodies: Vec<u8> = pulled.iter().map(|row| robot.body(row)[0]).collect();
    bodies.sort_unstable();
    assert_eq!(bodies, (10..20).collect::<Vec<u8>>());
    let mut numbers: Vec<u64> = pulled.iter().map(|row| row.seq).collect();
    numbers.sort_unstable();
    // Number 1 is the definition of its type, which went along.
    assert_eq!(numbers, (12..22).collect::<Vec<u64>>());
    let definitions = robot.rows(RecordKind::Definition);
    let of_ring = |row: &&RecordRow| row.recorder.is_ring();
    assert_eq!(definitions.iter().filter(of_ring).map(|row| row.seq).collect::<Vec<_>>(), [1]);

    // Asked again, and for more: nothing comes twice.
    assert_eq!(robot.pull(&asked).messages, 0);
    let all = RingSpan { topics: TopicPatterns::default(), ..span(0, u64::MAX, "") };
    assert_eq!(robot.pull(&all).messages, 20);
    assert_eq!(robot.rows(RecordKind::Data).len(), 60);
    assert_eq!(robot.notes.all(), []);
}

#[test]
fn what_is_asked_for_outlives_the_process_and_damaged_bytes_are_left_out() {
    let home = tempfile::tempdir().expect("a folder");
    let robot = Robot::new(home.path());
    let begun = Timestamp::now().0 - 60 * SECOND;
    robot.recorder.keep_in_ring(CAMERA, &robot.author, true);
    for second in 0..3u8 {
        robot.recorder.accept(message(CAMERA, Timestamp(begun + u64::from(second) * SECOND), vec![second; 40]));
    }
    robot.seal();
    let path = home.path().join("ring").join(format!("{:016}.ring", 1));
    let mut bytes = std::fs::read(&path).expect("a file");
    // The last byte is of the tag of the last message.
    let last = bytes.len() - 1;
    bytes[last] ^= 1;
    std::fs::write(&path, bytes).expect("written");
    let asked = span(begun, begun + 60 * SECOND, CAMERA);
    ask(&robot.plant.ledger.notes, 3, &asked).expect("noted");
    ask(&robot.plant.ledger.notes, 3, &asked).expect("noted once");
    // Another run, of which nothing is left but the ledger and the ring.
    let mut pulls = Pulls::new(robot.plant.clone(), Arc::clone(&robot.ring), robot.author.address);
    assert_eq!(pulls.step().expect("a step"), Step::Moved(2));
    drop(pulls);
    let mut pulls = Pulls::new(robot.plant.clone(), Arc::clone(&robot.ring), robot.author.address);
    assert_eq!(pulls.step().expect("a step"), Step::Moved(0), "begun anew, nothing doubled");
    assert!(matches!(pulls.step(), Ok(Step::Done(..))));
    assert_eq!(pulls.step().expect("a step"), Step::Idle);
    assert_eq!(robot.rows(RecordKind::Data).len(), 2);
    for number in 0..MOST as u64 {
        ask(&robot.plant.ledger.notes, number, &asked).expect("noted");
    }
    assert!(ask(&robot.plant.ledger.notes, 1000, &asked).is_err(), "not without bound");
}

#[test]
fn what_is_asked_for_while_another_request_ends_is_not_lost() {
    let home = tempfile::tempdir().expect("a folder");
    let robot = Robot::new(home.path());
    let (ledger, asked) = (robot.plant.ledger.clone(), span(1, 9, CAMERA));
    let mut pulls = Pulls::new(robot.plant.clone(), Arc::clone(&robot.ring), robot.author.address);
    // A home that was restored has asked for something else under this number.
    ask(&ledger.notes, 0, &span(2, 9, CAMERA)).expect("noted");
    let asking = std::thread::spawn(move || {
        (0..40u64).for_each(|number| ask(&ledger.notes, number, &asked).expect("noted"));
    });
    let mut done = 0;
    loop {
        let is_last = asking.is_finished();
        match pulls.step().expect("a step") {
            Step::Done(..) => done += 1,
            Step::Idle if is_last => break,
            Step::Idle | Step::Moved(_) => {}
        }
    }
    asking.join().expect("it asked");
    assert_eq!(done, 41);
}
