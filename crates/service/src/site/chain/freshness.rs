//! How fresh this site's view of the chain is: whether what it has read is all there is. Two things are asked. The node
//! named the newest block that was read a moment ago; and where the chain owes a block now and then, it has come. The
//! first notices a node that is away, the second one that is cut off from the others and does not know it.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use crate::chain::{BlockRef, MEASURED};

/// How long a view holds after the node was asked, and how long after it was due a block may come.
pub const GRACE: Duration = Duration::from_secs(2);

/// How many blocks say how late blocks usually come.
const REMEMBERED: usize = 15;

/// Why nobody's right is known now.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum NotFresh {
    /// No block was read in this run.
    #[error("no block of the chain was read yet")]
    Unread,
    /// The node did not answer lately, or what it names is not read yet.
    #[error("the newest block was read {0} s ago, and the chain has not confirmed since that it is the newest")]
    Silent(u64),
    /// The next block should have come.
    #[error("block {block} is {age} s old here, and the next one was due after {due} s: the node may be cut off")]
    #[allow(missing_docs, reason = "the line names its fields")]
    Late { block: u64, age: u64, due: u64 },
    /// It came later than others, or they come faster than they were sealed.
    #[error("the node is catching up: block {block} is an old one")]
    #[allow(missing_docs, reason = "the line names its fields")]
    Behind { block: u64 },
}

#[derive(Debug, Clone, Copy)]
struct Seen {
    head: BlockRef,
    /// When the node was last asked and named this one.
    confirmed: Instant,
    /// When it was first named.
    since: Instant,
    /// Its age when it came, by the clock here.
    age: Duration,
    /// It came no faster after the one before than its own time says, so the node is not catching up.
    is_paced: bool,
    /// How much later it came, after its own time, than blocks usually do here. The clock here is not asked for this.
    lag: Duration,
}

/// What is known of the newest block.
#[derive(Debug, Default)]
pub struct Freshness {
    seen: Option<Seen>,
    due: Option<Duration>,
    /// The block at which that was measured.
    measured: Option<u64>,
    /// A block came later than it was due.
    was_late: bool,
    /// The first moment, from which those below are counted.
    origin: Option<Instant>,
    /// Seconds from each of the newest blocks' own time to its coming, up to a constant.
    delays: VecDeque<i64>,
}

impl Freshness {
    /// All was read up to `head`, which the node named when it was asked at `asked`; `clock` is the time here, seconds.
    pub fn read(&mut self, head: BlockRef, asked: Instant, clock: u64) {
        let before = self.seen;
        if let Some(seen) = self.seen.as_mut().filter(|seen| seen.head.hash == head.hash) {
            seen.confirmed = asked;
            return;
        }
        let passed = before.map(|before| asked.saturating_duration_since(before.since));
        let stated = before.map_or(0, |before| head.timestamp.saturating_sub(before.head.timestamp));
        self.was_late |= passed.zip(self.due).is_some_and(|(passed, due)| passed > due + GRACE);
        self.seen = Some(Seen {
            head,
            confirmed: asked,
            since: asked,
            age: Duration::from_secs(clock.saturating_sub(head.timestamp)),
            is_paced: passed.is_some_and(|passed| passed * 2 >= Duration::from_secs(stated)),
            lag: self.lag(head, asked),
        });
    }

    /// Compares a block with the median of those before it: one sealer's wrong clock changes nothing.
    fn lag(&mut self, head: BlockRef, asked: Instant) -> Duration {
        let whole = |seconds: u64| i64::try_from(seconds).unwrap_or(i64::MAX);
        let passed = asked.saturating_duration_since(*self.origin.get_or_insert(asked)).as_secs();
        let delay = whole(passed).saturating_sub(whole(head.timestamp));
        let mut sorted: Vec<i64> = self.delays.iter().copied().collect();
        sorted.sort_unstable();
        let usual = sorted.get(sorted.len() / 2).copied().unwrap_or(delay);
        self.delays.push_back(delay);
        if self.delays.len() > REMEMBERED {
            self.delays.pop_front();
        }
        Duration::from_secs(u64::try_from(delay.saturating_sub(usual)).unwrap_or(0))
    }

    /// The node was asked at `asked` and named this block; whether that is the one that was read.
    pub fn is_named(&mut self, head: &BlockRef, asked: Instant) -> bool {
        let Some(seen) = self.seen.as_mut().filter(|seen| seen.head.hash == head.hash) else { return false };
        seen.confirmed = seen.confirmed.max(asked);
        true
    }

    /// Whether it is time to measure how often blocks come.
    pub fn is_to_measure(&self) -> bool {
        let Some(seen) = &self.seen else { return false };
        let is_old = |block: u64| seen.head.number < block || seen.head.number - block >= MEASURED;
        self.was_late || self.measured.is_none_or(is_old)
    }

    /// What was measured. A busy chain shows no pauses: then the ones known before count, unless a block was late.
    pub fn measured(&mut self, due: Option<Duration>) {
        self.due = due.or(self.due.filter(|_| !self.was_late));
        (self.measured, self.was_late) = (self.seen.map(|seen| seen.head.number), false);
    }

    /// The newest block, if it is known now that it is the newest.
    ///
    /// # Errors
    /// [`NotFresh`].
    pub fn judge(&self, now: Instant) -> Result<BlockRef, NotFresh> {
        let seen = self.seen.ok_or(NotFresh::Unread)?;
        let block = seen.head.number;
        let silence = now.saturating_duration_since(seen.confirmed);
        if silence > GRACE {
            return Err(NotFresh::Silent(silence.as_secs()));
        }
        let Some(due) = self.due else { return Ok(seen.head) };
        let age = now.saturating_duration_since(seen.since);
        if age > due + GRACE {
            return Err(NotFresh::Late { block, age: age.as_secs(), due: due.as_secs() });
        }
        if seen.lag > due + GRACE || !seen.is_paced && seen.age > due + GRACE {
            return Err(NotFresh::Behind { block });
        }
        Ok(seen.head)
    }
}

#[cfg(test)]
#[path = "freshness_tests.rs"]
mod tests;
