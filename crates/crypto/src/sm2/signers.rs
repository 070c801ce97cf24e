//! Tables for signers met before: a gateway and an auditor meet the same few thousand keys. A table only makes the
//! reckoning quicker; every signature is reckoned in full. It is made at a signer's third valid signature, and what is
//! in use gives way to nobody, so that strangers evict nobody however many keys they bring.

use std::collections::HashMap;
use std::hash::{BuildHasher as _, RandomState};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, LazyLock, Mutex, PoisonError, RwLock};

use crate::crypto::kernel::sm2::{Affine, SignerTable};
use crate::model::PublicKey;

/// Bytes of all tables together, at most.
const ROOM: usize = 64 << 20;
/// Tables at most.
const MOST: usize = ROOM / (SignerTable::BYTES + 1024);
/// At most 64 KiB a signer, and place for a few thousand.
const _: () = assert!(SignerTable::BYTES <= 64 << 10 && MOST * SignerTable::BYTES <= ROOM && MOST >= 2_500);
/// The valid signature at which a signer's table is made.
pub(super) const SIGHTINGS: u8 = 3;
/// Signers whose sightings are counted at once.
const COUNTED: usize = 4096;
/// A table may be replaced where it was not used for so many valid verifications.
pub(super) const IDLE: u64 = 1 << 16;

/// A signer met before: its key was checked when the table was made.
pub(super) struct Known {
    pub table: SignerTable,
    pub za: [u8; 32],
    /// When it was last used.
    used: AtomicU64,
}

pub(super) struct Signers {
    /// Counts valid signatures of strangers and uses of tables.
    clock: AtomicU64,
    tables: RwLock<HashMap<[u8; 64], Arc<Known>>>,
    /// By the hash of a key: the hash, and how often it was met.
    sightings: Mutex<Vec<(u64, u8)>>,
    hasher: RandomState,
    most: usize,
}

static SIGNERS: LazyLock<Signers> = LazyLock::new(|| Signers::new(MOST));

/// The table of a signer met before.
pub(super) fn known(public: &PublicKey) -> Option<Arc<Known>> {
    SIGNERS.known(public)
}

/// Counts a valid signature; makes the signer's table at the third.
pub(super) fn seen(public: &PublicKey, point: &Affine, za: &[u8; 32]) {
    SIGNERS.seen(public, point, za);
}

impl Signers {
    pub fn new(most: usize) -> Self {
        Self {
            clock: AtomicU64::new(0),
            tables: RwLock::default(),
            sightings: Mutex::new(vec![(0, 0); COUNTED]),
            hasher: RandomState::new(),
            most,
        }
    }

    pub fn known(&self, public: &PublicKey) -> Option<Arc<Known>> {
        let known = self.tables.read().unwrap_or_else(PoisonError::into_inner).get(&public.0).cloned()?;
        known.used.store(self.clock.fetch_add(1, Ordering::Relaxed), Ordering::Relaxed);
        Some(known)
    }

    pub fn seen(&self, public: &PublicKey, point: &Affine, za: &[u8; 32]) {
        // Strangers let time pass, too: were it only the tables, those of signers who came in numbers and left would
        // stay for good.
        self.clock.fetch_add(1, Ordering::Relaxed);
        if !self.is_due(public) || !self.has_room() {
            return;
        }
        let used = AtomicU64::new(self.clock.load(Ordering::Relaxed));
        let known = Arc::new(Known { table: SignerTable::new(point), za: *za, used });
        let mut tables = self.tables.write().unwrap_or_else(PoisonError::into_inner);
        if tables.len() >= self.most {
            let Some(idle) = self.idle(&tables) else { return };
            tables.remove(&idle);
        }
        tables.insert(public.0, known);
    }

    /// Whether this is the sighting at which a table is made; counting begins anew behind it. A signer may displace the
    /// count of another: the hash is keyed, so that nobody can aim.
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

    /// Whether a table would find a place, asked before it is made.
    fn has_room(&self) -> bool {
        let tables = self.tables.read().unwrap_or_else(PoisonError::into_inner);
        tables.len() < self.most || self.idle(&tables).is_some()
    }

    /// The table that was not used for the longest time, where that is long.
    fn idle(&self, tables: &HashMap<[u8; 64], Arc<Known>>) -> Option<[u8; 64]> {
        let now = self.clock.load(Ordering::Relaxed);
        let (key, used) =
            tables.iter().map(|(key, known)| (key, known.used.load(Ordering::Relaxed))).min_by_key(|one| one.1)?;
        (now.saturating_sub(used) >= IDLE).then_some(*key)
    }
}
