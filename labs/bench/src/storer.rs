//! A throw-away store, whose one writer commits everything waiting for it at once, as in the pipeline: what it acknowledges
//! is on disk.

use std::path::Path;

use authros_chain::merkle::Leaf;
use authros_model::{RecordKind, RecordState, Signature, Timestamp};
use authros_service::Failure;
use authros_service::reply::internal;
use authros_store::{Ciphertext, Ledger, NewRecord};

/// The store.
pub struct Storer(Ledger);

impl Storer {
    /// Opens one in `directory`.
    ///
    /// # Errors
    /// If it cannot be created.
    pub fn open(directory: &Path) -> Result<Self, Failure> {
        Ok(Self(Ledger::open(&directory.join("store.db"))?))
    }

    /// Stores one record; when this returns it is on disk.
    ///
    /// # Errors
    /// Errors of the store.
    pub async fn put(&self, leaf: Leaf, captured_at: Timestamp, blob: Vec<u8>) -> Result<(), Failure> {
        let Leaf { owner, signer, topic_id, seq, digest, .. } = leaf;
        let record = NewRecord {
            digest,
            owner,
            topic_id,
            seq,
            foreign: None,
            epoch: 1,
            kind: RecordKind::Data,
            signer,
            signature: Signature([0; 64]),
            filters: Vec::new(),
            topic: String::new(),
            type_name: String::new(),
            bytes: blob.len() as u64,
            captured_at,
            simulated: true,
            state: RecordState::Stored,
            blob: Some(blob),
        };
        let ledger = self.0.clone();
        let stored = tokio::task::spawn_blocking(move || ledger.records.append(vec![record])).await;
        Ok(stored.map_err(|error| internal(error.to_string()))??)
    }

    /// How many records it holds.
    ///
    /// # Errors
    /// Errors of the store.
    pub fn entries(&self) -> Result<u64, Failure> {
        Ok(Ciphertext::of(&self.0).usage()?.entries)
    }
}
