//! Messages on their way, oldest first; nothing overtakes, over all topics. rosrust's own queue silently drops the
//! oldest, so it gets little at a time.

use std::collections::{BTreeMap, VecDeque};

pub trait Outlet {
    /// Passes a message on; returns its number, from 1.
    fn attempt(&mut self, message: Vec<u8>) -> Result<u64, Vec<u8>>;
    /// Number of the last message that left.
    fn left(&self) -> u64;
    fn has_caught_up(&self) -> bool;
    fn is_outrun(&self) -> bool;
    fn outrun(&mut self, is_outrun: bool);
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Taken {
    pub messages: u32,
    /// Of these, not or perhaps not received by a subscriber that read too slowly.
    pub dropped: u32,
}

/// A message taken from the queue.
enum Fate {
    /// Passed on under this number.
    Handed(u32, u64),
    /// Not passed on: its topic is gone.
    Gone,
    /// Not passed on: a subscriber is behind.
    Dropped,
}

#[derive(Default)]
pub struct Queue {
    waiting: VecDeque<(u32, Vec<u8>)>,
    underway: VecDeque<Fate>,
}

impl Queue {
    pub fn is_empty(&self) -> bool {
        self.waiting.is_empty() && self.underway.is_empty()
    }

    pub fn push(&mut self, writer: u32, message: Vec<u8>) {
        self.waiting.push_back((writer, message));
    }

    /// Stops waiting for subscribers that are behind.
    pub fn outrun<O: Outlet>(&self, outlets: &mut BTreeMap<u32, O>) {
        for outlet in outlets.values_mut() {
            outlet.outrun(!outlet.has_caught_up());
        }
    }

    /// Passes on what it can, and counts what left.
    pub fn pump<O: Outlet>(&mut self, outlets: &mut BTreeMap<u32, O>) -> Taken {
        for outlet in outlets.values_mut() {
            if outlet.is_outrun() && outlet.has_caught_up() {
                outlet.outrun(false);
            }
        }
        while let Some((writer, message)) = self.waiting.pop_front() {
            let fate = match outlets.get_mut(&writer) {
                None => Fate::Gone,
                Some(outlet) => match outlet.attempt(message) {
                    Ok(number) => Fate::Handed(writer, number),
                    Err(_) if outlet.is_outrun() => Fate::Dropped,
                    Err(message) => {
                        self.waiting.push_front((writer, message));
                        break;
                    }
                },
            };
            self.underway.push_back(fate);
        }
        self.settle(outlets)
    }

    fn settle<O: Outlet>(&mut self, outlets: &BTreeMap<u32, O>) -> Taken {
        let mut taken = Taken::default();
        while let Some(fate) = self.underway.front() {
            let dropped = match fate {
                Fate::Gone => false,
                Fate::Dropped => true,
                Fate::Handed(writer, number) => match outlets.get(writer) {
                    None => false,
                    Some(outlet) if outlet.left() >= *number => false,
                    // rosrust has it and may still send it.
                    Some(outlet) if outlet.is_outrun() => true,
                    Some(_) => break,
                },
            };
            taken.messages += 1;
            taken.dropped += u32::from(dropped);
            self.underway.pop_front();
        }
        taken
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Has room for a number at a time; they leave when the test says so.
    #[derive(Default)]
    struct Fake {
        room: u64,
        got: Vec<Vec<u8>>,
        left: u64,
        outrun: bool,
    }

    impl Outlet for Fake {
        fn attempt(&mut self, message: Vec<u8>) -> Result<u64, Vec<u8>> {
            if self.got.len() as u64 - self.left >= self.room {
                return Err(message);
            }
            self.got.push(message);
            Ok(self.got.len() as u64)
        }

        fn left(&self) -> u64 {
            self.left
        }

        fn has_caught_up(&self) -> bool {
            self.left == self.got.len() as u64
        }

        fn is_outrun(&self) -> bool {
            self.outrun
        }

        fn outrun(&mut self, is_outrun: bool) {
            self.outrun = is_outrun;
        }
    }

    fn queue(messages: &[(u32, u8)]) -> Queue {
        let mut queue = Queue::default();
        messages.iter().for_each(|(writer, byte)| queue.push(*writer, vec![*byte]));
        queue
    }

    fn outlets(rooms: &[u64]) -> BTreeMap<u32, Fake> {
        (1..).zip(rooms.iter().map(|room| Fake { room: *room, ..Fake::default() })).collect()
    }

    fn leaves(outlets: &mut BTreeMap<u32, Fake>, writer: u32) {
        let outlet = outlets.get_mut(&writer).expect("there");
        outlet.left = outlet.got.len() as u64;
    }

    #[test]
    fn a_message_is_confirmed_when_it_has_left_and_nothing_overtakes() {
        let (mut queue, mut outlets) = (queue(&[(1, 1), (1, 2), (2, 3)]), outlets(&[1, 9]));
        assert_eq!(queue.pump(&mut outlets), Taken::default());
        assert_eq!((outlets[&1].got.len(), outlets[&2].got.len()), (1, 0));
        leaves(&mut outlets, 1);
        assert_eq!(queue.pump(&mut outlets), Taken { messages: 1, dropped: 0 });
        assert_eq!((outlets[&1].got.len(), outlets[&2].got.len()), (2, 1));
        leaves(&mut outlets, 2);
        assert_eq!(queue.pump(&mut outlets), Taken::default(), "the one before it has not left");
        leaves(&mut outlets, 1);
        assert_eq!(queue.pump(&mut outlets), Taken { messages: 2, dropped: 0 });
        assert!(queue.is_empty());
    }

    #[test]
    fn a_slow_reader_loses_messages_until_it_has_caught_up() {
        let (mut queue, mut outlets) = (queue(&[(1, 1), (1, 2), (2, 3), (1, 4)]), outlets(&[1, 9]));
        assert_eq!(queue.pump(&mut outlets), Taken::default());
        queue.outrun(&mut outlets);
        // The first may be sent yet, which nobody can say.
        assert_eq!(queue.pump(&mut outlets), Taken { messages: 2, dropped: 2 });
        leaves(&mut outlets, 2);
        assert_eq!(queue.pump(&mut outlets), Taken { messages: 2, dropped: 1 });
        leaves(&mut outlets, 1);
        queue.push(1, vec![5]);
        queue.push(1, vec![6]);
        assert_eq!(queue.pump(&mut outlets), Taken::default());
        assert!(!queue.is_empty() && outlets[&1].got == [[1], [5]], "it is waited for again");
    }

    #[test]
    fn what_is_taken_back_is_never_handed_on() {
        let (mut queue, mut outlets) = (queue(&[(1, 1), (1, 2), (2, 3)]), outlets(&[1, 9]));
        queue.pump(&mut outlets);
        outlets.remove(&1);
        assert_eq!(queue.pump(&mut outlets), Taken { messages: 2, dropped: 0 });
        assert_eq!(outlets[&2].got, [[3]]);
    }
}
