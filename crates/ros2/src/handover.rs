//! Moves each writer's messages from one participant of ours to its successor, none lost, doubled or out of order. The
//! former one brings a writer's messages until the successor shows that it has the next; from then on the successor
//! alone.

use std::collections::{HashMap, VecDeque};

use crate::graph::Id;
use crate::reading::Taken;

/// Bytes of messages that wait for those before them from the former one.
const MOST_HELD: usize = 32 << 20;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Bringer {
    /// No other participant of ours reads.
    Only,
    Former,
    Successor,
}

#[derive(Default)]
struct Line {
    /// Numbers up to here were passed on before the present bringer's turn; the first message of a writer is 1.
    floor: i64,
    /// The highest number passed on.
    last: i64,
    is_heard: bool,
    is_handed: bool,
    /// The successor's messages beyond a gap.
    held: VecDeque<Taken>,
}

impl Line {
    fn pass(&mut self, sample: Taken, into: &mut Vec<Taken>) {
        self.last = self.last.max(sample.number);
        into.push(sample);
    }

    /// The successor has a message already passed on, or the next one: then it will have all that follow.
    fn is_reached(&self, number: i64) -> bool {
        number <= self.last.saturating_add(1)
    }

    fn hand_over(&mut self, held: &mut usize, into: &mut Vec<Taken>) {
        (self.is_handed, self.floor) = (true, self.last);
        for sample in std::mem::take(&mut self.held) {
            *held -= sample.bytes.len();
            if sample.number > self.floor {
                self.pass(sample, into);
            }
        }
    }
}

#[derive(Default)]
pub struct Lines {
    by_writer: HashMap<Id, Line>,
    held: usize,
}

impl Lines {
    /// Appends to `into`, in order, the messages to pass on now.
    pub fn follow(&mut self, sample: Taken, bringer: Bringer, into: &mut Vec<Taken>) {
        let line = self.by_writer.entry(sample.writer).or_default();
        match bringer {
            Bringer::Former if line.is_handed => {}
            Bringer::Successor if !line.is_handed => {
                let reaches = line.is_reached(sample.number) || self.held + sample.bytes.len() > MOST_HELD;
                if sample.number > line.last {
                    self.held += sample.bytes.len();
                    line.held.push_back(sample);
                }
                if reaches {
                    line.hand_over(&mut self.held, into);
                }
            }
            _ if sample.number <= line.floor => {}
            _ => {
                line.is_heard |= bringer == Bringer::Former;
                line.pass(sample, into);
                if line.held.front().is_some_and(|first| line.is_reached(first.number)) {
                    line.hand_over(&mut self.held, into);
                }
            }
        }
    }

    /// Whether the successor brings the messages of every writer that the former one has heard since.
    pub fn are_handed_over(&self) -> bool {
        self.by_writer.values().all(|line| line.is_handed || !line.is_heard)
    }

    pub fn end(&mut self, into: &mut Vec<Taken>) {
        for line in self.by_writer.values_mut() {
            if !line.is_handed {
                line.hand_over(&mut self.held, into);
            }
            (line.is_handed, line.is_heard) = (false, false);
        }
    }

    /// Forgets writers that are gone, or no longer read.
    pub fn keep(&mut self, is_read: impl Fn(&Id) -> bool) {
        self.by_writer.retain(|id, line| !line.held.is_empty() || is_read(id));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use Bringer::{Former, Only, Successor};

    /// What is passed on of one writer's messages, as its participants bring them.
    fn passed(brought: &[(Bringer, i64)]) -> (Vec<i64>, Lines) {
        let (mut lines, mut passed) = (Lines::default(), Vec::new());
        for (bringer, number) in brought {
            lines.follow(sample(*number, 1), *bringer, &mut passed);
        }
        (passed.iter().map(|sample| sample.number).collect(), lines)
    }

    fn sample(number: i64, size: usize) -> Taken {
        Taken { writer: [7; 16], number, sent: None, arrived: 0, bytes: vec![0; size] }
    }

    #[test]
    fn however_two_participants_take_turns_each_message_is_passed_on_once_and_in_order() {
        // The former one brings 1 to 5; the successor comes to know the writer before any of the messages 1 to 6, and
        // brings 8.
        for first in 1..=6 {
            let (former, successor): (Vec<i64>, Vec<i64>) = ((1..=5).collect(), (first..=8).collect());
            let steps = former.len() + successor.len();
            for order in 0..1_u32 << steps {
                if usize::try_from(order.count_ones()) != Ok(successor.len()) {
                    continue;
                }
                let (mut former, mut successor) = (former.iter(), successor.iter());
                let brought: Vec<_> = (0..steps)
                    .filter_map(|step| match (order >> step) & 1 {
                        1 => Some((Successor, *successor.next()?)),
                        _ => Some((Former, *former.next()?)),
                    })
                    .collect();
                let (numbers, lines) = passed(&brought);
                assert_eq!(numbers, (1..=8).collect::<Vec<_>>(), "{brought:?}");
                assert!(lines.are_handed_over(), "{brought:?}");
            }
        }
    }

    #[test]
    fn history_that_a_successor_is_sent_again_is_passed_over_as_long_as_it_reads() {
        let brought = [(Only, 4), (Only, 5), (Successor, 4), (Successor, 5), (Former, 6), (Successor, 6)];
        let (numbers, mut lines) = passed(&brought);
        assert_eq!(numbers, [4, 5, 6]);
        let mut after = Vec::new();
        lines.end(&mut after);
        for number in [5, 7] {
            lines.follow(sample(number, 1), Only, &mut after);
        }
        assert_eq!(after.iter().map(|sample| sample.number).collect::<Vec<_>>(), [7]);
        // Read anew, it is wanted again.
        lines.keep(|_| false);
        lines.follow(sample(4, 1), Only, &mut after);
        assert_eq!(after.len(), 2);
    }

    #[test]
    fn holes_of_a_writer_that_repeats_nothing_hold_nobody_up() {
        let (numbers, _) =
            passed(&[(Former, 2), (Former, 4), (Successor, 3), (Successor, 6), (Former, 5), (Successor, 8)]);
        assert_eq!(numbers, [2, 4, 6, 8], "from 3 on the successor's alone");
    }

    #[test]
    fn what_waits_beyond_a_gap_is_bounded_by_bytes_and_by_the_end() {
        let gap = [(Former, 1), (Successor, 5), (Successor, 6)];
        let (numbers, mut lines) = passed(&gap);
        assert_eq!((numbers, lines.are_handed_over()), (vec![1], false));
        let mut after = Vec::new();
        lines.keep(|_| false);
        lines.end(&mut after);
        assert_eq!(after.len(), 2, "also of a writer that is gone");

        let (_, mut lines) = passed(&gap);
        lines.follow(sample(7, MOST_HELD), Successor, &mut after);
        assert_eq!(after.len(), 5);
        assert!(lines.are_handed_over());
    }
}
