//! Commands about the store as a whole: audit of records, backup.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::{Ask, Command, SecretText, UploadQuery};
use crate::model::Timestamp;
use crate::service::reply::{BackupView, RecordAudit, RecordPage};

requests! {
    /// Work on the whole store; needs no keyring.
    #[serde(rename_all = "snake_case", tag = "of_store")]
    enum StoreCommand by Command::OfStore;
    /// Compare all records with their proofs and the chain.
    AuditRecords {
        /// Also every stored byte and every signature.
        deep: bool,
        /// Only records captured at this time or later.
        since: Option<Timestamp>,
    } => Box<RecordAudit>;
    /// Records of all profiles of the home.
    #[serde(rename = "list_uploads")]
    ListAllUploads(query: UploadQuery) => RecordPage;
    /// Write keyrings, ledger, embedded vault and chain, settings and pins into one encrypted file.
    BackUp {
        /// The file, absolute; must not exist.
        file: PathBuf,
        /// Protects the backup.
        passphrase: SecretText,
    } => BackupView;
}
