//! What a reader could not read of a recording, and where.

use serde::{Deserialize, Serialize};

use crate::model::clean;

/// The most places of damage that are named; more are counted.
const MOST_DAMAGES: usize = 64;

/// A place that could not be read.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Damage {
    /// Where it begins, bytes from the start of the file.
    pub position: u64,
    /// What was skipped and why, cleaned.
    pub text: String,
}

/// What was skipped of a recording.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Findings {
    /// Places of damage, in the order met; only the first are named.
    pub damages: Vec<Damage>,
    /// Further ones.
    pub more_damages: u64,
    /// Messages that are there, but cannot be used: of a channel that is described nowhere, or of no encoding of ROS.
    pub messages_skipped: u64,
    /// Messages that no checksum covers: whether they were altered cannot be told from the file.
    #[serde(default)]
    pub unguarded: u64,
}

impl Findings {
    /// Notes a place of damage.
    pub(crate) fn note(&mut self, position: u64, text: &str) {
        if self.damages.len() < MOST_DAMAGES {
            self.damages.push(Damage { position, text: clean(text, 300) });
        } else {
            self.more_damages += 1;
        }
    }

    /// Compares how many messages the file's own index counts with how many were met, where nothing else tells of a loss.
    pub(crate) fn compare(&mut self, end: u64, counted: Option<u64>, met: u64) {
        let Some(counted) = counted.filter(|counted| self.damages.is_empty() && *counted != met) else { return };
        self.note(end, &format!("the file's index counts {counted} messages, {met} could be read"));
    }

    /// Whether all of the recording was read.
    pub fn is_whole(&self) -> bool {
        self.damages.is_empty() && self.messages_skipped == 0
    }
}
