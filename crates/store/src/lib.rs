//! What survives the process: the ledger with its ciphertext, the audit log, files with their modes and locks.

pub mod archive;
pub mod audit;
pub mod cache;
mod ciphertext;
mod database;
mod disk_ring;
mod error;
pub mod files;
mod ledger;
pub mod notes;
mod reserve;
pub mod snapshot;
mod sql;

use authros_crypto as crypto;
use authros_model as model;

pub use crate::audit::{AuditEntry, AuditFault, AuditLine, AuditQuery};
pub use crate::cache::{CacheSettings, CacheState};
pub use crate::ciphertext::{Ciphertext, Usage};
pub use crate::disk_ring::{DiskRing, KnownDefinition, RingFigures, RingRecord, note_restored};
pub use crate::error::StoreError;
pub use crate::files::{SiteLock, atomic_write};
pub use crate::ledger::*;
pub use crate::notes::Note;
pub use crate::reserve::{RESERVE_BYTES, Reserve, Waiting, WaitingFile};
