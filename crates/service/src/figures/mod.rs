//! The figures of a running site at one moment: what Prometheus reads and what alerts are judged by. Data only, no I/O
//! except in `http`; the site fills them in.

pub mod exposition;
pub mod http;

use crate::model::Timestamp;
use crate::service::reply::{LifeLine, QueueView, TaskState, TaskView};

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
    pub parts: Vec<PartFigures>,
    /// Background tasks.
    pub tasks: Vec<TaskView>,
    /// The ring in front of the sealer.
    pub queue: QueueView,
    /// Lanes of transactions.
    pub lanes: Vec<LaneFigures>,
    /// The newest block: its height and its own time.
    pub block: Option<(u64, Timestamp)>,
    /// Grants with an end, given by any profile or received from contacts, in the order of their ends; `None` = the
    /// chain is unknown at present.
    pub grants: Option<Vec<GrantFigures>>,
    /// Free bytes on the home's disk, and how many of them records leave.
    pub disk: Option<(u64, u64)>,
    /// Records waiting here for the vault, and their bytes.
    pub backlog: (u64, u64),
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
    /// Its name.
    pub topic: String,
    /// Messages captured.
    pub captured: u64,
    /// Of these, verified.
    pub verified: u64,
    /// Not captured: lost in transport.
    pub missed: u64,
}

/// A robot.
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
    /// When it ends.
    pub ends: Timestamp,
}

/// A running gateway.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct GatewayFigures {
    /// Open connections.
    pub connections: u64,
    /// Refusals since it was started, by the protocol's code.
    pub refused: Vec<(u16, u64)>,
}

/// A part of the site.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PartFigures {
    /// `ros`, `chain`, `vault`, `gateway`, `clock`, `account`.
    pub part: String,
    /// Whether it works.
    pub well: bool,
    /// Whether it has failed, rather than still being started.
    pub failed: bool,
    /// In words, cleaned; never shown in figures.
    pub text: String,
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
