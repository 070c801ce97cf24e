//! Tables for known signers: a gateway and an auditor meet the same few thousand keys. A table only makes verification
//! faster; every signature is verified in full. It is built at a signer's third valid signature, and evicted only if its
//! signer had no valid one for an hour: no flood makes an hour pass, whoever's signatures it consists of.

use std::collections::HashMap;
use std::hash::{BuildHasher as _, RandomState};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, LazyLock, Mutex, PoisonError, RwLock};
use std::time::Instant;

use crate::crypto::kernel::sm2::{Affine, SignerTable};
use crate::model::PublicKey;

/// The most bytes of all tables together.
const ROOM: usize = 64 << 20;
/// The most tables.
const MOST: usize = ROOM / (SignerTable::BYTES + 1024);
/// At most 64 KiB a signer, and room for a few thousand.
const _: () = assert!(SignerTable::BYTES <= 64 << 10 && MOST * SignerTable::BYTES <= ROOM && MOST >= 2_500);
/// The number of valid signatures at which a signer's table is built.
pub(super) const SIGHTINGS: u8 = 3;
/// The most signers whose sightings are counted at once.
const COUNTED: usize = 4096;
/// Seconds without a valid signature after which a signer's table may be replaced. Not a number of verifications: those
/// can be made in a second, by strangers or by one known signer, and would make all quiet signers replaceable.
pub(super) const IDLE: u64 = 3600;

/// A known signer: its key was checked when the table was built.
pub(super) struct Known {
    pub table: SignerTable,
    pub za: [u8; 32],
    /// When it last found a signature valid.
    used: AtomicU64,
}

impl Known {
    /// Notes a valid signature; an invalid one is anybody's and counts for nothing.
    pub fn used(&self, now: u64) {
        self.used.fetch_max(now, Ordering::Relaxed);
    }
}

pub(super) struct Signers {
    tables: RwLock<HashMap<[u8; 64], Arc<Known>>>,
    /// By the hash of a key: the hash, and how often it was seen.
    sightings: Mutex<Vec<(u64, u8)>>,
    hasher: RandomState,
    most: usize,
    /// No table is idle before then: as long as it has not come, nobody looks through all of them.
    idle_from: AtomicU64,
}

/// Those of this process, and since when time is counted.
static SIGNERS: LazyLock<(Signers, Instant)> = LazyLock::new(|| (Signers::new(MOST), Instant::now()));

/// The signers of this process, and the seconds since their beginning by the clock that nobody sets.
pub(super) fn of_process() -> (&'static Signers, u64) {
    let (signers, begun) = &*SIGNERS;
    (signers, begun.elapsed().as_secs())
}

impl Signers {
    pub fn new(most: usize) -> Self {
        Self {
            tables: RwLock::default(),
            sightings: Mutex::new(vec![(0, 0); COUNTED]),
            hasher: RandomState::new(),
            most,
            idle_from: AtomicU64::new(0),
        }
    }

    /// The table of a known signer.
    pub fn known(&self, public: &PublicKey) -> Option<Arc<Known>> {
        self.tables.read().unwrap_or_else(PoisonError::into_inner).get(&public.0).cloned()
    }

    /// Counts a valid signature; builds the signer's table at the third.
    pub fn seen(&self, public: &PublicKey, point: &Affine, za: &[u8; 32], now: u64) {
        if !self.is_due(public) || !self.has_room(now) {
            return;
        }
        let known = Arc::new(Known { table: SignerTable::new(point), za: *za, used: AtomicU64::new(now) });
        let mut tables = self.tables.write().unwrap_or_else(PoisonError::into_inner);
        if tables.len() >= self.most {
            let Some(idle) = self.idle(&tables, now) else { return };
            tables.remove(&idle);
        }
        tables.insert(public.0, known);
    }

    /// Whether this is the sighting at which a table is built; counting starts again after it. A signer may displace
    /// another's count: the hash is keyed, so nobody can do so on purpose.
    fn is_due(&self, public: &PublicKey) -> bool {
        let hash = self.hasher.hash_one(public.0);
        let mut sightings = self.sightings.lock().unwrap_or_else(PoisonError::into_inner);
        let place = usize::try_from(hash % COUNTED as u64).unwrap_or_default();
        let Some(sighting) = sightings.get_mut(place) else { return false };
        let count = if sighting.0 == hash { sighting.1.saturating_add(1) } else { 1 };
        let is_due = count >= SIGHTINGS;
        *sighting = (hash, if is_due { 0 } else { count });
        is_due
    }

    /// Whether there is room for a table, checked before it is built.
    fn has_room(&self, now: u64) -> bool {
        let tables = self.tables.read().unwrap_or_else(PoisonError::into_inner);
        tables.len() < self.most || self.idle(&tables, now).is_some()
    }

    /// The table unused for the longest time, if that is long enough.
    fn idle(&self, tables: &HashMap<[u8; 64], Arc<Known>>, now: u64) -> Option<[u8; 64]> {
        if now < self.idle_from.load(Ordering::Relaxed) {
            return None;
        }
        let used = tables.iter().map(|(key, known)| (key, known.used.load(Ordering::Relaxed)));
        let (key, used) = used.min_by_key(|one| one.1)?;
        if now.saturating_sub(used) >= IDLE {
            return Some(*key);
        }
        // Use moves forward only, and a table that takes the place of another one was used just now.
        self.idle_from.fetch_max(used + IDLE, Ordering::Relaxed);
        None
    }
}
