//! Which records are being fetched from some gateway of the fleet now: several tell of the same record, and it is to come
//! once.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::model::{Address, RecorderId, TopicId};

/// Whose records, numbered by whom, of which topic.
pub(super) type Which = (Address, RecorderId, TopicId);

/// Numbers by topic.
type Numbers = BTreeMap<Which, BTreeSet<u64>>;

/// What is being fetched.
#[derive(Debug, Default)]
pub(super) struct Fetching(Mutex<Numbers>);

/// Numbers that one line fetches; nobody else does until this is dropped.
#[derive(Debug)]
pub(super) struct Claim {
    fetching: Arc<Fetching>,
    which: Which,
    /// The numbers, ascending.
    pub numbers: Vec<u64>,
    /// Those that another line is fetching.
    pub elsewhere: Vec<u64>,
}

impl Fetching {
    /// Those of these numbers that nobody is fetching become the caller's.
    pub fn claim(self: &Arc<Self>, which: Which, wanted: impl IntoIterator<Item = u64>) -> Claim {
        let mut all = self.all();
        let busy = all.entry(which).or_default();
        let (numbers, elsewhere): (Vec<u64>, Vec<u64>) = wanted.into_iter().partition(|number| busy.insert(*number));
        if busy.is_empty() {
            all.remove(&which);
        }
        Claim { fetching: Arc::clone(self), which, numbers, elsewhere }
    }

    fn all(&self) -> MutexGuard<'_, Numbers> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        let mut all = self.fetching.all();
        let Some(busy) = all.get_mut(&self.which) else { return };
        for number in &self.numbers {
            busy.remove(number);
        }
        if busy.is_empty() {
            all.remove(&self.which);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WHICH: Which = (Address([1; 20]), RecorderId([2; 16]), TopicId([3; 16]));
    const OTHER: Which = (Address([1; 20]), RecorderId([2; 16]), TopicId([4; 16]));

    #[test]
    fn a_number_is_fetched_by_one_line_until_that_one_is_done() {
        let fetching = Arc::new(Fetching::default());
        let first = fetching.claim(WHICH, 1..=3);
        let second = fetching.claim(WHICH, 2..=5);
        assert_eq!((first.numbers.as_slice(), first.elsewhere.as_slice()), (&[1, 2, 3][..], &[][..]));
        assert_eq!((second.numbers.as_slice(), second.elsewhere.as_slice()), (&[4, 5][..], &[2, 3][..]));
        assert_eq!(fetching.claim(OTHER, [2]).numbers, [2], "of another topic");
        drop(first);
        assert_eq!(fetching.claim(WHICH, 1..=5).numbers, [1, 2, 3]);
        drop(second);
        assert!(fetching.all().is_empty(), "nothing stays behind");
    }
}
