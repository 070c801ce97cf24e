//! An owner: a profile whose keyring is open in this site.

use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, HashMap};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::crypto::{
    CryptoError, EoaSecret, EpochKey, EpochSalt, EpochSecret, EpochState, IndexKey, NetworkKeys, Provider, SealingKey,
    SmKeyPair, UnlockedKeyring, WrappedKeys, epoch_key, token, topic_id,
};
use crate::model::{Address, Digest, Domain, ProfileName, PublicKey, Timestamp, Token, TopicId};

use super::epoch::EpochKeys;
use super::{Author, PipelineError};

/// A profile with its keys. Its address does not change while it is open.
pub struct Owner {
    /// Its name on this machine.
    pub profile: ProfileName,
    /// Its EOA.
    pub address: Address,
    /// Seals in its name.
    pub author: Arc<Author>,
    keyring: Mutex<UnlockedKeyring>,
    /// Envelopes opened so far, by SM3 of the envelope.
    pub(super) opened: Mutex<HashMap<Digest, Arc<WrappedKeys>>>,
    /// Changes of epochs, keys and grants happen one at a time.
    pub changes: tokio::sync::Mutex<()>,
    locked: AtomicBool,
}

impl Owner {
    /// An owner with an open keyring.
    pub fn new(profile: ProfileName, keyring: UnlockedKeyring) -> Self {
        let address = keyring.keyring.eoa.address();
        Self {
            profile,
            address,
            author: Arc::new(Author::new(address)),
            keyring: Mutex::new(keyring),
            opened: Mutex::default(),
            changes: tokio::sync::Mutex::default(),
            locked: AtomicBool::new(false),
        }
    }

    /// Whether the keys that decrypt, grant and revoke were wiped.
    pub fn is_locked(&self) -> bool {
        self.locked.load(Ordering::Acquire)
    }

    /// Wipes the keys that decrypt, grant and revoke from memory. Those that seal under the current epoch, sign records
    /// and pay for anchors stay, so that capture continues: d_C, IK, the epoch's key, the EOA.
    ///
    /// # Errors
    /// Errors of the random source; nothing is wiped then.
    pub fn lock(&self, provider: &dyn Provider) -> Result<(), CryptoError> {
        self.keyring().strip(provider)?;
        self.opened.lock().unwrap_or_else(PoisonError::into_inner).clear();
        self.locked.store(true, Ordering::Release);
        Ok(())
    }

    /// Restores the keys that [`Self::lock`] wiped.
    pub fn unlock(&self, keyring: UnlockedKeyring) {
        *self.keyring() = keyring;
        self.locked.store(false, Ordering::Release);
    }

    /// The keyring itself.
    pub fn keyring(&self) -> MutexGuard<'_, UnlockedKeyring> {
        self.keyring.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The EOA's key.
    pub fn eoa(&self) -> EoaSecret {
        self.keyring().keyring.eoa.clone()
    }

    /// P_C with d_C.
    pub fn signing(&self) -> SmKeyPair {
        self.keyring().keyring.signing.clone()
    }

    /// P_E with d_E.
    pub fn envelope(&self) -> SmKeyPair {
        self.keyring().keyring.envelope.clone()
    }

    /// P_E with d_E, and the pairs that replace it or that it replaced: they open what was encrypted to them.
    pub fn envelopes(&self) -> Vec<SmKeyPair> {
        let keyring = self.keyring();
        let further = &keyring.keyring.further;
        let others = further.next_envelope.iter().chain(further.envelopes.iter().rev());
        [&keyring.keyring.envelope].into_iter().chain(others).cloned().collect()
    }

    /// The identity of the gateway that this owner keeps: P_C with d_C as of its founding.
    pub fn gateway_identity(&self) -> SmKeyPair {
        let keyring = self.keyring();
        keyring.keyring.further.gateway.as_ref().unwrap_or(&keyring.keyring.signing).clone()
    }

    /// P_C and P_E.
    pub fn public_keys(&self) -> (PublicKey, PublicKey) {
        let keyring = self.keyring();
        (keyring.keyring.signing.public, keyring.keyring.envelope.public)
    }

    /// IK.
    pub fn index(&self) -> IndexKey {
        self.keyring().keyring.index.clone()
    }

    /// The pseudonym of a topic.
    pub fn topic_id(&self, topic: &str) -> TopicId {
        topic_id(&self.keyring().keyring.index, topic)
    }

    /// The keys that seal new records; `None` until an epoch was begun or resumed.
    pub fn sealing(&self) -> Option<Arc<EpochKeys>> {
        self.author.sealing()
    }

