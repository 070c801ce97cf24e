//! Data on the disk: space for it, retention, and integrity after a crash.

mod retention;
mod server;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64};
use std::time::Duration;

use tokio::task::block_in_place;

pub(crate) use self::server::other_gateway;
pub(in crate::site) use self::server::{check_all_accounts, check_unused, may_hold, open_on_server};
use super::parts::Parts;
use super::reading::Reading;
use crate::event::{NoticeLevel, Part};
use crate::model::{ByteSize, ProfileName, Timestamp};
use crate::paths::Home;
use crate::pipeline::{Plant, network_pin};
use crate::reply::Result;
use crate::store::files::free_bytes;
use crate::store::notes::StoreWasGone;
use crate::store::{Ledger, Reserve, StoreError};

/// Shortest and longest interval between looks at the disk.
const LOOKS: (Duration, Duration) = (Duration::from_millis(250), Duration::from_secs(2));
/// Assumed fastest fill rate of a disk, bytes a second.
const FASTEST: u64 = 1 << 30;
/// Bytes set aside for states; each takes a few hundred.
const MOST_FOR_STATES: u64 = 4 << 20;
/// With less free space, what is set aside is released.
const LAST: u64 = 512 << 10;
/// Records re-read from the store: a crash can only have touched what was written last.
const NEWEST: usize = 256;
/// Time for the process that started the site to listen.
const LISTENING: Duration = Duration::from_millis(500);

pub(in crate::site) struct Storage {
    parts: Parts,
    /// Space for the states of records on a full disk.
    states: Reserve,
    reading: Arc<Reading>,
    /// Records are named one caller at a time.
    naming: tokio::sync::Mutex<()>,
    /// Named ciphertext may be left to delete.
    has_named: AtomicBool,
    /// Records that owners elsewhere erased and incidents hold, as of the last look.
    held: AtomicU64,
}

impl Storage {
    pub fn new(parts: &Parts, reading: &Arc<Reading>) -> Self {
        Self {
            parts: parts.clone(),
            states: working_reserve(&parts.home, parts.config.disk_reserve),
            reading: Arc::clone(reading),
            naming: tokio::sync::Mutex::default(),
            has_named: AtomicBool::new(true),
            held: AtomicU64::new(0),
        }
    }

    /// Watches the free space on the disk, and the cache.
    pub async fn keep_room(self: Arc<Self>) {
        let (mut held, mut pause, mut away) = (None, LOOKS.0, None);
        let reserve = self.parts.config.disk_reserve;
        while self.parts.life.beat(pause).await {
            let now_away = self.parts.plant.ciphertext.cache().and_then(|cache| cache.away).map(|away| away.since);
            if std::mem::replace(&mut away, now_away) != now_away {
                self.parts.hub.changed(Part::Health);
            }
            if self.parts.is_on_server() {
                pause = LOOKS.1;
                continue;
            }
            let Ok(free) = block_in_place(|| free_bytes(self.parts.home.root())) else { continue };
            pause = if free.saturating_sub(reserve) / FASTEST > LOOKS.1.as_secs() { LOOKS.1 } else { LOOKS.0 };
            if free < reserve && held.is_none() {
                held = Some(self.parts.plant.ledger.records.hold());
                self.tell_room(NoticeLevel::Error, &self.full_text(free));
            }
            if free < reserve.min(LAST) && self.states.is_held() {
                // Removing a file takes no space.
                drop(block_in_place(|| self.states.release()));
            }
            // More than the reserve, so that it does not flutter.
            if free >= reserve.saturating_add(reserve / 4) {
                if held.take().is_some() {
                    self.tell_room(NoticeLevel::Info, "there is disk space again: records are accepted again");
                }
                if !self.states.is_held() && free >= reserve.saturating_add(MOST_FOR_STATES) {
                    drop(block_in_place(|| self.states.refill()));
                }
            }
        }
    }

    fn tell_room(&self, level: NoticeLevel, text: &str) {
        self.parts.hub.notice(level, text);
        self.parts.hub.changed(Part::Health);
    }

    fn full_text(&self, free: u64) -> String {
        format!(
            "the disk of {} has {} left, less than disk.reserve ({}): no further record is acknowledged; captured \
             messages wait in memory, and those that do not fit are dropped and counted; free some space, then capture \
             resumes automatically",
            self.parts.home.root().display(),
            ByteSize(free),
            ByteSize(self.parts.config.disk_reserve)
        )
    }

