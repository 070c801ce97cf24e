//! Which topics are captured, and why others are not.

use crate::app::State;
use crate::model::counted;
use crate::service::reply::{HeldUp, TopicRow};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Capture {
    Unwatched,
    Watched,
    /// Not until the keyring is unlocked.
    WaitsForKey,
    Paused,
    NoPublisher,
}

impl Capture {
    /// The worst reason wins.
    pub fn of(row: &TopicRow) -> Self {
        match row {
            TopicRow { watched: false, .. } => Self::Unwatched,
            TopicRow { held_up: Some(HeldUp::WaitsForKey), .. } => Self::WaitsForKey,
            TopicRow { held_up: Some(HeldUp::Paused), .. } => Self::Paused,
            TopicRow { publishers, .. } if publishers.is_empty() => Self::NoPublisher,
            _ => Self::Watched,
        }
    }

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

pub fn count(state: &State, capture: Capture) -> usize {
    state.topics.rows.iter().filter(|row| Capture::of(row) == capture).count()
}

/// `the capture of /robot1/odom`, `the capture of 4 topics`.
pub fn captured(state: &State) -> Option<String> {
    let mut rows = state.topics.rows.iter().filter(|row| Capture::of(row) == Capture::Watched);
    let first = rows.next()?;
    Some(match rows.count() {
        0 => format!("the capture of {}", first.topic),
        more => format!("the capture of {}", counted(more as u64 + 1, "topic")),
    })
}

/// Watched topics that are not captured, and why.
pub fn not_captured(state: &State) -> Option<String> {
    let topics = |count: usize| counted(count as u64, "topic");
    match (count(state, Capture::WaitsForKey), count(state, Capture::Paused)) {
        (0, 0) => None,
        (0, paused) => Some(format!("capture of {} is paused", topics(paused))),
        (waiting, _) => Some(format!("capture of {} waits for the key", topics(waiting))),
    }
}