    /// The key of an epoch of this owner on a network, if the keyring has it.
    pub fn epoch_key(&self, domain: Domain, epoch: u64) -> Option<EpochKey> {
        let keyring = self.keyring();
        let secret = keyring.keyring.networks.get(&domain).and_then(|network| network.epochs.get(&epoch))?;
        Some(epoch_key(&secret.sm4, secret.salt.expose(), &domain, &self.address, epoch))
    }

    /// Numbers of the epochs in the keyring, oldest first.
    pub fn epochs(&self, domain: Domain) -> Vec<u64> {
        let keyring = self.keyring();
        keyring
            .keyring
            .networks
            .get(&domain)
            .map(|network| network.epochs.keys().copied().collect())
            .unwrap_or_default()
    }

    /// Token of an epoch in the keyring.
    pub fn token(&self, domain: Domain, epoch: u64) -> Option<Token> {
        self.epoch_key(domain, epoch).map(|key| token(&domain, &self.address, epoch, &key))
    }

    /// Makes sure that `epoch` has a secret in the keyring, saved before it is used, and returns its token. An epoch
    /// already begun but not yet on the chain keeps its secret.
    ///
    /// # Errors
    /// Errors of the random source and of saving the keyring.
    pub fn prepare_epoch(&self, domain: Domain, epoch: u64) -> Result<Token, PipelineError> {
        {
            let mut keyring = self.keyring();
            let sm4 = keyring.keyring.sm4.clone();
            let network = keyring
                .keyring
                .networks
                .entry(domain)
                .or_insert_with(|| NetworkKeys { epochs: BTreeMap::new(), current: 0 });
            if let Entry::Vacant(place) = network.epochs.entry(epoch) {
                place.insert(EpochSecret { salt: EpochSalt::generate()?, sm4, state: EpochState::Pending });
                if let Err(error) = keyring.save() {
                    // What is not on disk must not count as saved the next time.
                    if let Some(network) = keyring.keyring.networks.get_mut(&domain) {
                        network.epochs.remove(&epoch);
                    }
                    return Err(error.into());
                }
            }
        }
        self.token(domain, epoch).ok_or(PipelineError::UnknownEpoch(epoch))
    }

    /// From now on records are sealed under `epoch`, which is in the keyring.
    ///
    /// # Errors
    /// If the keyring has no such epoch, or cannot be saved.
    pub fn seal_under(&self, domain: Domain, epoch: u64) -> Result<(), PipelineError> {
        self.author.seal_under(self.epoch_keys(domain, epoch)?);
        Ok(())
    }

    /// From `moment` on records are sealed under `epoch`, which is in the keyring; of two such moments
    /// the earlier counts.
    ///
    /// # Errors
    /// If the keyring has no such epoch, or cannot be saved.
    pub fn seal_from(&self, moment: Timestamp, domain: Domain, epoch: u64) -> Result<(), PipelineError> {
        self.author.seal_from(moment, self.epoch_keys(domain, epoch)?);
        Ok(())
    }

    fn epoch_keys(&self, domain: Domain, epoch: u64) -> Result<Arc<EpochKeys>, PipelineError> {
        let key = self.epoch_key(domain, epoch).ok_or(PipelineError::UnknownEpoch(epoch))?;
        let token = token(&domain, &self.address, epoch, &key);
        let key = SealingKey::Epoch(key);
        Ok(Arc::new(EpochKeys::new(domain, (epoch, token), self.signing(), key, self.index())))
    }

    /// Whether an epoch of this owner was seen on the chain.
    pub fn has_registered_epoch(&self, domain: Domain) -> bool {
        let keyring = self.keyring();
        let network = keyring.keyring.networks.get(&domain);
        network.is_some_and(|network| network.epochs.values().any(|secret| matches!(secret.state, EpochState::Active)))
    }

    /// The chain has this epoch: records that in the keyring.
    ///
    /// # Errors
    /// Errors of saving the keyring.
    pub fn confirm_epoch(&self, domain: Domain, epoch: u64) -> Result<(), CryptoError> {
        let mut keyring = self.keyring();
        let Some(network) = keyring.keyring.networks.get_mut(&domain) else { return Ok(()) };
        let Some(secret) = network.epochs.get_mut(&epoch) else { return Ok(()) };
        if network.current == epoch && matches!(secret.state, EpochState::Active) {
            return Ok(());
        }
        secret.state = EpochState::Active;
        network.current = network.current.max(epoch);
        keyring.save()
    }
}
