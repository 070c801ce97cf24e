//! Sequence numbers of topics: from 1, without gaps, wherever this home assigned them or anchors them; and their times.

use super::report::{FindingKind, Tally};
use super::{Plant, Scope};
use crate::model::clean;
use crate::store::StoreError;

/// The most gaps listed for one topic.
const MOST_HOLES: usize = 5;

/// Searches for missing numbers. A gateway shows this home only the records it may see, so gaps in their numbers are
/// normal.
pub(super) fn compare(plant: &Plant, scope: &Scope, tally: &mut Tally) -> Result<(), StoreError> {
    for sequence in plant.ledger.sequences()? {
        let complete = sequence.keeper.is_none_or(|keeper| scope.accounts.contains(&keeper));
        let lost = sequence.last.saturating_sub(sequence.count);
        // What is missing of a ring fell out of it, or was not asked for.
        if !complete || lost == 0 || sequence.recorder.is_ring() {
            continue;
        }
        tally.gaps += lost;
        let holes = plant.ledger.holes(&sequence, MOST_HOLES)?;
        let words: Vec<String> = holes.iter().take(MOST_HOLES).map(|(from, to)| span(*from, *to)).collect();
        let text = format!(
            "{lost} of the numbers 1 to {} that the key {} gave for {} are missing from the ledger: {}",
            sequence.last,
            sequence.signer,
            sequence.owner,
            words.join(", ")
        );
        tally.find(FindingKind::Gap, &sequence.name, &text);
    }
    for (topic, count) in plant.ledger.backwards()? {
        tally.note(&format!(
            "{count} records of {} are dated earlier than the record before them: the clock was set back, or a \
             recording was imported",
            clean(&topic, 200)
        ));
    }
    Ok(())
}

fn span(from: u64, to: u64) -> String {
    if from == to { from.to_string() } else { format!("{from} to {to}") }
}
