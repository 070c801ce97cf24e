//! Every rule with Debian's Alertmanager: it holds each alert from its beginning to its end.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use std::collections::BTreeSet;
use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};

use serde_json::Value;

use super::over_http::until;
use super::*;
use crate::alerts::troubles::{troubles, well};
use crate::site::Needs;
use crate::site::testing::site_of;

const PROGRAM: &str = "/usr/bin/prometheus-alertmanager";

/// Ends with the test.
struct Alertmanager(Child);

impl Drop for Alertmanager {
    fn drop(&mut self) {
        // It may have ended on its own, which the test then reports.
        drop(self.0.kill());
        drop(self.0.wait());
    }
}

fn start(folder: &std::path::Path, port: u16) -> Alertmanager {
    let config = folder.join("alertmanager.yml");
    std::fs::write(&config, "route: {receiver: nobody}\nreceivers: [{name: nobody}]\n").expect("written");
    let mut command = Command::new(PROGRAM);
    command.arg(format!("--config.file={}", config.display()));
    command.arg(format!("--storage.path={}", folder.join("alertmanager").display()));
    command.arg(format!("--web.listen-address=127.0.0.1:{port}")).arg("--cluster.listen-address=");
    let child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn();
    Alertmanager(child.expect("it starts"))
}

/// The keys of the active alerts it holds; `None` while it does not answer.
fn held(port: u16) -> Option<BTreeSet<String>> {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).ok()?;
    stream.write_all(b"GET /api/v2/alerts HTTP/1.0\r\n\r\n").ok()?;
    let mut told = String::new();
    stream.read_to_string(&mut told).ok()?;
    let (head, body) = told.split_once("\r\n\r\n")?;
    let alerts: Value = head.starts_with("HTTP/1.0 200").then(|| serde_json::from_str(body).ok())??;
    let key = |alert: &Value| {
        let label = |name: &str| alert["labels"][name].as_str().unwrap_or_default().to_owned();
        let rule = label("alertname").trim_start_matches("authros_").to_owned();
        let subject = label("subject");
        if subject.is_empty() { rule } else { format!("{rule}/{subject}") }
    };
    Some(alerts.as_array()?.iter().map(key).collect())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_rule_is_held_by_an_alertmanager_from_its_beginning_to_its_end() {
    if !std::path::Path::new(PROGRAM).exists() {
        let line = "\nSKIPPED site::alerts::at_alertmanager: no prometheus-alertmanager; tests/run installs it\n";
        // Bypasses the harness's capture, in one write.
        drop(std::io::stderr().write_all(line.as_bytes()));
        return;
    }
    let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let port = listener.local_addr().expect("its address").port();
    drop(listener);
    let folder = tempfile::tempdir().expect("a folder");
    let _manager = start(folder.path(), port);
    until("the Alertmanager", || held(port).is_some()).await;
    let url = format!("http://127.0.0.1:{port}");
    let settings = [
        ("alerts.webhook", url.as_str()),
        ("alerts.form", "alertmanager"),
        ("alerts.grant_ends", "1h"),
        ("alerts.disk", "1000MiB"),
    ];
    let (site, _home) = site_of(&settings, Needs { ros: false, chain: false });
    drop(tokio::spawn(Arc::clone(&site).deliver_alerts()));
    let wanted: BTreeSet<String> = troubles().into_iter().map(|(key, _)| key.to_owned()).collect();
    (0..20).for_each(|look| drop(site.alerts.look(&well(look * 10))));
    // The chain last: while it is away, what only follows from that does not begin.
    for (look, but) in [(20, "chain"), (21, "")] {
        let mut bad = well(look * 10);
        troubles().iter().filter(|(key, _)| *key != but).for_each(|(_, trouble)| trouble(&mut bad));
        site.alerts.look(&bad);
    }
    until("all that began", || held(port).is_some_and(|held| held == wanted)).await;
    let shown: BTreeSet<String> = site.alerts.shown().0.into_iter().map(|alert| alert.key).collect();
    assert_eq!(shown, wanted, "the site itself says the same");
    (22..80).for_each(|look| drop(site.alerts.look(&well(look * 10))));
    until("the end of all", || held(port).is_some_and(|held| held.is_empty())).await;
    let over: BTreeSet<String> = site.alerts.shown().1.into_iter().map(|over| over.alert.key).collect();
    assert_eq!(over, wanted);
    site.stop().await;
}
