//! Commands about the store as a whole: audit of records, backup, erasing.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::{Ask, Command, SecretText, UploadQuery};
use crate::model::{Timestamp, TopicName};
use crate::service::reply::{BackupView, ErasureView, RecordAudit, RecordPage};

requests! {
    /// Work on the whole store; only erasing needs the keyring.
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
    /// Show which records would be erased, or erase them; needs the keyring.
    EraseRecords(wishes: ErasureWishes) => ErasureView;
}

/// What is to be erased, and why.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ErasureWishes {
    /// Messages of this topic.
    pub topic: Option<TopicName>,
    /// Captured at this time or later.
    pub since: Option<Timestamp>,
    /// Captured before this time.
    pub until: Option<Timestamp>,
    /// These records, by the beginnings of their digests; then nothing else decides.
    pub records: Vec<String>,
    /// Only those that an import of this recording sealed: its tag, 16 hexadecimal digits.
    pub recording: Option<String>,
    /// Why; kept with who and when.
    pub reason: String,
    /// Do it; else it is only shown.
    pub sure: bool,
}
