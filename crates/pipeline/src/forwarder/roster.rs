//! The gateways of a robot in order, and how each of them is: the first that is up takes the records.

use tokio::sync::watch;

use super::Link;
use crate::model::{SignerId, clean};

/// How a gateway is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Condition {
    /// Not asked for now: an earlier one is up.
    Resting,
    /// Connected.
    Up,
    /// It does not answer.
    Away(String),
    /// It answers and refuses this robot as such.
    Refused(String),
}

/// What all lines know of each other.
pub(super) struct Roster {
    /// Fingerprints and addresses.
    gates: Vec<(SignerId, String)>,
    conditions: watch::Sender<Vec<Condition>>,
}

impl Roster {
    pub fn new(gates: Vec<(SignerId, String)>) -> Self {
        let conditions = watch::channel(vec![Condition::Resting; gates.len()]).0;
        Self { gates, conditions }
    }

    /// How many gateways there are.
    pub fn len(&self) -> usize {
        self.gates.len()
    }

    /// The gateways' fingerprints, in order.
    pub fn fingerprints(&self) -> impl Iterator<Item = SignerId> {
        self.gates.iter().map(|(fingerprint, _)| *fingerprint)
    }

    /// Changes of any condition, from now on.
    pub fn follow(&self) -> watch::Receiver<Vec<Condition>> {
        self.conditions.subscribe()
    }

    pub fn set(&self, place: usize, condition: Condition) {
        self.conditions.send_if_modified(|all| match all.get_mut(place) {
            Some(known) if *known != condition => {
                *known = condition;
                true
            }
            _ => false,
        });
    }

    /// Whether a gateway takes the records: it is up, and none before it is.
    pub fn is_on_duty(&self, place: usize) -> bool {
        self.conditions.borrow().iter().position(|condition| *condition == Condition::Up) == Some(place)
    }

    /// Whether a gateway is known not to take records.
    pub fn is_away(&self, place: usize) -> bool {
        let conditions = self.conditions.borrow();
        matches!(conditions.get(place), Some(Condition::Away(_) | Condition::Refused(_)))
    }

    /// Whether every gateway before this one is known not to take records; the first is always wanted.
    pub fn is_next_in_line(&self, place: usize) -> bool {
        (0..place).all(|before| self.is_away(before))
    }

    /// What a robot is told while this gateway takes its records.
    pub fn up(&self, place: usize) -> Link {
        let address = |place: usize| self.gates.get(place).map_or_else(String::new, |(_, address)| clean(address, 255));
        match place {
            0 => Link::Up,
            _ => Link::InPlace(format!("connected to {}, in place of {}", address(place), address(0))),
        }
    }

    /// What a robot is told if none takes its records; none if one is up.
    pub fn down(&self) -> Option<Link> {
        let conditions = self.conditions.borrow();
        if conditions.contains(&Condition::Up) {
            return None;
        }
        let text = |condition: &Condition| match condition {
            Condition::Resting | Condition::Up => None,
            Condition::Away(text) | Condition::Refused(text) => Some(text.clone()),
        };
        let first = conditions.iter().find_map(text)?;
        let refused = conditions.iter().all(|condition| matches!(condition, Condition::Refused(_)));
        Some(if refused { Link::Refused(first) } else { Link::Away(first) })
    }

    /// The gateway that a record goes to next, if `holders` signed for it, the latest first: the one behind the latest
    /// that has not signed for it and is not known to be away.
    pub fn next_for(&self, holders: &[SignerId]) -> Option<usize> {
        let count = self.gates.len();
        let latest = holders.first().and_then(|latest| self.fingerprints().position(|gate| gate == *latest));
        let begin = latest.map_or(0, |place| place + 1);
        let ring = (begin..begin + count).map(|place| place % count);
        let lacks = |place: &usize| self.gates.get(*place).is_some_and(|(gate, _)| !holders.contains(gate));
        let mut free = ring.filter(lacks);
        free.find(|place| !self.is_away(*place))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn roster(count: u8) -> Roster {
        Roster::new((0..count).map(|number| (SignerId([number; 32]), format!("gate{number}:1"))).collect())
    }

    fn away() -> Condition {
        Condition::Away("gone".to_owned())
    }

    #[test]
    fn the_first_that_is_up_is_on_duty_and_the_others_wait_for_it() {
        let roster = roster(3);
        let on_duty = |roster: &Roster| (0..3).filter(|place| roster.is_on_duty(*place)).collect::<Vec<_>>();
        let wanted = |roster: &Roster| (0..3).filter(|place| roster.is_next_in_line(*place)).collect::<Vec<_>>();
        assert_eq!((on_duty(&roster), wanted(&roster)), (vec![], vec![0]), "the first is tried alone");
        assert_eq!(roster.down(), None, "nothing is known yet");
        roster.set(0, away());
        assert_eq!((on_duty(&roster), wanted(&roster)), (vec![], vec![0, 1]));
        assert_eq!(roster.down(), Some(Link::Away("gone".to_owned())));
        roster.set(1, Condition::Up);
        assert_eq!((on_duty(&roster), wanted(&roster)), (vec![1], vec![0, 1]));
        assert_eq!(roster.up(1), Link::InPlace("connected to gate1:1, in place of gate0:1".to_owned()));
        assert_eq!(roster.down(), None);
        roster.set(0, Condition::Up);
        assert_eq!((on_duty(&roster), wanted(&roster), roster.up(0)), (vec![0], vec![0], Link::Up), "home again");
        for place in 0..3 {
            roster.set(place, Condition::Refused("recalled".to_owned()));
        }
        assert_eq!(roster.down(), Some(Link::Refused("recalled".to_owned())));
        roster.set(2, away());
        assert!(matches!(roster.down(), Some(Link::Away(_))), "one may still take them");
    }

    #[test]
    fn a_record_goes_round_the_gateways_once() {
        let roster = roster(3);
        let holders = |numbers: &[u8]| numbers.iter().map(|number| SignerId([*number; 32])).collect::<Vec<_>>();
        assert_eq!(roster.next_for(&holders(&[0])), Some(1));
        assert_eq!(roster.next_for(&holders(&[2])), Some(0));
        assert_eq!(roster.next_for(&holders(&[1, 0])), Some(2));
        assert_eq!(roster.next_for(&holders(&[2, 1, 0])), None, "all have it");
        assert_eq!(roster.next_for(&holders(&[9])), Some(0), "of one that is no longer listed");
        roster.set(1, away());
        assert_eq!(roster.next_for(&holders(&[0])), Some(2), "the next that answers");
        roster.set(2, away());
        assert_eq!(roster.next_for(&holders(&[0])), None, "it waits");
    }
}
