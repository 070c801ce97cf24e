//! The worker of an hour's stamps, one look after the other, at moments that the test says; the authority is openssl.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::mpsc;

use super::*;
use crate::model::{Address, Digest, RecordKind, RecordState, Signature, SignerId, TopicId};
use crate::reply::HealthLevel;
use crate::site::testing::Ground;
use crate::store::{NewBatch, NewRecord};

const SETTINGS: &str = "[req]\ndistinguished_name = dn\nprompt = no\n[dn]\nCN = notary\n\
    [stamps]\nbasicConstraints = CA:false\nkeyUsage = critical,digitalSignature\nextendedKeyUsage = critical,timeStamping\n\
    [one]\nserial = ./serial\ndefault_policy = 1.2.3.4.1\ndigests = sha256\nsigner_digest = sha256\naccuracy = secs:1\n\
    ess_cert_id_alg = sha256\n";
const HOUR: u64 = 3600;
/// The first moment, seconds since 1970.
const BEGIN: u64 = 1_700_000_000;

fn openssl(folder: &Path, line: &str) {
    let mut command = Command::new("openssl");
    command.args(line.split_whitespace()).current_dir(folder).env("OPENSSL_CONF", folder.join("settings"));
    let done = command.stdin(Stdio::null()).output().expect("openssl");
    assert!(done.status.success(), "openssl {line}: {}", String::from_utf8_lossy(&done.stderr));
}

/// What the authority does with a request.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Mood {
    /// It is too busy.
    Busy,
    Well,
    /// It says nothing until its line is cut.
    Silent,
}

/// An authority, and where it keeps its keys.
struct Authority {
    folder: tempfile::TempDir,
    address: String,
    mood: Arc<Mutex<Mood>>,
    asked: Arc<AtomicU64>,
    /// A silent one tells of each request, by its line.
    lines: mpsc::Receiver<TcpStream>,
}

impl Authority {
    /// `None` if there is no openssl.
    fn new() -> Option<Self> {
        let known = Command::new("openssl").arg("version").stdout(Stdio::null()).status();
        if !known.is_ok_and(|status| status.success()) {
            println!("SKIPPED: no openssl");
            return None;
        }
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::write(folder.path().join("settings"), SETTINGS).expect("written");
        std::fs::write(folder.path().join("serial"), "01\n").expect("written");
        openssl(folder.path(), "genpkey -algorithm EC -pkeyopt ec_paramgen_curve:P-256 -out notary.key");
        let certificate = "req -x509 -new -key notary.key -days 9 -extensions stamps -config settings -out notary.pem";
        openssl(folder.path(), certificate);
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let address = listener.local_addr().expect("an address").to_string();
        let (mood, asked) = (Arc::new(Mutex::new(Mood::Busy)), Arc::new(AtomicU64::new(0)));
        let (line, lines) = mpsc::channel();
        let (place, mooded, counted) = (folder.path().to_owned(), Arc::clone(&mood), Arc::clone(&asked));
        std::thread::spawn(move || {
            while let Ok((stream, _)) = listener.accept() {
                counted.fetch_add(1, Ordering::AcqRel);
                let mood = *mooded.lock().expect("mood");
                match mood {
                    Mood::Silent => line.send(stream).expect("the test waits"),
                    Mood::Busy | Mood::Well => answer(stream, &place, mood),
                }
            }
        });
        Some(Self { folder, address, mood, asked, lines })
    }

    fn becomes(&self, mood: Mood) {
        *self.mood.lock().expect("mood") = mood;
    }

    fn asked(&self) -> u64 {
        self.asked.load(Ordering::Acquire)
    }

    /// A home that asks it at this address.
    fn ground(&self, address: &str) -> Ground {
        let certificate = self.folder.path().join("notary.pem");
        let text = format!(
            "[{{ name = \"The notary\", url = \"http://{address}/tsa\", certificate = \"{}\" }}]",
            certificate.display()
        );
        Ground::with(&[("time.authorities", &text)])
    }
}

