//! A profile's keys: shown, loaded, exported, and its SM2 pairs replaced.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use tokio::task::block_in_place;

use super::Accounts;
use crate::chain::Call;
use crate::command::{KeyKind, SecretBytes, SecretText};
use crate::crypto::{
    Fingerprint, Keyring, SmKeyPair, keyfile, open_transport_key, prove, seal_transport_key, signer_id,
};
use crate::gateway::Cabinet;
use crate::model::{RecordState, SignerId, counted};
use crate::pipeline::{Network, Owner, PipelineError, recovery};
use crate::reply::{EpochView, Failure, KeysView, Part, Result, input, refused};
use crate::site::{Profiles, blocking};
use crate::store::notes::ProfileAccounts;
use crate::store::{BoundName, RecordQuery, StoreError};

/// Longest wait for records signed by the old signing key.
const DRAIN: Duration = Duration::from_secs(60);
const LOOK: Duration = Duration::from_millis(250);
const PAGE: usize = 1000;

impl Profiles {
    pub async fn keys(&self, owner: &Owner) -> Result<KeysView> {
        let (signing, envelope) = owner.public_keys();
        let mut epochs = Vec::new();
        if let Some(Network { domain, .. }) = self.parts.link.network_now() {
            let sealing = owner.sealing().map(|keys| keys.epoch);
            let view =
                |epoch| Some(EpochView { epoch, token: owner.token(domain, epoch)?, current: sealing == Some(epoch) });
            epochs.extend(owner.epochs(domain).into_iter().filter_map(view));
        }
        Ok(KeysView {
            address: owner.address,
            signing_key: signing,
            signing_fingerprint: Fingerprint::of(&signing).to_string(),
            envelope_key: envelope,
            envelope_fingerprint: Fingerprint::of(&envelope).to_string(),
            epochs,
        })
    }

    pub async fn load_key(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        kind: KeyKind,
        path: PathBuf,
        passphrase: Option<SecretText>,
    ) -> Result<KeysView> {
        let registered = self.registered_network(owner).await?;
        let word = format!("{kind:?}").to_lowercase();
        let loaded = async {
            match kind {
                KeyKind::Sm4 => self.load_sm4(owner, path, registered.is_some()).await.map(|()| Arc::clone(owner)),
                KeyKind::Sm2 => self.load_sm2(owner, path, registered.as_ref()).await.map(|()| Arc::clone(owner)),
                KeyKind::Eoa => self.load_eoa(owner, path, passphrase).await,
            }
        };
        let owner = self.parts.log.deed(&owner.profile, "load key", &word, loaded).await?;
        self.parts.hub.changed(Part::Identity);
        self.keys(&owner).await
    }

    async fn load_sm4(self: &Arc<Self>, owner: &Owner, path: PathBuf, registered: bool) -> Result<()> {
        let key = blocking(self, move |_| Ok(keyfile::load_sm4(&path)?)).await?;
        {
            let _one_at_a_time = owner.changes.lock().await;
            let loaded = |keys: &mut Keyring| {
                keys.sm4 = key;
                Ok(())
            };
            block_in_place(|| owner.keyring().change(loaded))?;
        }
        if registered {
            self.sharing.rotate(owner, "a new SM4 key was loaded").await?;
        }
        Ok(())
    }

    async fn load_sm2(self: &Arc<Self>, owner: &Owner, path: PathBuf, network: Option<&Network>) -> Result<()> {
        let provider = self.parts.plant.provider;
        let pair = blocking(self, move |_| Ok(SmKeyPair::from_secret(provider, keyfile::load_sm2(&path)?)?)).await?;
        let new = NewPairs { signing: Some(pair), ..NewPairs::default() };
        self.change_pairs(owner, network, new).await
    }

    /// Makes a new envelope pair; the old one still opens what was sealed to it.
    pub async fn rotate_envelope(&self, owner: &Owner) -> Result<KeysView> {
        let registered = self.registered_network(owner).await?;
        let pair = SmKeyPair::generate(self.parts.plant.provider)?;
        let new = NewPairs { envelope: Some(pair), ..NewPairs::default() };
        let changed = self.change_pairs(owner, registered.as_ref(), new);
        self.parts.log.deed(&owner.profile, "rotate envelope key", &owner.address.to_string(), changed).await?;
        self.parts.hub.changed(Part::Identity);
        self.keys(owner).await
    }

