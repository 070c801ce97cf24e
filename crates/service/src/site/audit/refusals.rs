//! What is counted instead of written line by line: refusals per peer, code and minute, and repeated queries.
//!
//! This way a peer that is refused a thousand times a second, or a screen that is redrawn, cannot fill the audit log.

use std::collections::{BTreeMap, HashMap};
use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::model::{Timestamp, clean};

/// The most counters kept; beyond that, refusals are counted under [`OTHERS`].
const MOST: usize = 1024;
/// The most queries remembered; beyond that, each gets a line of its own.
const MOST_QUERIES: usize = 256;
/// The name under which further peers are counted.
pub const OTHERS: &str = "other peers";

const MINUTE: u64 = 60_000_000_000;

/// One counter: the minute since 1970, the peer, and the constant code.
pub type Refusal = (u64, String, String);

/// A query repeated within its minute.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Repeated {
    /// The asking profile.
    pub profile: String,
    /// The query.
    pub query: String,
    /// The number of repetitions.
    pub times: u64,
}

/// The counters of a site.
#[derive(Debug, Default)]
pub struct Refusals {
    counts: Mutex<BTreeMap<Refusal, u64>>,
    asked: Mutex<HashMap<(String, String), (Timestamp, u64)>>,
}

impl Refusals {
    fn counts(&self) -> MutexGuard<'_, BTreeMap<Refusal, u64>> {
        self.counts.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn asked(&self) -> MutexGuard<'_, HashMap<(String, String), (Timestamp, u64)>> {
        self.asked.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Counts a refusal; returns whether it is the first of its counter.
    pub fn add(&self, at: Timestamp, peer: &str, code: &str) -> bool {
        let mut counts = self.counts();
        let (peer, code) = (clean(peer, 100), clean(code, 60));
        let mut key = (at.0 / MINUTE, peer, code);
        if counts.len() >= MOST && !counts.contains_key(&key) {
            OTHERS.clone_into(&mut key.1);
        }
        if counts.len() >= 2 * MOST && !counts.contains_key(&key) {
            // Codes are constants of the program, so this takes many minutes without a ledger.
            "refused".clone_into(&mut key.2);
        }
        let count = counts.entry(key).or_default();
        *count += 1;
        *count == 1
    }

    /// Takes the counters of the minutes that have ended at `now`; all of them if `now` is `None`.
    pub fn take(&self, now: Option<Timestamp>) -> Vec<(Refusal, u64)> {
        let mut counts = self.counts();
        let running = match now {
            Some(now) => counts.split_off(&(now.0 / MINUTE, String::new(), String::new())),
            None => BTreeMap::new(),
        };
        std::mem::replace(&mut *counts, running).into_iter().collect()
    }

    /// Puts back counters that could not be written.
    pub fn put_back(&self, refusals: Vec<(Refusal, u64)>) {
        let mut counts = self.counts();
        for (key, count) in refusals {
            *counts.entry(key).or_default() += count;
        }
    }

    /// Whether a query gets a line of its own: this profile did not ask it within the last minute.
    pub fn is_new_query(&self, at: Timestamp, profile: &str, query: &str) -> bool {
        let mut asked = self.asked();
        let key = (profile.to_owned(), query.to_owned());
        if let Some((_, times)) = asked.get_mut(&key).filter(|(first, _)| at.0.saturating_sub(first.0) < MINUTE) {
            *times += 1;
            return false;
        }
        if asked.len() < MOST_QUERIES {
            // What was counted before is reported by `repeated`, which is called every second.
            asked.entry(key).or_insert((at, 0));
        }
        true
    }

    /// The line of a query could not be written: it does not count as asked.
    pub fn forget_query(&self, profile: &str, query: &str) {
        self.asked().remove(&(profile.to_owned(), query.to_owned()));
    }

    /// Takes the queries whose minute has ended at `now` (all if it is `None`) and that were repeated.
    pub fn repeated(&self, now: Option<Timestamp>) -> Vec<Repeated> {
        let mut asked = self.asked();
        let ended = |first: &Timestamp| now.is_none_or(|now| now.0.saturating_sub(first.0) >= MINUTE);
        let taken: Vec<_> = asked.extract_if(|_, (first, _)| ended(first)).collect();
        let again = taken.into_iter().filter(|(_, (_, times))| *times > 0);
        let mut again: Vec<Repeated> =
            again.map(|((profile, query), (_, times))| Repeated { profile, query, times }).collect();
        again.sort_by(|one, other| (&one.profile, &one.query).cmp(&(&other.profile, &other.query)));
        again
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refusals_are_counted_per_peer_code_and_minute() {
        let refusals = Refusals::default();
        let second = |second: u64| Timestamp::from_seconds(second);
        for at in [60, 61, 119] {
            refusals.add(second(at), "10.0.0.1", "not_granted");
        }
        refusals.add(second(61), "10.0.0.1", "bad_tag");
        refusals.add(second(120), "10.0.0.1", "not_granted");
        assert!(refusals.take(Some(second(119))).is_empty(), "the minute runs");
        let taken = refusals.take(Some(second(120)));
        let told: Vec<_> = taken.iter().map(|((minute, _, code), count)| (*minute, code.as_str(), *count)).collect();
        assert_eq!(told, [(1, "bad_tag", 1), (1, "not_granted", 3)]);
        refusals.put_back(taken);
        assert_eq!(refusals.take(None).len(), 3, "and at the end everything");
        assert!(refusals.take(None).is_empty());
    }

    #[test]
    fn a_crowd_of_peers_takes_bounded_memory_and_none_is_lost() {
        let refusals = Refusals::default();
        for peer in 0..5_000 {
            refusals.add(Timestamp(0), &format!("peer {peer}"), "throttled");
        }
        let taken = refusals.take(None);
        assert_eq!((taken.len(), taken.iter().map(|(_, count)| count).sum::<u64>()), (MOST + 1, 5_000));
        assert!(taken.iter().any(|((_, peer, _), count)| peer == OTHERS && *count == 5_000 - MOST as u64));
    }

    #[test]
    fn an_identical_query_is_a_line_once_a_minute() {
        let refusals = Refusals::default();
        let at = Timestamp::from_seconds;
        assert!(refusals.is_new_query(at(1), "a", "all"));
        assert!(refusals.is_new_query(at(2), "b", "all") && refusals.is_new_query(at(2), "a", "page 2"));
        assert!(!refusals.is_new_query(at(3), "a", "all") && !refusals.is_new_query(at(60), "a", "all"));
        assert!(refusals.repeated(Some(at(60))).is_empty());
        let again = refusals.repeated(Some(at(62)));
        assert_eq!(again, [Repeated { profile: "a".to_owned(), query: "all".to_owned(), times: 2 }]);
        assert!(refusals.is_new_query(at(62), "a", "all"));
        refusals.forget_query("a", "all");
        assert!(refusals.is_new_query(at(62), "a", "all"), "its line was not written");
        for number in 0..1_000 {
            assert!(refusals.is_new_query(at(63), "c", &number.to_string()));
        }
        assert!(refusals.is_new_query(at(63), "c", "999"), "beyond what is remembered each is a line");
    }
}
