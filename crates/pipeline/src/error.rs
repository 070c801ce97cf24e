//! What can go wrong between capture and verification.

use crate::chain::{ChainError, Shortfall};
use crate::crypto::CryptoError;
use crate::model::{Address, Digest, ErrorKind};
use crate::ros::RosError;
use crate::store::{Retained, StoreError};

use super::authority::NoRight;

/// A failure of a worker or of a request that a worker serves.
#[derive(Debug, thiserror::Error)]
pub enum PipelineError {
    /// A key, seal or signature.
    #[error(transparent)]
    Crypto(#[from] CryptoError),
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error(transparent)]
    Chain(#[from] ChainError),
    /// The account has not registered an identity on the contract.
    #[error(transparent)]
    Ros(#[from] RosError),
    /// The account's identity on the chain has no valid proof.
    #[error("{0} is not registered on this contract; its owner runs `authros register` first")]
    Unregistered(Address),
    /// No grant covers the request.
    #[error(
        "the identity that {0} registered is invalid, so it counts as unregistered; ask its owner to register again"
    )]
    BadIdentity(Address),
    /// The owner, who would have to grant access.
    #[error("{owner} does not share {what} with {reader}; ask for `authros grant {reader}`")]
    NotGranted { owner: Address, reader: Address, what: String },
    /// There is no such record, or it is not shared.
    #[error("there is no record '{0}' here; `authros uploads list` and `authros shared list` show those there are")]
    NoRecord(String),
    /// The ledger contradicts a record's signed header or sealed head.
    #[error(
        "the ledger was altered: record {id} differs from its row in its {field}, so it is not shown; `authros audit` \
         lists every such row; restore the ledger from a backup"
    )]
    RowDiffers { id: String, field: &'static str },
    /// The store no longer holds a record.
    #[error(
        "the ciphertext of record {0} is missing from the store; restore it from a backup (its digest is still on the \
         chain)"
    )]
    Missing(String),
    /// Retention has deleted a record's ciphertext.
    #[error(
        "the ciphertext of record {0} was deleted by retention (see retention record {1} on the chain); its header, \
         signature and proof remain, its message does not"
    )]
    Deleted(String, Digest),
    /// Somebody had a record's ciphertext erased.
    #[error(
        "record {id} was {erasure} (see retention record {report} on the chain); its header, signature and proof remain, \
         its message does not"
    )]
    Erased {
        id: String,
        /// `erased`, when, by whom and why.
        erasure: String,
        /// The retention record that names it.
        report: Digest,
    },
    /// The keyring lacks the key of an epoch.
    #[error(
        "the keyring has no key of epoch {0}; it is fetched once the chain answers, or restore a newer keyring of this profile"
    )]
    UnknownEpoch(u64),
    /// The chain has newer SM2 pairs of an account than its keyring, and no key of the keyring leads to them.
    #[error(
        "the chain has newer SM2 keys of {0} than the keyring, and none of its keys opens them; restore a newer keyring of \
         this profile"
    )]
    NoHandover(Address),
    /// A topic whose key was not issued.
    #[error("there is no key for topic {0} here, so it is not captured; enrol again with `--topic` for it")]
    Uncovered(String),
    /// A transaction was mined and reverted.
    #[error("the contract refused {purpose}: {reason}")]
    Reverted {
        /// The purpose of the transaction.
        purpose: String,
        /// The contract's words, cleaned.
        reason: String,
    },
    /// The account cannot pay for gas.
    #[error("{0}, then repeat the command")]
    NoEther(Shortfall),
    /// A transaction was not mined in time; it stays stored and is sent again.
    #[error(
        "{purpose} was sent but is not in a block yet ({why}); it is stored and will be resent, see `authros chain status`"
    )]
    NotMined {
        /// The purpose of the transaction.
        purpose: String,
        /// What holds it up, as far as is known.
        why: String,
    },
    /// Somebody cancelled a transaction.
    #[error(
        "{0} was cancelled with `authros chain cancel`; it had no effect; repeat the command if it is still wanted"
    )]
    Cancelled(String),
    /// The chain kept changing while it was read.
    #[error("the chain changed while it was being read; it is read again; check that all nodes behind the URL agree")]
    Unsteady,
    /// The node has not what it named, or what it had before.
    #[error(
        "the node names block {head} and does not give block {block}: it is behind, or several nodes answer at its URL and \
         not all are up to date; nothing is decided by it until it has caught up; check that node"
    )]
    NodeBehind {
        /// The block that is not there, or not whole.
        block: u64,
        /// The newest block, as the node says.
        head: u64,
    },
    /// A record whose signer had no right at the block that anchors it.
    #[error("record {id} is not verified: {why}; ask its owner whether it has been anchored again since")]
    NoRight { id: String, why: Box<NoRight> },
    /// The contract's answer about a reader differs from what its events say.
    #[error(
        "the contract {claim}, and its events up to block {block} say otherwise; a grant or revoke may have just been \
         mined, so repeat the command; if the answer stays, do not trust this node: ask another one with `--chain URL`"
    )]
    Contradicted {
        /// What the contract answers.
        claim: String,
        /// The newest block whose events are known here.
        block: u64,
    },
    /// A grant or revoke that the present state does not allow.
    #[error("{0}")]
    Refused(String),
}

impl PipelineError {
    /// That a record's ciphertext is gone, as its retention record says.
    pub fn gone(id: &str, retained: Retained) -> Self {
        let (id, report) = (id.to_owned(), retained.report);
        match retained.erased {
            Some(erasure) => Self::Erased { id, erasure: erasure.to_string(), report },
            None => Self::Deleted(id, report),
        }
    }

    /// Determines the exit code.
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Crypto(error) => error.kind(),
            Self::Store(error) => error.kind(),
            Self::Chain(error) => error.kind(),
            Self::Ros(error) => error.kind(),
            Self::NoEther(_) | Self::Unregistered(_) | Self::BadIdentity(_) | Self::NotGranted { .. } => {
                ErrorKind::Refused
            }
            Self::Cancelled(_) | Self::Reverted { .. } | Self::Contradicted { .. } | Self::Refused(_) => {
                ErrorKind::Refused
            }
            Self::NoRecord(_) => ErrorKind::Input,
            Self::Missing(_) | Self::RowDiffers { .. } | Self::NoRight { .. } => ErrorKind::Tampered,
            Self::Deleted(..) | Self::Erased { .. } => ErrorKind::Refused,
            Self::UnknownEpoch(_) | Self::NoHandover(_) | Self::Uncovered(_) => ErrorKind::Refused,
            Self::NotMined { .. } | Self::Unsteady | Self::NodeBehind { .. } => ErrorKind::Incomplete,
        }
    }
}
