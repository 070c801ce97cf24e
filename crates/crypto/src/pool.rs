//! Works on several records at once. Helper threads are limited for the whole process: sealer, verifier and gateway
//! together never have more of them than there are cores.

use std::panic::resume_unwind;
use std::sync::LazyLock;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread::{Builder, available_parallelism, scope};

const MOST: usize = 7;
/// Work that outweighs the start of a helper several times over, nanoseconds.
const WORTH: usize = 200_000;
/// The approximate cost of a signature or its verification, nanoseconds (`authros-bench sm2`: 20 to 50 microseconds).
const PER_RECORD: usize = 35_000;
/// The approximate cost of a byte, nanoseconds: almost all of it SM3.
const PER_BYTE: usize = 4;

/// The most helpers: one for each core but the caller's.
static PLACES: LazyLock<usize> = LazyLock::new(|| available_parallelism().map_or(0, |cores| cores.get() - 1).min(MOST));
static TAKEN: AtomicUsize = AtomicUsize::new(0);

struct Places(usize);

impl Places {
    fn take(wanted: usize) -> Self {
        let mut found = 0;
        let taken = TAKEN.fetch_update(Ordering::AcqRel, Ordering::Acquire, |taken| {
            found = wanted.min(PLACES.saturating_sub(taken));
            (found > 0).then_some(taken + found)
        });
        Self(taken.map_or(0, |_| found))
    }
}

impl Drop for Places {
    fn drop(&mut self) {
        TAKEN.fetch_sub(self.0, Ordering::AcqRel);
    }
}

/// How many helpers are worthwhile for this many records and bytes: none for a small job.
pub fn helpers_for(records: usize, bytes: usize) -> usize {
    let work = records.saturating_mul(PER_RECORD).saturating_add(bytes.saturating_mul(PER_BYTE));
    (work / WORTH).min(records).saturating_sub(1)
}

/// Runs `work` on each item and returns the results in order. The caller works, together with up to `helpers` threads,
/// fewer if other callers have them. A panic in `work` is passed to the caller once all threads are done.
pub fn each<T: Sync, R: Send>(items: &[T], helpers: usize, work: impl Fn(&T) -> R + Sync) -> Vec<R> {
    let places = Places::take(helpers.min(items.len().saturating_sub(1)));
    each_with(items, places.0, work)
}

fn each_with<T: Sync, R: Send>(items: &[T], helpers: usize, work: impl Fn(&T) -> R + Sync) -> Vec<R> {
    if helpers == 0 {
        return items.iter().map(work).collect();
    }
    let next = AtomicUsize::new(0);
    let share = || {
        let mut done = Vec::new();
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            let Some(item) = items.get(index) else { return done };
            done.push((index, work(item)));
        }
    };
    let mut done = scope(|scope| {
        // If a thread cannot be started, the others do its share.
        let start = |_| Builder::new().name("records".to_owned()).spawn_scoped(scope, share).ok();
        let helpers: Vec<_> = (0..helpers).filter_map(start).collect();
        let mut done = share();
        for helper in helpers {
            done.extend(helper.join().unwrap_or_else(|panic| resume_unwind(panic)));
        }
        done
    });
    done.sort_unstable_by_key(|(index, _)| *index);
    done.into_iter().map(|(_, result)| result).collect()
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;
    use std::panic::{AssertUnwindSafe, catch_unwind};
    use std::sync::{Barrier, Mutex};

    use super::*;

    #[test]
    fn results_stand_in_the_order_of_the_items() {
        let items: Vec<u64> = (0..500).collect();
        let squares: Vec<u64> = items.iter().map(|item| item * item).collect();
        for helpers in [0, 1, 3, 7] {
            assert_eq!(each_with(&items, helpers, |item| item * item), squares, "{helpers} helpers");
            assert_eq!(each(&items, helpers, |item| item * item), squares, "{helpers} helpers wanted");
        }
        assert!(each(&[] as &[u64], 3, |item| *item).is_empty());
    }

    #[test]
    fn helpers_work_at_the_same_time_as_the_caller() {
        // Nobody passes until three have arrived.
        let (barrier, threads) = (Barrier::new(3), Mutex::new(HashSet::new()));
        each_with(&[1, 2, 3], 2, |_| {
            threads.lock().expect("not poisoned").insert(std::thread::current().id());
            barrier.wait();
        });
        assert_eq!(threads.into_inner().expect("not poisoned").len(), 3);
    }

    #[test]
    fn a_panic_is_the_callers_and_places_are_free_again() {
        for bad in 0..20 {
            let work = |item: &u32| assert_ne!(*item, bad, "the bad one");
            let items: Vec<u32> = (0..20).collect();
            assert!(catch_unwind(AssertUnwindSafe(|| each_with(&items, 3, work))).is_err());
            assert!(catch_unwind(AssertUnwindSafe(|| each(&items, 3, work))).is_err());
        }
        // Other tests may hold some of them now, but one lost in a panic would be lost forever.
        let all_free = || TAKEN.load(Ordering::Acquire) == 0;
        let deadline = std::time::Instant::now() + std::time::Duration::from_secs(60);
        while !all_free() && std::time::Instant::now() < deadline {
            std::thread::yield_now();
        }
        assert!(all_free());
    }

    #[test]
    fn small_work_is_the_callers_alone() {
        assert_eq!((helpers_for(0, 0), helpers_for(1, 1 << 30), helpers_for(2, 2048)), (0, 0, 0));
        assert_eq!(helpers_for(2, 120_000), 1, "two pictures");
        assert!(helpers_for(256, 256 * 1024) > MOST);
    }
}
