//! Commands about the store as a whole: audit of records, back-up.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::{SecretText, UploadQuery};
use crate::model::Timestamp;

/// What is done with the whole store; needs no keyring.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "of_store")]
pub enum StoreCommand {
    /// Compare all records with proofs and chain.
    AuditRecords {
        /// Also every stored byte and every signature.
        deep: bool,
        /// Only records captured then or later.
        since: Option<Timestamp>,
    },
    /// Records of all profiles of the home.
    ListUploads(UploadQuery),
    /// Write keyrings, ledger, embedded vault and chain, settings and pins into one encrypted file.
    BackUp {
        /// The file, absolute; must not exist.
        file: PathBuf,
        /// Protects the back-up.
        passphrase: SecretText,
    },
}
