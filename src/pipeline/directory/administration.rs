//! What the administrator of the contract decided, as far as its events tell.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

use crate::chain::{Event, EventAt};
use crate::model::{Address, Hash};

/// A lost account and who continues its work.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Succession {
    /// The account whose key is lost or stolen; suspended for good.
    pub lost: Address,
    /// The account that continues.
    pub successor: Address,
    /// Block in which the administrator named it.
    pub block: u64,
    /// The transaction.
    pub transaction: Hash,
}

/// The administrator and what was decided.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Administration {
    /// Who administers; `None` before the first event.
    pub administrator: Option<Address>,
    /// Who is to administer next, once it accepts.
    pub nominee: Option<Address>,
    /// Whether anyone may register.
    pub open: bool,
    /// Whether all changes are stopped but those that take rights away.
    pub paused: bool,
    /// Accounts whose changes are stopped.
    pub suspended: BTreeSet<Address>,
    /// Successors named, oldest first.
    pub successions: Vec<Succession>,
}

impl Administration {
    /// Applies one event; applying it twice changes nothing.
    pub(super) fn apply(&mut self, at: &EventAt) {
        match &at.event {
            Event::Suspended { account } => drop(self.suspended.insert(*account)),
            Event::Restored { account } => drop(self.suspended.remove(account)),
            Event::OpenChanged { open } => self.open = *open,
            Event::PausedChanged { paused } => self.paused = *paused,
            Event::Succeeded { lost, successor } => {
                let (lost, successor) = (*lost, *successor);
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

    /// Who continues the work of `account`, at the end of the line; `None` where no successor was named.
    pub fn successor(&self, account: Address) -> Option<Address> {
        let mut found = None;
        let mut current = account;
        // The contract lets no circle come about; the bound holds whatever a chain says.
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
        let (transaction, block_hash) = (Hash([u8::try_from(block).expect("small"); 32]), Hash([9; 32]));
        let at = EventAt { block, block_hash, timestamp: None, transaction, log_index: 0, event };
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
        // No contract of ours says this; it must end all the same.
        told(&mut administration, 4, Event::Succeeded { lost: d, successor: a });
        assert!(administration.successor(a).is_none_or(|found| found != a));
    }

    #[test]
    fn the_administrators_decisions_are_kept() {
        let (a, b) = (Address([1; 20]), Address([2; 20]));
        let mut administration = Administration::default();
        told(&mut administration, 1, Event::AdministratorChanged { previous: Address([0; 20]), administrator: a });
        told(&mut administration, 1, Event::OpenChanged { open: true });
        told(&mut administration, 2, Event::PausedChanged { paused: true });
        told(&mut administration, 3, Event::Suspended { account: b });
        told(&mut administration, 4, Event::AdministratorNominated { nominee: b });
        assert!(administration.open && administration.paused && administration.suspended.contains(&b));
        assert_eq!((administration.administrator, administration.nominee), (Some(a), Some(b)));
        told(&mut administration, 5, Event::AdministratorChanged { previous: a, administrator: b });
        told(&mut administration, 6, Event::Restored { account: b });
        assert_eq!((administration.administrator, administration.nominee), (Some(b), None));
        assert!(administration.suspended.is_empty());
    }
}
