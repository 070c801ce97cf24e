//! The audit of records: rows against proofs and chain, batches against events, sequences without gaps, the audit log's
//! hashes; `deep` also every stored byte and signature. Pages are shared by workers: memory does not grow with the
//! store.

mod batches;
mod records;
mod report;
mod stored;

pub use report::{FindingKind, RecordAudit, RecordFinding};

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::time::Instant;

use tokio::runtime::Handle;

use self::records::{Bench, Uploaded, look, read_again};
use self::report::Tally;
use crate::chain::{ChainError, Event, EventAt};
use crate::columns::Keys;
use crate::directory::Told;
use crate::model::{Address, Digest, ErrorKind, RecordState, Timestamp, counted};
use crate::store::notes::ScrubbedUpTo;
use crate::store::{AuditLog, AuditedRecord, Ledger, StoreError};
use crate::watcher;
use crate::{Network, Plant, audit_head};

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
) -> Result<RecordAudit, StoreError> {
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
fn log_of(plant: &Plant, log: &AuditLog, scope: &Scope, tally: &mut Tally) -> Result<(), StoreError> {
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
fn file_of(plant: &Plant, scope: &Scope, tally: &mut Tally) -> Result<(), StoreError> {
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

fn differing_blocks(ledger: &Ledger, (from, to): (u64, u64), events: &[EventAt]) -> Result<BTreeSet<u64>, StoreError> {
    let Some(compared) = Compared::new(ledger, (from, to), events)? else { return Ok(BTreeSet::new()) };
    let missing = compared.missing.iter().map(|event| event.block);
    Ok(missing.chain(compared.surplus.iter().map(|told| told.block)).chain(compared.other.iter().copied()).collect())
}

fn differences(
    ledger: &Ledger,
    blocks: (u64, u64),
    events: &[EventAt],
) -> Result<Vec<(FindingKind, String)>, StoreError> {
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
    fn new(ledger: &Ledger, (from, to): (u64, u64), events: &'a [EventAt]) -> Result<Option<Self>, StoreError> {
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
pub fn scrub_round(plant: &Plant, network: &Network, most: usize) -> Result<Scrubbed, StoreError> {
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

fn scrub(
    plant: &Plant,
    network: &Network,
    record: AuditedRecord,
    done: &mut Scrubbed,
) -> Result<Option<Digest>, StoreError> {
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
