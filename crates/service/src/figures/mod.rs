//! The figures of a running site, for Prometheus and alerts.

use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _};

use crate::chain::serve::is_this_machine;
use crate::model::Timestamp;
use crate::pipeline::LaneState;
use crate::reply::{HealthLevel, LifeLine, PartHealth, QueueView, TaskState, TaskView};
use crate::store::{CacheState, LeaseState};

#[derive(Debug, Clone, Default)]
pub struct Figures {
    pub now: Timestamp,
    pub owners: Vec<OwnerFigures>,
    /// Without this home's own keys.
    pub robots: Vec<RobotFigures>,
    pub parts: Vec<PartHealth>,
    pub tasks: Vec<TaskView>,
    pub queue: QueueView,
    pub lanes: Vec<LaneState>,
    /// Height, and the block's own time.
    pub block: Option<(u64, Timestamp)>,
    /// In the order of their ends; `None` = the chain is unknown.
    pub grants: Option<Vec<GrantFigures>>,
    /// Free bytes on the home's disk, and how many of them records leave.
    pub disk: Option<(u64, u64)>,
    pub cache: Option<CacheState>,
    pub untold_gaps: u64,
    pub audit_lines: u64,
    /// Every profile is locked, so what heads cover is unknown.
    pub audit_locked: bool,
    /// Seconds ahead of the time used for rights; negative = behind.
    pub clock_ahead: i64,
    pub gateway: Option<GatewayFigures>,
    /// Of a store that several workers may share.
    pub lease: Option<LeaseState>,
    pub alerts: Vec<(&'static str, u64)>,
    /// Waiting, and dropped without report.
    pub deliveries: (u64, u64),
    pub latencies: Vec<Latency>,
    pub busy: Vec<(&'static str, f64)>,
}

#[derive(Debug, Clone, Default)]
pub struct OwnerFigures {
    pub owner: String,
    pub life: LifeLine,
    pub oldest_unanchored: Option<Timestamp>,
    /// The oldest audit log line that no head of this account covers; `None` while its profile is locked.
    pub audit_unanchored: Option<Timestamp>,
    /// Only if the settings ask for them.
    pub topics: Vec<TopicFigures>,
}

#[derive(Debug, Clone, Default)]
pub struct TopicFigures {
    pub topic: String,
    pub captured: u64,
    pub verified: u64,
    pub missed: u64,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RobotFigures {
    pub robot: String,
    /// By its own clock.
    pub last_seen: Timestamp,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GrantFigures {
    pub owner: String,
    pub reader: String,
    /// Whether this home shares by it, or receives.
    pub given: bool,
    /// When its present end was set; `None` = unknown.
    pub begun: Option<Timestamp>,
    pub ends: Timestamp,
}

#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct GatewayFigures {
    pub connections: u64,
    pub refused: Vec<(u16, u64)>,
}

#[derive(Debug, Clone)]
pub struct Latency {
    pub milestone: &'static str,
    pub within: Vec<u64>,
    pub count: u64,
    pub seconds: f64,
}

/// Powers of two, microseconds, from a millisecond to an hour.
pub const BOUNDS: [u32; 12] = [10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30, 32];

/// Enough digits to distinguish accounts and robots.
pub fn short(text: &str) -> String {
    text.trim_start_matches("0x").chars().filter(char::is_ascii_hexdigit).take(8).collect()
}

impl Figures {
    pub fn age(&self, moment: Timestamp) -> f64 {
        Duration::from_nanos(self.now.0.saturating_sub(moment.0)).as_secs_f64()
    }

    pub fn until(&self, moment: Timestamp) -> f64 {
        Duration::from_nanos(moment.0.saturating_sub(self.now.0)).as_secs_f64()
    }
}

const LONGEST_HEAD: usize = 8 * 1024;
const PATIENCE: Duration = Duration::from_secs(2);
pub const MOST: usize = 16;

/// `any_host`: the peer may use any name for this address. `figures` returns `None` if they cannot be read.
pub async fn answer<S, Told>(mut stream: S, any_host: bool, figures: impl FnOnce() -> Told)
where
    S: AsyncRead + AsyncWrite + Unpin,
    Told: Future<Output = Option<std::sync::Arc<str>>>,
{
    let Ok(Some(head)) = tokio::time::timeout(PATIENCE, head(&mut stream)).await else { return };
    let message = match judge(&head, any_host) {
        Ok(()) => match figures().await {
            Some(text) => message("200 OK", CONTENT_TYPE, &text),
            None => refusal("503 Service Unavailable", "the ledger cannot be read at the moment; try again"),
        },
        Err((status, why)) => refusal(status, why),
    };
    let sent = async {
        stream.write_all(message.as_bytes()).await?;
        stream.shutdown().await
    };
    drop(tokio::time::timeout(PATIENCE, sent).await);
}

async fn head(stream: &mut (impl AsyncRead + Unpin)) -> Option<Vec<u8>> {
    let (mut head, mut part) = (Vec::new(), [0; 1024]);
    while !ends(&head) && head.len() <= LONGEST_HEAD {
        match stream.read(&mut part).await {
            Ok(count @ 1..) => head.extend_from_slice(part.get(..count)?),
            _ => return None,
        }
    }
    Some(head)
}

fn ends(head: &[u8]) -> bool {
    head.windows(4).any(|four| four == b"\r\n\r\n") || head.windows(2).any(|two| two == b"\n\n")
}

pub fn judge(head: &[u8], any_host: bool) -> Result<(), (&'static str, &'static str)> {
    if head.len() > LONGEST_HEAD && !ends(head) {
        return Err(("431 Request Header Fields Too Large", "the head is too long"));
    }
    let Ok(text) = std::str::from_utf8(head) else { return Err(("400 Bad Request", "the head is not text")) };
    let mut lines = text.lines();
    let words: Vec<&str> = lines.next().unwrap_or_default().split(' ').collect();
    let [method, target, "HTTP/1.0" | "HTTP/1.1"] = words[..] else {
        return Err(("400 Bad Request", "the request line is not METHOD TARGET HTTP/1.1"));
    };
    if method != "GET" {
        return Err(("405 Method Not Allowed", "use GET to read metrics"));
    }
    if target.split('?').next() != Some("/metrics") {
        return Err(("404 Not Found", "metrics are at /metrics"));
    }
    let headers: Vec<(String, &str)> = lines
        .take_while(|line| !line.is_empty())
        .filter_map(|line| line.split_once(':'))
        .map(|(name, value)| (name.trim().to_ascii_lowercase(), value.trim()))
        .collect();
    let of =
        |name: &str| headers.iter().filter(|(other, _)| other == name).map(|(_, value)| *value).collect::<Vec<_>>();
    if !of("origin").is_empty() {
        return Err(("403 Forbidden", "requests from web pages are refused"));
    }
    // A name that an attacker's DNS points here still reveals itself in `Host`.
    if !any_host && !matches!(of("host")[..], [host] if is_this_machine(host)) {
        return Err(("403 Forbidden", "the Host header must name this machine: localhost or 127.0.0.1"));
    }
    Ok(())
}

fn refusal(status: &str, why: &str) -> String {
    message(status, "text/plain; charset=utf-8", &format!("{why}\n"))
}

fn message(status: &str, kind: &str, body: &str) -> String {
    let allow = if status.starts_with("405") { "Allow: GET\r\n" } else { "" };
    format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nConnection: close\r\n{allow}\
         X-Content-Type-Options: nosniff\r\nCache-Control: no-store\r\n\r\n{body}",
        body.len()
    )
}

pub const CONTENT_TYPE: &str = "text/plain; version=0.0.4; charset=utf-8";

type Labels<'a> = &'a [(&'a str, &'a str)];

#[derive(Default)]
struct Text(String);

impl Text {
    fn begin(&mut self, name: &str, kind: &str, help: &str) {
        self.0.push_str(&format!("# HELP {name} {help}\n# TYPE {name} {kind}\n"));
    }

    fn value(&mut self, name: &str, labels: Labels<'_>, value: impl std::fmt::Display) {
        self.0.push_str(name);
        for (index, (label, text)) in labels.iter().enumerate() {
            let before = if index == 0 { '{' } else { ',' };
            self.0.push_str(&format!("{before}{label}=\"{}\"", escaped(text)));
        }
        let behind = if labels.is_empty() { "" } else { "}" };
        self.0.push_str(&format!("{behind} {value}\n"));
    }

    fn single(&mut self, name: &str, kind: &str, help: &str, value: impl std::fmt::Display) {
        self.begin(name, kind, help);
        self.value(name, &[], value);
    }

    fn family<'r, Row, Value: std::fmt::Display, const LABELS: usize>(
        &mut self,
        name: &str,
        kind: &str,
        help: &str,
        rows: &'r [Row],
        each: impl Fn(&'r Row) -> ([(&'static str, &'r str); LABELS], Value),
    ) {
        if !rows.is_empty() {
            self.begin(name, kind, help);
        }
        for (labels, value) in rows.iter().map(each) {
            self.value(name, &labels, value);
        }
    }
}

fn escaped(text: &str) -> String {
    text.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n")
}

pub fn text(figures: &Figures) -> String {
    let mut text = Text::default();
    text.begin("authros_build_info", "gauge", "The program's version; always 1.");
    text.value("authros_build_info", &[("version", env!("CARGO_PKG_VERSION"))], 1);
    records(&mut text, figures);
    topics(&mut text, figures);
    ages(&mut text, figures);
    line(&mut text, figures);
    chain(&mut text, figures);
    health(&mut text, figures);
    if !figures.latencies.is_empty() {
        let help = "Time from capture to a milestone; the sum is at most 1/16 too high.";
        text.begin("authros_latency_seconds", "histogram", help);
    }
    figures.latencies.iter().for_each(|latency| histogram(&mut text, latency));
    text.0
}

fn states(life: &LifeLine) -> [(&'static str, u64); 6] {
    [
        ("verified", life.verified),
        ("pending", life.pending),
        ("right_ended", life.right_ended),
        ("quarantined", life.quarantined),
        ("dropped", life.dropped),
        ("tampered", life.tampered),
    ]
}

fn losses(life: &LifeLine) -> [(&'static str, u64); 2] {
    [("transport", life.lost_in_transport), ("recorder", life.lost_in_recorder)]
}

fn records(text: &mut Text, figures: &Figures) {
    fn by(row: &OwnerFigures) -> [(&'static str, &str); 1] {
        [("owner", &row.owner)]
    }
    fn split<const TERMS: usize>(
        owners: &[OwnerFigures],
        terms: fn(&LifeLine) -> [(&'static str, u64); TERMS],
    ) -> Vec<(&str, &'static str, u64)> {
        owners.iter().flat_map(|row| terms(&row.life).map(|(term, count)| (&*row.owner, term, count))).collect()
    }
    let owners = &figures.owners;
    let help = "Messages captured, including those dropped later.";
    text.family("authros_records_captured_total", "counter", help, owners, |row| (by(row), row.life.captured));
    let help = "Data records by state; their sum is authros_records_captured_total.";
    text.family("authros_records", "gauge", help, &split(owners, states), |(owner, state, count)| {
        ([("owner", owner), ("state", state)], count)
    });
    let help = "1 if captured equals the sum of all states, overall and per topic; otherwise 0.";
    text.family("authros_records_conserved", "gauge", help, owners, |row| (by(row), u64::from(row.life.conserved)));
    let help = "Messages that did not become records: transport (never arrived), recorder (no room or no key).";
    text.family("authros_losses_total", "counter", help, &split(owners, losses), |(owner, place, count)| {
        ([("owner", owner), ("place", place)], count)
    });
    let help = "Quarantined records that the operator discarded.";
    text.family("authros_records_discarded_total", "counter", help, owners, |row| (by(row), row.life.discarded));
}

fn topics(text: &mut Text, figures: &Figures) {
    fn by<'a>((owner, topic): &(&'a str, &'a TopicFigures)) -> [(&'static str, &'a str); 2] {
        [("owner", owner), ("topic", &topic.topic)]
    }
    let owners = figures.owners.iter();
    let rows: Vec<_> = owners.flat_map(|row| row.topics.iter().map(move |topic| (&*row.owner, topic))).collect();
    let help = "Messages of a topic that were captured.";
    text.family("authros_topic_captured_total", "counter", help, &rows, |row| (by(row), row.1.captured));
    let help = "Records of a topic that are verified.";
    text.family("authros_topic_verified_records", "gauge", help, &rows, |row| (by(row), row.1.verified));
    let help = "Messages of a topic that never arrived.";
    text.family("authros_topic_missed_total", "counter", help, &rows, |row| (by(row), row.1.missed));
}

fn ages(text: &mut Text, figures: &Figures) {
    let age = |moment: Option<Timestamp>| moment.map_or(0.0, |moment| figures.age(moment));
    let help = "Age of the oldest record not yet in a block; 0 if all are.";
    text.family("authros_oldest_unanchored_age_seconds", "gauge", help, &figures.owners, |row| {
        ([("owner", &row.owner)], age(row.oldest_unanchored))
    });
    let help = "Time since a robot's newest record arrived here.";
    text.family("authros_robot_last_seen_age_seconds", "gauge", help, &figures.robots, |row| {
        ([("robot", &row.robot)], figures.age(row.last_seen))
    });
    let help = "Time until a grant ends; the first 64 to end of those given, and of those received from contacts.";
    let grants = figures.grants.as_deref().unwrap_or_default();
    text.family("authros_grant_ends_seconds", "gauge", help, grants, |row| {
        ([("owner", &row.owner), ("reader", &row.reader)], figures.until(row.ends))
    });
    let uncovered = figures.owners.iter().filter_map(|owner| owner.audit_unanchored).min();
    let help = "Age of the oldest audit log line not covered by an anchored head; 0 if all are covered.";
    text.single("authros_audit_unanchored_age_seconds", "gauge", help, age(uncovered));
    text.single("authros_audit_lines_total", "counter", "Lines of the audit log.", figures.audit_lines);
}

fn line(text: &mut Text, figures: &Figures) {
    let queue = &figures.queue;
    text.single("authros_queue_messages", "gauge", "Messages in memory waiting to be sealed.", queue.messages);
    text.single("authros_queue_bytes", "gauge", "Bytes of messages waiting to be sealed.", queue.bytes);
    let help = "Limit for bytes of messages waiting to be sealed.";
    text.single("authros_queue_capacity_bytes", "gauge", help, queue.capacity);
    cache(text, figures);
    text.single("authros_gaps_untold", "gauge", "Losses not yet reported in a gap record.", figures.untold_gaps);
    if let Some((free, reserve)) = figures.disk {
        text.single("authros_disk_free_bytes", "gauge", "Free space on the disk of the home.", free);
        let help = "Free space below which no record is acknowledged.";
        text.single("authros_disk_reserve_bytes", "gauge", help, reserve);
    }
    let help = "Time that a pipeline stage spent working.";
    text.family("authros_stage_busy_seconds_total", "counter", help, &figures.busy, |(stage, seconds)| {
        ([("stage", stage)], seconds)
    });
}

fn cache(text: &mut Text, figures: &Figures) {
    let Some(cache) = &figures.cache else { return };
    let away = cache.away.as_ref().map_or(0.0, |away| figures.age(away.since));
    for (name, help, count) in [
        ("authros_cache_hits_total", "Records that the cache had.", cache.hits),
        ("authros_cache_misses_total", "Records that the cache did not have.", cache.misses),
        ("authros_cache_wrong_total", "Answers of the cache that were not the record asked for.", cache.wrong),
        ("authros_cache_skipped_total", "Records not written to the cache.", cache.skipped),
    ] {
        text.single(name, "counter", help, count);
    }
    let help = "Time since the cache, or a part of it, stopped answering; 0 if it answers.";
    text.single("authros_cache_away_seconds", "gauge", help, away);
}

fn chain(text: &mut Text, figures: &Figures) {
    fn by<'a>((account, _): &'a (String, &LaneState)) -> [(&'static str, &'a str); 1] {
        [("account", account)]
    }
    if let Some((number, time)) = figures.block {
        text.single("authros_chain_block_height", "gauge", "Height of the newest block.", number);
        let help = "Time since the newest block, by that block's own time.";
        text.single("authros_last_block_age_seconds", "gauge", help, figures.age(time));
    }
    let lanes: Vec<_> = figures.lanes.iter().map(|lane| (short(&lane.account.to_string()), lane)).collect();
    let (lanes, age) = (&lanes, |oldest| figures.age(oldest));
    let help = "Transactions of a lane that are not in a block yet.";
    text.family("authros_lane_open_transactions", "gauge", help, lanes, |row| (by(row), row.1.open));
    let help = "Age of a lane's oldest open transaction; 0 if there is none.";
    text.family("authros_lane_oldest_age_seconds", "gauge", help, lanes, |row| {
        (by(row), row.1.oldest.map_or(0.0, age))
    });
    let help = "1 if a lane is stuck until somebody intervenes; otherwise 0.";
    text.family("authros_lane_paused", "gauge", help, lanes, |row| (by(row), u8::from(row.1.paused.is_some())));
}

fn health(text: &mut Text, figures: &Figures) {
    let help = "1 if a part of the site works; 0 if it is starting, retrying, or has failed.";
    text.family("authros_part_up", "gauge", help, &figures.parts, |row| {
        ([("part", &row.part)], u8::from(row.level == HealthLevel::Ok))
    });
    let help = "Seconds by which the machine's clock is ahead of the time used for grants and device authorisations; \
                negative if it is behind.";
    text.single("authros_clock_ahead_seconds", "gauge", help, figures.clock_ahead);
    text.begin("authros_tasks", "gauge", "Background tasks by state.");
    let resting = figures.tasks.iter().filter(|task| task.state == TaskState::Resting).count();
    text.value("authros_tasks", &[("state", "running")], figures.tasks.len() - resting);
    text.value("authros_tasks", &[("state", "resting")], resting);
    if let Some(gateway) = &figures.gateway {
        text.single("authros_gateway_connections", "gauge", "Open connections of the gateway.", gateway.connections);
        let help = "Frames and connections that the gateway refused, by the protocol's code.";
        let refused: Vec<_> = gateway.refused.iter().map(|(code, count)| (code.to_string(), count)).collect();
        text.family("authros_gateway_refused_total", "counter", help, &refused, |(code, count)| {
            ([("code", code)], count)
        });
    }
    figures.lease.iter().for_each(|lease| leases(text, lease));
    let help = "Active alerts of the site itself, by rule.";
    text.family("authros_alerts", "gauge", help, &figures.alerts, |(rule, count)| ([("rule", rule)], count));
    let (waiting, dropped) = figures.deliveries;
    text.single("authros_alert_deliveries_waiting", "gauge", "Alert deliveries that are queued.", waiting);
    let help = "Alert deliveries dropped because the queue was full, and not yet reported by another delivery.";
    text.single("authros_alert_deliveries_dropped", "gauge", help, dropped);
}

fn leases(text: &mut Text, lease: &LeaseState) {
    let (is_held, is_own) = (lease.holder.is_some(), lease.holder.as_ref().is_some_and(|holder| holder.is_own));
    let help = "1 = a worker holds the lease of the database.";
    text.single("authros_lease_held", "gauge", help, u8::from(is_held));
    text.single("authros_lease_held_here", "gauge", "1 = this worker holds it.", u8::from(is_own));
    let help = "How often the lease was taken, by any worker.";
    text.single("authros_lease_taken_total", "counter", help, lease.number);
    let help = "Workers that gave a sign of life in the database within 10 s.";
    text.single("authros_workers", "gauge", help, lease.workers.len());
}

fn histogram(text: &mut Text, latency: &Latency) {
    let milestone = ("milestone", latency.milestone);
    for (power, within) in BOUNDS.iter().zip(&latency.within) {
        let bound = std::time::Duration::from_micros(1 << power).as_secs_f64().to_string();
        text.value("authros_latency_seconds_bucket", &[milestone, ("le", &bound)], within);
    }
    text.value("authros_latency_seconds_bucket", &[milestone, ("le", "+Inf")], latency.count);
    text.value("authros_latency_seconds_sum", &[milestone], latency.seconds);
    text.value("authros_latency_seconds_count", &[milestone], latency.count);
}

#[cfg(test)]
mod http_tests {
    use super::*;

    fn status(request: &str) -> String {
        match judge(request.as_bytes(), false) {
            Ok(()) => "200".to_owned(),
            Err((status, _)) => status[..3].to_owned(),
        }
    }

    #[test]
    fn only_this_route_of_this_machine_is_answered() {
        let with = |from: &str, to: &str| "GET /metrics HTTP/1.1\r\nHost: 127.0.0.1:9464\r\n\r\n".replace(from, to);
        for (expected, request) in [
            ("200", with("", "")),
            ("200", with("/metrics", "/metrics?x=1")),
            ("200", with("127.0.0.1", "LOCALHOST")),
            ("200", with("127.0.0.1:9464", "[::1]:1")),
            ("405", with("GET", "POST")),
            ("404", with("/metrics", "/")),
            ("404", with("/metrics", "/metrics/../etc")),
            ("400", with("HTTP/1.1", "HTTP/2")),
            ("400", with("GET ", "GET  ")),
            ("403", with("127.0.0.1", "evil.example")),
            ("403", with("127.0.0.1", "127.0.0.1.evil.example")),
            ("403", with("Host: 127.0.0.1:9464\r\n", "")),
            ("403", with("Host:", "Host: localhost\r\nHost:")),
            ("403", with("Host:", "Origin: http://x\r\nHost:")),
            ("431", "G".repeat(LONGEST_HEAD + 1)),
        ] {
            assert_eq!(status(&request), expected, "{request:.200}");
        }
        assert_eq!(judge(b"GET /metrics HTTP/1.1\r\n\r\n", true), Ok(()));
        assert!(judge(b"\xff\n\n", true).is_err());
    }

    async fn asked(request: &[u8]) -> String {
        let (near, mut far) = tokio::io::duplex(64 * 1024);
        let answering = tokio::spawn(answer(near, false, || async { Some("a 1\n".into()) }));
        // A peer that refuses the rest has already answered.
        drop(far.write_all(request).await);
        let mut told = String::new();
        far.read_to_string(&mut told).await.expect("text");
        answering.await.expect("ends");
        told
    }

    #[tokio::test]
    async fn an_answer_and_an_end() {
        let told = asked(b"GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n").await;
        assert!(told.starts_with("HTTP/1.1 200 OK\r\n") && told.ends_with("\r\n\r\na 1\n"), "{told}");
        assert!(asked(&vec![b'x'; 20_000]).await.starts_with("HTTP/1.1 431"));
    }

    #[tokio::test]
    async fn who_says_nothing_is_not_waited_for_long() {
        assert_eq!(asked(b"GET /metrics").await, "");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn figures() -> Figures {
        let life = LifeLine {
            captured: 21,
            verified: 6,
            pending: 5,
            right_ended: 4,
            quarantined: 3,
            dropped: 2,
            ..LifeLine::default()
        };
        let life = LifeLine { tampered: 1, conserved: true, ..life };
        let owner = OwnerFigures { owner: "0a0b0c0d".to_owned(), life, ..OwnerFigures::default() };
        let oldest_unanchored = Some(Timestamp::from_seconds(90));
        Figures {
            now: Timestamp::from_seconds(100),
            owners: vec![OwnerFigures { oldest_unanchored, ..owner }],
            robots: vec![RobotFigures { robot: "12345678".to_owned(), last_seen: Timestamp::from_seconds(140) }],
            latencies: vec![Latency { milestone: "durable", within: vec![1; 12], count: 2, seconds: 0.5 }],
            ..Figures::default()
        }
    }

    #[test]
    fn the_terms_of_the_law_stand_beside_what_was_captured() {
        let text = text(&figures());
        for line in [
            "authros_records_captured_total{owner=\"0a0b0c0d\"} 21",
            "authros_records{owner=\"0a0b0c0d\",state=\"verified\"} 6",
            "authros_records{owner=\"0a0b0c0d\",state=\"tampered\"} 1",
            "authros_records_conserved{owner=\"0a0b0c0d\"} 1",
            "authros_oldest_unanchored_age_seconds{owner=\"0a0b0c0d\"} 10",
            "authros_robot_last_seen_age_seconds{robot=\"12345678\"} 0",
            "authros_latency_seconds_bucket{milestone=\"durable\",le=\"0.001024\"} 1",
            "authros_latency_seconds_bucket{milestone=\"durable\",le=\"+Inf\"} 2",
        ] {
            assert!(text.lines().any(|other| other == line), "{line} is not in\n{text}");
        }
        assert!(!text.contains("authros_topic"), "no topic unless asked for");
    }

    #[test]
    fn a_topic_with_quotes_cannot_leave_its_label() {
        let mut figures = figures();
        let topic = "/a\"} 1\nauthros_records{state=\"\\".to_owned();
        figures.owners[0].topics.push(TopicFigures { topic, captured: 9, ..TopicFigures::default() });
        let text = text(&figures);
        let line =
            "authros_topic_captured_total{owner=\"0a0b0c0d\",topic=\"/a\\\"} 1\\nauthros_records{state=\\\"\\\\\"} 9";
        assert!(text.lines().any(|other| other == line), "{text}");
    }

    #[test]
    fn a_family_is_begun_once_and_before_its_values() {
        let text = text(&figures());
        let names: Vec<_> = text.lines().filter_map(|line| line.strip_prefix("# TYPE ")).collect();
        let distinct: std::collections::BTreeSet<_> = names.iter().collect();
        assert_eq!(names.len(), distinct.len(), "{names:?}");
    }
}
