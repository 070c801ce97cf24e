//! What can go wrong with keys, records and envelopes; each message says what to do next. No message carries a secret,
//! and text from a peer is always cleaned first.

use std::path::{Path, PathBuf};

use crate::model::wire::WireError;
use crate::model::{ErrorKind, clean};

pub(crate) type Result<T, E = CryptoError> = std::result::Result<T, E>;

/// Why an operation on keys, records, envelopes or key files failed.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the variants and their messages name the fields")]
pub enum CryptoError {
    #[error("the operating system returned no random bytes; nothing was sealed or generated, try again")]
    Random,
    #[error("{0} failed inside the crypto provider; try another one with crypto.provider")]
    Internal(&'static str),
    #[error("the {0} private key is out of range; use one made for this curve")]
    SecretRange(&'static str),
    #[error("the SM2 public key is not a point on the curve; ask its owner to register again")]
    PublicPoint,
    #[error("the SM2 signature is invalid; do not trust the data it came with, and fetch it again")]
    BadSignature,
    #[error("the account's signature is invalid; do not trust the data it came with, and ask the sender to sign again")]
    BadAccountSignature,
    #[error("the ciphertext does not belong to this key or was altered; fetch it again")]
    BadCiphertext,
    #[error("the {what} is {found} bytes long, but {allowed} are allowed; split it or make it smaller")]
    Length { what: &'static str, found: usize, allowed: &'static str },
    #[error("the {what} is malformed ({why}); get it again from its source")]
    Malformed { what: &'static str, why: WireError },
    #[error("the {0} does not match the rest; correct it and try again")]
    Inconsistent(&'static str),
    #[error("the record is damaged ({0}); fetch it again, or ask its owner for an intact copy")]
    DamagedRecord(WireError),
    #[error("the record was tampered with: its {0} does not match; keep it as evidence and fetch it again")]
    Tampered(&'static str),
    #[error("the record is not the one requested: its {0} differs; the store may have swapped it")]
    NotAsked(&'static str),
    /// A record that is as it was sealed, but whose signer wrote a name into it that belongs to another pseudonym.
    #[error(
        "the record is not shown: its signer wrote a false {0} into it, which does not belong to the pseudonym it is \
         filed under; `authros records show` names the signer: if it is a device of yours, revoke it"
    )]
    FalseName(&'static str),
    #[error("this key does not open the record; ask its owner for a grant of its epoch and topic")]
    WrongKey,
    #[error("the {what} was rejected: its {field} does not match the chain; ask its owner to issue it again")]
    NotAccepted { what: &'static str, field: &'static str },
    #[error("wrong passphrase for {0}; try again, nothing was changed")]
    WrongPassphrase(String),
    /// A keyring whose keys were wiped from memory.
    #[error("the keyring {0} is locked; unlock it with its passphrase, nothing was changed")]
    Locked(String),
    #[error("the passphrase has {0} characters; use 8 or more")]
    ShortPassphrase(usize),
    #[error("{0} is protected by a passphrase; pass it with --keystore-passphrase-file")]
    PassphraseNeeded(String),
    #[error("{path} is accessible to others (mode {mode:04o}); run: chmod {wanted:o} {path}")]
    OpenToOthers { path: String, mode: u32, wanted: u32 },
    #[error("{path} has {found} bytes, more than the {most} of the largest such file; give another file")]
    TooLong { path: String, found: usize, most: usize },
    #[error("{path} is not {wanted}: {found}")]
    NotAKey { path: String, wanted: &'static str, found: String },
    #[error(
        "{path} is {what} of version {found}, but this program reads only version 1; use a newer authros, or the one that \
         wrote it"
    )]
    Version { path: String, what: &'static str, found: u8 },
    #[error("{path} cannot be read ({source}); check the path and its permissions")]
    Read { path: String, source: std::io::Error },
    #[error("{path} cannot be written ({source}); check the directory, its permissions and the free space")]
    Write { path: String, source: std::io::Error },
    #[error("{0} already exists and is never overwritten; choose another file")]
    Exists(String),
    #[error("the keyring {0} is damaged; restore it from its backup")]
    DamagedKeyring(String),
    #[error(
        "the keyring {path} was changed by another program after this one read it (it has generation {found}, read was \
         {read}); nothing was written and no key is lost: run the command again, and if it still fails, stop the site of \
         this home and start it again"
    )]
    Superseded { path: String, read: u64, found: u64 },
    #[error("the keyring has no key for epoch {0} on this chain; it may be out of date, restore a newer one")]
    NoEpoch(u64),
}

impl CryptoError {
    /// The kind of failure.
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Random | Self::Internal(_) => ErrorKind::Internal,
            Self::SecretRange(_)
            | Self::PublicPoint
            | Self::Length { .. }
            | Self::Malformed { .. }
            | Self::Inconsistent(_)
            | Self::ShortPassphrase(_)
            | Self::PassphraseNeeded(_)
            | Self::OpenToOthers { .. }
            | Self::TooLong { .. }
            | Self::NotAKey { .. }
            | Self::Version { .. }
            | Self::Read { .. }
            | Self::NoEpoch(_) => ErrorKind::Input,
            Self::BadSignature
            | Self::BadAccountSignature
            | Self::BadCiphertext
            | Self::FalseName(_)
            | Self::WrongKey
            | Self::NotAccepted { .. }
            | Self::WrongPassphrase(_)
            | Self::Locked(_)
            | Self::Superseded { .. } => ErrorKind::Refused,
            Self::DamagedRecord(_) | Self::Tampered(_) | Self::NotAsked(_) | Self::DamagedKeyring(_) => {
                ErrorKind::Tampered
            }
            Self::Write { .. } => ErrorKind::Home,
            Self::Exists(_) => ErrorKind::Input,
        }
    }

    /// Something read is not what it should be.
    pub fn malformed(what: &'static str) -> impl Fn(WireError) -> Self {
        move |why| Self::Malformed { what, why }
    }

    /// A file could not be read.
    pub fn read(path: &Path) -> impl Fn(std::io::Error) -> Self {
        let path = shown(path);
        move |source| Self::Read { path: path.clone(), source }
    }

    /// A file could not be written.
    pub fn write(path: &Path) -> impl Fn(std::io::Error) -> Self {
        let path = shown(path);
        move |source| Self::Write { path: path.clone(), source }
    }
}

/// A path, cleaned for use in a message.
pub fn shown(path: &Path) -> String {
    clean(&PathBuf::from(path).display().to_string(), 240)
}
