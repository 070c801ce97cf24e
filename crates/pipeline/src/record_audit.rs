//! The audit of records: rows against proofs and chain, batches against events, sequences without gaps, the audit log's
//! hashes; `deep` also every stored byte and signature. Pages are shared by workers: memory does not grow with the
//! store.

mod batches;
mod records;

use std::collections::{BTreeMap, BTreeSet};
use std::{sync::Arc, sync::atomic::AtomicU64, time::Instant};

use serde::{Deserialize, Serialize};
use tokio::runtime::Handle;

use crate::chain::{ChainError, Event, EventAt};
use crate::model::{Address, Digest, ErrorKind, RecordState, Timestamp, clean, counted};
use crate::record_audit::records::{Bench, Uploaded, look, read_again};
use crate::store::{AuditLog, AuditedRecord, Ledger, StoreError};
use crate::{Network, Plant, audit_head, columns::Keys, directory::Told, store::notes::ScrubbedUpTo, watcher};

type Result<T, E = StoreError> = std::result::Result<T, E>;

#[derive(Clone)]
pub struct Scope {
    /// Also every stored byte and every signature.
    pub deep: bool,
    /// Only records captured at or after this time; batches, numbers and the audit log are always checked in full.
    pub since: Timestamp,
    pub accounts: Vec<Address>,
    /// Keys of the profiles whose keyrings are open: names are compared by their pseudonyms.
    pub keys: Arc<dyn Keys + Send + Sync>,
    /// Counts the records that were given to the threads, which take a few at a time.
    pub looked_at: Arc<AtomicU64>,
}

/// `chain` is what the rows are compared with, or why it cannot be queried; `None` in a home that never used a chain.
/// Blocks: call it on a thread that may wait for the runtime. Faults in the store are part of the answer.
pub fn audit(
    plant: &Plant,
    chain: Option<Result<&Network, String>>,
    log: &AuditLog,
    scope: &Scope,
    runtime: &Handle,
) -> Result<RecordAudit> {
    let begun = Instant::now();
    let mut tally = Tally::default();
    let network = match &chain {
        Some(Ok(network)) => Some(*network),
        Some(Err(reason)) => {
            tally.find(FindingKind::Unreachable, "chain", &format!("nothing could be compared with it: {reason}"));
            None
        }
        None => {
            tally.note("the store names no chain, so nothing was compared with one");
            None
        }
    };
    let left_out = chain.is_some() && network.is_none();
    batches::compare(plant, network, scope, runtime, &mut tally)?;
    let reading = records::compare(plant, network, left_out, scope, runtime, &mut tally)?;
    records::compare_sequences(plant, scope, &mut tally)?;
    if let Some(network) = network.filter(|_| scope.deep) {
        run_chain_again(network, runtime, &mut tally);
    }
    log_of(plant, log, scope, &mut tally)?;
    file_of(plant, scope, &mut tally)?;
    let seconds = begun.elapsed().as_secs_f64();
    Ok(tally.report(scope.deep, seconds, reading))
}

/// Every block of the embedded chain, run again; other chains are vouched for by their nodes.
fn run_chain_again(network: &Network, runtime: &Handle, tally: &mut Tally) {
    if let Err(error) = runtime.block_on(network.chain.run_again()) {
        let tampered = error.kind() == ErrorKind::Tampered;
        let kind = if tampered { FindingKind::Tampered } else { FindingKind::Unreachable };
        tally.find(kind, "chain", &error.to_string());
    }
}

/// The audit log's own hash chain, and the heads that the home's profiles noted when they sealed them.
fn log_of(plant: &Plant, log: &AuditLog, scope: &Scope, tally: &mut Tally) -> Result<()> {
    match log.verify() {
        Ok(lines) => tally.audit.audit_lines = lines,
        Err(fault) => tally.find(FindingKind::Tampered, "audit log", &fault.to_string()),
    }
    for account in &scope.accounts {
        let Some(head) = audit_head::noted(&plant.ledger.notes, *account)? else { continue };
        if let Err(fault) = log.compare(&[head]) {
            tally.find(FindingKind::Tampered, "audit log", &fault.to_string());
        }
    }
    Ok(())
}

