//! What can go wrong between capture and verification.

use crate::chain::{ChainError, Shortfall};
use crate::model::{Address, Digest, ErrorKind};
use crate::store::{Retained, StoreError};
use crate::{authority::NoRight, crypto::CryptoError, ros::RosError};

/// The outcome of a worker's step.
pub type Result<T, E = PipelineError> = std::result::Result<T, E>;

#[derive(Debug, thiserror::Error)]
pub enum PipelineError {
    #[error(transparent)]
    Crypto(#[from] CryptoError),
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error(transparent)]
    Chain(#[from] ChainError),
    #[error(transparent)]
    Ros(#[from] RosError),
    #[error("{0} is not registered on this contract; its owner runs `authros identity register` first")]
    Unregistered(Address),
    #[error(
        "the identity that {0} registered is invalid, so it counts as unregistered; ask its owner to register again"
    )]
    BadIdentity(Address),
    #[error("{owner} does not share {what} with {reader}; ask for `authros grant add {reader}`")]
    NotGranted { owner: Address, reader: Address, what: String },
    #[error("there is no record '{0}' here; `authros records list` and `authros received list` show all")]
    NoRecord(String),
    #[error(
        "the ledger was altered: record {id} differs from its row in its {field}, so it is not shown; `authros audit` \
         lists every such row; restore the ledger from a backup"
    )]
    RowDiffers { id: String, field: &'static str },
    #[error(
        "the ciphertext of record {0} is missing from the store; restore it from a backup (its digest is still on the \
         chain)"
    )]
    Missing(String),
    #[error(
        "the ciphertext of record {0} was deleted by retention (see retention record {1} on the chain); its header, \
         signature and proof remain, its message does not"
    )]
    Deleted(String, Digest),
    #[error(
        "record {id} was {erasure} (see retention record {report} on the chain); its header, signature and proof remain, \
         its message does not"
    )]
    Erased {
        id: String,
        /// `erased`, when, by whom and why.
        erasure: String,
        report: Digest,
    },
    #[error(
        "the keyring has no key of epoch {0}; it is fetched once the chain answers, or restore a newer keyring of this profile"
    )]
    UnknownEpoch(u64),
    #[error(
        "the chain has newer SM2 keys of {0} than the keyring, and none of its keys opens them; restore a newer keyring of \
         this profile"
    )]
    NoHandover(Address),
    #[error("there is no key for topic {0} here, so it is not captured; enrol again with `--topic` for it")]
    Uncovered(String),
    #[error("the contract refused {purpose}: {reason}")]
    Reverted { purpose: String, reason: String },
    #[error("{0}, then repeat the command")]
    NoEther(Shortfall),
    #[error(
        "{purpose} was sent but is not in a block yet ({why}); it is stored and will be resent, see `authros chain status`"
    )]
    NotMined { purpose: String, why: String },
    #[error(
        "{0} was cancelled with `authros chain cancel`; it had no effect; repeat the command if it is still wanted"
    )]
    Cancelled(String),
    #[error("the chain changed while it was being read; it is read again; check that all nodes behind the URL agree")]
    Unsteady,
    #[error(
        "the node reports block {head} but does not return block {block}: it is behind, or several nodes answer at its \
         URL and not all are up to date; its answers are ignored until it has caught up; check that node"
    )]
    NodeBehind { block: u64, head: u64 },
    #[error("record {id} is not verified: {why}; ask its owner whether it has been anchored again since")]
    NoRight { id: String, why: Box<NoRight> },
    #[error(
        "the contract {claim}, and its events up to block {block} say otherwise; a grant or revoke may have just been \
         mined, so repeat the command; if the answer stays, do not trust this node: ask another one with `--chain URL`"
    )]
    Contradicted { claim: String, block: u64 },
    #[error("{0}")]
    Refused(String),
}

impl PipelineError {
    pub fn gone(id: &str, retained: Retained) -> Self {
        let (id, report) = (id.to_owned(), retained.report);
        match retained.erased {
            Some(erasure) => Self::Erased { id, erasure: erasure.to_string(), report },
            None => Self::Deleted(id, report),
        }
    }

    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Crypto(error) => error.kind(),
            Self::Store(error) => error.kind(),
            Self::Chain(error) => error.kind(),
            Self::Ros(error) => error.kind(),
            Self::NoRecord(_) => ErrorKind::Input,
            Self::Missing(_) | Self::RowDiffers { .. } | Self::NoRight { .. } => ErrorKind::Tampered,
            Self::NotMined { .. } | Self::Unsteady | Self::NodeBehind { .. } => ErrorKind::Incomplete,
            Self::Unregistered(_)
            | Self::BadIdentity(_)
            | Self::NotGranted { .. }
            | Self::Deleted(..)
            | Self::Erased { .. }
            | Self::UnknownEpoch(_)
            | Self::NoHandover(_)
            | Self::Uncovered(_)
            | Self::Reverted { .. }
            | Self::NoEther(_)
            | Self::Cancelled(_)
            | Self::Contradicted { .. }
            | Self::Refused(_) => ErrorKind::Refused,
        }
    }
}
