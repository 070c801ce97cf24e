//! Queues between capture and sealer, one a topic, under one budget of bytes. A message that does not fit goes back to
//! the caller, who counts it. A topic may hold as much as is left for all others, so none starves them.

use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::{ops::Deref, time::Duration};

/// Size in memory, bytes.
pub trait Weighted {
    fn weight(&self) -> usize;
}

#[derive(Debug)]
struct Ring<T> {
    /// Each with its number in all rings.
    items: VecDeque<(u64, T)>,
    /// Bytes of its items, including those taken but not acknowledged.
    held: usize,
}

#[derive(Debug)]
struct Inner<T> {
    rings: HashMap<Arc<str>, Ring<T>>,
    /// Topics with waiting items, in the order of their turns.
    turns: VecDeque<Arc<str>>,
    waiting: usize,
    held: usize,
    /// Items taken and not yet acknowledged.
    in_hand: usize,
    /// The least number among them.
    oldest_in_hand: u64,
    /// Items that ever came.
    came: u64,
    /// Takers that wait; with none, waking would waste a system call.
    takers: usize,
    closed: bool,
}

impl<T> Inner<T> {
    fn append(&mut self, topic: &Arc<str>, item: T, weight: usize) {
        let new = || Ring { items: VecDeque::new(), held: 0 };
        let ring = self.rings.entry(Arc::clone(topic)).or_insert_with(new);
        if ring.items.is_empty() {
            self.turns.push_back(Arc::clone(topic));
        }
        ring.items.push_back((self.came, item));
        self.came += 1;
        ring.held += weight;
        self.held += weight;
        self.waiting += 1;
    }
}

#[derive(Debug)]
pub struct Rings<T> {
    inner: Mutex<Inner<T>>,
    filled: Condvar,
    emptied: Condvar,
    capacity: usize,
}

/// Items taken; their bytes are free again when this is dropped.
#[derive(Debug)]
pub struct Taken<'a, T> {
    rings: &'a Rings<T>,
    items: Vec<T>,
    weights: Vec<(Arc<str>, usize)>,
}

impl<T> Deref for Taken<'_, T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        &self.items
    }
}

impl<T> Drop for Taken<'_, T> {
    fn drop(&mut self) {
        let mut inner = self.rings.inner.lock().unwrap_or_else(PoisonError::into_inner);
        inner.in_hand = inner.in_hand.saturating_sub(self.items.len());
        if inner.in_hand == 0 {
            inner.oldest_in_hand = u64::MAX;
        }
        for (topic, weight) in &self.weights {
            inner.held = inner.held.saturating_sub(*weight);
            let Some(ring) = inner.rings.get_mut(topic) else { continue };
            ring.held = ring.held.saturating_sub(*weight);
            if ring.held == 0 && ring.items.is_empty() {
                inner.rings.remove(topic);
            }
        }
        drop(inner);
        self.rings.emptied.notify_all();
    }
}

impl<T: Weighted> Rings<T> {
    pub fn new(capacity: usize) -> Self {
        let (rings, turns) = (HashMap::new(), VecDeque::new());
        let inner = Inner {
            rings,
            turns,
            waiting: 0,
            held: 0,
            in_hand: 0,
            oldest_in_hand: u64::MAX,
            came: 0,
            takers: 0,
            closed: false,
        };
        Self { inner: Mutex::new(inner), filled: Condvar::new(), emptied: Condvar::new(), capacity }
    }

