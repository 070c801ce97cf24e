//! What became of acknowledged records, by what the gateways list to the records' owners over the protocol.

use std::collections::{HashMap, HashSet};

use super::world::World;
use authros_gateway::{Entry, Standing};
use authros_model::Digest;
use authros_service::Failure;

/// The outcome, of all parts so far of one fleet.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Reckoning {
    /// Acknowledged, and verified at no gateway.
    pub lost: u64,
    /// Copies that acknowledged records should have and do not.
    pub lacking: u64,
    /// In a list twice: the same record, or another one with its number.
    pub doubled: u64,
}

/// Lists all records of all owners at all gateways, so many of which are to have each record.
///
/// # Errors
/// If a gateway does not answer.
pub(super) async fn reckon(world: &World, acknowledged: &HashSet<Digest>, copies: usize) -> Result<Reckoning, Failure> {
    let (mut found, mut doubled) = (HashMap::new(), 0);
    for place in 0..world.scene.places.len() {
        for owner in &world.owners {
            doubled += noted(&owner.list(&world.scene, place).await?, &mut found);
        }
    }
    Ok(judged(acknowledged, &found, copies as u64, doubled))
}

/// Counts the gateways that have each record; returns how many entries of a list are there twice.
fn noted(list: &[Entry], found: &mut HashMap<Digest, u64>) -> u64 {
    let (mut digests, mut numbers, mut doubled) = (HashSet::new(), HashSet::new(), 0);
    for entry in list {
        let first = digests.insert(entry.digest);
        if !(numbers.insert((entry.recorder.0, entry.topic_id.0, entry.seq)) && first) {
            doubled += 1;
        } else if entry.standing == Standing::Verified {
            *found.entry(entry.digest).or_default() += 1;
        }
    }
    doubled
}

fn judged(acknowledged: &HashSet<Digest>, found: &HashMap<Digest, u64>, copies: u64, doubled: u64) -> Reckoning {
    let mut reckoning = Reckoning { doubled, ..Reckoning::default() };
    for digest in acknowledged {
        let at = found.get(digest).copied().unwrap_or(0);
        reckoning.lost += u64::from(at == 0);
        reckoning.lacking += copies.saturating_sub(at);
    }
    reckoning
}

#[cfg(test)]
mod tests {
    use super::*;
    use authros_model::{Address, RecordKind, RecorderId, Timestamp, TopicId};

    fn entry(number: u8, seq: u64, standing: Standing) -> Entry {
        Entry {
            digest: Digest([number; 32]),
            owner: Address([1; 20]),
            recorder: RecorderId([2; 16]),
            seq,
            topic_id: TopicId([3; 16]),
            epoch: 1,
            captured_at: Timestamp(4),
            length: 5,
            kind: RecordKind::Data,
            standing,
        }
    }

    #[test]
    fn what_was_acknowledged_is_looked_for_in_every_list() {
        let acknowledged: HashSet<Digest> = [1, 2, 3, 4].map(|number| Digest([number; 32])).into();
        let mut found = HashMap::new();
        let here = [entry(1, 1, Standing::Verified), entry(2, 2, Standing::Verified), entry(3, 3, Standing::Anchored)];
        // The first one again, and another record with the number of the second.
        let there = [here[0], here[0], here[1], entry(9, 2, Standing::Verified)];
        assert_eq!((noted(&here, &mut found), noted(&there, &mut found)), (0, 2));
        // 3 is not verified anywhere, 4 is nowhere.
        let expected = Reckoning { lost: 2, lacking: 4, doubled: 2 };
        assert_eq!(judged(&acknowledged, &found, 2, 2), expected);
        assert_eq!(judged(&acknowledged, &found, 1, 0), Reckoning { lost: 2, lacking: 2, doubled: 0 });
    }
}
