//! Figures for Prometheus: an independent parser accepts them, their terms are those of `status`, they name nobody, and
//! strangers cannot exhaust the listener.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::fs;
use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::os::unix::fs::PermissionsExt as _;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use support::{Home, count, free_port, is_verified, skipped, system_program, wait_until};

const TOPIC: &str = "/robot1/odom";
const GET: &[u8] = b"GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n";

/// A connection's answer to `GET /metrics`.
fn asked(mut stream: impl std::io::Read + std::io::Write) -> String {
    stream.write_all(GET).expect("asked");
    let mut told = String::new();
    stream.read_to_string(&mut told).expect("an answer");
    told
}

pub(crate) fn figures(port: u16) -> Option<String> {
    let told = asked(TcpStream::connect(("127.0.0.1", port)).ok()?);
    let (head, body) = told.split_once("\r\n\r\n").expect("a head and a body");
    assert!(head.starts_with("HTTP/1.1 200 OK\r\n"), "{head}");
    Some(body.to_owned())
}

/// Every text of a document.
fn strings(value: &serde_json::Value, found: &mut Vec<String>) {
    match value {
        serde_json::Value::String(text) => found.push(text.clone()),
        serde_json::Value::Array(values) => values.iter().for_each(|value| strings(value, found)),
        serde_json::Value::Object(fields) => fields.values().for_each(|value| strings(value, found)),
        serde_json::Value::Null | serde_json::Value::Bool(_) | serde_json::Value::Number(_) => {}
    }
}

/// The value of a line that begins so, as any parser of the text would read it.
pub(crate) fn value(figures: &str, begin: &str) -> f64 {
    let line = figures.lines().find(|line| line.starts_with(begin)).unwrap_or_else(|| panic!("no {begin}:\n{figures}"));
    line.rsplit(' ').next().and_then(|value| value.parse().ok()).expect("a number")
}

pub(crate) fn promtool(arguments: &[&str], input: &str) {
    let Some(program) = system_program("promtool") else { skipped!("no promtool") };
    let mut child = Command::new(program)
        .args(arguments)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("promtool");
    child.stdin.take().expect("stdin").write_all(input.as_bytes()).expect("given");
    let outcome = child.wait_with_output().expect("it ends");
    let told = [outcome.stdout, outcome.stderr].concat();
    assert!(outcome.status.success(), "{}\n{input}", String::from_utf8_lossy(&told));
}

#[test]
fn figures_of_a_site_are_those_of_status_and_promtool_takes_them() {
    let home = Home::new();
    let port = free_port();
    let authros = home.authros().with(&["--robots", "1"]);
    let serving = authros.with_variable("AUTHROS_METRICS_LISTEN", &format!("127.0.0.1:{port}"));
    let site = serving.serve(&home);
    authros.capture(&[TOPIC], 5);
    assert!(authros.records(&["records", "list", "--oldest"]).iter().all(is_verified));
    let status = authros.json(&["status"]);
    let life = &status["life"];
    // Results are cached for a second.
    let told = wait_until(30, "the figures of the capture", || {
        figures(port).filter(|told| value(told, "authros_records_captured_total{") >= 5.0)
    });
    for state in ["verified", "pending", "right_ended", "quarantined", "dropped", "tampered"] {
        let line = told
            .lines()
            .find(|line| line.contains(&format!("state=\"{state}\"")) && line.starts_with("authros_records{"));
        let told = line.and_then(|line| line.rsplit(' ').next()).and_then(|value| value.parse().ok());
        assert_eq!(told, Some(count(life, state)), "{state}: {life}");
    }
    assert_eq!(value(&told, "authros_records_captured_total{").to_string(), count(life, "captured").to_string());
    assert_eq!(value(&told, "authros_records_conserved{").to_string(), "1");
    for milestone in ["durable", "confirmed", "verified"] {
        assert!(
            value(&told, &format!("authros_latency_seconds_count{{milestone=\"{milestone}\"")) >= 5.0,
            "{milestone}"
        );
    }
    let other = home.profile("bob").enrol();
    authros.json(&["contacts", "add", "harbourmaster", &other]);
    std::thread::sleep(Duration::from_millis(1100));
    let told = figures(port).expect("figures, with a contact");
    for name in [TOPIC, "odom", "robot1", "default", "harbourmaster"] {
        assert!(!told.to_lowercase().contains(name), "{name} is in the figures");
    }
    let mut keys = Vec::new();
    strings(&authros.json(&["keys", "list"]), &mut keys);
    strings(&authros.json(&["identity", "show"]), &mut keys);
    let keys: Vec<String> = keys.into_iter().filter(|text| text.len() > 16).collect();
    assert!(keys.len() >= 4, "accounts, keys and fingerprints: {keys:?}");
    for key in keys.iter().map(|key| key.trim_start_matches("0x").to_lowercase()) {
        assert!(!told.to_lowercase().contains(&key), "{key} is in the figures");
    }
    promtool(&["check", "metrics"], &told);
    // The best of several, so that a busy machine does not decide.
    let best = (0..5).map(|_| {
        std::thread::sleep(Duration::from_millis(1100));
        let begun = Instant::now();
        figures(port).expect("figures");
        begun.elapsed()
    });
    eprintln!("a scrape took {:?} at best", best.min().expect("some"));
    site.stop("INT", 20).expect_code(0);
}

