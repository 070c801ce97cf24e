//! An attack in several parts: each is refused with the promised name, or achieved something, or neither.

use authros::gateway::{Code, GatewayError};

use crate::Outcome;

/// The results of the parts so far.
#[derive(Debug, Default)]
pub struct Parts {
    refusals: Vec<String>,
    reached: Vec<String>,
    otherwise: Vec<String>,
}

impl Parts {
    /// A gateway's answer: what was achieved, or its refusal with one of these codes, under the session's key.
    pub fn answered(&mut self, what: &str, answer: Result<String, GatewayError>, codes: &[Code]) {
        match answer {
            Ok(reached) => self.reached.push(reached),
            Err(GatewayError::Refused(code)) if codes.contains(&code) => self.refusals.push(format!("{what}: {code}")),
            Err(error) => self.otherwise.push(format!("{what}: {error}")),
        }
    }

    /// A refusal that was read, which must contain these words.
    pub fn refused(&mut self, what: &str, read: &str, words: &str) {
        let told = format!("{what}: {read}");
        if read.contains(words) { self.refusals.push(told) } else { self.otherwise.push(told) }
    }

    /// Something was achieved.
    pub fn reached(&mut self, what: String) {
        self.reached.push(what);
    }

    /// Something that is not a refusal and achieved nothing.
    pub fn otherwise(&mut self, what: String) {
        self.otherwise.push(what);
    }

    /// The results of further parts.
    pub fn add(&mut self, more: Self) {
        self.refusals.extend(more.refusals);
        self.reached.extend(more.reached);
        self.otherwise.extend(more.otherwise);
    }

    /// How all of it ended; the same words are reported once.
    pub fn outcome(mut self) -> Outcome {
        for told in [&mut self.refusals, &mut self.otherwise] {
            told.sort_unstable();
            told.dedup();
        }
        if !self.reached.is_empty() {
            Outcome::Succeeded(self.reached.join(", "))
        } else if !self.otherwise.is_empty() || self.refusals.is_empty() {
            Outcome::Otherwise(self.otherwise.join("; "))
        } else {
            Outcome::Refused(self.refusals.join("; "))
        }
    }
}
