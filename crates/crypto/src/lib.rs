//! SM2, SM3, SM4-GCM and HKDF-SM3, and what is built from them: records, envelopes, identities, and keys at rest. Three
//! providers compute the algorithms; nothing here knows ROS, the chain or the ledger.
#![doc = include_str!("../README.md")]

use crate as crypto;
pub use authros_fault as fault;
use authros_model as model;

pub mod account;
pub mod agreement;
mod authros_provider;
pub mod compression;
pub mod der;
pub mod derive;
pub mod enrolment;
pub mod envelope;
mod erased;
pub mod error;
mod file_key;
mod gateway_addresses;
mod gcm;
pub mod handover;
pub mod identity;
pub mod kdf;
pub mod kept_key;
pub mod kernel;
pub mod keyfile;
pub mod keyring;
pub mod keystore;
mod libsm_provider;
pub mod merkle;
pub mod owner_key;
pub mod passphrase;
pub mod pool;
pub mod private_file;
pub mod provider;
pub mod random;
pub mod record;
mod robot_policy;
mod rustcrypto;
pub mod sealed_stream;
pub mod secret;
mod sm2;
pub mod sm3;
mod sm4_gcm;
pub mod transport_file;
pub mod unfinished;

#[cfg(test)]
mod differential_tests;
#[cfg(test)]
mod openssl_tests;
#[cfg(test)]
mod readme_tests;
#[cfg(test)]
mod vector_tests;

pub use account::{AccountSignature, TypedStructure, keccak256, recover_account, sign_hash};
pub use agreement::Ephemeral;
pub use der::{signature_der, signature_from_der};
pub use derive::{
    anchoring_secret, domain, epoch_key, filter_id, filter_key, notice_key, notice_topic, signer_id, token,
    topic_filter_id, topic_id, topic_key,
};
pub use enrolment::{
    Enrolment, EpochIssue, GatewayAccess, IssuedKeys, IssuedTopic, LastNotice, Notice, SealedEnrolment, SealingKey,
};
pub use envelope::{GrantedKeys, WrappedKeys, unwrap, wrap};
pub use erased::ErasedStatement;
pub use error::CryptoError;
pub use gateway_addresses::GatewayAddresses;
pub use handover::{hand_over, take_over};
pub use identity::{check_identity, prove};
pub use kdf::{hkdf_sm3, hmac_sm3};
pub use kept_key::{open_transport_key, seal_transport_key};
pub use kernel::{Kernel, KernelError};
pub use keyring::{EpochSecret, EpochState, Keyring, NetworkKeys, PublicIdentity, UnlockedKeyring, read_public};
pub use owner_key::OwnerKeyChange;
pub use passphrase::Passphrase;
pub use provider::{Provider, ProviderName, provider};
pub use random::random_bytes;
pub use record::{
    Anchor, Expected, Names, OpenedRecord, SealRequest, SealedRecord, Unchecked, check, check_alone, check_deleted,
    check_many, open, seal,
};
pub use robot_policy::{LONGEST_POLICY, SignedPolicy};
pub use secret::{
    EoaSecret, EpochKey, EpochSalt, FilterKey, Fingerprint, FingerprintError, IndexKey, Sm4Key, SmKeyPair, SmSecret,
    TopicKey, TransportKey,
};
pub use sm2::verify_as_stranger;
pub use sm3::{Sm3Hasher, sm3_many};
