//! What a reader could not read of a recording, and where.

use serde::{Deserialize, Serialize};

use crate::model::clean;

/// The most damaged places listed; further ones are counted.
const MOST_DAMAGES: usize = 64;

/// A place that could not be read.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Damage {
    /// Its offset in the file, bytes.
    pub position: u64,
    /// What was skipped and why, cleaned.
    pub text: String,
}

/// The skipped parts of a recording.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Findings {
    /// Damaged places, in order; only the first are listed.
    pub damages: Vec<Damage>,
    /// The number of further ones.
    pub more_damages: u64,
    /// Messages that are present but unusable: of a channel that is not described anywhere, or not in an encoding of
    /// ROS.
    pub messages_skipped: u64,
    /// Messages that no checksum covers: the file does not show whether they were altered.
    pub unguarded: u64,
}

impl Findings {
    /// Notes a damaged place.
    pub(crate) fn note(&mut self, position: u64, text: &str) {
        if self.damages.len() < MOST_DAMAGES {
            self.damages.push(Damage { position, text: clean(text, 300) });
        } else {
            self.more_damages += 1;
        }
    }

    /// Compares how many messages the file's own index counts with how many were found, if nothing else reports a loss.
    pub(crate) fn compare(&mut self, end: u64, counted: Option<u64>, met: u64) {
        let Some(counted) = counted.filter(|counted| self.damages.is_empty() && *counted != met) else { return };
        self.note(end, &format!("the file's index counts {counted} messages, but {met} could be read"));
    }

    /// Whether the whole recording was read.
    pub fn is_whole(&self) -> bool {
        self.damages.is_empty() && self.messages_skipped == 0
    }
}
