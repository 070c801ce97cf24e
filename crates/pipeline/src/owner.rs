//! An owner: a profile whose keyring is open in this site.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::crypto::{
    CryptoError, Enrolment, EoaSecret, EpochKey, EpochSecret, EpochState, IndexKey, NetworkKeys, Provider, SealingKey,
    SmKeyPair, UnlockedKeyring, WrappedKeys, token, topic_id,
};
use crate::model::{Address, Digest, Domain, ProfileName, PublicKey, Timestamp, Token, TopicId};
use crate::{PipelineError, Result, epoch::EpochKeys, model::steady_clock::steady_now};

/// Its address does not change while it is open.
pub struct Owner {
    /// Its name on this machine.
    pub profile: ProfileName,
    pub address: Address,
    pub author: Arc<Author>,
    keyring: Arc<Mutex<UnlockedKeyring>>,
    /// Envelopes opened so far, by SM3 of the envelope.
    pub(super) opened: Mutex<HashMap<Digest, Arc<WrappedKeys>>>,
    /// Changes of epochs, keys and grants happen one at a time.
    pub changes: Arc<tokio::sync::Mutex<()>>,
    locked: Arc<AtomicBool>,
}

impl Owner {
    pub fn new(profile: ProfileName, keyring: UnlockedKeyring) -> Self {
        Self::of(profile, Arc::new(Mutex::new(keyring)), Arc::default(), Arc::default())
    }

    /// The owner of the same keyring after its account changed. Both share the one copy of the keys, so neither can save
    /// an older one over the other's.
    #[must_use]
    pub fn with_new_account(&self) -> Self {
        let (keyring, changes) = (Arc::clone(&self.keyring), Arc::clone(&self.changes));
        Self::of(self.profile.clone(), keyring, changes, Arc::clone(&self.locked))
    }

    fn of(
        profile: ProfileName,
        keyring: Arc<Mutex<UnlockedKeyring>>,
        changes: Arc<tokio::sync::Mutex<()>>,
        locked: Arc<AtomicBool>,
    ) -> Self {
        let address = keyring.lock().unwrap_or_else(PoisonError::into_inner).keys().eoa.address();
        let author = Arc::new(Author::new(address));
        Self { profile, address, author, keyring, opened: Mutex::default(), changes, locked }
    }

    /// Whether the keys that decrypt, grant and revoke were wiped.
    pub fn is_locked(&self) -> bool {
        self.locked.load(Ordering::Acquire)
    }

    /// Wipes the keys that decrypt, grant and revoke from memory. Those that seal under the current epoch, sign records
    /// and pay for anchors stay, so that capture continues: d_C, IK, the epoch's key, the EOA.
    pub fn lock(&self, provider: &dyn Provider) -> Result<(), CryptoError> {
        let mut keyring = self.keyring();
        keyring.strip(provider)?;
        self.opened.lock().unwrap_or_else(PoisonError::into_inner).clear();
        self.locked.store(true, Ordering::Release);
        Ok(())
    }

    /// Restores the keys that [`Self::lock`] wiped. Keys that are not wiped stay: a copy of the file is never newer.
    pub fn unlock(&self, keyring: UnlockedKeyring) {
        let mut held = self.keyring();
        if self.is_locked() {
            *held = keyring;
            self.locked.store(false, Ordering::Release);
        }
    }

    pub fn keyring(&self) -> MutexGuard<'_, UnlockedKeyring> {
        self.keyring.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn eoa(&self) -> EoaSecret {
        self.keyring().keys().eoa.clone()
    }

    pub fn signing(&self) -> SmKeyPair {
        self.keyring().keys().signing.clone()
    }

    pub fn envelope(&self) -> SmKeyPair {
        self.keyring().keys().envelope.clone()
    }

    /// P_E with d_E, and the pairs that replace it or that it replaced: they open what was encrypted to them.
    pub fn envelopes(&self) -> Vec<SmKeyPair> {
        let keyring = self.keyring();
        let further = &keyring.keys().further;
        let others = further.next_envelope.iter().chain(further.envelopes.iter().rev());
        [&keyring.keys().envelope].into_iter().chain(others).cloned().collect()
    }

    /// The identity of the gateway that this owner keeps: P_C with d_C as of its founding.
    pub fn gateway_identity(&self) -> SmKeyPair {
        let keyring = self.keyring();
        keyring.keys().further.gateway.as_ref().unwrap_or(&keyring.keys().signing).clone()
    }

