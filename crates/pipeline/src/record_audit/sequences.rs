//! Sequence numbers of topics: from 1, without gaps, wherever this home assigned them or anchors them; and their times.

use super::report::{FindingKind, Tally};
use super::{Plant, Scope};
use crate::model::clean;
use crate::store::StoreError;

/// The most gaps listed for one topic.
const MOST_HOLES: usize = 5;

/// Searches for missing numbers. What others numbered comes here as it is allowed and as it arrives: a gateway shows a
/// reader only what it may see, and of a robot's records some may be on their way or at another gateway.
pub(super) fn compare(plant: &Plant, scope: &Scope, tally: &mut Tally) -> Result<(), StoreError> {
    let mut elsewhere = Vec::new();
    for sequence in plant.ledger.sequences()? {
        let lost = sequence.last.saturating_sub(sequence.count);
        // What is missing of a ring fell out of it, or was not asked for.
        if lost == 0 || sequence.recorder.is_ring() {
            continue;
        }
        if let Some(keeper) = sequence.keeper {
            if scope.accounts.contains(&keeper) {
                elsewhere.push(format!("{lost} of {} by the key {}", sequence.name, sequence.signer));
            }
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
    if !elsewhere.is_empty() {
        let more = elsewhere.len().saturating_sub(MOST_HOLES);
        let more = if more > 0 { format!(" and of {more} more topics") } else { String::new() };
        elsewhere.truncate(MOST_HOLES);
        tally.note(&format!(
            "numbers that robots gave are not here: {}{more}; they are on their way, at another gateway, or held back at \
             the robot, whose recorder states what it gave",
            elsewhere.join(", ")
        ));
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
