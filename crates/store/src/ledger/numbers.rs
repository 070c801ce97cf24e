//! Which numbers of an owner's topics are here, by recorder: what the lists of gateways are compared with.

use std::collections::BTreeMap;

use rusqlite::params;

use super::Ledger;
use super::rows::{LEARNED_NAME, TOPIC_NAME, state, unsigned};
use crate::model::{Address, Digest, Ranges, RecordState, RecorderId, Spans, TopicId};
use crate::store::StoreError;

/// The numbers of one topic that one recorder gave, as far as this ledger knows them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HeldNumbers {
    /// Who gave the numbers.
    pub recorder: RecorderId,
    /// Pseudonym of the topic.
    pub topic_id: TopicId,
    /// Its name, or the pseudonym in its place.
    pub topic: String,
    /// Whether they were recorded here, and not fetched from somewhere.
    pub is_own: bool,
    /// All of them.
    pub known: Ranges,
    /// Those with their bytes, sound and not quarantined.
    pub held: Ranges,
    /// Of those, the verified ones.
    pub verified: Ranges,
    /// Those whose bytes were deleted.
    pub deleted: Vec<(u64, Digest)>,
    /// The lowest number of each epoch.
    pub epochs: BTreeMap<u64, u64>,
}

impl Ledger {
    /// The numbers of an owner's topics. Reads all of its rows, in their order.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn numbers(&self, owner: Address) -> Result<Vec<HeldNumbers>, StoreError> {
        self.read(|connection| {
            let mut topics = connection.prepare_cached(&format!(
                "SELECT t.key, r.id, t.topic_id, {TOPIC_NAME}, t.keeper IS NULL
                 FROM topics t JOIN recorders r ON r.key = t.recorder {LEARNED_NAME} WHERE t.owner = ?1 ORDER BY t.key"
            ))?;
            let topics = topics.query_map(params![owner.0], |row| {
                let (recorder, topic_id) = (RecorderId(row.get(1)?), TopicId(row.get(2)?));
                let numbers = HeldNumbers {
                    recorder,
                    topic_id,
                    topic: row.get(3)?,
                    is_own: row.get(4)?,
                    known: Ranges::default(),
                    held: Ranges::default(),
                    verified: Ranges::default(),
                    deleted: Vec::new(),
                    epochs: BTreeMap::new(),
                };
                Ok((row.get::<_, i64>(0)?, numbers))
            })?;
            let mut statement = connection.prepare_cached(
                "SELECT seq, state, epoch, deleted_at IS NOT NULL, digest FROM records WHERE topic = ?1 ORDER BY seq",
            )?;
            let mut found = Vec::new();
            for topic in topics {
                let (key, mut numbers) = topic?;
                let (mut known, mut held, mut verified) = (Spans::default(), Spans::default(), Spans::default());
                let mut rows = statement.query(params![key])?;
                while let Some(row) = rows.next()? {
                    let (seq, state, epoch) = (unsigned(row, 0)?, state(row, 1)?, unsigned(row, 2)?);
                    known.add(seq);
                    numbers.epochs.entry(epoch).or_insert(seq);
                    if row.get(3)? {
                        numbers.deleted.push((seq, Digest(row.get(4)?)));
                    } else if is_sound(state) {
                        held.add(seq);
                        if state == RecordState::Verified {
                            verified.add(seq);
                        }
                    }
                }
                (numbers.known, numbers.held, numbers.verified) = (known.ranges(), held.ranges(), verified.ranges());
                found.push(numbers);
            }
            Ok(found)
        })
    }
}

fn is_sound(state: RecordState) -> bool {
    !matches!(state, RecordState::Captured | RecordState::Quarantined | RecordState::Dropped | RecordState::Tampered)
}

#[cfg(test)]
mod tests {
    use super::super::tests::numbered;
    use super::*;
    use crate::store::{Foreign, NewRecord};

    const THERE: RecorderId = RecorderId([7; 16]);

    fn foreign(number: u8) -> NewRecord {
        NewRecord { foreign: Some(Foreign { recorder: THERE, keeper: Address([9; 20]) }), ..numbered(number) }
    }

    #[test]
    fn numbers_are_told_by_recorder_and_topic_with_what_became_of_them() {
        let home = tempfile::tempdir().expect("a folder");
        let ledger = Ledger::open(&home.path().join("ledger.db")).expect("opens");
        let quarantined = NewRecord { state: RecordState::Quarantined, ..numbered(3) };
        let later = NewRecord { epoch: 4, digest: Digest([99; 32]), ..foreign(6) };
        let own = [numbered(1), numbered(2), quarantined];
        let fetched = [(10, 1), (11, 2), (13, 4)].map(|(digest, seq)| NewRecord {
            digest: Digest([digest; 32]),
            seq,
            ..foreign(digest)
        });
        ledger.append([own.to_vec(), fetched.to_vec(), vec![later]].concat()).expect("acknowledged");
        ledger.deleted(&[Digest([11; 32])]).expect("noted");
        let found = ledger.numbers(Address([1; 20])).expect("read");
        let told: Vec<_> =
            found.iter().map(|one| (one.recorder, one.is_own, one.known.clone(), one.held.clone())).collect();
        let expected = [
            (ledger.recorder(), true, Ranges::of(vec![1, 2, 3]), Ranges::of(vec![1, 2])),
            (THERE, false, Ranges::of(vec![1, 2, 4, 6]), Ranges::of(vec![1, 4, 6])),
        ];
        assert_eq!(told, expected);
        assert!(found.iter().all(|one| one.verified.is_empty() && one.topic == "/a"), "{found:?}");
        let fetched = found.last().expect("two");
        assert_eq!((&fetched.deleted[..], &fetched.epochs), (&[(2, Digest([11; 32]))][..], &[(1, 1), (4, 6)].into()));
        assert_eq!(ledger.numbers(Address([2; 20])), Ok(Vec::new()));
    }
}