    /// The network, if the owner is registered on it; `None` if this home has none.
    pub async fn registered_network(&self, owner: &Owner) -> Result<Option<Network>> {
        match self.parts.link.network().await {
            Ok(network) => Ok(network.directory.identity(owner.address).is_ok().then_some(network)),
            Err(failure) => match self.connection.pin()? {
                Some(_) => Err(failure),
                None => Ok(None),
            },
        }
    }

    async fn load_eoa(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        path: PathBuf,
        passphrase: Option<SecretText>,
    ) -> Result<Arc<Owner>> {
        // If it registered meanwhile, the account and its epoch keys would be lost.
        let _one_at_a_time = owner.changes.lock().await;
        self.is_current(owner)?;
        if self.registered_network(owner).await?.is_some() {
            return Err(refused(format!(
                "profile '{}' is registered as {}; an EOA is an identity, so create another profile for another EOA",
                owner.profile, owner.address
            )));
        }
        let rows = self.parts.plant.ledger.records.in_state(Some(owner.address), RecordState::Stored, 1)?;
        if !rows.is_empty() {
            return Err(refused(format!("records of {} are waiting to be anchored; register first", owner.address)));
        }
        let key =
            blocking(self, move |_| Ok(keyfile::load_eoa(&path, passphrase.as_ref().map(SecretText::expose))?)).await?;
        let (profile, address) = (owner.profile.clone(), key.address());
        let also = |accounts: &mut Accounts| {
            accounts.entry(profile).or_default().push(address);
            Ok::<(), StoreError>(())
        };
        self.parts.plant.ledger.notes.change(&ProfileAccounts {}, also)?;
        let loaded = |keys: &mut Keyring| {
            keys.eoa = key;
            keys.networks.clear();
            Ok(())
        };
        block_in_place(|| owner.keyring().change(loaded))?;
        Ok(self.put_in_place(owner.with_new_account()))
    }

    pub async fn export_key(
        self: &Arc<Self>,
        owner: &Owner,
        kind: KeyKind,
        passphrase: Option<SecretText>,
    ) -> Result<SecretBytes> {
        let word = format!("{kind:?}").to_lowercase();
        let exported = self.key_file(owner, kind, passphrase);
        self.parts.log.deed(&owner.profile, "export key", &word, exported).await.map(SecretBytes::new)
    }

    async fn key_file(self: &Arc<Self>, owner: &Owner, kind: KeyKind, secret: Option<SecretText>) -> Result<Vec<u8>> {
        let (sm4, signing, eoa) = {
            let keyring = owner.keyring();
            (keyring.keys().sm4.clone(), keyring.keys().signing.clone(), keyring.keys().eoa.clone())
        };
        match kind {
            KeyKind::Sm4 => Ok(keyfile::sm4_hex(&sm4).as_bytes().to_vec()),
            KeyKind::Sm2 => Ok(keyfile::sm2_pem(&signing.secret)?.as_bytes().to_vec()),
            KeyKind::Eoa => {
                let passphrase =
                    secret.ok_or_else(|| input("a V3 keystore needs a passphrase; pass --keystore-passphrase-file"))?;
                blocking(self, move |_| Ok(keyfile::eoa_keystore(&eoa, passphrase.expose())?.into_bytes())).await
            }
        }
    }

    /// Replaces pairs; on the chain too if `network` is given.
    pub async fn change_pairs(&self, owner: &Owner, network: Option<&Network>, new: NewPairs) -> Result<()> {
        // Until the new key signs: the old one may sign nothing once the chain has the new one.
        let _one_at_a_time = owner.changes.lock().await;
        if let Some(network) = network {
            self.drain_former(owner, network).await?;
            // Robots already know of a change begun before.
            self.settle_pairs(owner, network).await?;
            if new.signing.is_some() {
                self.nothing_is_captured(owner)?;
            }
        }
        {
            let mut keyring = owner.keyring();
            let noted = |keys: &mut Keyring| {
                keys.further.next_signing = new.signing;
                keys.further.next_envelope = new.envelope;
                Ok(())
            };
            block_in_place(|| keyring.change(noted))?;
        }
        match network {
            Some(network) => self.finish_pairs(owner, network).await,
            None => self.take_over_pairs(owner, None),
        }
    }

