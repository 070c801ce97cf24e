//! Tables for known signers: a gateway and an auditor meet the same few thousand keys. A table only makes verification
//! faster; every signature is verified in full. It is built at a signer's third valid signature, and a table in use is
//! never evicted, so strangers evict nobody however many keys they bring.

use std::collections::HashMap;
use std::hash::{BuildHasher as _, RandomState};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, LazyLock, Mutex, PoisonError, RwLock};

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
/// A table may be replaced if it was unused for this many valid verifications.
pub(super) const IDLE: u64 = 1 << 16;

/// A known signer: its key was checked when the table was built.
pub(super) struct Known {
    pub table: SignerTable,
    pub za: [u8; 32],
    /// When it was last used.
    used: AtomicU64,
}

pub(super) struct Signers {
    /// Counts valid signatures of unknown signers and uses of tables.
    clock: AtomicU64,
    tables: RwLock<HashMap<[u8; 64], Arc<Known>>>,
    /// By the hash of a key: the hash, and how often it was seen.
    sightings: Mutex<Vec<(u64, u8)>>,
    hasher: RandomState,
    most: usize,
}

static SIGNERS: LazyLock<Signers> = LazyLock::new(|| Signers::new(MOST));

/// The table of a known signer.
pub(super) fn known(public: &PublicKey) -> Option<Arc<Known>> {
    SIGNERS.known(public)
}

/// Counts a valid signature; builds the signer's table at the third.
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
        // Unknown signers advance this clock too: if only tables did, those of a crowd of signers that came and left
        // would stay forever.
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
    fn has_room(&self) -> bool {
        let tables = self.tables.read().unwrap_or_else(PoisonError::into_inner);
        tables.len() < self.most || self.idle(&tables).is_some()
    }

    /// The table unused for the longest time, if that is long enough.
    fn idle(&self, tables: &HashMap<[u8; 64], Arc<Known>>) -> Option<[u8; 64]> {
        let now = self.clock.load(Ordering::Relaxed);
        let (key, used) =
            tables.iter().map(|(key, known)| (key, known.used.load(Ordering::Relaxed))).min_by_key(|one| one.1)?;
        (now.saturating_sub(used) >= IDLE).then_some(*key)
    }
}