fn answer(mut stream: TcpStream, folder: &Path, mood: Mood) {
    let mut bytes = Vec::new();
    let body = loop {
        let mut some = [0; 4096];
        let count = stream.read(&mut some).expect("a request");
        bytes.extend(&some[..count]);
        let Some(head) = bytes.windows(4).position(|four| four == b"\r\n\r\n") else { continue };
        let text = String::from_utf8_lossy(&bytes[..head]).to_lowercase();
        let length = text.lines().find_map(|line| line.strip_prefix("content-length:")).expect("a length");
        if bytes.len() - head - 4 == length.trim().parse::<usize>().expect("a number") {
            break bytes.split_off(head + 4);
        }
    };
    let (status, body) = if mood == Mood::Well {
        std::fs::write(folder.join("query"), body).expect("written");
        openssl(
            folder,
            "ts -reply -queryfile query -config settings -section one -signer notary.pem -inkey notary.key -out reply",
        );
        ("200 OK", std::fs::read(folder.join("reply")).expect("read"))
    } else {
        ("503 Service Unavailable", Vec::new())
    };
    let head = format!("HTTP/1.1 {status}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n", body.len());
    stream.write_all(&[head.as_bytes(), &body].concat()).expect("answered");
}

/// Moments, as many seconds after the first as are asked for.
struct Time(Instant);

impl Time {
    fn at(&self, seconds: u64) -> Moment {
        Moment { wall: Timestamp::from_seconds(BEGIN + seconds), steady: self.0 + Duration::from_secs(seconds) }
    }
}

/// Closes a batch of one record; its root begins with the number.
fn close(ground: &Ground, number: u8) -> Hash {
    let (owner, digest, root) = (Address([1; 20]), Digest([number; 32]), Hash([number; 32]));
    let record = NewRecord {
        digest,
        owner,
        topic_id: TopicId([2; 16]),
        seq: u64::from(number),
        foreign: None,
        epoch: 1,
        kind: RecordKind::Data,
        signer: SignerId([1; 32]),
        signature: Signature([7; 64]),
        filters: Vec::new(),
        topic: "/odom".to_owned(),
        type_name: "a/B".to_owned(),
        bytes: 9,
        captured_at: Timestamp::from_seconds(BEGIN),
        simulated: false,
        state: RecordState::Stored,
        blob: None,
    };
    let ledger = &ground.parts.plant.ledger;
    ledger.records.append(vec![record]).expect("acknowledged");
    ledger.batches.close(NewBatch { owner, root, leaves: vec![(digest, Vec::new())] }).expect("closed");
    root
}

fn stamps(ground: &Ground) -> Arc<TimeStamps> {
    Arc::new(TimeStamps::new(&ground.parts))
}

