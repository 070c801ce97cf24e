//! The owner for whom messages are sealed, with the keys, of a keyring or an enrolment, and when each takes effect.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::crypto::Enrolment;
use crate::model::steady_clock::steady_now;
use crate::model::{Address, Timestamp};

use super::epoch::EpochKeys;

pub struct Author {
    pub address: Address,
    sealing: Mutex<Sealing>,
}

#[derive(Default)]
struct Sealing {
    keys: Option<Arc<EpochKeys>>,
    next: Option<(Timestamp, Arc<EpochKeys>)>,
}

impl Author {
    pub fn new(address: Address) -> Self {
        Self { address, sealing: Mutex::default() }
    }

    /// `None` before the first keys and after the last have ended. A message captured after the moment of
    /// [`Self::seal_from`] is never sealed under the earlier keys, even if nothing ran at that moment.
    pub fn sealing(&self) -> Option<Arc<EpochKeys>> {
        let mut sealing = self.lock();
        if let Some((_, keys)) = sealing.next.take_if(|(from, _)| steady_now() >= *from) {
            sealing.keys = Some(keys);
        }
        sealing.keys.as_ref().filter(|keys| keys.ends.is_none_or(|ends| steady_now() < ends)).cloned()
    }

    fn lock(&self) -> MutexGuard<'_, Sealing> {
        self.sealing.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn next(&self) -> Option<(Timestamp, Arc<EpochKeys>)> {
        self.lock().next.clone()
    }

    /// Takes the keys that an owner sent to a device: the present ones, and others from a future moment.
    pub fn obey(&self, enrolment: &Enrolment) {
        self.seal_under(Arc::new(EpochKeys::issued(enrolment, &enrolment.keys.now)));
        if let Some((moment, next)) = &enrolment.keys.next {
            self.seal_from(*moment, Arc::new(EpochKeys::issued(enrolment, next)));
        }
    }

    pub fn seal_under(&self, keys: Arc<EpochKeys>) {
        *self.lock() = Sealing { keys: Some(keys), next: None };
    }

    pub fn rest(&self) {
        *self.lock() = Sealing::default();
    }

    /// From `moment` on records are sealed with these keys, unless those of the same or a later epoch are already in
    /// use; of two such moments the earlier counts.
    pub fn seal_from(&self, moment: Timestamp, keys: Arc<EpochKeys>) {
        let mut sealing = self.lock();
        if sealing.keys.as_ref().is_some_and(|now| now.domain == keys.domain && now.epoch >= keys.epoch) {
            return;
        }
        if sealing.next.as_ref().is_none_or(|(from, _)| moment < *from) {
            sealing.next = Some((moment, keys));
        }
    }
}
