//! The scrubber: a few records at a time are re-hashed like in a deep audit, from a cursor stored in the ledger;
//! damaged ones become `tampered` and are reported.

use super::records::{Bench, Uploaded, look, read_again};
use super::report::Tally;
use super::{Network, Plant};
use crate::model::{Digest, RecordState, Timestamp};
use crate::store::{AuditedRecord, StoreError};

/// The row after which the next round begins.
const CURSOR: &str = "scrub-cursor";

/// The result of a round.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Scrubbed {
    /// Records re-hashed.
    pub records: u64,
    /// Their bytes.
    pub bytes: u64,
    /// Records that are tampered or missing.
    pub bad: u64,
}

/// Re-hashes up to `most` verified records after the cursor, and moves it; at the end it starts over.
///
/// # Errors
/// Errors of ledger and vault; then the cursor stays.
pub fn scrub_round(plant: &Plant, network: &Network, most: usize) -> Result<Scrubbed, StoreError> {
    let after = plant.ledger.setting(CURSOR)?.and_then(|text| text.parse().ok()).unwrap_or(0);
    let page = plant.ledger.audit_page(after, Timestamp(0), most)?;
    let mut done = Scrubbed::default();
    let mut bad = Vec::new();
    // An unreadable row is reported by the audit: it has no digest to mark.
    for record in page.records.into_iter().flatten().filter(|record| record.row.state == RecordState::Verified) {
        if let Some(digest) = scrub(plant, network, record, &mut done)? {
            bad.push(digest);
        }
    }
    if !bad.is_empty() {
        mark(plant, &bad)?;
    }
    done.bad = u64::try_from(bad.len()).unwrap_or(u64::MAX);
    plant.ledger.put_setting(CURSOR, &page.next.unwrap_or(0).to_string())?;
    Ok(done)
}

fn scrub(
    plant: &Plant,
    network: &Network,
    record: AuditedRecord,
    done: &mut Scrubbed,
) -> Result<Option<Digest>, StoreError> {
    let digest = record.row.digest;
    let bench = Bench { plant, network: Some(network), blind: false, deep: true, headers: true, keys: None };
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
    done.bytes += tally.bytes;
    let Some(finding) = tally.findings().first() else { return Ok(None) };
    plant
        .observer
        .alert(true, format!("{}: {}; `authros audit --deep` checks all records", finding.subject, finding.text));
    Ok(Some(digest))
}

fn mark(plant: &Plant, bad: &[Digest]) -> Result<(), StoreError> {
    plant.ledger.advance(bad, RecordState::Verified, RecordState::Tampered)?;
    plant.observer.tampered(bad);
    plant.observer.records_changed();
    Ok(())
}