/// Stamped, waiting, and what health says of it.
fn told(ground: &Ground, stamps: &TimeStamps) -> (u64, u64, HealthLevel, String) {
    let counts = ground.parts.plant.ledger.proofs.stamp_counts().expect("counts");
    let health = stamps.health().expect("read").expect("an authority is configured");
    (counts.stamped, counts.waiting, health.level, health.text)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn each_hours_roots_are_stamped_once_and_a_busy_authority_is_asked_later_and_later() {
    let Some(authority) = Authority::new() else { return };
    let ground = authority.ground(&authority.address);
    let (stamps, time) = (stamps(&ground), Time(Instant::now()));
    stamps.look(time.at(0)).await;
    assert_eq!((authority.asked(), told(&ground, &stamps).1), (0, 0), "nothing to stamp, and nobody is asked");

    let first = close(&ground, 1);
    // A minute, then two, then four: the pause grows from the moment of each failure.
    for (seconds, asked) in [(60, 1), (90, 1), (121, 2), (240, 2), (242, 3), (480, 3)] {
        stamps.look(time.at(seconds)).await;
        assert_eq!(authority.asked(), asked, "after {seconds} s");
        let (stamped, waiting, level, text) = told(&ground, &stamps);
        assert_eq!((stamped, waiting, level), (0, 1, HealthLevel::Waiting), "{text}");
        assert!(text.contains(&counted(asked, "request")) && text.contains("answered 503"), "{text}");
    }
    authority.becomes(Mood::Well);
    let second = close(&ground, 2);
    stamps.look(time.at(483)).await;
    let (stamped, waiting, level, text) = told(&ground, &stamps);
    assert_eq!((stamped, waiting, level), (1, 0, HealthLevel::Ok), "{text}");

    // The stamp was begun after a minute; what was closed since is the next hour's.
    stamps.look(time.at(60 + HOUR - 1)).await;
    assert_eq!((authority.asked(), told(&ground, &stamps).0), (4, 1), "not yet an hour");
    let third = close(&ground, 3);
    stamps.look(time.at(60 + HOUR)).await;
    assert_eq!((authority.asked(), told(&ground, &stamps).0), (5, 2));
    stamps.look(time.at(120 + HOUR)).await;
    assert_eq!(authority.asked(), 5, "each hour once");
    let ledger = &ground.parts.plant.ledger;
    let under = |root: Hash| {
        let key = ledger.proofs.stamp_of(root).expect("read").expect("stamped");
        ledger.proofs.stamp(key).expect("read").expect("there")
    };
    assert_eq!((under(first).roots, under(second).roots), (vec![first], vec![second, third]));
    for root in [first, third] {
        by_openssl(&authority, under(root));
    }
}

/// A token, by openssl alone: it is over the tree of its roots.
fn by_openssl(authority: &Authority, stamp: KeptStamp) {
    let tree = StampTree::new(stamp.roots).expect("a tree");
    let [token] = stamp.tokens.as_slice() else { unreachable!("one authority gives one token") };
    std::fs::write(authority.folder.path().join("token"), token).expect("written");
    let imprint = Hash(tree.imprint()).to_hex();
    let line = "-token_in -in token -CAfile notary.pem -partial_chain";
    openssl(authority.folder.path(), &format!("ts -verify -digest {imprint} {line}"));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_authority_that_is_not_reached_is_counted_and_asked_again() {
    let Some(authority) = Authority::new() else { return };
    // Nobody listens at a port that was just given back.
    let nobody = TcpListener::bind("127.0.0.1:0").and_then(|listener| listener.local_addr()).expect("a port");
    let ground = authority.ground(&nobody.to_string());
    let (stamps, time) = (stamps(&ground), Time(Instant::now()));
    close(&ground, 1);
    for (seconds, failed) in [(0, 1), (59, 1), (61, 2)] {
        stamps.look(time.at(seconds)).await;
        let (stamped, waiting, level, text) = told(&ground, &stamps);
        assert_eq!((stamped, waiting, level), (0, 1, HealthLevel::Waiting), "{text}");
        assert!(text.contains(&counted(failed, "request")) && text.contains("cannot be reached"), "{text}");
    }
    assert_eq!(authority.asked(), 0);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nothing_waits_for_an_authority_that_says_nothing() {
    let Some(authority) = Authority::new() else { return };
    authority.becomes(Mood::Silent);
    let ground = authority.ground(&authority.address);
    let (stamps, time) = (stamps(&ground), Time(Instant::now()));
    close(&ground, 1);
    let (looking, now) = (Arc::clone(&stamps), time.at(0));
    let look = tokio::spawn(async move { looking.look(now).await });
    let line = tokio::task::block_in_place(|| authority.lines.recv()).expect("it is asked");
    // It is asked and has not answered; the ledger closes batches, and health is told.
    close(&ground, 2);
    assert_eq!((told(&ground, &stamps).1, look.is_finished()), (1, false));
    drop(line);
    look.await.expect("ends");
    let (stamped, waiting, level, text) = told(&ground, &stamps);
    assert_eq!((stamped, waiting, level), (0, 1, HealthLevel::Waiting), "{text}");
    assert!(text.contains("1 request failed"), "{text}");
}
