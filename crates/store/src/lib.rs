//! What survives the process: the ledger of records and their states (SQLite), the vault of ciphertext (embedded or
//! Redis), the hash-chained audit log, and files with their modes and locks.
//!
//! Nothing here seals, opens or checks a record, and nothing here talks to the chain.

pub mod archive;
pub mod audit;
mod database;
mod disk_ring;
mod error;
pub mod files;
pub mod ledger;
mod reserve;
pub mod snapshot;
pub mod vault;

use authros_chain as chain;
use authros_crypto as crypto;
use authros_model as model;

pub use crate::audit::{AuditEntry, AuditFault, AuditLine, AuditLog, AuditQuery};
pub use crate::disk_ring::{DiskRing, KnownDefinition, RingFigures, RingRecord, note_restored};
pub use crate::error::StoreError;
pub use crate::files::{ConsoleLock, SiteLock, atomic_write};
pub use crate::ledger::{
    AlarmRow, Anchors, AuditPage, AuditedBatch, AuditedPlace, AuditedRecord, BatchPlace, Coverage, CoveragePart,
    CoverageQuery, Erasure, ErasurePage, Feed, FeedFilter, FeedPage, FeedPlace, FeedRow, FilterChoice, Foreign, GapRow,
    Glance, HashedNode, HeldMinute, HeldQuery, HeldRow, Hold, IncidentNote, IncidentRow, IncidentSpan, KeptBinding,
    KeptEnvelope, KeptErasure, KeptProof, KeptReceipt, KeptRight, KeptStamp, KeptStanding, KeptTopic, LaneCount,
    LastSeen, Ledger, Loss, NewBatch, NewRecord, NewTransaction, NewestRecord, OldRecord, OpenTransaction, PinRow,
    PlacedRecord, ProofCounts, RecordPage, RecordQuery, RecordRow, RecordsHeld, Reissue, Retained, RightEvent,
    RightKind, RootSighting, Sequence, Sighting, SignerTopic, SpanCoverage, StampCounts, StandingRights, StateCounts,
    StatedErasure, TakenErased, ToldErased, TopicCounts, TransactionOutcome, TransactionRow, TransactionState,
    UnprovenBatch, Unstated, WaitingBatch, WaitingSigner,
};
pub use crate::reserve::{RESERVE_BYTES, Reserve, Waiting, WaitingFile};
pub use crate::vault::{Stored, Usage, Vault, open_vault};