    pub fn public_keys(&self) -> (PublicKey, PublicKey) {
        let keyring = self.keyring();
        (keyring.keys().signing.public, keyring.keys().envelope.public)
    }

    /// P_C and P_E once a change of the pairs that was begun is finished.
    pub fn next_public_keys(&self) -> (PublicKey, PublicKey) {
        let keyring = self.keyring();
        let (keys, further) = (keyring.keys(), &keyring.keys().further);
        let signing = further.next_signing.as_ref().unwrap_or(&keys.signing);
        (signing.public, further.next_envelope.as_ref().unwrap_or(&keys.envelope).public)
    }

    /// Saves pairs as the next ones, in place of any others, and those between as former ones.
    pub fn note_pairs(
        &self,
        signing: SmKeyPair,
        envelope: SmKeyPair,
        between: Vec<(SmKeyPair, SmKeyPair)>,
    ) -> Result<(), CryptoError> {
        self.keyring().change(|keys| {
            for (_, former) in between {
                let further = &mut keys.further.envelopes;
                if former != keys.envelope && former != envelope && !further.contains(&former) {
                    further.push(former);
                }
            }
            keys.further.next_signing = Some(signing).filter(|pair| *pair != keys.signing);
            keys.further.next_envelope = Some(envelope).filter(|pair| *pair != keys.envelope);
            Ok(())
        })
    }

    pub fn index(&self) -> IndexKey {
        self.keyring().keys().index.clone()
    }

    pub fn topic_id(&self, topic: &str) -> TopicId {
        topic_id(&self.keyring().keys().index, topic)
    }

    pub fn sealing(&self) -> Option<Arc<EpochKeys>> {
        self.author.sealing()
    }

    pub fn epoch_key(&self, domain: Domain, epoch: u64) -> Option<EpochKey> {
        let keyring = self.keyring();
        let secret = keyring.keys().networks.get(&domain).and_then(|network| network.epochs.get(&epoch))?;
        Some(secret.key.clone())
    }

    pub fn domains(&self) -> Vec<Domain> {
        let keyring = self.keyring();
        let used = keyring.keys().networks.iter().filter(|(_, network)| !network.epochs.is_empty());
        used.map(|(domain, _)| *domain).collect()
    }

    /// Numbers of the epochs in the keyring, oldest first.
    pub fn epochs(&self, domain: Domain) -> Vec<u64> {
        let keyring = self.keyring();
        let network = keyring.keys().networks.get(&domain);
        network.map(|network| network.epochs.keys().copied().collect()).unwrap_or_default()
    }

    pub fn token(&self, domain: Domain, epoch: u64) -> Option<Token> {
        self.epoch_key(domain, epoch).map(|key| token(&domain, &self.address, epoch, &key))
    }

    /// Makes sure that `epoch` has a secret in the keyring, saved before it is used, and returns its token. An epoch
    /// already begun but not yet on the chain keeps its secret.
    pub fn prepare_epoch(&self, domain: Domain, epoch: u64) -> Result<Token> {
        {
            let mut keyring = self.keyring();
            let has_it = |network: &NetworkKeys| network.epochs.contains_key(&epoch);
            if !keyring.keys().networks.get(&domain).is_some_and(has_it) {
                keyring.change(|keys| {
                    let secret = EpochSecret::begin(&keys.sm4, &domain, &self.address, epoch)?;
                    keys.networks.entry(domain).or_default().epochs.insert(epoch, secret);
                    Ok(())
                })?;
            }
        }
        self.token(domain, epoch).ok_or(PipelineError::UnknownEpoch(epoch))
    }

    pub fn seal_under(&self, domain: Domain, epoch: u64) -> Result<()> {
        self.author.seal_under(self.epoch_keys(domain, epoch)?);
        Ok(())
    }

    /// Of two such moments the earlier counts.
    pub fn seal_from(&self, moment: Timestamp, domain: Domain, epoch: u64) -> Result<()> {
        self.author.seal_from(moment, self.epoch_keys(domain, epoch)?);
        Ok(())
    }

    fn epoch_keys(&self, domain: Domain, epoch: u64) -> Result<Arc<EpochKeys>> {
        let key = self.epoch_key(domain, epoch).ok_or(PipelineError::UnknownEpoch(epoch))?;
        let token = token(&domain, &self.address, epoch, &key);
        let key = SealingKey::Epoch(key);
        Ok(Arc::new(EpochKeys::new(domain, (epoch, token), self.signing(), key, self.index())))
    }

