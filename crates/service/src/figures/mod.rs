//! The figures of a running site, for Prometheus and alerts.

pub mod exposition;

use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _};

use crate::chain::serve::is_this_machine;
use crate::model::Timestamp;
use crate::pipeline::sender::LaneState;
use crate::reply::{LifeLine, PartHealth, QueueView, TaskView};
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
            Some(text) => message("200 OK", exposition::CONTENT_TYPE, &text),
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