/// The counts beside the rows, from which lists know where to look; deep also the file's pages and indices.
fn file_of(plant: &Plant, scope: &Scope, tally: &mut Tally) -> Result<()> {
    let inspection = &plant.ledger.inspection;
    for text in inspection.contradictions()? {
        let text = format!("{text}, so lists and totals may leave records out; restore the last backup");
        tally.find(FindingKind::Tampered, "ledger", &text);
    }
    match if scope.deep { inspection.check_file() } else { Ok(()) } {
        Err(fault @ StoreError::Corrupt { .. }) => tally.find(FindingKind::Tampered, "ledger", &fault.to_string()),
        checked => checked?,
    }
    Ok(())
}

/// Why a comparison with the chain ended early.
#[derive(Debug, thiserror::Error)]
enum Stop {
    #[error(transparent)]
    Chain(#[from] ChainError),
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// The most differing blocks of a page that are named one by one.
const MOST_BLOCKS: usize = 100;
/// What follows from a difference, and what to do.
const ADVICE: &str = "what is verified and who may read is judged here by the ledger. The chain is read again from this \
                      block on while the site runs (`authros serve`); then audit again, and check the node behind \
                      chain.url";

/// An event's name in the contract.
fn name(event: &Event) -> String {
    let text = format!("{event:?}");
    text.split([' ', '{']).next().unwrap_or("event").to_owned()
}

/// Compares the contract's events in blocks `from` to `to`, as the chain has them, with the ledger. A block that differs
/// is read once more: the watcher may just have been at it.
async fn compare(
    plant: &Plant,
    network: &Network,
    (from, to): (u64, u64),
    events: &[EventAt],
    tally: &mut Tally,
) -> Result<(), Stop> {
    let differing = differing_blocks(&plant.ledger, (from, to), events)?;
    let mut first = None;
    for block in differing.iter().copied().take(MOST_BLOCKS) {
        let again = network.chain.events(block, block).await?;
        let found = differences(&plant.ledger, (block, block), &again)?;
        for (kind, text) in &found {
            tally.find(*kind, &format!("block {block}"), &format!("{text}; {ADVICE}"));
        }
        first = first.or((!found.is_empty()).then_some(block));
    }
    if differing.len() > MOST_BLOCKS {
        let text = format!(
            "events of {} from {from} to {to} differ from the ledger; {ADVICE}",
            counted(differing.len() as u64, "block")
        );
        tally.find(FindingKind::Missing, "chain", &text);
    }
    if let Some(block) = first {
        watcher::note(&plant.ledger.notes, block)?;
    }
    Ok(())
}

fn differing_blocks(ledger: &Ledger, (from, to): (u64, u64), events: &[EventAt]) -> Result<BTreeSet<u64>> {
    let Some(compared) = Compared::new(ledger, (from, to), events)? else { return Ok(BTreeSet::new()) };
    let missing = compared.missing.iter().map(|event| event.block);
    Ok(missing.chain(compared.surplus.iter().map(|told| told.block)).chain(compared.other.iter().copied()).collect())
}

fn differences(ledger: &Ledger, blocks: (u64, u64), events: &[EventAt]) -> Result<Vec<(FindingKind, String)>> {
    let Some(compared) = Compared::new(ledger, blocks, events)? else { return Ok(Vec::new()) };
    let mut found = Vec::new();
    for at in &compared.missing {
        let text = format!("{} (event {}) is on the chain, and the ledger missed it", name(&at.event), at.log_index);
        found.push((FindingKind::Missing, text));
    }
    for told in &compared.surplus {
        let text = format!("{} (event {}) is in the ledger, and not on the chain", name(&told.event), told.place);
        found.push((FindingKind::Tampered, text));
    }
    if !compared.other.is_empty() {
        found.push((FindingKind::Tampered, "the ledger has an event of it otherwise than the chain".to_owned()));
    }
    Ok(found)
}

struct Compared<'a> {
    /// On the chain alone.
    missing: Vec<&'a EventAt>,
    /// In the ledger alone.
    surplus: Vec<Told>,
    /// Blocks with an event that both have, but not the same.
    other: Vec<u64>,
}

impl<'a> Compared<'a> {
    /// As far as the watcher has read; `None` if that is before these blocks.
    fn new(ledger: &Ledger, (from, to): (u64, u64), events: &'a [EventAt]) -> Result<Option<Self>> {
        // Asked before the ledger is: what is read up to here is in it.
        let Some((read, _)) = ledger.trail.cursor()?.filter(|(read, _)| *read >= from) else { return Ok(None) };
        let to = to.min(read);
        let missing: Vec<&EventAt> =
            watcher::of(ledger, events)?.into_iter().filter(|event| event.block <= to).collect();
        let on_chain: BTreeMap<(u64, u64), &EventAt> =
            events.iter().map(|event| ((event.block, event.log_index), event)).collect();
        let (mut surplus, mut other) = (Vec::new(), Vec::new());
        for row in ledger.rights.rights_in(from, to)? {
            let Ok(told) = Told::from_row(&ledger.rights, &row) else {
                other.push(row.block);
                continue;
            };
            match on_chain.get(&(row.block, row.place)) {
                None => surplus.push(told),
                Some(at) if !told.is_of(at) => other.push(row.block),
                Some(_) => {}
            }
        }
        Ok(Some(Self { missing, surplus, other }))
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Scrubbed {
    pub records: u64,
    pub bytes: u64,
    pub bad: u64,
}

/// Re-hashes up to `most` verified records after the cursor, and moves it; at the end it starts over.
pub fn scrub_round(plant: &Plant, network: &Network, most: usize) -> Result<Scrubbed> {
    let after = plant.ledger.notes.read(&ScrubbedUpTo {})?.unwrap_or(0);
    let page = plant.ledger.inspection.audit_page(after, Timestamp(0), most)?;
    let mut done = Scrubbed::default();
    let mut bad = Vec::new();
    // An unreadable row is reported by the audit: it has no digest to mark.
    for record in page.records.into_iter().flatten().filter(|record| record.row.state == RecordState::Verified) {
        if let Some(digest) = scrub(plant, network, record, &mut done)? {
            bad.push(digest);
        }
    }
    if !bad.is_empty() {
        plant.ledger.records.advance(&bad, RecordState::Verified, RecordState::Tampered)?;
        plant.observer.tampered(&bad);
        plant.observer.records_changed();
    }
    done.bad = u64::try_from(bad.len()).unwrap_or(u64::MAX);
    plant.ledger.notes.write(&ScrubbedUpTo {}, &page.next.unwrap_or(0))?;
    Ok(done)
}

fn scrub(plant: &Plant, network: &Network, record: AuditedRecord, done: &mut Scrubbed) -> Result<Option<Digest>> {
    let digest = record.row.digest;
    let bench = Bench { plant, network: Some(network), blind: false, deep: true, keys: None };
    let (mut tally, mut piece) = (Tally::default(), [(record, Uploaded::NotAsked)]);
    look(bench, &piece, &mut tally)?;
    if !tally.findings().is_empty() {
        // Its bytes may have been deleted on purpose, or its block replaced, since its row was read.
        if let Some(now) = read_again(plant, &piece)?.pop() {
            piece = [(now, Uploaded::NotAsked)];
        }
        tally = Tally::default();
        look(bench, &piece, &mut tally)?;
    }
    done.records += 1;
    done.bytes += tally.audit.bytes;
    let Some(finding) = tally.findings().first() else { return Ok(None) };
    let text = format!("{}: {}; `authros audit --deep` checks all records", finding.subject, finding.text);
    plant.observer.alert(true, text);
    Ok(Some(digest))
}

// The findings of an audit, as counted and as reported.

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
