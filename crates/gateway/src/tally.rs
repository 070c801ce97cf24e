//! Who is connected to a gateway and what it has refused since it was started: counts for its operator, no content.
//! Nothing here makes decisions.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::model::{Address, ProfileName, Timestamp};

use super::code::Code;

/// A sender whose session is under its transport key.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sender {
    /// N.
    pub name: ProfileName,
    /// Addr.
    pub account: Address,
    /// Its address.
    pub peer: SocketAddr,
    /// When it began.
    pub since: Timestamp,
    /// Frames of this session.
    pub frames: u64,
    /// Bytes of these frames.
    pub bytes: u64,
    /// When the last frame came.
    pub last: Timestamp,
}

#[derive(Debug, Default)]
struct Counts {
    next: u64,
    senders: BTreeMap<u64, Sender>,
    refused: BTreeMap<Code, u64>,
}

/// The counts of one gateway, shared by clones.
#[derive(Debug, Clone, Default)]
pub struct Tally(Arc<Mutex<Counts>>);

impl Tally {
    fn lock(&self) -> MutexGuard<'_, Counts> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A session under a transport key begins; it is counted until the guard is dropped.
    pub fn enter(&self, name: ProfileName, account: Address, peer: SocketAddr) -> Presence {
        let now = Timestamp::now();
        let sender = Sender { name, account, peer, since: now, frames: 0, bytes: 0, last: now };
        let mut counts = self.lock();
        counts.next += 1;
        let number = counts.next;
        counts.senders.insert(number, sender);
        Presence { tally: self.clone(), number }
    }

    /// A frame, or a connection, was refused.
    pub fn refuse(&self, code: Code) {
        *self.lock().refused.entry(code).or_default() += 1;
    }

    /// Everyone connected, the longest first.
    pub fn senders(&self) -> Vec<Sender> {
        self.lock().senders.values().cloned().collect()
    }

    /// Refusals by reason.
    pub fn refused(&self) -> Vec<(Code, u64)> {
        self.lock().refused.iter().map(|(code, count)| (*code, *count)).collect()
    }
}

/// One session in the tally.
#[derive(Debug)]
pub struct Presence {
    tally: Tally,
    number: u64,
}

impl Presence {
    /// A frame came.
    pub fn frame(&self, bytes: usize) {
        if let Some(sender) = self.tally.lock().senders.get_mut(&self.number) {
            sender.frames += 1;
            sender.bytes = sender.bytes.saturating_add(u64::try_from(bytes).unwrap_or(u64::MAX));
            sender.last = Timestamp::now();
        }
    }
}

impl Drop for Presence {
    fn drop(&mut self) {
        self.tally.lock().senders.remove(&self.number);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_session_counts_while_it_lasts_and_refusals_stay() {
        let tally = Tally::default();
        let peer = SocketAddr::from(([127, 0, 0, 1], 4_711));
        let presence = tally.enter("robot1".parse().expect("a name"), Address([7; 20]), peer);
        presence.frame(100);
        presence.frame(28);
        let senders = tally.senders();
        assert_eq!((senders.len(), senders[0].frames, senders[0].bytes), (1, 2, 128));
        drop(presence);
        assert!(tally.senders().is_empty());
        tally.refuse(Code::Tag);
        tally.refuse(Code::Tag);
        assert_eq!(tally.refused(), [(Code::Tag, 2)]);
    }
}
