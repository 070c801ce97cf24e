//! Whether records that should be in the vault and have no local copy are there. Missing ones become `tampered`, like
//! those found by the scrubber, and ones that are back continue.

use crate::crypto::fault;
use crate::model::{Digest, RecordState, Timestamp};
use crate::pipeline::{PipelineError, Plant};
use crate::store::{AuditedRecord, RecordRow};

/// Records asked for at once.
const ROUND: usize = 256;

/// The result of checking all verified records without a local copy.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Missing {
    /// Missing records, including those known before.
    pub gone: u64,
    /// Of these, those not known before.
    pub newly: u64,
    /// Records that were missing or altered and are intact again.
    pub back: u64,
}

/// Checks for every verified record whose bytes only the vault has.
///
/// # Errors
/// Errors of ledger and vault.
pub fn look_for_all(plant: &Plant, stopped: &dyn Fn() -> bool) -> Result<Missing, PipelineError> {
    let (mut found, mut after) = (Missing::default(), Some(0));
    while let Some(from) = after.filter(|_| !stopped()) {
        let page = plant.ledger.audit_page(from, Timestamp(0), ROUND)?;
        after = page.next;
        let rows: Vec<RecordRow> =
            page.records.into_iter().flatten().filter(depends_on_vault).map(|one| one.row).collect();
        look_for(plant, &rows, &mut found)?;
    }
    Ok(found)
}

/// Whether only the vault can have its bytes, or they were once found wrong there. A robot has handed what is in no
/// block over to its gateway.
fn depends_on_vault(record: &AuditedRecord) -> bool {
    let settled = match record.row.state {
        RecordState::Verified => !record.has_copy,
        state => state == RecordState::Tampered,
    };
    settled && record.row.block.is_some() && record.row.deleted_at.is_none()
}

fn look_for(plant: &Plant, rows: &[RecordRow], found: &mut Missing) -> Result<(), PipelineError> {
    let digests: Vec<Digest> = rows.iter().map(|row| row.digest).collect();
    let (mut lost, mut back) = (Vec::new(), Vec::new());
    for (row, there) in rows.iter().zip(plant.vault.contains_many(&digests)?) {
        match row.state {
            RecordState::Verified if !there && is_gone(plant, row.digest)? => lost.push(row.digest),
            RecordState::Tampered if !there => found.gone += u64::from(plant.ledger.local_copy(row.digest)?.is_none()),
            RecordState::Tampered if is_right(plant, row.digest)? => back.push(row.digest),
            _ => {}
        }
    }
    if !lost.is_empty() {
        let marked = plant.ledger.advance(&lost, RecordState::Verified, RecordState::Tampered)?;
        fault::point("missing");
        (found.gone, found.newly) = (found.gone + marked, found.newly + marked);
        plant.observer.tampered(&lost);
        plant.observer.records_changed();
    }
    if !back.is_empty() {
        found.back += plant.ledger.heal(&back)?;
        plant.observer.records_changed();
    }
    Ok(())
}

/// Whether it is still missing when checked again: retention may have deleted it since its row was read.
fn is_gone(plant: &Plant, digest: Digest) -> Result<bool, PipelineError> {
    let now = plant.ledger.record(digest)?;
    let kept = now.is_some_and(|row| row.state == RecordState::Verified && row.deleted_at.is_none());
    Ok(kept
        && plant.ledger.retained(digest)?.is_none()
        && plant.ledger.local_copy(digest)?.is_none()
        && !plant.vault.contains(digest)?)
}

fn is_right(plant: &Plant, digest: Digest) -> Result<bool, PipelineError> {
    let bytes = plant.vault.get(digest)?;
    Ok(bytes.is_some_and(|bytes| plant.provider.sm3(&[&bytes]) == digest.0))
}