    /// If the chain went back to earlier pairs, waits until everything signed with those is anchored: they lose their
    /// right once the keyring's are registered again. Fails after a minute; the site's health then says why.
    pub async fn drain_former(&self, owner: &Owner, network: &Network) -> Result<()> {
        if !recovery::is_ahead(network, owner)? {
            return Ok(());
        }
        let registered = network.directory.identity(owner.address)?.signing;
        let drained = self.drain(owner, signer_id(&registered)).await.map_err(|failure| {
            let text = format!(
                "the chain has earlier SM2 keys of '{}' than the keyring, whose keys are registered again once everything \
                 signed before is anchored: {}",
                owner.profile, failure.message
            );
            Failure { message: text, ..failure }
        });
        self.sharing.note_pairs(owner, drained.as_ref().err().map(|failure| failure.message.clone()));
        self.parts.hub.changed(Part::Health);
        drained
    }

    /// Brings the chain to the keyring's pairs: re-registers them where it went back, and finishes a change that was
    /// begun. The caller holds the owner's changes, has recovered what the chain returns, and drained.
    pub async fn settle_pairs(&self, owner: &Owner, network: &Network) -> Result<()> {
        if recovery::is_ahead(network, owner)? {
            let (signing, envelope) = (owner.signing(), owner.envelope());
            let sent = self.submit(owner, network, &signing, &envelope).await.map_err(|failure| {
                let text = format!(
                    "the chain has earlier SM2 keys of '{}' than the keyring, and the keyring's could not be registered \
                     again: {}; run `authros identity register`",
                    owner.profile, failure.message
                );
                self.sharing.note_pairs(owner, Some(text.clone()));
                Failure { message: text, ..failure }
            });
            let subject = owner.address.to_string();
            self.parts.log.ended(&owner.profile, "register keys again", &subject, sent).await?;
            self.sharing.note_pairs(owner, None);
            let text = format!(
                "the chain had gone back to earlier SM2 keys of '{}', as an older copy does: those of the keyring are \
                 registered again",
                owner.profile
            );
            self.parts.hub.warn(&text);
            self.parts.hub.changed(Part::Identity);
        }
        self.finish_pairs(owner, network).await
    }

    /// Finishes a change that was begun, if any. The caller holds the owner's changes.
    pub async fn finish_pairs(&self, owner: &Owner, network: &Network) -> Result<()> {
        let (signing, envelope, moves) = {
            let keyring = owner.keyring();
            let (ring, further) = (keyring.keys(), &keyring.keys().further);
            if further.next_signing.is_none() && further.next_envelope.is_none() {
                return Ok(());
            }
            let signing = further.next_signing.as_ref().unwrap_or(&ring.signing).clone();
            let envelope = further.next_envelope.as_ref().unwrap_or(&ring.envelope).clone();
            (signing, envelope, further.next_signing.is_some())
        };
        let registered = network.directory.identity(owner.address)?;
        if (registered.signing, registered.envelope) != (signing.public, envelope.public) {
            let sent = self.register_pairs(owner, network, &signing, &envelope, moves).await;
            sent.map_err(|failure| {
                let noted = "the change is stored: it continues at the next unlock, or when you repeat the command";
                Failure { message: format!("{}; {noted}", failure.message), ..failure }
            })?;
        }
        self.take_over_pairs(owner, Some(network))
    }

    async fn register_pairs(
        &self,
        owner: &Owner,
        network: &Network,
        signing: &SmKeyPair,
        envelope: &SmKeyPair,
        moves: bool,
    ) -> Result<()> {
        if !moves {
            return self.submit(owner, network, signing, envelope).await;
        }
        self.nothing_is_captured(owner)?;
        block_in_place(|| self.enrolments.tell_owner_key(owner, network, &signing.public))?;
        self.drain(owner, signer_id(&owner.signing().public)).await?;
        let sealing = owner.sealing();
        owner.author.rest();
        let sent = self.submit(owner, network, signing, envelope).await;
        if let (Err(_), Some(keys)) = (&sent, sealing) {
            owner.author.seal_under(keys);
            self.sharing.foresee_expiry(owner, network, None)?;
        }
        sent
    }

    async fn submit(&self, owner: &Owner, network: &Network, signing: &SmKeyPair, envelope: &SmKeyPair) -> Result<()> {
        let token = network.directory.account(owner.address).and_then(|account| account.token);
        let token = token.ok_or(PipelineError::Unregistered(owner.address))?;
        let (provider, domain) = (self.parts.plant.provider, &network.domain);
        let identity = prove(provider, domain, &owner.address, signing, &envelope.public, token)?;
        let envelope = recovery::handover(&self.parts.plant, network, owner, (signing, envelope))?;
        let call = Call::RotateKeys { identity, envelope };
        let (_, receipt) = self.parts.sender.send(&network.chain, &owner.eoa(), call, "rotateKeys").await?;
        self.parts.link.scanned(receipt.block).await;
        Ok(())
    }

