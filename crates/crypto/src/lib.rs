//! SM2, SM3, SM4-GCM and HKDF-SM3, and what is built from them: records, envelopes, identities, and keys at rest. Three
//! providers compute the algorithms; nothing here knows ROS, the chain or the ledger.
#![doc = include_str!("../README.md")]
#![warn(missing_docs, clippy::missing_errors_doc)]

mod anchor_proof;
pub mod compression;
pub mod der;
#[cfg(test)]
mod differential_tests;
pub mod enrolment;
pub mod envelope;
mod erased;
pub mod error;
mod gateway_addresses;
mod gcm;
pub mod hands;
pub mod identity;
pub mod join_file;
pub mod kdf;
pub mod kernel;
pub mod keyfile;
pub mod keyring;
pub mod keystore;
pub mod merkle;
#[cfg(test)]
mod openssl_tests;
pub mod pool;
pub mod private_file;
pub mod provider;
#[cfg(test)]
mod readme_tests;
pub mod record;
mod robot_policy;
mod sealed_file;
pub mod sealed_stream;
pub mod secret;
mod sm2;
pub mod sm3;
mod sm4_gcm;
pub mod transport_file;
pub mod unfinished;
#[cfg(test)]
mod vector_tests;

use authros_model as model;

pub use crate::anchor_proof::AnchorProof;
pub use crate::der::{signature_der, signature_from_der};
pub use crate::enrolment::{
    Enrolment, EpochIssue, GatewayAccess, IssuedKeys, IssuedTopic, LastNotice, Notice, SealedEnrolment, SealingKey,
};
pub use crate::erased::ErasedStatement;
pub use crate::error::CryptoError;
pub(crate) use crate::error::Result;
pub use crate::gateway_addresses::GatewayAddresses;
pub use crate::identity::{
    AccountSignature, Ephemeral, TypedStructure, check_identity, keccak256, prove, recover_account, sign_hash,
};
pub use crate::join_file::{JoinFile, JoinKey};
pub use crate::kernel::{Kernel, KernelError};
pub use crate::keyring::{EpochSecret, EpochState, Keyring, NetworkKeys, PublicIdentity, UnlockedKeyring, read_public};
pub use crate::keystore::{OwnerKeyChange, open_transport_key, seal_transport_key};
pub use crate::provider::{Provider, ProviderName, provider};
pub use crate::record::{
    Anchor, Expected, Names, OpenedRecord, SealRequest, SealedRecord, Unchecked, check, check_alone, check_deleted,
    check_many, open, seal,
};
pub use crate::robot_policy::{LONGEST_POLICY, SignedPolicy};
pub use crate::sm2::verify_as_stranger;
pub use crate::sm3::{Sm3Hasher, sm3_many};
pub use authros_fault as fault;
pub use envelope::{GrantedKeys, WrappedKeys, hand_over, take_over, unwrap, wrap};
pub use kdf::{
    anchoring_secret, domain, epoch_key, filter_id, filter_key, hkdf_sm3, hmac_sm3, notice_key, notice_topic,
    signer_id, token, topic_filter_id, topic_id, topic_key,
};
pub use secret::{
    EoaSecret, EpochKey, EpochSalt, FilterKey, Fingerprint, FingerprintError, IndexKey, JoinSecret, Passphrase,
    SHORTEST_PASSPHRASE, Sm4Key, SmKeyPair, SmSecret, TopicKey, TransportKey, random_bytes,
};
