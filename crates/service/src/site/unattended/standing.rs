//! The state of unattended capture: for whom, with which device, until when, and whether the owner has come.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::model::{Address, ProfileName, SignerId, Timestamp, clean};
use crate::pipeline::Author;

/// Until when capture can go on without its owner, or why it cannot.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::site) enum Reach {
    /// Until this moment, for this reason.
    Until(Timestamp, &'static str),
    /// Not any more, for this reason.
    Ended(String),
}

/// Capture in the name of a locked profile.
pub(in crate::site) struct Standing {
    /// The profile.
    pub profile: ProfileName,
    /// Seals its records; the profile's owner goes on with the same author.
    pub author: Arc<Author>,
    /// The lent device.
    pub device: SignerId,
    /// The account that anchors.
    pub account: Address,
    /// The topics that it has keys for.
    pub topics: Vec<String>,
    anchors: AtomicBool,
    reach: Mutex<Reach>,
    /// Held while topics are followed or left, and while the owner takes over.
    passing: Mutex<()>,
}

impl Standing {
    /// Capture that may go on for now, and anchors.
    pub fn new(
        (profile, author): (ProfileName, Arc<Author>),
        device: SignerId,
        account: Address,
        topics: Vec<String>,
        reach: Reach,
    ) -> Self {
        let (anchors, reach, passing) = (AtomicBool::new(true), Mutex::new(reach), Mutex::default());
        Self { profile, author, device, account, topics, anchors, reach, passing }
    }

    /// Until when it can go on, or why it cannot.
    pub fn reach(&self) -> Reach {
        self.reach.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Notes the same; returns whether it has just ended, or can go on again.
    pub fn note(&self, reach: Reach) -> bool {
        let mut known = self.reach.lock().unwrap_or_else(PoisonError::into_inner);
        let turned = matches!(*known, Reach::Ended(_)) != matches!(reach, Reach::Ended(_));
        *known = reach;
        turned
    }

    /// While this is held, the owner does not take over, and topics are neither followed nor left.
    pub fn hold(&self) -> MutexGuard<'_, ()> {
        self.passing.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether it still anchors; the owner's own anchoring waits for that.
    pub fn anchors(&self) -> bool {
        self.anchors.load(Ordering::Acquire)
    }

    /// It anchors nothing any more.
    pub fn anchored_last(&self) {
        self.anchors.store(false, Ordering::Release);
    }

    /// Until when it can go on, in words.
    pub fn text(&self) -> String {
        match self.reach() {
            Reach::Until(until, why) => format!("capture runs unattended until {until} ({why})"),
            Reach::Ended(why) => format!("unattended capture has ended: {}", clean(&why, 300)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_tells_once_that_it_ended_and_once_that_it_goes_on() {
        let author = Arc::new(Author::new(Address([1; 20])));
        let until = |second| Reach::Until(Timestamp::from_seconds(second), "the loan of its device ends");
        let profile = "alice".parse().expect("a name");
        let standing =
            Standing::new((profile, author), SignerId([2; 32]), Address([3; 20]), vec!["/a".to_owned()], until(5));
        assert!(!standing.note(until(60)), "renewed");
        assert!(standing.text().contains("until 1970-01-01T00:01:00"), "{}", standing.text());
        let ended = Reach::Ended("recalled".to_owned());
        assert!(standing.note(ended.clone()) && !standing.note(ended));
        assert!(standing.text().ends_with("has ended: recalled"), "{}", standing.text());
        assert!(standing.note(until(90)));
    }
}
