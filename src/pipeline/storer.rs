//! Brings sealed records from the ledger's local copies into a vault that is not itself durable.

use std::time::{Duration, Instant};

use crate::model::RecordState;

use super::stages::Stage;
use super::{PipelineError, Plant};

/// Records a round.
const ROUND: usize = 64;

/// Moves every `sealed` record into the vault; returns how many were moved.
///
/// # Errors
/// Of vault and ledger; nothing is lost, the local copies stay.
pub fn store_round(plant: &Plant) -> Result<usize, PipelineError> {
    let begun = Instant::now();
    let rows = plant.ledger.in_state(None, RecordState::Sealed, ROUND)?;
    let mut entries = Vec::with_capacity(rows.len());
    for row in &rows {
        if let Some(copy) = plant.ledger.local_copy(row.digest)? {
            entries.push((row.digest, copy));
        }
    }
    let borrowed: Vec<_> = entries.iter().map(|(digest, bytes)| (*digest, bytes.as_slice())).collect();
    plant.vault.put(&borrowed)?;
    let digests: Vec<_> = entries.iter().map(|(digest, _)| *digest).collect();
    plant.ledger.advance(&digests, RecordState::Sealed, RecordState::Stored)?;
    if let Some(stages) = plant.observer.stages().filter(|_| !digests.is_empty()) {
        stages.spent(Stage::Store, begun.elapsed());
    }
    Ok(digests.len())
}

/// Works until `stopped`; waits while nothing is to be done or the vault fails.
pub fn run(plant: &Plant, stopped: &dyn Fn() -> bool, wait: &dyn Fn(Duration), stored: &dyn Fn()) {
    let mut pause = Duration::from_millis(250);
    while !stopped() {
        match store_round(plant) {
            Ok(0) => wait(Duration::from_millis(500)),
            Ok(_) => {
                pause = Duration::from_millis(250);
                plant.observer.records_changed();
                stored();
            }
            Err(error) => {
                plant
                    .observer
                    .alert(true, format!("the vault does not take records, they wait in the ledger: {error}"));
                wait(pause);
                pause = (pause * 2).min(Duration::from_secs(8));
            }
        }
    }
}
