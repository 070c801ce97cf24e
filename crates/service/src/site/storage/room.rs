//! Space on the disk: below the reserve no further record is acknowledged, so that acknowledged ones can still reach
//! the chain; if others have filled the disk, the states of records are written into space set aside for them.

use super::Storage;
use std::sync::Arc;
use std::time::Duration;

use crate::model::ByteSize;
use crate::paths::Home;
use crate::service::event::{NoticeLevel, Part};
use crate::service::reply::{Failure, HealthLevel};
use crate::site::blocking;
use crate::store::files::free_bytes;
use crate::store::{Ledger, Reserve, StoreError};

/// Interval between looks at the disk: the shortest and the longest.
const LOOKS: (Duration, Duration) = (Duration::from_millis(250), Duration::from_secs(2));
/// The fastest rate at which a disk is assumed to fill up, bytes a second.
const FASTEST: u64 = 1 << 30;
/// The most bytes set aside for states; each takes a few hundred.
const MOST_FOR_STATES: u64 = 4 << 20;
/// With less free space than this, what is set aside is released.
const LAST: u64 = 512 << 10;

/// The ledger of a home; on a full disk the space set aside for the states of its records is released for it. The
/// second value says whether the home is a copy.
pub(in crate::site) fn open_ledger(home: &Home) -> Result<(Ledger, bool), StoreError> {
    if home.original().is_some() {
        // Nothing is recorded in it, so it needs no recorder of its own.
        return Ok((Ledger::open(&home.ledger())?, false));
    }
    match Ledger::open_in_place(&home.ledger()) {
        Err(StoreError::DiskFull { .. }) if std::fs::remove_file(home.working_reserve()).is_ok() => {
            Ledger::open_in_place(&home.ledger())
        }
        opened => opened,
    }
}

/// Sets space aside for the states of records, never so much that the rest is less than the reserve itself.
pub(in crate::site) fn working_reserve(home: &Home, reserve: u64) -> Reserve {
    // If there is no space now, it is tried again when there is.
    Reserve::open(&home.working_reserve(), reserve.min(MOST_FOR_STATES)).0
}

impl Storage {
    /// Watches the free space on the disk until the site ends.
    pub(in crate::site) async fn keep_room(self: Arc<Self>) {
        let (mut held, mut pause) = (None, LOOKS.0);
        let reserve = self.config.disk_reserve;
        while !self.life.is_stopping() {
            if !self.life.beat(pause).await {
                return;
            }
            let Ok(free) = blocking(&self, |storage| Ok(free_bytes(storage.home.root())?)).await else { continue };
            pause = if free.saturating_sub(reserve) / FASTEST > LOOKS.1.as_secs() { LOOKS.1 } else { LOOKS.0 };
            if free < reserve && held.is_none() {
                held = Some(self.plant.ledger.hold_records());
                self.tell_room(NoticeLevel::Error, &self.full_text(free));
            }
            if free < reserve.min(LAST) && self.states.is_held() {
                // Removing a file takes no space.
                drop(blocking(&self, |storage| Ok(storage.states.release()?)).await);
            }
            // Somewhat more than the reserve, so that it does not flutter.
            if free >= reserve.saturating_add(reserve / 4) {
                if held.take().is_some() {
                    self.tell_room(NoticeLevel::Info, "there is disk space again: records are accepted again");
                }
                if !self.states.is_held() && free >= reserve.saturating_add(MOST_FOR_STATES) {
                    drop(blocking(&self, |storage| Ok(storage.states.refill()?)).await);
                }
            }
        }
    }

    fn tell_room(&self, level: NoticeLevel, text: &str) {
        self.hub.notice(level, text);
        self.hub.changed(Part::Health);
    }

    fn full_text(&self, free: u64) -> String {
        format!(
            "the disk of {} has {} left, less than disk.reserve ({}): no further record is acknowledged; captured \
             messages wait in memory, and those that do not fit are dropped and counted; free some space, then capture \
             resumes automatically",
            self.home.root().display(),
            ByteSize(free),
            ByteSize(self.config.disk_reserve)
        )
    }

    /// How the vault's health is reported while records are refused.
    pub(in crate::site) fn room_health(&self) -> Option<(HealthLevel, String)> {
        let held: Result<(), Failure> = self.plant.ledger.takes_records().map_err(Failure::from);
        held.err().map(|_| {
            let free = free_bytes(self.home.root()).unwrap_or(0);
            (HealthLevel::Failed, self.full_text(free))
        })
    }
}
