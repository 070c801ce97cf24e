//! The cache against real servers, and against ones that lie: it costs time and nothing else.

mod server;

use std::io::{Read as _, Write as _};
use std::net::TcpListener;
use std::time::{Duration, Instant};

use self::server::Server;
use super::*;
use crate::ledger::tests::record;
use crate::{Ledger, NewRecord};

/// How long a busy machine may take for what takes a moment.
const PATIENCE: Duration = Duration::from_secs(30);

struct Store {
    _home: tempfile::TempDir,
    ledger: Ledger,
    behind: Ciphertext,
    numbers: u64,
}

impl Store {
    fn behind(url: &str) -> Self {
        let home = tempfile::tempdir().expect("temporary directory");
        let ledger = Ledger::open(&home.path().join("ledger.db")).expect("opens");
        let settings = CacheSettings { url: url.to_owned(), roots: None };
        let behind = Ciphertext::cached(&ledger, &settings).expect("not waited for");
        Self { _home: home, ledger, behind, numbers: 0 }
    }

    /// Acknowledges a record, as the pipeline does.
    fn keep(&mut self, length: usize) -> (Digest, Vec<u8>) {
        self.numbers += 1;
        let bytes: Vec<u8> = self.numbers.to_be_bytes().into_iter().cycle().take(length).collect();
        let digest = Digest(sm3(&[&bytes]));
        let record = NewRecord { digest, blob: Some(bytes.clone()), ..record(1, 1, self.numbers) };
        self.ledger.records.append(vec![record]).expect("acknowledged");
        self.behind.written([digest]);
        (digest, bytes)
    }

    fn state(&self) -> CacheState {
        self.behind.cache().expect("a cache")
    }

    fn read(&self, digest: Digest) -> Option<Vec<u8>> {
        self.behind.through_cache(digest).expect("the store answers")
    }

    /// Until the cache itself has a record.
    fn until_hit(&self, (digest, bytes): &(Digest, Vec<u8>)) {
        until("a hit", || {
            let before = self.state().hits;
            assert_eq!(self.read(*digest).as_ref(), Some(bytes));
            self.state().hits > before
        });
    }
}