    /// Moves the new pairs, registered or of an owner on no chain, into their place in the keyring, and re-encrypts
    /// what depends on them.
    fn take_over_pairs(&self, owner: &Owner, network: Option<&Network>) -> Result<()> {
        let founded = block_in_place(|| Cabinet::founded_in(&self.parts.home.gateway()));
        {
            let mut keyring = owner.keyring();
            let taken_over = |keys: &mut Keyring| {
                if let Some(next) = keys.further.next_signing.take() {
                    let former = std::mem::replace(&mut keys.signing, next);
                    // Robots and joined sites have pinned the gateway's identity: it stays.
                    if keys.further.gateway.is_none() && founded == Some(signer_id(&former.public)) {
                        keys.further.gateway = Some(former);
                    }
                }
                if let Some(next) = keys.further.next_envelope.take() {
                    let former = std::mem::replace(&mut keys.envelope, next);
                    keys.further.envelopes.push(former);
                }
                Ok(())
            };
            block_in_place(|| keyring.change(taken_over))?;
        }
        let Some(network) = network else { return Ok(()) };
        block_in_place(|| self.reseal_kept(owner))?;
        // A joined gateway knows this site only by its old keys; another transport key is allocated.
        drop(std::fs::remove_file(self.parts.home.transport_key(&owner.profile)));
        self.sharing.take_up_epoch(owner, network)
    }

    /// Re-encrypts the transport keys of this owner's gateway under its current pair.
    fn reseal_kept(&self, owner: &Owner) -> Result<()> {
        let (pairs, provider, ledger) = (owner.envelopes(), self.parts.plant.provider, &self.parts.plant.ledger);
        let under = self.gateway.kept_under(owner);
        // Nothing is bound meanwhile.
        let mut held = under.as_ref().map(|under| under.write().unwrap_or_else(std::sync::PoisonError::into_inner));
        let Some((present, former)) = pairs.split_first() else { return Ok(()) };
        for BoundName { name, .. } in ledger.bindings.bound_names()? {
            let Some(kept) = name.parse().ok().map(|name| ledger.bindings.binding(&name)).transpose()?.flatten() else {
                continue;
            };
            let open = |pair: &SmKeyPair| open_transport_key(provider, &pair.secret, &name, &kept.sealed_key).ok();
            if open(present).is_some() {
                continue;
            }
            if let Some(key) = former.iter().find_map(open) {
                let sealed = seal_transport_key(provider, &present.secret, &name, &key)?;
                ledger.bindings.reseal_binding(&name, kept.sealed_key.clone(), sealed)?;
            }
        }
        if let Some(held) = &mut held {
            **held = pairs;
        }
        Ok(())
    }

    fn nothing_is_captured(&self, owner: &Owner) -> Result<()> {
        if self.recorder.wanted_by(&owner.author).is_empty() {
            return Ok(());
        }
        Err(refused("topics are being captured; stop watching them before changing the signing key"))
    }

    /// Waits until no record signed by a key is in flight; lent devices' records may be.
    async fn drain(&self, owner: &Owner, signer: SignerId) -> Result<()> {
        let deadline = tokio::time::Instant::now() + DRAIN;
        loop {
            let pending = block_in_place(|| self.pending_of(owner, signer))?;
            if pending == 0 {
                return Ok(());
            }
            if tokio::time::Instant::now() > deadline {
                return Err(refused(format!(
                    "signed with the registered key and not verified yet: {}; try again later",
                    counted(pending as u64, "record")
                )));
            }
            tokio::time::sleep(LOOK).await;
        }
    }

    /// Records signed by this key that are neither verified nor given up.
    fn pending_of(&self, owner: &Owner, signer: SignerId) -> Result<usize> {
        let mut pending = 0;
        // Records waiting for their signer's right also need the current key.
        let waits = |state: &&RecordState| state.is_pending() || **state == RecordState::RightEnded;
        for state in RecordState::ALL.iter().filter(waits).copied() {
            let (owner, state) = (Some(owner.address), Some(state));
            let query = RecordQuery { owner, state, limit: PAGE, ..RecordQuery::default() };
            for row in self.parts.plant.ledger.records.all(query) {
                pending += usize::from(row?.signer == signer);
            }
        }
        Ok(pending)
    }
}

#[derive(Default)]
pub struct NewPairs {
    pub signing: Option<SmKeyPair>,
    pub envelope: Option<SmKeyPair>,
}
