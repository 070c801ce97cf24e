//! The keys of one profile: EOA, the two SM2 pairs, K_C, IK, and the key of every epoch on every network. The file
//! format is in `file`; what is registered on the chain is not known here.

use std::collections::BTreeMap;

use crate::model::{Address, Domain, PublicKey, Token};

use super::{CryptoError, EoaSecret, EpochKey, EpochSalt, IndexKey, Provider, Sm4Key, SmKeyPair, epoch_key, token};

mod file;

pub use file::{UnlockedKeyring, read_public};

/// Whether the chain knows an epoch's token.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EpochState {
    /// Its transaction is not confirmed.
    Pending,
    /// It is registered.
    Active,
}

/// The key of an epoch.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EpochSecret {
    /// EK.
    pub key: EpochKey,
    /// Whether the chain knows it.
    pub state: EpochState,
}

impl EpochSecret {
    /// The key of an epoch that begins, from K_C and a fresh salt, which is needed only here.
    ///
    /// # Errors
    /// [`CryptoError::Random`] if the random source fails.
    pub fn begin(sm4: &Sm4Key, domain: &Domain, owner: &Address, epoch: u64) -> Result<Self, CryptoError> {
        let salt = EpochSalt::generate()?;
        Ok(Self { key: epoch_key(sm4, salt.expose(), domain, owner, epoch), state: EpochState::Pending })
    }
}

/// The epochs of a profile on one network.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct NetworkKeys {
    /// Every epoch so far.
    pub epochs: BTreeMap<u64, EpochSecret>,
    /// The epoch that seals new records; 0 before the first.
    pub current: u64,
}

/// What is readable of a profile without its passphrase.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PublicIdentity {
    /// The EOA's address.
    pub address: Address,
    /// P_C.
    pub signing: PublicKey,
    /// P_E.
    pub envelope: PublicKey,
}

/// SM2 pairs of a profile other than the two in use.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct FurtherPairs {
    /// Former (d_E, P_E), oldest first: they open what was encrypted to them.
    pub envelopes: Vec<SmKeyPair>,
    /// The next (d_C, P_C), to be used once the chain has it: robots may know it already.
    pub next_signing: Option<SmKeyPair>,
    /// The next (d_E, P_E), to be used once the chain has it.
    pub next_envelope: Option<SmKeyPair>,
    /// The identity of the gateway that this profile keeps, if (d_C, P_C) has changed since the gateway was founded.
    pub gateway: Option<SmKeyPair>,
}

/// All secrets of one profile.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Keyring {
    /// The Ethereum account.
    pub eoa: EoaSecret,
    /// (d_C, P_C): signs.
    pub signing: SmKeyPair,
    /// (d_E, P_E): opens envelopes.
    pub envelope: SmKeyPair,
    /// K_C for future epochs.
    pub sm4: Sm4Key,
    /// IK.
    pub index: IndexKey,
    /// Epochs by network.
    pub networks: BTreeMap<Domain, NetworkKeys>,
    /// Former and future pairs.
    pub further: FurtherPairs,
}

impl Keyring {
    /// Fresh keys, with no network yet.
    ///
    /// # Errors
    /// [`CryptoError::Random`] if the random source fails.
    pub fn generate(provider: &dyn Provider) -> Result<Self, CryptoError> {
        Ok(Self {
            eoa: EoaSecret::generate()?,
            signing: SmKeyPair::generate(provider)?,
            envelope: SmKeyPair::generate(provider)?,
            sm4: Sm4Key::generate()?,
            index: IndexKey::generate()?,
            networks: BTreeMap::new(),
            further: FurtherPairs::default(),
        })
    }

    /// The public part.
    pub fn public(&self) -> PublicIdentity {
        PublicIdentity { address: self.eoa.address(), signing: self.signing.public, envelope: self.envelope.public }
    }

    /// Notes that the chain confirmed an epoch's token.
    ///
    /// # Errors
    /// [`CryptoError::NoEpoch`] if the keyring lacks the epoch.
    pub fn confirm_epoch(&mut self, domain: &Domain, epoch: u64) -> Result<(), CryptoError> {
        let network = self.networks.get_mut(domain).ok_or(CryptoError::NoEpoch(epoch))?;
        let secret = network.epochs.get_mut(&epoch).ok_or(CryptoError::NoEpoch(epoch))?;
        secret.state = EpochState::Active;
        Ok(())
    }

    /// EK of any past or present epoch, derived again.
    ///
    /// # Errors
    /// [`CryptoError::NoEpoch`] if the keyring lacks the epoch.
    pub fn epoch_key(&self, domain: &Domain, epoch: u64) -> Result<EpochKey, CryptoError> {
        let secret = self.networks.get(domain).and_then(|network| network.epochs.get(&epoch));
        Ok(secret.ok_or(CryptoError::NoEpoch(epoch))?.key.clone())
    }

    /// The token of an epoch.
    ///
    /// # Errors
    /// [`CryptoError::NoEpoch`] if the keyring lacks the epoch.
    pub fn token(&self, domain: &Domain, epoch: u64) -> Result<Token, CryptoError> {
        Ok(token(domain, &self.eoa.address(), epoch, &self.epoch_key(domain, epoch)?))
    }
}

#[cfg(test)]
mod tests;
