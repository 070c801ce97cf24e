//! Capture -> seal -> store -> anchor -> confirm -> verify, as workers over the ledger: a restart runs them again.

pub mod anchorer;
pub mod audit_head;
pub mod authority;
pub mod chain_proofs;
pub mod columns;
pub mod directory;
pub mod disk_ring;
pub mod epoch;
pub mod error;
pub mod evidence;
pub mod export_folder;
pub mod forwarder;
pub mod importer;
pub mod intake;
pub mod losses;
pub mod notices;
pub mod owner;
pub mod pace;
pub mod pins;
pub mod quarantine;
pub mod reader;
pub mod record_audit;
pub mod recorder;
pub mod recorder_heads;
pub mod recovery;
pub mod retention;
pub mod ring;
pub mod sealer;
pub mod sender;
pub mod session;
pub mod stages;
pub mod statement;
pub mod verifier;
pub mod watcher;

#[cfg(test)]
use crate as pipeline;
use std::{path::Path, sync::Arc};

use authros_chain as chain;
use authros_crypto as crypto;
use authros_gateway as gateway;
use authros_model as model;
use authros_ros as ros;
use authros_store as store;

use crate::chain::{Chain, Pin};
use crate::crypto::Provider;
use crate::model::{Digest, Domain};
use crate::store::{Ciphertext, Glance, Ledger, NewRecord, RecordRow, Rights, StoreError};

pub use chain_proofs::BlockTimes;
pub use columns::Shown;
pub use directory::{Directory, GrantState, Granted};
pub use epoch::tag_choice;
pub use error::{PipelineError, Result};
pub use forwarder::Forwarder;
pub use importer::Importer;
pub use intake::Anchors;
pub use losses::Losses;
pub use owner::{Author, Owner};
pub use pins::{PinRules, Pins};
pub use reader::{Definitions, Opening, Reader, is_held};
pub use recorder::{CapturedMessage, Recorder};
pub use ring::Rings;
pub use sender::{LaneState, Outgoing, Sender};
pub use session::CaptureSession;

/// What workers report to the service. Implementations return quickly and never block.
pub trait Observer: Send + Sync {
    fn records_changed(&self);
    fn verified(&self, digests: &[Digest]);
    /// These records differ from what was anchored, or are missing.
    fn tampered(&self, digests: &[Digest]);
    fn directory_changed(&self);
    fn erased(&self) {}
    fn publishers_doubted(&self) {}
    fn stages(&self) -> Option<&stages::Stages> {
        None
    }
    /// An account of this home anchored something this home did not send.
    fn foreign_anchors(&self, _found: &store::notes::ForeignAnchors) {}
    /// Something an operator should know; `urgent` stays on screen.
    fn alert(&self, urgent: bool, text: String);
}

#[derive(Clone)]
pub struct Plant {
    pub ledger: Ledger,
    pub ciphertext: Ciphertext,
    pub provider: &'static dyn Provider,
    pub observer: Arc<dyn Observer>,
}

#[derive(Clone)]
pub struct Network {
    pub chain: Chain,
    pub domain: Domain,
    pub directory: Arc<Directory>,
    /// Confirmations an anchor needs, its own block included.
    pub confirmations: u64,
    pub times: Arc<BlockTimes>,
    /// Why the chain cannot be asked; then this is what the home kept of it.
    pub absent: Option<Arc<str>>,
}

/// The chain and contract that a home's ledger is bound to; `None` = none yet.
pub fn network_pin(rights: &Rights) -> Result<Option<Pin>, StoreError> {
    rights.contract_pin()?.map(|text| read_pin(&text, rights.path())).transpose()
}

/// Same, for a home whose ledger is not open here.
pub fn network_pin_in(path: &Path) -> Result<Option<Pin>, StoreError> {
    Rights::contract_pin_in(path)?.map(|text| read_pin(&text, path)).transpose()
}

/// Same, for a store that is only looked at.
pub fn network_pin_at(glance: &Glance) -> Result<Option<Pin>, StoreError> {
    glance.contract_pin()?.map(|text| read_pin(&text, glance.path())).transpose()
}

fn read_pin(text: &str, path: &Path) -> Result<Pin, StoreError> {
    let detail = |_| "the row of its contract cannot be read".to_owned();
    serde_json::from_str(text).map_err(detail).map_err(|detail| StoreError::Corrupt { file: path.to_owned(), detail })
}

impl Network {
    pub fn new(chain: Chain, pin: &Pin, provider: &'static dyn Provider, confirmations: u64) -> Self {
        let domain = pin.domain();
        let directory = Arc::new(Directory::new(domain, provider));
        Self { chain, domain, directory, confirmations, times: Arc::default(), absent: None }
    }

    /// What a home kept of a chain that cannot be asked, for reading alone: accounts and rights as of the last block read.
    pub fn kept(plant: &Plant, pin: Pin, why: &str) -> Result<Self, StoreError> {
        let chain = Chain::absent(pin.clone(), why.to_owned());
        let network = Self { absent: Some(why.into()), ..Self::new(chain, &pin, plant.provider, 1) };
        directory::kept::read_back(&plant.ledger.rights, &network.directory)?;
        Ok(network)
    }
}

// The only way for a sealed record into a site: the reserve is checked, row and bytes are written in one commit, which
// acknowledges it, and only then the cache learns of it.

impl Plant {
    /// In the commit of `acknowledge`; after an error none is stored. Bytes that were deleted here do not come back.
    pub fn keep<R: AsRef<[NewRecord]>, T>(
        &self,
        records: R,
        acknowledge: impl FnOnce(R) -> Result<T, StoreError>,
    ) -> Result<T, StoreError> {
        self.ledger.records.takes_records()?;
        let cached = self.ciphertext.is_cached();
        let digests: Vec<_> = records.as_ref().iter().filter(|_| cached).map(|record| record.digest).collect();
        let done = acknowledge(records)?;
        self.ciphertext.written(digests);
        Ok(done)
    }

    /// Perhaps from the cache. Deleted bytes are gone, even where store or cache have them again.
    pub fn stored_bytes(&self, row: &RecordRow) -> Result<Option<Vec<u8>>, StoreError> {
        if row.deleted_at.is_some() {
            return Ok(None);
        }
        self.ciphertext.through_cache(row.digest)
    }
}

#[cfg(test)]
mod fixture;

#[cfg(test)]
mod gateway_stage;

#[cfg(test)]
mod tests;
