//! Messages waiting to be written, oldest first; nothing overtakes, over all topics.

use std::collections::{BTreeMap, HashSet, VecDeque};
use std::time::{Duration, Instant};

use rustdds::bytes::Bytes;

use super::writing::Attempt;

/// The network code keeps written messages for repair and clears them every six seconds: bytes written within that
/// time.
const MOST_KEPT: usize = 512 << 20;
const KEPT_FOR: Duration = Duration::from_secs(7);

pub trait Outlet {
    fn attempt(&mut self, message: &Bytes) -> Attempt;
    /// Whether some subscribers do not acknowledge.
    fn is_unconfirmed(&self) -> bool;
    fn has_caught_up(&self) -> bool;
    /// Whether it no longer waits for its subscribers.
    fn outrun(&mut self) -> &mut bool;
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Taken {
    pub messages: u32,
    /// Of these, not written because a subscriber is behind.
    pub dropped: u32,
    /// Of these, possibly missed by best-effort subscribers, or taken back.
    pub unconfirmed: u32,
}

#[derive(Default)]
pub struct Queue {
    waiting: VecDeque<(u32, Bytes)>,
    /// Writers that are gone, or never were; messages for writers still to come wait.
    gone: HashSet<u32>,
    written: VecDeque<(Instant, usize)>,
    written_bytes: usize,
    pub last_written: Option<Instant>,
}

impl Queue {
    pub fn is_empty(&self) -> bool {
        self.waiting.is_empty()
    }

    pub fn push(&mut self, writer: u32, message: Vec<u8>) {
        self.waiting.push_back((writer, Bytes::from(message)));
    }

    /// Its messages leave the queue unwritten.
    pub fn forget(&mut self, writer: u32) {
        self.gone.insert(writer);
    }

    /// Stops waiting for subscribers that are behind.
    pub fn outrun<O: Outlet>(&self, outlets: &mut BTreeMap<u32, O>) {
        for outlet in outlets.values_mut() {
            *outlet.outrun() = !outlet.has_caught_up();
        }
    }

    pub fn pump<O: Outlet>(&mut self, outlets: &mut BTreeMap<u32, O>, now: Instant) -> Taken {
        self.clear_away(now);
        let mut taken = Taken::default();
        while let Some((writer, message)) = self.waiting.front() {
            let (writer, size) = (*writer, message.len());
            let attempt = match outlets.get_mut(&writer) {
                None if self.gone.contains(&writer) => {
                    taken.unconfirmed += 1;
                    Attempt::Written
                }
                // It is about to be announced.
                None => break,
                Some(_) if self.written_bytes > 0 && self.written_bytes + size > MOST_KEPT => break,
                Some(outlet) => {
                    if *outlet.outrun() && outlet.has_caught_up() {
                        *outlet.outrun() = false;
                    }
                    let attempt = outlet.attempt(message);
                    if attempt == Attempt::Begun || attempt == Attempt::Full && !*outlet.outrun() {
                        break;
                    }
                    if attempt == Attempt::Written {
                        taken.unconfirmed += u32::from(outlet.is_unconfirmed());
                        self.written.push_back((now, size));
                        self.written_bytes += size;
                        self.last_written = Some(now);
                    }
                    attempt
                }
            };
            taken.messages += 1;
            taken.dropped += u32::from(attempt != Attempt::Written);
            self.waiting.pop_front();
        }
        taken
    }

    fn clear_away(&mut self, now: Instant) {
        while let Some((at, size)) = self.written.front().copied()
            && now.saturating_duration_since(at) >= KEPT_FOR
        {
            self.written_bytes -= size;
            self.written.pop_front();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Its capacity in messages.
    #[derive(Default)]
    struct Fake {
        room: usize,
        got: Vec<Bytes>,
        outrun: bool,
    }

    impl Outlet for Fake {
        fn attempt(&mut self, message: &Bytes) -> Attempt {
            if self.room == 0 {
                return Attempt::Full;
            }
            self.room -= 1;
            self.got.push(message.clone());
            Attempt::Written
        }

        fn is_unconfirmed(&self) -> bool {
            false
        }

        fn has_caught_up(&self) -> bool {
            self.room > 0
        }

        fn outrun(&mut self) -> &mut bool {
            &mut self.outrun
        }
    }

    fn queue(messages: &[(u32, u8)]) -> Queue {
        let mut queue = Queue::default();
        messages.iter().for_each(|(writer, byte)| queue.push(*writer, vec![*byte]));
        queue
    }

    fn outlets(rooms: &[usize]) -> BTreeMap<u32, Fake> {
        (1..).zip(rooms.iter().map(|room| Fake { room: *room, ..Fake::default() })).collect()
    }

    #[test]
    fn nothing_overtakes_a_message_that_waits() {
        let (mut queue, mut outlets, now) = (queue(&[(1, 1), (1, 2), (2, 3)]), outlets(&[1, 9]), Instant::now());
        assert_eq!(queue.pump(&mut outlets, now), Taken { messages: 1, dropped: 0, unconfirmed: 0 });
        assert_eq!(queue.pump(&mut outlets, now), Taken::default());
        assert!(outlets[&2].got.is_empty() && !queue.is_empty());
        outlets.get_mut(&1).expect("there").room = 1;
        assert_eq!(queue.pump(&mut outlets, now), Taken { messages: 2, dropped: 0, unconfirmed: 0 });
        assert_eq!((outlets[&1].got.len(), outlets[&2].got.len()), (2, 1));
    }

    #[test]
    fn a_writer_that_is_outrun_loses_messages_until_it_has_caught_up() {
        let (mut queue, mut outlets, now) = (queue(&[(1, 1), (2, 2), (1, 3)]), outlets(&[0, 9]), Instant::now());
        queue.outrun(&mut outlets);
        assert_eq!(queue.pump(&mut outlets, now), Taken { messages: 3, dropped: 2, unconfirmed: 0 });
        outlets.get_mut(&1).expect("there").room = 1;
        queue.push(1, vec![4]);
        queue.push(1, vec![5]);
        assert_eq!(queue.pump(&mut outlets, now), Taken { messages: 1, dropped: 0, unconfirmed: 0 });
        assert!(!queue.is_empty(), "it is waited for again");
    }

    #[test]
    fn what_is_taken_back_is_never_written() {
        let (mut queue, mut outlets, now) = (queue(&[(1, 1), (2, 2), (1, 3)]), outlets(&[9, 9]), Instant::now());
        queue.forget(1);
        outlets.remove(&1);
        assert_eq!(queue.pump(&mut outlets, now), Taken { messages: 3, dropped: 0, unconfirmed: 2 });
        assert_eq!(outlets[&2].got, [Bytes::from_static(&[2])]);
    }

    #[test]
    fn memory_is_bounded_by_what_is_written_within_seconds() {
        let (mut queue, mut outlets, now) = (Queue::default(), outlets(&[9]), Instant::now());
        for _ in 0..3 {
            // Zeros of which no page is touched.
            queue.push(1, vec![0; MOST_KEPT / 2]);
        }
        assert_eq!(queue.pump(&mut outlets, now), Taken { messages: 2, dropped: 0, unconfirmed: 0 });
        assert_eq!(queue.pump(&mut outlets, now + KEPT_FOR / 2), Taken::default());
        assert_eq!(queue.pump(&mut outlets, now + KEPT_FOR), Taken { messages: 1, dropped: 0, unconfirmed: 0 });
    }
}
