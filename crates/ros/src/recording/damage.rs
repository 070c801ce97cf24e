//! What a reader could not read of a recording, and where.

use serde::{Deserialize, Serialize};

use crate::model::clean;

/// The most damaged places listed; further ones are counted.
const MOST_DAMAGES: usize = 64;

/// The most rows of unusable messages; those of further topics share one row without a name.
const MOST_UNUSABLE: usize = 256;

/// A place that could not be read.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Damage {
    /// Its offset in the file, bytes.
    pub position: u64,
    /// What was skipped and why, cleaned.
    pub text: String,
}

/// Messages of one topic that are present but cannot be used, for one reason.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Unusable {
    /// Their topic, cleaned; empty if the file does not name it.
    pub topic: String,
    /// Why, cleaned.
    pub why: String,
    /// How many.
    pub messages: u64,
}

/// The skipped parts of a recording.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Findings {
    /// Damaged places, in order; only the first are listed.
    pub damages: Vec<Damage>,
    /// The number of further ones.
    pub more_damages: u64,
    /// Messages that are present but unusable, by topic and reason.
    pub unusable: Vec<Unusable>,
    /// Messages, attachments and metadata records that no checksum covers: the file does not show whether they were altered.
    pub unguarded: u64,
    /// Whether the recorder was killed before it wrote the index: nothing shows whether the end is missing.
    pub unfinished: bool,
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

    /// Counts a message that is present but unusable.
    pub(crate) fn leave_out(&mut self, topic: &str, why: &str) {
        self.leave_out_many(topic, why, 1);
    }

    fn leave_out_many(&mut self, topic: &str, why: &str, messages: u64) {
        let (topic, why) = (clean(topic, 255), clean(why, 200));
        if let Some(row) = self.unusable.iter_mut().find(|row| row.topic == topic && row.why == why) {
            row.messages += messages;
        } else if self.unusable.len() < MOST_UNUSABLE {
            self.unusable.push(Unusable { topic, why, messages });
        } else if let Some(row) = self.unusable.last_mut() {
            let why = String::from("there are too many topics and reasons to list");
            *row = Unusable { topic: String::new(), why, messages: row.messages + messages };
        }
    }

    /// Adds what was skipped of one file of several.
    pub(crate) fn add(&mut self, name: &str, of_file: &Self) {
        for damage in &of_file.damages {
            self.note(damage.position, &format!("{name}: {}", damage.text));
        }
        self.more_damages += of_file.more_damages;
        for row in &of_file.unusable {
            self.leave_out_many(&row.topic, &row.why, row.messages);
        }
        self.unguarded += of_file.unguarded;
        self.unfinished |= of_file.unfinished;
    }

    /// How many messages are present but unusable.
    pub fn messages_skipped(&self) -> u64 {
        self.unusable.iter().map(|row| row.messages).sum()
    }

    /// Compares how many messages, or `what` else, the file's own index counts with how many were found, if nothing else reports a loss.
    pub(crate) fn compare(&mut self, end: u64, what: &str, counted: Option<u64>, met: u64) {
        let Some(counted) = counted.filter(|counted| self.damages.is_empty() && *counted != met) else { return };
        self.note(end, &format!("the file's index counts {counted} {what}, but {met} could be read"));
    }

    /// Whether the whole recording was read.
    pub fn is_whole(&self) -> bool {
        self.damages.is_empty() && self.unusable.is_empty()
    }
}