    fn lock(&self) -> MutexGuard<'_, Inner<T>> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn wake(&self, inner: MutexGuard<'_, Inner<T>>) {
        let waits = inner.takers > 0;
        drop(inner);
        if waits {
            self.filled.notify_one();
        }
    }

    /// Returns `item` if there is no room or the rings are closed.
    pub fn push(&self, topic: &Arc<str>, item: T) -> Result<(), T> {
        let mut guard = self.lock();
        let inner = &mut *guard;
        let weight = item.weight();
        let free = self.capacity.saturating_sub(inner.held);
        let own = inner.rings.get(topic).map_or(0, |ring| ring.held);
        // Half of the budget for one topic alone, a third each for two, and always room for a first message.
        if inner.closed || weight > free || own > 0 && own + weight > free - weight {
            return Err(item);
        }
        inner.append(topic, item, weight);
        self.wake(guard);
        Ok(())
    }

    /// Waits up to `patience` until all rings together hold at most `limit` bytes with `item`, or nothing; else returns
    /// it. Items that can wait leave the rest of the budget to those that cannot.
    pub fn push_within(&self, topic: &Arc<str>, item: T, limit: usize, patience: Duration) -> Result<(), T> {
        let (inner, weight) = (self.lock(), item.weight());
        let full = |inner: &mut Inner<T>| !inner.closed && inner.held > 0 && inner.held + weight > limit;
        let waited = self.emptied.wait_timeout_while(inner, patience, full);
        let mut inner = waited.unwrap_or_else(PoisonError::into_inner).0;
        if inner.closed || full(&mut inner) {
            return Err(item);
        }
        inner.append(topic, item, weight);
        self.wake(inner);
        Ok(())
    }

    /// Takes up to `most` items of together about `weight` bytes, one of each topic in turn, waiting up to `patience`
    /// for the first. Empty if nothing came; `None` if the rings are closed and empty.
    pub fn take(&self, most: usize, weight: usize, patience: Duration) -> Option<Taken<'_, T>> {
        let mut inner = self.lock();
        if inner.waiting == 0 && !inner.closed {
            inner.takers += 1;
            inner = self.filled.wait_timeout(inner, patience).unwrap_or_else(PoisonError::into_inner).0;
            inner.takers = inner.takers.saturating_sub(1);
        }
        if inner.waiting == 0 && inner.closed {
            return None;
        }
        let mut taken = Taken { rings: self, items: Vec::new(), weights: Vec::new() };
        let mut total = 0;
        while taken.items.len() < most && total < weight {
            let Some(topic) = inner.turns.pop_front() else { break };
            let Some(ring) = inner.rings.get_mut(&topic) else { continue };
            let Some((number, item)) = ring.items.pop_front() else { continue };
            let more = !ring.items.is_empty();
            inner.oldest_in_hand = inner.oldest_in_hand.min(number);
            total += item.weight();
            taken.weights.push((Arc::clone(&topic), item.weight()));
            taken.items.push(item);
            if more {
                inner.turns.push_back(topic);
            }
        }
        inner.waiting -= taken.items.len();
        inner.in_hand += taken.items.len();
        drop(inner);
        Some(taken)
    }

    /// Refuses further items; those in the rings can still be taken.
    pub fn close(&self) {
        self.lock().closed = true;
        self.filled.notify_all();
        self.emptied.notify_all();
    }

    pub fn is_closed(&self) -> bool {
        self.lock().closed
    }

    /// Items not acknowledged yet, and the bytes they hold.
    pub fn depth(&self) -> (usize, usize) {
        let inner = self.lock();
        (inner.waiting + inner.in_hand, inner.held)
    }

    /// How many items ever came.
    pub fn came(&self) -> u64 {
        self.lock().came
    }

    /// Whether the first `came` items are all acknowledged.
    pub fn is_past(&self, came: u64) -> bool {
        let inner = self.lock();
        let waiting = inner.rings.values().filter_map(|ring| ring.items.front().map(|(number, _)| *number)).min();
        inner.oldest_in_hand >= came && waiting.is_none_or(|number| number >= came)
    }

    pub fn each_waiting(&self, mut show: impl FnMut(&T)) {
        self.lock().rings.values().flat_map(|ring| &ring.items).for_each(|(_, item)| show(item));
    }

    pub fn capacity(&self) -> usize {
        self.capacity
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    impl Weighted for usize {
        fn weight(&self) -> usize {
            *self
        }
    }

    fn topic(name: &str) -> Arc<str> {
        name.into()
    }

    fn taken(rings: &Rings<usize>, most: usize) -> Vec<usize> {
        rings.take(most, usize::MAX, Duration::ZERO).map(|taken| taken.to_vec()).unwrap_or_default()
    }

    fn taken_within(rings: &Rings<usize>, patience: Duration) -> Vec<usize> {
        rings.take(9, usize::MAX, patience).map(|taken| taken.to_vec()).unwrap_or_default()
    }

    #[test]
    fn a_full_ring_gives_the_newest_back_and_recovers() {
        let (rings, a) = (Rings::new(20), topic("a"));
        assert_eq!((rings.push(&a, 6), rings.push(&a, 5), rings.push(&a, 4)), (Ok(()), Err(5), Ok(())));
        assert_eq!(rings.depth(), (2, 10));
        let hand = rings.take(10, 100, Duration::ZERO).expect("open");
        assert_eq!((&*hand, rings.depth()), (&[6, 4][..], (2, 10)));
        assert_eq!(rings.push(&a, 11), Err(11), "what is in hand still holds its bytes");
        drop(hand);
        assert_eq!(rings.depth(), (0, 0));
        assert_eq!((rings.push(&a, 21), rings.push(&a, 20)), (Err(21), Ok(())), "one alone may fill all");
    }

    #[test]
    fn a_flooding_topic_leaves_room_and_turns_to_the_others() {
        let (rings, flood, calm) = (Rings::new(1000), topic("flood"), topic("calm"));
        let kept = (0..500).filter(|_| rings.push(&flood, 10).is_ok()).count();
        assert_eq!(kept, 50);
        assert!((0..20).all(|_| rings.push(&calm, 10).is_ok()));
        assert!(rings.push(&flood, 10).is_err());
        let hand = rings.take(8, 1000, Duration::ZERO).expect("open");
        let of_calm = hand.weights.iter().filter(|(topic, _)| **topic == *calm).count();
        assert_eq!((hand.len(), of_calm), (8, 4));
    }

    #[test]
    fn what_can_wait_leaves_room_and_is_never_dropped() {
        let (rings, a) = (Rings::new(100), topic("a"));
        assert_eq!(rings.push_within(&a, 30, 20, Duration::ZERO), Ok(()), "alone");
        assert_eq!(rings.push_within(&a, 1, 20, Duration::ZERO), Err(1));
        assert_eq!(rings.push(&topic("live"), 60), Ok(()), "what cannot wait has the rest");
        std::thread::scope(|scope| {
            let waiting = scope.spawn(|| rings.push_within(&a, 2, 20, Duration::from_secs(60)));
            assert_eq!(taken(&rings, 2), [30, 60]);
            assert_eq!(waiting.join().expect("joined"), Ok(()));
        });
        rings.close();
        assert_eq!(rings.push_within(&a, 1, 20, Duration::ZERO), Err(1));
    }

    #[test]
    fn what_came_before_a_moment_is_past_once_it_is_acknowledged() {
        let (rings, a, b) = (Rings::new(100), topic("a"), topic("b"));
        assert!(rings.is_past(rings.came()), "nothing came");
        assert_eq!((rings.push(&a, 1), rings.push(&a, 2), rings.push(&b, 3)), (Ok(()), Ok(()), Ok(())));
        let moment = rings.came();
        assert_eq!((rings.push(&b, 4), moment), (Ok(()), 3));
        let hand = rings.take(3, 100, Duration::ZERO).expect("open");
        assert_eq!(&*hand, &[1, 3, 2][..], "in turns");
        assert!(!rings.is_past(moment), "taken and not acknowledged");
        drop(hand);
        assert!(rings.is_past(moment), "the fourth came later");
        assert!(!rings.is_past(rings.came()));
        assert_eq!(taken(&rings, 9), [4]);
        assert!(rings.is_past(rings.came()));
    }

    #[test]
    fn closed_rings_hand_out_the_rest_and_then_end() {
        let (rings, a) = (Rings::new(10), topic("a"));
        assert_eq!(rings.push(&a, 3), Ok(()));
        rings.close();
        assert_eq!((rings.push(&a, 1), rings.is_closed()), (Err(1), true));
        assert_eq!(taken(&rings, 1), [3]);
        assert!(rings.take(1, 1, Duration::ZERO).is_none());
    }

    #[test]
    fn who_waits_for_an_item_is_woken_by_it() {
        let (rings, a) = (Rings::new(100), topic("a"));
        std::thread::scope(|scope| {
            let taker = scope.spawn(|| taken_within(&rings, Duration::from_secs(600)));
            while rings.lock().takers == 0 {
                std::thread::yield_now();
            }
            assert_eq!(rings.push(&a, 7), Ok(()));
            assert_eq!(taker.join().expect("joined"), [7]);
        });
        assert_eq!(rings.lock().takers, 0);
    }

    proptest! {
        #[test]
        fn order_per_topic_is_kept_and_the_budget_never_exceeded(
            steps in prop::collection::vec((0usize..4, 1usize..40, any::<bool>()), 1..300),
        ) {
            let rings = Rings::new(200);
            let topics: Vec<_> = ["a", "b", "c", "d"].map(topic).into();
            let (mut sent, mut got) = (vec![Vec::new(); 4], vec![Vec::new(); 4]);
            let mut note = |hand: Taken<'_, usize>| {
                for (item, (topic, _)) in hand.iter().zip(&hand.weights) {
                    let index = topics.iter().position(|other| other == topic).unwrap_or(0);
                    got[index].push(*item);
                }
            };
            for (index, weight, take) in steps {
                if rings.push(&topics[index], weight).is_ok() {
                    sent[index].push(weight);
                }
                prop_assert!(rings.depth().1 <= 200);
                if take {
                    note(rings.take(3, 50, Duration::ZERO).expect("open"));
                }
            }
            rings.close();
            while let Some(hand) = rings.take(7, 70, Duration::ZERO) {
                note(hand);
            }
            prop_assert_eq!(sent, got);
            prop_assert_eq!(rings.depth(), (0, 0));
        }
    }
}
