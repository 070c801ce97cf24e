//! The last step: re-reads confirmed records from the vault and checks digest and signature.

use std::time::Instant;

use crate::crypto::{Anchor, check};
use crate::model::{Digest, RecordState};
use crate::store::RecordRow;

use super::stages::{Milestone, Stage};
use super::{Network, PipelineError, Plant, proof, signers};

/// Records a round.
const ROUND: usize = 128;

/// Checks up to [`ROUND`] confirmed records; returns how many it decided about.
///
/// # Errors
/// Of vault and ledger; a vault that does not answer decides nothing.
pub fn verify_round(plant: &Plant, network: &Network) -> Result<usize, PipelineError> {
    let begun = Instant::now();
    let rows = plant.ledger.in_state(None, RecordState::Confirmed, ROUND)?;
    let (mut good, mut bad) = (Vec::new(), Vec::new());
    for row in &rows {
        put_back(plant, row)?;
        let verified = is_sound(plant, network, row)?;
        if verified { &mut good } else { &mut bad }.push(row.digest);
    }
    settle(plant, &good, RecordState::Verified)?;
    settle(plant, &bad, RecordState::Tampered)?;
    if let Some(stages) = plant.observer.stages().filter(|_| !rows.is_empty()) {
        stages.spent(Stage::Verify, begun.elapsed());
        stages.reached(Milestone::Verified, rows.iter().map(|row| row.captured_at));
    }
    Ok(rows.len())
}

/// A vault that is only a cache may have forgotten the record; the ledger still has its copy.
fn put_back(plant: &Plant, row: &RecordRow) -> Result<(), PipelineError> {
    if plant.vault.durable() || plant.vault.contains(row.digest)? {
        return Ok(());
    }
    if let Some(copy) = plant.ledger.local_copy(row.digest)? {
        plant.vault.put(&[(row.digest, &copy)])?;
    }
    Ok(())
}

fn is_sound(plant: &Plant, network: &Network, row: &RecordRow) -> Result<bool, PipelineError> {
    let Some(blob) = plant.vault.get(row.digest)? else { return Ok(false) };
    let Some(signer) = signers::key_of(plant, network, row)? else { return Ok(false) };
    let checked = check(plant.provider, &blob, &row.signature, &signer, Anchor::Chain(row.digest));
    let same = checked.is_ok_and(|(header, digest, _)| {
        digest == row.digest && header.owner == row.owner && header.seq == row.seq && network.accepts(&header.domain)
    });
    Ok(same && proof::was_sighted(plant, row)?)
}

fn settle(plant: &Plant, digests: &[Digest], state: RecordState) -> Result<(), PipelineError> {
    if digests.is_empty() {
        return Ok(());
    }
    plant.ledger.advance(digests, RecordState::Confirmed, state)?;
    if state == RecordState::Verified {
        if !plant.vault.durable() {
            plant.ledger.drop_local_copies(digests)?;
        }
        plant.observer.verified(digests);
    } else {
        plant.observer.tampered(digests);
        plant.observer.alert(
            true,
            format!("{} records differ from what was anchored, or are gone from the vault", digests.len()),
        );
    }
    plant.observer.records_changed();
    Ok(())
}