    /// Token of the epoch that the keyring takes for the current one; the chain need not be known.
    pub fn current_token(&self, domain: Domain) -> Option<Token> {
        let current = self.keyring().keys().networks.get(&domain).map(|network| network.current);
        current.and_then(|epoch| self.token(domain, epoch))
    }

    /// Whether an epoch of this owner was seen on the chain.
    pub fn has_registered_epoch(&self, domain: Domain) -> bool {
        self.confirmed_epoch(domain) > 0
    }

    /// The last epoch of this owner that was seen on the chain; 0 if none was.
    pub fn confirmed_epoch(&self, domain: Domain) -> u64 {
        let keyring = self.keyring();
        let Some(network) = keyring.keys().networks.get(&domain) else { return 0 };
        let seen = network.epochs.iter().filter(|(_, secret)| matches!(secret.state, EpochState::Active));
        seen.map(|(epoch, _)| *epoch).max().unwrap_or(0)
    }

    /// Saves keys of epochs that the chain returned, over any other of the same epochs, and IK if one came with them.
    pub fn adopt(&self, domain: Domain, new: Vec<(u64, EpochKey)>, index: Option<IndexKey>) -> Result<(), CryptoError> {
        self.keyring().change(|keys| {
            let network = keys.networks.entry(domain).or_default();
            for (epoch, key) in new {
                network.epochs.insert(epoch, EpochSecret { key, state: EpochState::Active });
            }
            if let Some(index) = index {
                keys.index = index;
            }
            Ok(())
        })
    }

    pub fn confirm_epoch(&self, domain: Domain, epoch: u64) -> Result<(), CryptoError> {
        let mut keyring = self.keyring();
        let Some(network) = keyring.keys().networks.get(&domain) else { return Ok(()) };
        let Some(secret) = network.epochs.get(&epoch) else { return Ok(()) };
        if network.current == epoch && matches!(secret.state, EpochState::Active) {
            return Ok(());
        }
        keyring.change(|keys| {
            keys.confirm_epoch(&domain, epoch)?;
            let network = keys.networks.entry(domain).or_default();
            network.current = network.current.max(epoch);
            Ok(())
        })
    }
}

// The owner for whom messages are sealed, with the keys, of a keyring or an enrolment, and when each takes effect.

pub struct Author {
    pub address: Address,
    sealing: Mutex<Sealing>,
}

#[derive(Default)]
struct Sealing {
    keys: Option<Arc<EpochKeys>>,
    next: Option<(Timestamp, Arc<EpochKeys>)>,
}

impl Author {
    pub fn new(address: Address) -> Self {
        Self { address, sealing: Mutex::default() }
    }

    /// `None` before the first keys and after the last have ended. A message captured after the moment of
    /// [`Self::seal_from`] is never sealed under the earlier keys, even if nothing ran at that moment.
    pub fn sealing(&self) -> Option<Arc<EpochKeys>> {
        let mut sealing = self.lock();
        if let Some((_, keys)) = sealing.next.take_if(|(from, _)| steady_now() >= *from) {
            sealing.keys = Some(keys);
        }
        sealing.keys.as_ref().filter(|keys| keys.ends.is_none_or(|ends| steady_now() < ends)).cloned()
    }

    fn lock(&self) -> MutexGuard<'_, Sealing> {
        self.sealing.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn next(&self) -> Option<(Timestamp, Arc<EpochKeys>)> {
        self.lock().next.clone()
    }

    /// Takes the keys that an owner sent to a device: the present ones, and others from a future moment.
    pub fn obey(&self, enrolment: &Enrolment) {
        self.seal_under(Arc::new(EpochKeys::issued(enrolment, &enrolment.keys.now)));
        if let Some((moment, next)) = &enrolment.keys.next {
            self.seal_from(*moment, Arc::new(EpochKeys::issued(enrolment, next)));
        }
    }

    pub fn seal_under(&self, keys: Arc<EpochKeys>) {
        *self.lock() = Sealing { keys: Some(keys), next: None };
    }

    pub fn rest(&self) {
        *self.lock() = Sealing::default();
    }

    /// From `moment` on records are sealed with these keys, unless those of the same or a later epoch are already in
    /// use; of two such moments the earlier counts.
    pub fn seal_from(&self, moment: Timestamp, keys: Arc<EpochKeys>) {
        let mut sealing = self.lock();
        if sealing.keys.as_ref().is_some_and(|now| now.domain == keys.domain && now.epoch >= keys.epoch) {
            return;
        }
        if sealing.next.as_ref().is_none_or(|(from, _)| moment < *from) {
            sealing.next = Some((moment, keys));
        }
    }
}