fn until(what: &str, mut done: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !done() {
        assert!(begun.elapsed() < PATIENCE, "{what}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn what_was_committed_or_missed_is_in_the_cache_and_what_was_deleted_is_not() {
    let Some(mut server) = Server::start(&[]) else { return };
    for url in [server.url(), server.socket_url()] {
        let mut store = Store::behind(&url);
        let (one, two, large) = (store.keep(700), store.keep(60_000), store.keep(3 << 20));
        [&one, &two, &large].into_iter().for_each(|record| store.until_hit(record));
        server.command(&["FLUSHALL"]);
        // Filled on a miss.
        let misses = store.state().misses;
        store.until_hit(&one);
        assert!(store.state().misses > misses);
        store.until_hit(&two);
        store.behind.discard(&[one.0]).expect("deleted");
        store.behind.scour(&[two.0]).expect("overwritten");
        until("both are gone from it", || [&one, &two].iter().all(|(key, _)| !server.has(*key)));
        assert_eq!([store.read(one.0), store.read(two.0)], [None, None]);
        let state = store.state();
        assert_eq!((state.wrong, state.away.is_none()), (0, true), "{state:?}");
    }
    server.kill();
}

#[test]
fn one_that_stands_still_is_waited_for_once_and_comes_back_with_its_deletions() {
    let Some(server) = Server::start(&[]) else { return };
    let mut store = Store::behind(&server.url());
    let (one, two) = (store.keep(700), store.keep(700));
    store.until_hit(&one);
    store.until_hit(&two);
    server.signal("STOP");
    let begun = Instant::now();
    until("it is away", || {
        assert_eq!(store.read(one.0).as_ref(), Some(&one.1));
        store.state().away.is_some()
    });
    let away = store.state().away.expect("away");
    assert!(away.why.contains("does not answer in time"), "{away:?}");
    // Nobody waits for it any more: many reads take less than one of its silences would.
    let (reads, asked) = (200, Instant::now());
    (0..reads).for_each(|_| assert_eq!(store.read(two.0).as_ref(), Some(&two.1)));
    assert!(asked.elapsed() < connection::SILENCE * reads / 2, "{:?} of {:?}", asked.elapsed(), begun.elapsed());
    store.behind.discard(&[one.0]).expect("deleted in the store");
    assert_eq!(store.read(one.0), None, "and nobody gets it from there");
    server.signal("CONT");
    until("it is back", || store.state().away.is_none());
    until("what was deleted meanwhile is deleted there", || !server.has(one.0));
    store.until_hit(&two);
}

#[test]
fn one_that_is_killed_is_away_and_used_again_when_it_is_back() {
    let Some(mut server) = Server::start(&[]) else { return };
    let mut store = Store::behind(&server.url());
    let one = store.keep(700);
    store.until_hit(&one);
    server.kill();
    until("it is away", || {
        assert_eq!(store.read(one.0).as_ref(), Some(&one.1));
        store.state().away.is_some()
    });
    let (since, two) = (store.state().away.expect("away").since, store.keep(900));
    assert_eq!(store.read(two.0), Some(two.1.clone()));
    assert_eq!(store.state().away.map(|away| away.since), Some(since), "since it went, not since it was last asked");
    server.revive();
    store.until_hit(&two);
}

#[test]
fn one_without_room_takes_what_it_can_and_evicts_what_it_likes() {
    for policy in ["allkeys-lru", "noeviction"] {
        let Some(server) = Server::start(&["--maxmemory", "3mb", "--maxmemory-policy", policy]) else { return };
        let mut store = Store::behind(&server.url());
        let all: Vec<_> = (0..60).map(|_| store.keep(60_000)).collect();
        for _ in 0..3 {
            all.iter().for_each(|(digest, bytes)| assert_eq!(store.read(*digest).as_ref(), Some(bytes), "{policy}"));
        }
        let state = store.state();
        assert_eq!((state.wrong, state.hits + state.misses), (0, 180), "{policy}: {state:?}");
    }
}

#[test]
fn a_password_is_needed_where_one_is_set_and_is_never_shown() {
    let arguments = ["--user", "me", "on", ">s3cret", "~authros:*", "+@all", "--user", "default", "off"];
    let Some(server) = Server::start(&arguments) else { return };
    let at = server.url().replace("redis://", "");
    let mut store = Store::behind(&format!("redis://me:s3cret@{at}"));
    let one = store.keep(700);
    store.until_hit(&one);
    let mut refused = Store::behind(&format!("redis://me:wr0ng@{at}"));
    let two = refused.keep(700);
    assert_eq!(refused.read(two.0), Some(two.1));
    until("it is away", || refused.state().away.is_some());
    for state in [store.state(), refused.state()] {
        let told = format!("{state:?} {}", state.line());
        assert!(!["s3cret", "wr0ng", "me:"].iter().any(|secret| told.contains(secret)), "{told}");
    }
    let why = refused.state().away.expect("away").why;
    assert!(why.contains("does not accept the user name and password"), "{why}");
}

/// A server that answers `PING`, takes everything, and has its own idea of what lies under a key.
fn liar(answer: impl Fn(&str) -> Vec<u8> + Send + Sync + 'static) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("binds");
    let url = format!("redis://{}", listener.local_addr().expect("an address"));
    let answer = Arc::new(answer);
    std::thread::spawn(move || {
        for mut stream in listener.incoming().map_while(Result::ok) {
            let answer = Arc::clone(&answer);
            std::thread::spawn(move || {
                let mut request = vec![0; 1 << 16];
                while let Ok(length @ 1..) = stream.read(&mut request) {
                    let text = String::from_utf8_lossy(&request[..length]).into_owned();
                    let reply = match text.contains("GET") {
                        true => answer(&text),
                        false if text.contains("PING") => b"+PONG\r\n".to_vec(),
                        false => b"+OK\r\n".to_vec(),
                    };
                    if stream.write_all(&reply).is_err() {
                        return;
                    }
                    // Without an end.
                    while reply.starts_with(b"$9") && stream.write_all(&[b'0'; 4096]).is_ok() {}
                }
            });
        }
    });
    url
}

fn bulk(bytes: &[u8]) -> Vec<u8> {
    [format!("${}\r\n", bytes.len()).as_bytes(), bytes, b"\r\n"].concat()
}

#[test]
fn no_lie_is_believed_and_each_is_counted() {
    type Lie = (&'static str, fn() -> Vec<u8>);
    let lies: [Lie; 6] = [
        ("wrong bytes", || bulk(&[7; 700])),
        ("another's value", || bulk(&2u64.to_be_bytes().into_iter().cycle().take(700).collect::<Vec<_>>())),
        ("nothing in it", || bulk(b"")),
        ("no end", || b"$9000000000000\r\n".to_vec()),
        ("lists in lists", || b"*1\r\n".repeat(100)),
        ("another protocol", || b"HTTP/1.1 400 Bad Request\r\n\r\n".to_vec()),
    ];
    for (lie, answer) in lies {
        let mut store = Store::behind(&liar(move |_| answer()));
        let one = store.keep(700);
        let begun = Instant::now();
        until(lie, || {
            assert_eq!(store.read(one.0).as_ref(), Some(&one.1), "{lie}");
            store.state().wrong > 0
        });
        let state = store.state();
        assert_eq!((state.hits, state.wrong <= state.misses), (0, true), "{lie}: {state:?}");
        assert!(begun.elapsed() < PATIENCE / 2, "{lie}: {:?}", begun.elapsed());
    }
}

#[test]
fn an_altered_record_is_not_passed_on_and_a_cached_one_still_opens() {
    let Some(server) = Server::start(&[]) else { return };
    let mut store = Store::behind(&server.url());
    let (one, two) = (store.keep(700), store.keep(700));
    store.until_hit(&one);
    store.until_hit(&two);
    assert_eq!(store.behind.replace(one.0, b"altered"), Ok(true));
    assert_eq!(store.read(one.0), Some(one.1), "what the cache has is what was anchored");
    assert_eq!(
        store.behind.get(one.0),
        Ok(Some(b"altered".to_vec())),
        "what lies on the disk is told to who asks for it"
    );
    server.command(&["FLUSHALL"]);
    assert_eq!(store.read(one.0), Some(b"altered".to_vec()), "the reader's own check refuses it");
    store.until_hit(&two);
    assert!(!server.has(one.0));
}
