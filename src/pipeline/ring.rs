//! The bounded ring between capture and sealer: memory has a cap, and a full ring drops the
//! newest message and says so to the caller, who counts it.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Something with a size in memory.
pub trait Weighted {
    /// Bytes it holds.
    fn weight(&self) -> usize;
}

#[derive(Debug)]
struct Inner<T> {
    items: VecDeque<T>,
    weight: usize,
    closed: bool,
}

/// A queue bounded by the bytes it holds.
#[derive(Debug)]
pub struct Ring<T> {
    inner: Mutex<Inner<T>>,
    filled: Condvar,
    emptied: Condvar,
    capacity: usize,
}

impl<T: Weighted> Ring<T> {
    /// An empty ring for at most `capacity` bytes.
    pub fn new(capacity: usize) -> Self {
        let inner = Inner { items: VecDeque::new(), weight: 0, closed: false };
        Self { inner: Mutex::new(inner), filled: Condvar::new(), emptied: Condvar::new(), capacity }
    }

    fn lock(&self) -> MutexGuard<'_, Inner<T>> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Appends `item`, or gives it back where the ring is full or closed.
    ///
    /// # Errors
    /// The item itself.
    pub fn push(&self, item: T) -> Result<(), T> {
        let mut inner = self.lock();
        let weight = item.weight();
        if inner.closed || inner.weight + weight > self.capacity {
            return Err(item);
        }
        inner.weight += weight;
        inner.items.push_back(item);
        drop(inner);
        self.filled.notify_one();
        Ok(())
    }

    /// Appends `item` once what lies in the ring leaves room for it below `limit` bytes, or nothing lies in it; waits
    /// up to `patience` for that. So what can wait leaves the rest of the ring to what cannot.
    ///
    /// # Errors
    /// The item itself, where there was no room or the ring is closed.
    pub fn push_within(&self, item: T, limit: usize, patience: Duration) -> Result<(), T> {
        let (inner, weight) = (self.lock(), item.weight());
        let full = |inner: &mut Inner<T>| !inner.closed && inner.weight > 0 && inner.weight + weight > limit;
        let waited = self.emptied.wait_timeout_while(inner, patience, full);
        let (mut inner, _) = waited.unwrap_or_else(PoisonError::into_inner);
        if inner.closed || full(&mut inner) {
            return Err(item);
        }
        inner.weight += weight;
        inner.items.push_back(item);
        drop(inner);
        self.filled.notify_one();
        Ok(())
    }

    /// Whether it takes no further items.
    pub fn is_closed(&self) -> bool {
        self.lock().closed
    }

    /// Takes up to `most` items of together about `weight` bytes, waiting up to `patience` for the
    /// first. An empty answer means that nothing came; `None` that the ring is closed and empty.
    pub fn take(&self, most: usize, weight: usize, patience: Duration) -> Option<Vec<T>> {
        let mut inner = self.lock();
        if inner.items.is_empty() && !inner.closed {
            inner = self.filled.wait_timeout(inner, patience).unwrap_or_else(PoisonError::into_inner).0;
        }
        if inner.items.is_empty() && inner.closed {
            return None;
        }
        let mut taken = Vec::new();
        let mut total = 0;
        while taken.len() < most && total < weight {
            let Some(item) = inner.items.pop_front() else { break };
            total += item.weight();
            inner.weight = inner.weight.saturating_sub(item.weight());
            taken.push(item);
        }
        drop(inner);
        self.emptied.notify_all();
        Some(taken)
    }

    /// Refuses further items; what lies in the ring can still be taken.
    pub fn close(&self) {
        self.lock().closed = true;
        self.filled.notify_all();
        self.emptied.notify_all();
    }

    /// Items and bytes waiting.
    pub fn depth(&self) -> (usize, usize) {
        let inner = self.lock();
        (inner.items.len(), inner.weight)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    impl Weighted for usize {
        fn weight(&self) -> usize {
            *self
        }
    }

    #[test]
    fn full_ring_gives_the_newest_back_and_recovers() {
        let ring = Ring::new(10);
        assert_eq!(ring.push(6), Ok(()));
        assert_eq!(ring.push(5), Err(5));
        assert_eq!(ring.push(4), Ok(()));
        assert_eq!(ring.take(10, 100, Duration::ZERO), Some(vec![6, 4]));
        assert_eq!(ring.depth(), (0, 0));
        assert_eq!(ring.push(10), Ok(()));
    }

    #[test]
    fn what_can_wait_leaves_room_and_is_never_dropped() {
        let ring = Ring::new(10);
        assert_eq!(ring.push_within(7, 5, Duration::ZERO), Ok(()), "alone");
        assert_eq!(ring.push_within(1, 5, Duration::ZERO), Err(1));
        assert_eq!(ring.push(3), Ok(()), "what cannot wait has the rest");
        std::thread::scope(|scope| {
            let waiting = scope.spawn(|| ring.push_within(2, 5, Duration::from_secs(60)));
            assert_eq!(ring.take(2, 100, Duration::ZERO), Some(vec![7, 3]));
            assert_eq!(waiting.join().expect("joined"), Ok(()));
        });
        ring.close();
        assert!(ring.is_closed() && ring.push_within(1, 5, Duration::ZERO) == Err(1));
    }

    #[test]
    fn closed_ring_hands_out_the_rest_and_then_ends() {
        let ring = Ring::new(10);
        assert_eq!(ring.push(3), Ok(()));
        ring.close();
        assert_eq!(ring.push(1), Err(1));
        assert_eq!(ring.take(1, 1, Duration::ZERO), Some(vec![3]));
        assert_eq!(ring.take(1, 1, Duration::ZERO), None);
    }
}