    /// The store refuses records, or replaced a lost one.
    pub fn fault(&self) -> Result<Option<String>> {
        if self.parts.plant.ledger.records.takes_records().is_err() {
            return Ok(Some(self.full_text(free_bytes(self.parts.home.root()).unwrap_or(0))));
        }
        let ledger = &self.parts.plant.ledger;
        let missed = ledger.notes.read(&StoreWasGone {})?;
        let unbound = missed.is_some() && network_pin(&ledger.rights)?.is_none();
        Ok(missed.filter(|_| unbound).map(|missed| format!("{}; {STORE_LOST}", store_loss(&self.parts.home, missed))))
    }

    pub async fn tell_of_copy(self: Arc<Self>) {
        let (what, text) = match self.parts.is_on_server() {
            true => (
                "restored database",
                "the database was restored to an earlier time: it lacks what this home had committed there. Own records are \
                 numbered under a new recorder, readers read the feed from its beginning, and robots send again what they \
                 still have",
            ),
            false => (
                "copied home",
                "this home is a copy: its ledger is not the file it was when last used. New records are numbered under a \
                 new recorder; do not run it at the same time as the original",
            ),
        };
        if let Ok(profile) = "site".parse::<ProfileName>() {
            let written = self.parts.log.write(&profile, what, "a new recorder begins", "noticed").await;
            if let Err(failure) = written {
                self.parts.hub.alarm(&failure.message);
            }
        }
        tokio::time::sleep(LISTENING).await;
        self.parts.hub.warn(text);
    }

    /// Checks once, in the background, if the previous run did not close its files.
    pub async fn check_after_crash(self: Arc<Self>) {
        if self.parts.plant.ledger.inspection.ended_cleanly() {
            return;
        }
        match block_in_place(|| contradictions(&self.parts.plant)) {
            Ok(found) if found.is_empty() => {
                self.parts.hub.inform("the previous run did not shut down cleanly; the store is sound");
            }
            Ok(found) => found.iter().for_each(|text| self.parts.hub.alarm(text)),
            Err(failure) => {
                self.parts.hub.alarm(&format!(
                    "after an unclean shutdown it could not be checked whether everything is there: {}",
                    failure.message
                ));
            }
        }
    }
}

/// The ledger of a home, if need be with the space set aside for states. The second value: the home is a copy.
pub(in crate::site) fn open_ledger(home: &Home) -> Result<(Ledger, bool), StoreError> {
    if home.original().is_some() {
        // A read-only home records nothing, so it needs no recorder of its own.
        return Ok((Ledger::open(&home.ledger())?, false));
    }
    let missed = misses_store(home);
    let opened = match Ledger::open_in_place(&home.ledger()) {
        Err(StoreError::DiskFull { .. }) if std::fs::remove_file(home.working_reserve()).is_ok() => {
            Ledger::open_in_place(&home.ledger())
        }
        opened => opened,
    }?;
    if missed {
        opened.0.notes.write(&StoreWasGone {}, &Timestamp::now())?;
    }
    Ok(opened)
}

/// Whether a home without a store, or with an empty file for one, must have had one: it has keys or an embedded chain.
pub(crate) fn misses_store(home: &Home) -> bool {
    let is_empty = std::fs::metadata(home.ledger()).is_ok_and(|file| file.len() == 0);
    (is_empty || !home.ledger().exists()) && (home.chain().join("chain.db").exists() || !home.profiles().is_empty())
}

/// What is wrong with a store that replaced a lost one, until it is bound to a contract.
pub(crate) fn store_loss(home: &Home, missed: Timestamp) -> String {
    format!("{} was gone at {missed}, and its records with it", home.ledger().display())
}

pub(crate) const STORE_LOST: &str =
    "restore the last backup: `authros backup restore FILE`; without one, name the contract with --contract";

/// Sets space aside for states, never leaving less than the reserve itself.
pub(in crate::site) fn working_reserve(home: &Home, reserve: u64) -> Reserve {
    // Without space now, it is tried again later.
    Reserve::open(&home.working_reserve(), reserve.min(MOST_FOR_STATES)).0
}

fn contradictions(plant: &Plant) -> Result<Vec<String>> {
    let mut found: Vec<String> = plant
        .ledger
        .inspection
        .contradictions()?
        .into_iter()
        .map(|text| format!("after an unclean shutdown, in the ledger: {text}; keep a copy of the home"))
        .collect();
    for digest in plant.ledger.inspection.newest_stored(NEWEST)? {
        let blob = plant.ciphertext.get(digest)?;
        if blob.is_none_or(|blob| plant.provider.sm3(&[&blob]) != digest.0) {
            found.push(format!("after an unclean shutdown: record {digest} is not in the store as it was written"));
        }
    }
    Ok(found)
}

#[cfg(test)]
mod tests;
