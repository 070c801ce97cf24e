//! From figures to a webhook: every rule, a webhook that refuses and hangs, and one that is dead for an hour.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicUsize, Ordering};

use serde_json::Value;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream};

use super::*;
use crate::alerts::troubles::{before, troubles, well};
use crate::figures::RobotFigures;
use crate::model::locked;
use crate::site::Needs;
use crate::site::testing::site_of;

/// What a server accepted, and how many it refused or stalled before.
#[derive(Default)]
struct Taken {
    bodies: Mutex<Vec<Value>>,
    asked: AtomicUsize,
}

impl Taken {
    fn all(&self) -> Vec<Value> {
        locked(&self.bodies).clone()
    }
}

/// Answers every request: the first `refusals` are refused, one more hangs if there were any, all others are accepted.
async fn serve(listener: TcpListener, refusals: usize, taken: Arc<Taken>) {
    let mut held = Vec::new();
    while let Ok((mut stream, _)) = listener.accept().await {
        let body = body(&mut stream).await;
        let number = taken.asked.fetch_add(1, Ordering::AcqRel);
        if number == refusals && refusals > 0 {
            held.push(stream);
            continue;
        }
        let status = if number < refusals { "503 Service Unavailable" } else { "200 OK" };
        if number >= refusals {
            let body = serde_json::from_slice(&body).expect("JSON");
            locked(&taken.bodies).push(body);
        }
        let answer = format!("HTTP/1.1 {status}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n");
        drop(stream.write_all(answer.as_bytes()).await);
    }
}

async fn body(stream: &mut TcpStream) -> Vec<u8> {
    let mut bytes = Vec::new();
    loop {
        let mut some = [0; 4096];
        let count = stream.read(&mut some).await.expect("a request");
        bytes.extend(&some[..count]);
        let Some(head) = bytes.windows(4).position(|four| four == b"\r\n\r\n") else { continue };
        let text = String::from_utf8_lossy(&bytes[..head]).to_lowercase();
        let length = text.lines().find_map(|line| line.strip_prefix("content-length:")).expect("a length");
        if bytes.len() - head - 4 == length.trim().parse::<usize>().expect("a number") {
            return bytes.split_off(head + 4);
        }
    }
}

