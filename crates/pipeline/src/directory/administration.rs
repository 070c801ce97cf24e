//! The decisions of the contract's administrator, as far as its events show.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

use super::Told;
use crate::chain::Event;
use crate::model::{Address, Hash, Timestamp};

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Succession {
    /// The account whose key is lost or stolen; suspended permanently.
    pub lost: Address,
    pub successor: Address,
    pub block: u64,
    pub transaction: Hash,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Proposal {
    pub lost: Address,
    pub successor: Address,
    /// Who may stop it, besides the administrator; `None` if its owner had named nobody.
    pub recovery: Option<Address>,
    /// When it can be completed.
    pub due: Timestamp,
    pub block: u64,
}

/// Who may stop a succession of an account.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Recovery {
    /// Until `from`.
    pub current: Option<Address>,
    pub next: Option<Address>,
    /// When `next` takes effect, or took.
    pub from: Timestamp,
}

impl Recovery {
    /// `next` takes effect at `from`, `delay` seconds after it was named. A naming read before changes nothing.
    pub(super) fn named(known: Option<Self>, next: Option<Address>, from: Timestamp, delay: u64) -> Self {
        let made = Timestamp::from_seconds(from.seconds().saturating_sub(delay));
        match known {
            Some(known) if known.from > from => known,
            Some(known) => Self { current: known.in_effect(made), next, from },
            None => Self { current: None, next, from },
        }
    }

    /// Who may stop a succession proposed at `now`.
    pub fn in_effect(&self, now: Timestamp) -> Option<Address> {
        if now >= self.from { self.next } else { self.current }
    }
}

#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Administration {
    /// `None` before the first event.
    pub administrator: Option<Address>,
    pub nominee: Option<Address>,
    /// Whether anyone may register.
    pub open: bool,
    /// Until when all changes except those that take rights away are or were last paused; `None` = never.
    pub paused_until: Option<Timestamp>,
    /// The delay of a succession, seconds; 0 before the first event.
    pub delay: u64,
    /// Pending successions, oldest first.
    pub proposals: Vec<Proposal>,
    pub suspended: BTreeSet<Address>,
    /// Named successors, oldest first.
    pub successions: Vec<Succession>,
}

impl Administration {
    /// Applying an event twice changes nothing.
    pub(super) fn apply(&mut self, at: &Told) {
        match &at.event {
            Event::Suspended { account } => drop(self.suspended.insert(*account)),
            Event::Restored { account } => drop(self.suspended.remove(account)),
            Event::OpenChanged { open } => self.open = *open,
            Event::PausedUntil { until } => self.paused_until = Some(*until),
            Event::DelayFixed { seconds } => self.delay = *seconds,
            Event::SuccessionProposed { lost, successor, recovery, due } => {
                self.proposals.retain(|proposal| proposal.lost != *lost);
                let (lost, successor, recovery, due) = (*lost, *successor, *recovery, *due);
                self.proposals.push(Proposal { lost, successor, recovery, due, block: at.block });
            }
            Event::SuccessionCancelled { lost, .. } => self.proposals.retain(|proposal| proposal.lost != *lost),
            Event::Succeeded { lost, successor } => {
                let (lost, successor) = (*lost, *successor);
                self.proposals.retain(|proposal| proposal.lost != lost);
                let named = Succession { lost, successor, block: at.block, transaction: at.transaction };
                if !self.successions.contains(&named) {
                    self.successions.push(named);
                }
                self.suspended.insert(lost);
            }
            Event::AdministratorNominated { nominee } => {
                self.nominee = (nominee.0 != [0; 20]).then_some(*nominee);
            }
            Event::AdministratorChanged { administrator, .. } => {
                self.administrator = Some(*administrator);
                self.nominee = None;
            }
            _ => {}
        }
    }

    pub fn is_paused(&self, now: Timestamp) -> bool {
        self.paused_until.is_some_and(|until| now < until)
    }