#[test]
fn topics_are_named_where_that_is_asked_for_and_a_socket_is_its_users_alone() {
    let home = Home::new();
    let path = home.root().join("figures.sock");
    let authros = home.authros().with(&["--robots", "1"]);
    let serving = authros
        .with_variable("AUTHROS_METRICS_LISTEN", path.to_str().expect("UTF-8"))
        .with_variable("AUTHROS_METRICS_TOPICS", "yes");
    let site = serving.serve(&home);
    authros.capture(&[TOPIC], 2);
    let told = wait_until(30, "the figures of the topic", || {
        let told = asked(UnixStream::connect(&path).ok()?);
        told.contains(&format!("topic=\"{TOPIC}\"")).then_some(told)
    });
    assert!(value(&told, "authros_topic_captured_total{") >= 2.0);
    promtool(&["check", "metrics"], told.split_once("\r\n\r\n").expect("a body").1);
    assert_eq!(fs::metadata(&path).expect("a socket").permissions().mode() & 0o777, 0o600);
    site.stop("INT", 20).expect_code(0);
}

#[test]
fn who_holds_connections_or_asks_for_something_else_does_not_keep_the_figures_from_others() {
    let home = Home::new();
    let port = free_port();
    let authros = home.authros().with(&["--robots", "0"]);
    let serving = authros.with_variable("AUTHROS_METRICS_LISTEN", &format!("127.0.0.1:{port}"));
    let mut site = serving.serve(&home);
    wait_until(30, "the figures", || figures(port));
    let held: Vec<TcpStream> = (0..40).filter_map(|_| TcpStream::connect(("127.0.0.1", port)).ok()).collect();
    for request in
        [&b"GET /metrics HTTP/1.1\r\nHost: evil.example\r\n\r\n"[..], b"POST /metrics HTTP/1.1\r\n\r\n", &[b'x'; 9000]]
    {
        let mut stream = TcpStream::connect(("127.0.0.1", port)).expect("connected");
        // It may be refused before all of it was accepted.
        drop(stream.write_all(request));
        let mut told = Vec::new();
        drop(stream.read_to_end(&mut told));
        assert!(!told.starts_with(b"HTTP/1.1 200"), "{}", String::from_utf8_lossy(&told));
    }
    assert!(figures(port).is_some(), "forty that say nothing are let go after two seconds each");
    drop(held);
    site.expect_running();
    site.stop("INT", 20).expect_code(0);
}

#[test]
fn an_open_address_is_refused_unless_it_is_asked_for_and_a_taken_one_is_told() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "0"]);
    let refused = authros.with_variable("AUTHROS_METRICS_LISTEN", "0.0.0.0:9464").fails(3, &["config", "check"]);
    assert!(refused.contains("metrics.open"), "{refused}");
    let asked_for =
        authros.with_variable("AUTHROS_METRICS_LISTEN", "0.0.0.0:9464").with_variable("AUTHROS_METRICS_OPEN", "yes");
    asked_for.run(&["config", "check"]).expect_code(0);
    let taken = TcpListener::bind("127.0.0.1:0").expect("a port");
    let place = taken.local_addr().expect("its address").to_string();
    let mut site = authros.with_variable("AUTHROS_METRICS_LISTEN", &place).serve(&home);
    site.wait_for_text("metrics cannot be served", 30);
    drop(taken);
    let port = place.rsplit(':').next().and_then(|port| port.parse().ok()).expect("a port");
    wait_until(60, "the figures once the port is free", || figures(port));
    site.stop("INT", 20).expect_code(0);
}

#[test]
fn the_rules_are_ones_that_prometheus_takes_and_every_figure_they_name_is_there() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/monitoring");
    let rules = folder.join("alerts.yml");
    let source = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("crates/service/src/figures/mod.rs"));
    let source = source.expect("the source of the figures");
    let dashboard = fs::read_to_string(folder.join("dashboard.json")).expect("a dashboard");
    let parsed: serde_json::Value = serde_json::from_str(&dashboard).expect("JSON");
    assert!(parsed["panels"].as_array().is_some_and(|panels| panels.len() > 10));
    let rules_text = fs::read_to_string(&rules).expect("rules");
    let words = |text: &str| {
        let word = |c: char| !(c.is_ascii_alphanumeric() || c == '_');
        text.split(word).filter(|word| word.starts_with("authros_")).map(str::to_owned).collect::<Vec<_>>()
    };
    for name in words(&rules_text).into_iter().chain(words(&dashboard)) {
        assert!(source.contains(&format!("\"{name}\"")), "{name} is no figure");
    }
    promtool(&["check", "rules", rules.to_str().expect("UTF-8")], "");
    let tests = folder.join("alerts.test.yml");
    let tests_text = fs::read_to_string(&tests).expect("tests of the rules");
    for alert in rules_text.lines().filter_map(|line| line.trim().strip_prefix("- alert: ")) {
        assert!(tests_text.contains(&format!("alertname=\"{alert}\"")), "{alert} is not tried");
    }
    promtool(&["test", "rules", tests.to_str().expect("UTF-8")], "");
}

#[test]
fn status_is_watched_until_it_is_ended_and_only_changes_are_printed() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1"]);
    authros.fails(3, &["status", "--watch"]);
    let site = authros.serve(&home);
    let mut watching = authros.spawn(&["status", "--watch"]);
    watching.wait_for_text("captured 0 = verified 0", 30);
    authros.capture(&[TOPIC], 2);
    watching.wait_for_text("captured 2 = verified 2", 60);
    watching.stop("INT", 20).expect_code(0);
    site.stop("INT", 20).expect_code(0);
}