pub(super) async fn until(what: &str, done: impl Fn() -> bool) {
    for _ in 0..2400 {
        if done() {
            return;
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    panic!("{what}: not within two minutes");
}

/// A site that alerts a webhook, with no other part than delivery running.
fn telling(port: u16) -> (Arc<Site>, tempfile::TempDir) {
    let url = format!("http://127.0.0.1:{port}/");
    let settings = [("alerts.webhook", url.as_str()), ("alerts.grant_ends", "1h"), ("alerts.disk", "1000MiB")];
    let (site, folder) = site_of(&settings, Needs { ros: false, chain: false });
    drop(tokio::spawn(Arc::clone(&site).deliver_alerts()));
    (site, folder)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_rule_begins_once_and_ends_once_at_a_webhook_that_refuses_four_times_and_hangs_once() {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let (site, _folder) = telling(listener.local_addr().expect("its address").port());
    let taken = Arc::new(Taken::default());
    let server = tokio::spawn(serve(listener, 4, Arc::clone(&taken)));
    for look in 0..80 {
        let mut figures = well(look * 10);
        // The chain last: while it is away, what only follows from that does not begin.
        let is_due = |key: &str| (20..24).contains(&look) && (key != "chain" || look > 20);
        troubles().iter().filter(|(key, _)| is_due(key)).for_each(|(_, trouble)| trouble(&mut figures));
        site.alerts.look(&figures);
    }
    let keys: BTreeSet<&str> = troubles().into_iter().map(|(key, _)| key).collect();
    until("all that began and ended", || taken.all().len() >= 2 * keys.len()).await;
    until("an empty queue", || site.alerts.with(|known| known.queue.first().is_none())).await;
    let mut told: BTreeMap<(String, String), u32> = BTreeMap::new();
    for body in taken.all() {
        let text = |value: &Value| value.as_str().expect("a text").to_owned();
        *told.entry((text(&body["alert"]["key"]), text(&body["state"]))).or_default() += 1;
    }
    let wanted = keys.iter().flat_map(|key| ["begun", "resolved"].map(|state| ((*key).to_owned(), state.to_owned())));
    assert_eq!(told, wanted.map(|pair| (pair, 1)).collect());
    assert_eq!(taken.asked.load(Ordering::Acquire), 4 + 1 + 2 * keys.len());
    server.abort();
    site.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_hour_without_a_webhook_fills_a_bounded_queue_and_what_was_given_up_is_told_behind_it() {
    // Nobody listens on this port until the hour is over.
    let port = TcpListener::bind("127.0.0.1:0").await.expect("a port").local_addr().expect("its address").port();
    let (site, folder) = telling(port);
    let mut changes = 0;
    for look in 0..360 {
        let mut figures = well(look * 10);
        let silent = |number: u32| RobotFigures {
            robot: format!("{number:08x}"),
            last_seen: if (look / 10) % 2 == 1 { before(&figures, 700) } else { figures.now },
        };
        figures.robots = (0..10).map(silent).collect();
        changes += site.alerts.look(&figures).len();
    }
    let view = site.alerts.view();
    // Robots are judged from the second minute on, and fall silent and return every hundred seconds.
    assert!(changes > 250, "{changes}");
    let all = u64::try_from(changes).expect("few");
    assert_eq!((view.waiting, view.waiting + view.dropped), (200, all), "nothing went without being counted");
    let file = std::fs::metadata(folder.path().join("home/alerts.queue")).expect("a queue").len();
    assert!(file < 1 << 20, "{file} bytes");
    let listener = TcpListener::bind(("127.0.0.1", port)).await.expect("the port is free");
    let taken = Arc::new(Taken::default());
    let server = tokio::spawn(serve(listener, 0, Arc::clone(&taken)));
    until("what waited", || site.alerts.with(|known| known.queue.first().is_none())).await;
    let bodies = taken.all();
    let dropped: u64 = bodies.iter().map(|body| body["dropped"].as_u64().expect("a number")).sum();
    assert_eq!((bodies.len(), dropped), (200, all - 200));
    let numbers: BTreeSet<u64> = bodies.iter().map(|body| body["number"].as_u64().expect("a number")).collect();
    assert_eq!(numbers.len(), 200, "each came once");
    server.abort();
    site.stop().await;
}

/// Answers 400 to deliveries about the disk, and accepts all others.
async fn serve_but_no_disk(listener: TcpListener, taken: Arc<Taken>) {
    while let Ok((mut stream, _)) = listener.accept().await {
        let body: Value = serde_json::from_slice(&body(&mut stream).await).expect("JSON");
        let is_refused = body["alert"]["key"] == "disk";
        taken.asked.fetch_add(usize::from(is_refused), Ordering::AcqRel);
        if !is_refused {
            locked(&taken.bodies).push(body);
        }
        let status = if is_refused { "400 Bad Request" } else { "200 OK" };
        let answer = format!("HTTP/1.1 {status}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n");
        drop(stream.write_all(answer.as_bytes()).await);
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_delivery_that_is_refused_for_itself_is_dropped_and_counted_and_the_next_is_sent() {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let (site, _folder) = telling(listener.local_addr().expect("its address").port());
    let taken = Arc::new(Taken::default());
    let server = tokio::spawn(serve_but_no_disk(listener, Arc::clone(&taken)));
    let alert = |key: &str| AlertView {
        key: key.to_owned(),
        severity: Severity::Critical,
        text: "t".to_owned(),
        site: String::new(),
        begun: Timestamp::from_seconds(1_700_000_000),
    };
    site.alerts.with(|known| ["disk", "store"].iter().for_each(|key| known.queue.add(Change::Begun(alert(key)))));
    site.alerts.added.notify_one();
    until("the second one", || !taken.all().is_empty()).await;
    let body = &taken.all()[0];
    assert_eq!((&body["alert"]["key"], &body["dropped"]), (&Value::from("store"), &Value::from(1)));
    assert_eq!(taken.asked.load(Ordering::Acquire), 5, "not given up at once");
    server.abort();
    site.stop().await;
}
