//! Where the site runs, and whether watched topics are captured: what must never be off unnoticed.

use super::state::State;
use crate::service::reply::{HeldUp, TopicRow};

/// Where the site runs, seen from this console.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Standing {
    /// In this process: it ends with the console.
    Host,
    /// In another process, which continues; 0 = one that does not report its number.
    Joined(u32),
}

impl Standing {
    /// Where the site of this console runs; `None` = it has not answered yet.
    pub fn of(state: &State) -> Option<Self> {
        let process = state.site.as_ref()?.process;
        Some(if process == state.settings.process { Self::Host } else { Self::Joined(process) })
    }

    /// The header's text for it.
    pub fn badge(self) -> String {
        match self {
            Self::Host => "HOST".to_owned(),
            Self::Joined(0) => "JOINED".to_owned(),
            Self::Joined(process) => format!("JOINED {process}"),
        }
    }
}

/// Whether a topic is captured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Capture {
    /// Not watched.
    Unwatched,
    /// Captured.
    Watched,
    /// Not until the keyring is unlocked.
    WaitsForKey,
    /// Paused.
    Paused,
    /// Waiting for somebody to publish it.
    NoPublisher,
}

impl Capture {
    /// The state of a topic; the worst one wins.
    pub fn of(row: &TopicRow) -> Self {
        match row {
            TopicRow { watched: false, .. } => Self::Unwatched,
            TopicRow { held_up: Some(HeldUp::WaitsForKey), .. } => Self::WaitsForKey,
            TopicRow { held_up: Some(HeldUp::Paused), .. } => Self::Paused,
            TopicRow { publishers, .. } if publishers.is_empty() => Self::NoPublisher,
            _ => Self::Watched,
        }
    }

    /// In a word or two.
    pub fn word(self) -> &'static str {
        match self {
            Self::Unwatched => "-",
            Self::Watched => "watched",
            Self::WaitsForKey => "waits for key",
            Self::Paused => "paused",
            Self::NoPublisher => "no publisher",
        }
    }
}

/// How many topics are in this state.
pub fn count(state: &State, capture: Capture) -> usize {
    state.topics.rows.iter().filter(|row| Capture::of(row) == capture).count()
}

/// `the capture of /robot1/odom`, `the capture of 4 topics`; `None` = of none.
pub fn captured(state: &State) -> Option<String> {
    let mut rows = state.topics.rows.iter().filter(|row| Capture::of(row) == Capture::Watched);
    let first = rows.next()?;
    Some(match rows.count() {
        0 => format!("the capture of {}", first.topic),
        more => format!("the capture of {} topics", more + 1),
    })
}

/// What is watched but not captured, and why; `None` = there is none.
pub fn not_captured(state: &State) -> Option<String> {
    let topics = |count: usize| if count == 1 { "1 topic".to_owned() } else { format!("{count} topics") };
    match (count(state, Capture::WaitsForKey), count(state, Capture::Paused)) {
        (0, 0) => None,
        (0, paused) => Some(format!("capture of {} is paused", topics(paused))),
        (waiting, _) => Some(format!("capture of {} waits for the key", topics(waiting))),
    }
}
