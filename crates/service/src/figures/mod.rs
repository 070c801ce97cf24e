//! The figures of a running site at one moment: what Prometheus reads, over HTTP, and what alerts are judged by. The
//! site fills them in.

pub mod exposition;

use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _};

use crate::chain::serve::is_this_machine;
use crate::model::Timestamp;
use crate::reply::{LifeLine, PartHealth, QueueView, TaskState, TaskView};
use crate::store::CacheState;

/// The figures of a site.
#[derive(Debug, Clone, Default)]
pub struct Figures {
    /// When they were read.
    pub now: Timestamp,
    /// Accounts with records here.
    pub owners: Vec<OwnerFigures>,
    /// Robots that were heard of, without this home's own keys.
    pub robots: Vec<RobotFigures>,
    /// The parts of this run and their health.
    pub parts: Vec<PartHealth>,
    pub tasks: Vec<TaskView>,
    /// The ring in front of the sealer.
    pub queue: QueueView,
    pub lanes: Vec<LaneFigures>,
    /// The newest block: its height and its own time.
    pub block: Option<(u64, Timestamp)>,
    /// Grants with an end, given by any profile or received from contacts, in the order of their ends; `None` = the
    /// chain is unknown at present.
    pub grants: Option<Vec<GrantFigures>>,
    /// Free bytes on the home's disk, and how many of them records leave.
    pub disk: Option<(u64, u64)>,
    /// The cache in front of the store, if there is one.
    pub cache: Option<CacheState>,
    /// Losses not yet reported by a gap record.
    pub untold_gaps: u64,
    /// Lines of the audit log.
    pub audit_lines: u64,
    /// When its oldest line without an anchored head was written.
    pub audit_unanchored: Option<Timestamp>,
    /// Whether that is unknown, because every profile is locked.
    pub audit_locked: bool,
    /// How many seconds the machine's clock is ahead of the one used for rights; negative = behind.
    pub clock_ahead: i64,
    /// The gateway served here.
    pub gateway: Option<GatewayFigures>,
    /// How many alerts of each rule are active.
    pub alerts: Vec<(&'static str, u64)>,
    /// Deliveries of alerts that wait, and those dropped for want of room and not reported yet.
    pub deliveries: (u64, u64),
    /// Times of the line, by milestone.
    pub latencies: Vec<Latency>,
    /// Seconds that each stage was busy.
    pub busy: Vec<(&'static str, f64)>,
}

/// The records of one account.
#[derive(Debug, Clone, Default)]
pub struct OwnerFigures {
    /// The beginning of the account's address.
    pub owner: String,
    /// The counts of its records by state.
    pub life: LifeLine,
    /// When the oldest record that is in no block was captured.
    pub oldest_unanchored: Option<Timestamp>,
    /// Topics by name, only if the settings ask for them.
    pub topics: Vec<TopicFigures>,
}

/// The records of one topic.
#[derive(Debug, Clone, Default)]
pub struct TopicFigures {
    pub topic: String,
    pub captured: u64,
    pub verified: u64,
    /// Not captured: lost in transport.
    pub missed: u64,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RobotFigures {
    /// The beginning of its fingerprint.
    pub robot: String,
    /// When its newest record was captured, by its own clock.
    pub last_seen: Timestamp,
}

/// A grant that will end.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GrantFigures {
    /// The beginning of the sharing account's address.
    pub owner: String,
    /// The beginning of the reading account's address.
    pub reader: String,
    /// Whether an account of this home shares by it; otherwise one of its contacts does.
    pub given: bool,
    pub ends: Timestamp,
}

#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct GatewayFigures {
    pub connections: u64,
    /// Refusals since it was started, by the protocol's code.
    pub refused: Vec<(u16, u64)>,
}

/// A lane of transactions.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LaneFigures {
    /// The beginning of the account's address.
    pub account: String,
    /// Transactions not in a block yet.
    pub open: u64,
    /// When the oldest was first signed.
    pub oldest: Option<Timestamp>,
    /// Whether it is stalled.
    pub paused: bool,
}

/// Times from capture to a milestone.
#[derive(Debug, Clone)]
pub struct Latency {
    /// `durable`, `confirmed`, `verified`.
    pub milestone: &'static str,
    /// How many were within each bound of [`BOUNDS`].
    pub within: Vec<u64>,
    /// How many in total.
    pub count: u64,
    /// Their sum, seconds.
    pub seconds: f64,
}

/// The bounds of latencies: powers of two, microseconds, from a millisecond to an hour.
pub const BOUNDS: [u32; 12] = [10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30, 32];

