//! Capture -> seal -> store -> anchor -> confirm -> verify, as workers over the ledger's tables.
//!
//! Every worker is a function of the ledger: a restart simply runs it again. Profiles, commands and sockets are up to
//! the service; screens know nothing of this crate.

use crate as pipeline;
use authros_chain as chain;
use authros_crypto as crypto;
use authros_gateway as gateway;
use authros_model as model;
use authros_ros as ros;
use authros_store as store;

pub mod anchorer;
pub mod audit_head;
pub mod author;
pub mod authority;
mod block_times;
pub mod chain_proofs;
pub mod columns;
pub mod directory;
pub mod disk_ring;
pub mod epoch;
pub mod equivocation;
pub mod error;
pub mod evidence;
pub mod export_folder;
#[cfg(test)]
mod fixture;
pub mod forwarder;
#[cfg(test)]
mod gateway_stage;
pub mod importer;
pub mod intake;
mod keep;
pub mod losses;
pub mod meter;

pub mod notices;
pub mod owner;
pub mod pace;
pub mod packing;
pub mod pins;
pub mod quarantine;
pub mod reader;
pub mod record_audit;
pub mod recorded_names;
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
#[cfg(test)]
mod tests;
pub mod verifier;
pub mod watcher;

pub use author::Author;
pub use block_times::BlockTimes;
pub use directory::Directory;
pub use error::PipelineError;
pub use forwarder::Forwarder;
pub use losses::Losses;
pub use owner::Owner;
pub use pins::{PinRules, Pins};
pub use recorder::Recorder;
pub use sender::{Outgoing, Sender};
pub use session::CaptureSession;

use std::path::Path;
use std::sync::Arc;

use crate::chain::{Chain, Pin};
use crate::crypto::Provider;
use crate::model::{Digest, Domain};
use crate::store::{Ciphertext, Ledger, Rights, StoreError};

/// A worker's report to the service; short, never blocking.
pub trait Observer: Send + Sync {
    /// Records were acknowledged, or changed their state.
    fn records_changed(&self);
    /// These records are now verified.
    fn verified(&self, digests: &[Digest]);
    /// These records differ from what was anchored, or are missing.
    fn tampered(&self, digests: &[Digest]);
    /// Registrations or grants changed on the chain.
    fn directory_changed(&self);
    /// Ciphertext of some records was deleted.
    fn erased(&self) {}
    /// A publisher of a watched topic is doubted.
    fn publishers_doubted(&self) {}
    /// Where times are counted, if they are.
    fn stages(&self) -> Option<&stages::Stages> {
        None
    }
    /// An account of this home anchored something this home did not send.
    fn foreign_anchors(&self, _found: &store::notes::ForeignAnchors) {}
    /// Something an operator should know; `urgent` stays on screen.
    fn alert(&self, urgent: bool, text: String);
}

/// State shared by all workers of a site.
#[derive(Clone)]
pub struct Plant {
    /// States of all records.
    pub ledger: Ledger,
    /// Their ciphertext, of the same store.
    pub ciphertext: Ciphertext,
    pub provider: &'static dyn Provider,
    pub observer: Arc<dyn Observer>,
}

/// The chain in use with everything bound to it.
#[derive(Clone)]
pub struct Network {
    /// The node or embedded chain, with the contract.
    pub chain: Chain,
    /// Binds records to this chain and contract.
    pub domain: Domain,
    /// Registrations and grants, from the chain's events.
    pub directory: Arc<Directory>,
    /// Confirmations an anchor needs, its own block included.
    pub confirmations: u64,
    /// Times of known blocks.
    pub times: Arc<BlockTimes>,
    /// Why the chain cannot be asked, if it cannot: then this is what the home kept of it.
    pub absent: Option<Arc<str>>,
}

/// The chain and contract that a home's ledger is bound to; `None` = none yet.
pub fn network_pin(rights: &Rights) -> Result<Option<Pin>, StoreError> {
    rights.contract_pin()?.map(|text| read_pin(&text, rights.path())).transpose()
}

/// The same of a home whose ledger is not open here.
pub fn network_pin_in(path: &Path) -> Result<Option<Pin>, StoreError> {
    Rights::contract_pin_in(path)?.map(|text| read_pin(&text, path)).transpose()
}

fn read_pin(text: &str, path: &Path) -> Result<Pin, StoreError> {
    let detail = |_| "the row of its contract cannot be read".to_owned();
    serde_json::from_str(text).map_err(detail).map_err(|detail| StoreError::Corrupt { file: path.to_owned(), detail })
}

impl Network {
    /// A connected chain with the contract of this pin; nothing is known of its accounts yet.
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
