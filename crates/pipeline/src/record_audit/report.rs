//! The findings of an audit, as counted and as reported.

use serde::{Deserialize, Serialize};

use crate::model::{ErrorKind, clean};

/// Findings listed individually; the rest are counted.
const MOST_TOLD: usize = 100;
/// The longest text of a finding, characters.
const WIDEST: usize = 400;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, strum::IntoStaticStr)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "lowercase")]
pub enum FindingKind {
    Tampered,
    Missing,
    /// A record is as it was sealed, but its signer wrote a name into it that belongs to another pseudonym.
    #[strum(to_string = "false name")]
    FalseName,
    Gap,
    Unreachable,
}

impl FindingKind {
    pub fn word(self) -> &'static str {
        self.into()
    }
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordFinding {
    pub kind: FindingKind,
    /// Its subject: a record's id, a batch's root, a topic, `audit log`, `chain`.
    pub subject: String,
    pub text: String,
}

#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct RecordAudit {
    pub ok: bool,
    pub deep: bool,
    pub records: u64,
    /// Stored bytes hashed (deep), or bytes of the messages.
    pub bytes: u64,
    pub missing: u64,
    pub tampered: u64,
    /// Records whose signers wrote false names into them; everything else about them is as it was sealed.
    pub false_names: u64,
    pub gaps: u64,
    pub batches: u64,
    pub audit_lines: u64,
    /// Records not yet on any chain.
    pub pending: u64,
    /// Records whose bytes were deleted on purpose: discarded from quarantine, by retention, or handed over to a
    /// gateway.
    pub given_up: u64,
    /// Records whose signature could not be checked: the signer's key is not on any chain known here (deep).
    pub unchecked: u64,
    pub seconds: f64,
    /// Records a second, while records were examined.
    pub records_per_second: f64,
    /// Megabytes (10^6) a second, while records were examined.
    pub megabytes_per_second: f64,
    pub threads: usize,
    pub findings: Vec<RecordFinding>,
    pub findings_left_out: u64,
    /// What was left out of the audit, and why that is not a finding.
    pub notes: Vec<String>,
}

impl RecordAudit {
    /// The worst finding, as a kind of error; `None` if there was none.
    pub fn worst(&self) -> Option<ErrorKind> {
        if self.tampered + self.missing + self.gaps > 0 {
            Some(ErrorKind::Tampered)
        } else if self.false_names > 0 {
            Some(ErrorKind::Refused)
        } else if self.ok {
            None
        } else {
            Some(ErrorKind::Unreachable)
        }
    }
}

#[derive(Debug, Clone, Default)]
pub(super) struct Tally {
    /// The figures so far; times and rates come with the report.
    pub audit: RecordAudit,
    /// Entries of the index of tags supported by headers.
    pub indexed: u64,
    pub unnamed: u64,
    /// Records whose headers are not here.
    pub unread: u64,
    /// The highest row number.
    pub last: u64,
    found: u64,
}

#[derive(Debug, Clone, Copy)]
pub(super) struct Reading {
    pub seconds: f64,
    pub threads: usize,
}

impl Tally {
    pub fn find(&mut self, kind: FindingKind, subject: &str, text: &str) {
        match kind {
            FindingKind::Tampered => self.audit.tampered += 1,
            FindingKind::Missing => self.audit.missing += 1,
            FindingKind::FalseName => self.audit.false_names += 1,
            FindingKind::Gap | FindingKind::Unreachable => {}
        }
        self.found += 1;
        if self.audit.findings.len() < MOST_TOLD {
            self.audit.findings.push(RecordFinding { kind, subject: clean(subject, 120), text: clean(text, WIDEST) });
        }
    }

    pub fn note(&mut self, text: &str) {
        self.audit.notes.push(clean(text, WIDEST));
    }

    pub fn join(&mut self, other: Self) {
        let (own, more) = (&mut self.audit, other.audit);
        own.records += more.records;
        own.bytes += more.bytes;
        own.gaps += more.gaps;
        own.batches += more.batches;
        own.pending += more.pending;
        own.given_up += more.given_up;
        own.unchecked += more.unchecked;
        own.tampered += more.tampered;
        own.missing += more.missing;
        own.false_names += more.false_names;
        let room = MOST_TOLD.saturating_sub(own.findings.len());
        own.findings.extend(more.findings.into_iter().take(room));
        own.notes.extend(more.notes);
        self.indexed += other.indexed;
        self.unnamed += other.unnamed;
        self.unread += other.unread;
        self.last = self.last.max(other.last);
        self.found += other.found;
    }

    pub fn findings(&self) -> &[RecordFinding] {
        &self.audit.findings
    }

    pub fn report(self, deep: bool, seconds: f64, reading: Reading) -> RecordAudit {
        let rate = |count: u64| {
            #[expect(clippy::cast_precision_loss, reason = "a rate for people")]
            let count = count as f64;
            if reading.seconds > 0.0 { count / reading.seconds } else { 0.0 }
        };
        let told = u64::try_from(self.audit.findings.len()).unwrap_or(u64::MAX);
        RecordAudit {
            ok: self.found == 0,
            deep,
            seconds,
            records_per_second: rate(self.audit.records),
            megabytes_per_second: rate(self.audit.bytes) / 1e6,
            threads: reading.threads,
            findings_left_out: self.found.saturating_sub(told),
            ..self.audit
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn findings_are_told_up_to_a_bound_and_counted_beyond() {
        let mut tally = Tally::default();
        let mut other = Tally::default();
        for number in 0..80 {
            tally.find(FindingKind::Missing, "a", &number.to_string());
            other.find(FindingKind::Tampered, "b", "\u{202e}x");
        }
        tally.join(other);
        let report = tally.report(true, 1.0, Reading { seconds: 0.0, threads: 1 });
        assert_eq!((report.findings.len(), report.findings_left_out), (100, 60));
        assert_eq!((report.missing, report.tampered, report.ok), (80, 80, false));
        assert_eq!(report.worst(), Some(ErrorKind::Tampered));
        assert!(report.findings.iter().all(|finding| !finding.text.contains('\u{202e}')));
        let mut misnamed = Tally::default();
        misnamed.find(FindingKind::FalseName, "record 1", "a false topic");
        let report = misnamed.report(false, 1.0, Reading { seconds: 1.0, threads: 1 });
        assert_eq!((report.ok, report.tampered, report.worst()), (false, 0, Some(ErrorKind::Refused)));
        let mut silent = Tally::default();
        silent.find(FindingKind::Unreachable, "chain", "no answer");
        let report = silent.report(false, 1.0, Reading { seconds: 1.0, threads: 1 });
        assert_eq!((report.ok, report.worst()), (false, Some(ErrorKind::Unreachable)));
    }
}