    /// The last successor of `account` in the line; `None` if none was named.
    pub fn successor(&self, account: Address) -> Option<Address> {
        let mut found = None;
        let mut current = account;
        // The contract prevents cycles; the limit holds whatever a chain says.
        for _ in 0..=self.successions.len() {
            let Some(next) = self.successions.iter().rev().find(|named| named.lost == current) else { break };
            current = next.successor;
            found = Some(current);
        }
        found.filter(|successor| *successor != account)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(administration: &mut Administration, block: u64, event: Event) {
        let transaction = Hash([u8::try_from(block).expect("small"); 32]);
        let at = Told { block, place: 0, transaction, event, proven: false };
        administration.apply(&at);
        let once = administration.clone();
        administration.apply(&at);
        assert_eq!(once, *administration, "twice is once");
    }

    #[test]
    fn successors_are_followed_to_the_one_who_works_now() {
        let [a, b, c, d] = [1, 2, 3, 4].map(|byte| Address([byte; 20]));
        let mut administration = Administration::default();
        assert_eq!(administration.successor(a), None);
        told(&mut administration, 1, Event::Succeeded { lost: a, successor: b });
        assert_eq!((administration.successor(a), administration.successor(b)), (Some(b), None));
        told(&mut administration, 2, Event::Succeeded { lost: b, successor: c });
        assert_eq!((administration.successor(a), administration.successor(b)), (Some(c), Some(c)));
        told(&mut administration, 3, Event::Succeeded { lost: a, successor: d });
        assert_eq!((administration.successor(a), administration.successor(b)), (Some(d), Some(c)), "the last word");
        assert!(administration.suspended.contains(&a) && !administration.suspended.contains(&c));
        // No contract of ours says this; the search must end all the same.
        told(&mut administration, 4, Event::Succeeded { lost: d, successor: a });
        assert!(administration.successor(a).is_none_or(|found| found != a));
    }

    #[test]
    fn a_succession_waits_until_it_is_stopped_or_completed() {
        let [a, b, c] = [1, 2, 3].map(|byte| Address([byte; 20]));
        let at = Timestamp::from_seconds;
        let mut administration = Administration::default();
        told(&mut administration, 1, Event::DelayFixed { seconds: 100 });
        let proposed = |due| Event::SuccessionProposed { lost: a, successor: b, recovery: Some(c), due: at(due) };
        told(&mut administration, 2, proposed(500));
        let waits = Proposal { lost: a, successor: b, recovery: Some(c), due: at(500), block: 2 };
        assert_eq!((&administration.proposals, administration.successor(a)), (&vec![waits], None));
        told(&mut administration, 3, Event::SuccessionCancelled { lost: a, by: c });
        assert!(administration.proposals.is_empty() && administration.suspended.is_empty());
        told(&mut administration, 4, proposed(600));
        told(&mut administration, 5, Event::Succeeded { lost: a, successor: b });
        assert_eq!((administration.proposals.len(), administration.successor(a)), (0, Some(b)));
        told(&mut administration, 6, Event::PausedUntil { until: at(700) });
        assert!(administration.is_paused(at(699)) && !administration.is_paused(at(700)));
    }

    #[test]
    fn a_recovery_account_is_counted_as_the_contract_counts() {
        let [a, b, c] = [1, 2, 3].map(|byte| Some(Address([byte; 20])));
        let at = Timestamp::from_seconds;
        let named = |known, next, from| Recovery::named(known, next, at(from), 100);
        let first = named(None, a, 200);
        assert_eq!((first.in_effect(at(199)), first.in_effect(at(200))), (None, a));
        assert_eq!(named(Some(first), a, 200), first, "twice is once");
        let hasty = named(Some(first), b, 250);
        assert_eq!((hasty.in_effect(at(249)), hasty.in_effect(at(250))), (None, b), "the first never took effect");
        let second = named(Some(first), b, 300);
        assert_eq!((second.in_effect(at(299)), second.in_effect(at(300))), (a, b));
        assert_eq!(named(Some(second), a, 200), second, "an older one");
        let none = named(Some(second), None, 500);
        assert_eq!((none.in_effect(at(499)), none.in_effect(at(500))), (b, None));
        assert_eq!(named(Some(none), c, 500), Recovery { current: b, next: c, from: at(500) }, "in the same block");
    }

    #[test]
    fn the_administrators_decisions_are_kept() {
        let (a, b) = (Address([1; 20]), Address([2; 20]));
        let mut administration = Administration::default();
        told(&mut administration, 1, Event::AdministratorChanged { previous: Address([0; 20]), administrator: a });
        told(&mut administration, 1, Event::OpenChanged { open: true });
        told(&mut administration, 3, Event::Suspended { account: b });
        told(&mut administration, 4, Event::AdministratorNominated { nominee: b });
        assert!(administration.open && administration.suspended.contains(&b));
        assert_eq!((administration.administrator, administration.nominee), (Some(a), Some(b)));
        told(&mut administration, 5, Event::AdministratorChanged { previous: a, administrator: b });
        told(&mut administration, 6, Event::Restored { account: b });
        assert_eq!((administration.administrator, administration.nominee), (Some(b), None));
        assert!(administration.suspended.is_empty());
    }
}
