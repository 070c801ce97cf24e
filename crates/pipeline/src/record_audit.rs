//! The audit of records: ledger rows against proofs and chain, batches against the chain's events, sequences without
//! gaps, the audit log's hashes; `deep` also re-hashes every stored ciphertext and checks its signature.
//!
//! Pages are read from the ledger, one snapshot each, and shared by workers: memory does not grow with the store.

mod batches;
mod bound;
mod events;
mod records;
mod report;
mod scrub;
mod sequences;
mod stored;

use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::time::Instant;

use tokio::runtime::Handle;

use crate::model::{Address, ErrorKind, Timestamp};
use crate::store::{AuditLog, StoreError};

pub use report::{FindingKind, RecordAudit, RecordFinding};
pub use scrub::{Scrubbed, scrub_round};

use self::report::Tally;
use super::columns::Keys;
use super::{Network, Plant, audit_head};

/// The scope of an audit.
#[derive(Clone)]
pub struct Scope {
    /// Also every stored byte and every signature.
    pub deep: bool,
    /// Only records captured at or after this time; batches, numbers and the audit log are always checked in full.
    pub since: Timestamp,
    /// Accounts of the home's profiles.
    pub accounts: Vec<Address>,
    /// Keys of the profiles whose keyrings are open: names are compared by their pseudonyms.
    pub keys: Arc<dyn Keys + Send + Sync>,
    /// Counts the records that were given to the threads, which take a few at a time.
    pub looked_at: Arc<AtomicU64>,
}

/// Audits the store. `chain` is what the rows are compared with, or why it cannot be queried (then the rest is done all
/// the same); `None` in a home that never used a chain. Blocks for as long as it takes; call it on a thread that may
/// block and may wait for the runtime.
///
/// # Errors
/// Errors of ledger and vault if they do not answer at all; faults in them are part of the answer.
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
            tally.note("this home was never connected to a chain, so nothing was compared with one");
            None
        }
    };
    let left_out = chain.is_some() && network.is_none();
    batches::compare(plant, network, scope, runtime, &mut tally)?;
    let reading = records::compare(plant, network, left_out, scope, runtime, &mut tally)?;
    sequences::compare(plant, scope, &mut tally)?;
    if let Some(network) = network.filter(|_| scope.deep) {
        run_chain_again(network, runtime, &mut tally);
    }
    log_of(plant, log, scope, &mut tally)?;
    let seconds = begun.elapsed().as_secs_f64();
    let hashed = bound::sm3_rate(plant.provider, reading.threads);
    Ok(tally.report(scope.deep, seconds, reading, hashed))
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
        Ok(lines) => tally.lines = lines,
        Err(fault) => tally.find(FindingKind::Tampered, "audit log", &fault.to_string()),
    }
    for account in &scope.accounts {
        let Some(head) = audit_head::noted(&plant.ledger, *account)? else { continue };
        if let Err(fault) = log.compare(&[head]) {
            tally.find(FindingKind::Tampered, "audit log", &fault.to_string());
        }
    }
    Ok(())
}