/// The beginning of an account's address or a fingerprint: enough to tell robots apart, and not a key.
pub fn short(text: &str) -> String {
    text.trim_start_matches("0x").chars().filter(char::is_ascii_hexdigit).take(8).collect()
}

impl Figures {
    /// Seconds since a moment; none before it.
    pub fn age(&self, moment: Timestamp) -> f64 {
        std::time::Duration::from_nanos(self.now.0.saturating_sub(moment.0)).as_secs_f64()
    }

    /// Seconds until a moment; none after it.
    pub fn until(&self, moment: Timestamp) -> f64 {
        std::time::Duration::from_nanos(moment.0.saturating_sub(self.now.0)).as_secs_f64()
    }

    /// Tasks that failed and are pausing.
    pub fn resting(&self) -> usize {
        self.tasks.iter().filter(|task| task.state == TaskState::Resting).count()
    }
}

/// The longest request line with all headers, bytes.
const LONGEST_HEAD: usize = 8 * 1024;
/// How long a request may take to arrive, and an answer to be sent.
const PATIENCE: Duration = Duration::from_secs(2);
/// Connections answered at the same time.
pub const MOST: usize = 16;

/// The answer to a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Asked {
    Figures,
    /// None, for this reason: the status and what to do.
    Refused(&'static str, &'static str),
}

/// Reads one request, answers it, and closes. `any_host` = a peer that reaches this address may use any name for it.
/// `figures` = the text; `None` if it cannot be read now.
pub async fn answer<S, Told>(mut stream: S, any_host: bool, figures: impl FnOnce() -> Told)
where
    S: AsyncRead + AsyncWrite + Unpin,
    Told: Future<Output = Option<std::sync::Arc<str>>>,
{
    let Ok(Some(head)) = tokio::time::timeout(PATIENCE, head(&mut stream)).await else { return };
    let message = match judge(&head, any_host) {
        Asked::Figures => match figures().await {
            Some(text) => message("200 OK", exposition::CONTENT_TYPE, &text),
            None => refusal("503 Service Unavailable", "the ledger cannot be read at the moment; try again"),
        },
        Asked::Refused(status, why) => refusal(status, why),
    };
    let sent = async {
        stream.write_all(message.as_bytes()).await?;
        stream.shutdown().await
    };
    // A peer that does not wait for its answer is not an error.
    drop(tokio::time::timeout(PATIENCE, sent).await);
}

/// Everything up to the empty line; `None` if the peer ends before it.
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

/// What the headers ask for.
pub fn judge(head: &[u8], any_host: bool) -> Asked {
    use Asked::Refused;
    if head.len() > LONGEST_HEAD && !ends(head) {
        return Refused("431 Request Header Fields Too Large", "the head is too long");
    }
    let Ok(text) = std::str::from_utf8(head) else { return Refused("400 Bad Request", "the head is not text") };
    let mut lines = text.lines();
    let words: Vec<&str> = lines.next().unwrap_or_default().split(' ').collect();
    let [method, target, "HTTP/1.0" | "HTTP/1.1"] = words[..] else {
        return Refused("400 Bad Request", "the request line is not METHOD TARGET HTTP/1.1");
    };
    if method != "GET" {
        return Refused("405 Method Not Allowed", "use GET to read metrics");
    }
    if target.split('?').next() != Some("/metrics") {
        return Refused("404 Not Found", "metrics are at /metrics");
    }
    let headers: Vec<(String, &str)> = lines
        .take_while(|line| !line.is_empty())
        .filter_map(|line| line.split_once(':'))
        .map(|(name, value)| (name.trim().to_ascii_lowercase(), value.trim()))
        .collect();
    let of =
        |name: &str| headers.iter().filter(|(other, _)| other == name).map(|(_, value)| *value).collect::<Vec<_>>();
    if !of("origin").is_empty() {
        return Refused("403 Forbidden", "requests from web pages are refused");
    }
    // A name that an attacker's DNS points at this machine is still the attacker's name in Host.
    if !any_host && !matches!(of("host")[..], [host] if is_this_machine(host)) {
        return Refused("403 Forbidden", "the Host header must name this machine: localhost or 127.0.0.1");
    }
    Asked::Figures
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
            Asked::Figures => "200".to_owned(),
            Asked::Refused(status, _) => status[..3].to_owned(),
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
        assert_eq!(judge(b"GET /metrics HTTP/1.1\r\n\r\n", true), Asked::Figures);
        assert!(matches!(judge(b"\xff\n\n", true), Asked::Refused(..)));
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
