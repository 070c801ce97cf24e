//! Capture -> seal -> store -> anchor -> confirm -> verify, as workers over the ledger's table.
//!
//! Every worker is a function of the ledger: a restart just runs it again. What profiles,
//! commands and sockets are is the service's business; screens know nothing of this room.

pub mod adoption;
pub mod anchorer;
pub mod audit_head;
pub mod author;
pub mod directory;
pub mod epoch;
pub mod error;
pub mod export_folder;
#[cfg(test)]
mod fixture;
pub mod forwarder;
pub mod importer;
pub mod losses;
pub mod meter;
pub mod mirror;
pub mod notices;
pub mod owner;
pub mod pace;
pub mod packing;
pub mod pins;
pub mod proof;
pub mod quarantine;
pub mod reader;
pub mod record_audit;
pub mod recorder;
pub mod retention;
pub mod ring;
mod sampler;
pub mod sealer;
pub mod sender;
pub mod session;
pub mod signers;
pub mod stages;
pub mod statement;
pub mod storer;
#[cfg(test)]
mod tests;
pub mod verifier;
pub mod watcher;
pub mod witness;

pub use author::Author;
pub use directory::Directory;
pub use error::PipelineError;
pub use forwarder::Forwarder;
pub use losses::Losses;
pub use owner::Owner;
pub use pins::{PinRules, Pins};
pub use recorder::Recorder;
pub use sender::{Outgoing, Sender};
pub use session::CaptureSession;

use std::sync::Arc;

use crate::crypto::Provider;
use crate::model::{Digest, Domain};
use crate::store::{Ledger, Vault};

/// What a worker tells the service; short, never blocking.
pub trait Observer: Send + Sync {
    /// Records were acknowledged, or changed their state.
    fn records_changed(&self);
    /// These records are now verified.
    fn verified(&self, digests: &[Digest]);
    /// These records differ from what was anchored, or are gone.
    fn tampered(&self, digests: &[Digest]);
    /// Registrations or grants changed on the chain.
    fn directory_changed(&self);
    /// A publisher of a watched topic is doubted.
    fn publishers_doubted(&self) {}
    /// Where times are counted, if they are.
    fn stages(&self) -> Option<&stages::Stages> {
        None
    }
    /// An operator should know; `urgent` stays on screen.
    fn alert(&self, urgent: bool, text: String);
}

/// What all workers of a site share.
#[derive(Clone)]
pub struct Plant {
    /// States of all records.
    pub ledger: Ledger,
    /// Ciphertext.
    pub vault: Arc<dyn Vault>,
    /// SM2, SM3, SM4.
    pub provider: &'static dyn Provider,
    /// Hears what happens.
    pub observer: Arc<dyn Observer>,
}

/// The chain in use with everything bound to it.
#[derive(Clone)]
pub struct Network {
    /// The node or embedded chain, with the contract.
    pub chain: crate::chain::Chain,
    /// Binds records to this chain and contract.
    pub domain: Domain,
    /// Registrations and grants as the chain's events tell them.
    pub directory: Arc<Directory>,
    /// Domains that this home used before it adopted this chain.
    pub earlier: Arc<Vec<Domain>>,
    /// Blocks on top of an anchor, itself included, until it counts as confirmed.
    pub confirmations: u64,
}

impl Network {
    /// Whether records of this domain belong here: the network's own, or one used before it was adopted.
    pub fn accepts(&self, domain: &Domain) -> bool {
        self.domain == *domain || self.earlier.contains(domain)
    }
}
