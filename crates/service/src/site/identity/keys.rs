//! A profile's keys: shown, loaded, exported.

use super::Profiles;
use std::path::PathBuf;
use std::sync::Arc;

use tokio::task::block_in_place;

use super::pairs::NewPairs;
use crate::crypto::{Fingerprint, Keyring, SmKeyPair, keyfile};
use crate::model::RecordState;
use crate::pipeline::{Network, Owner};
use crate::service::command::{KeyKind, SecretBytes, SecretText};
use crate::service::event::Part;
use crate::service::failure::{input, refused};
use crate::service::reply::{EpochView, Failure, KeysView};
use crate::site::blocking;

impl Profiles {
    /// Keys with fingerprints and epochs; no secret.
    pub(in crate::site) async fn keys(self: &Arc<Self>, owner: &Arc<Owner>) -> Result<KeysView, Failure> {
        let (signing, envelope) = owner.public_keys();
        let mut epochs = Vec::new();
        if let Some(network) = self.link.network_now() {
            let current = owner.sealing().map(|keys| keys.epoch);
            for epoch in owner.epochs(network.domain) {
                if let Some(token) = owner.token(network.domain, epoch) {
                    epochs.push(EpochView { epoch, token, current: current == Some(epoch) });
                }
            }
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

    /// Replaces one key with that in a file.
    pub(in crate::site) async fn load_key(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        kind: KeyKind,
        path: PathBuf,
        passphrase: Option<SecretText>,
    ) -> Result<KeysView, Failure> {
        let registered = self.registered_network(owner).await?;
        let word = format!("{kind:?}").to_lowercase();
        self.log.begin(owner, "load key", &word).await?;
        let loaded = match kind {
            KeyKind::Sm4 => self.load_sm4(owner, path, registered.is_some()).await,
            KeyKind::Sm2 => self.load_sm2(owner, path, registered.as_ref()).await,
            KeyKind::Eoa => self.load_eoa(owner, path, passphrase).await,
        };
        let owner = self.log.end(owner, "load key", &word, loaded).await?;
        self.hub.changed(Part::Identity);
        self.keys(&owner).await
    }

    async fn load_sm4(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        path: PathBuf,
        registered: bool,
    ) -> Result<Arc<Owner>, Failure> {
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
        Ok(Arc::clone(owner))
    }

    async fn load_sm2(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        path: PathBuf,
        network: Option<&Network>,
    ) -> Result<Arc<Owner>, Failure> {
        let provider = self.plant.provider;
        let pair = blocking(self, move |_| Ok(SmKeyPair::from_secret(provider, keyfile::load_sm2(&path)?)?)).await?;
        let new = NewPairs { signing: Some(pair), ..NewPairs::default() };
        self.change_pairs(owner, network, new).await?;
        Ok(Arc::clone(owner))
    }

    /// Makes a new envelope pair; the old one still opens what was sealed to it.
    pub(in crate::site) async fn rotate_envelope(self: &Arc<Self>, owner: &Arc<Owner>) -> Result<KeysView, Failure> {
        let registered = self.registered_network(owner).await?;
        self.log.begin(owner, "rotate envelope key", &owner.address.to_string()).await?;
        let pair = SmKeyPair::generate(self.plant.provider)?;
        let new = NewPairs { envelope: Some(pair), ..NewPairs::default() };
        let changed = self.change_pairs(owner, registered.as_ref(), new).await;
        self.log.end(owner, "rotate envelope key", &owner.address.to_string(), changed).await?;
        self.hub.changed(Part::Identity);
        self.keys(owner).await
    }

    /// The network, if the owner is registered on it; nothing if this home has none.
    pub(in crate::site) async fn registered_network(
        self: &Arc<Self>,
        owner: &Owner,
    ) -> Result<Option<Network>, Failure> {
        match self.link.network().await {
            Ok(network) => Ok(network.directory.identity(owner.address).is_ok().then_some(network)),
            Err(failure) if self.home.pin().exists() => Err(failure),
            Err(_) => Ok(None),
        }
    }

    async fn load_eoa(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        path: PathBuf,
        passphrase: Option<SecretText>,
    ) -> Result<Arc<Owner>, Failure> {
        // Registered meanwhile, the account and the keys of its epochs would be lost.
        let _one_at_a_time = owner.changes.lock().await;
        self.is_current(owner)?;
        if self.registered_network(owner).await?.is_some() {
            return Err(refused(format!(
                "profile '{}' is registered as {}; an EOA is an identity, so create another profile for another EOA",
                owner.profile, owner.address
            )));
        }
        let rows = block_in_place(|| self.plant.ledger.in_state(Some(owner.address), RecordState::Stored, 1))?;
        if !rows.is_empty() {
            return Err(refused(format!("records of {} are waiting to be anchored; register first", owner.address)));
        }
        let key =
            blocking(self, move |_| Ok(keyfile::load_eoa(&path, passphrase.as_ref().map(SecretText::expose))?)).await?;
        let loaded = |keys: &mut Keyring| {
            keys.eoa = key;
            keys.networks.clear();
            Ok(())
        };
        block_in_place(|| owner.keyring().change(loaded))?;
        Ok(self.put_in_place(owner.with_new_account()))
    }

    /// Exports one key, in the format of other tools.
    pub(in crate::site) async fn export_key(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        kind: KeyKind,
        passphrase: Option<SecretText>,
    ) -> Result<SecretBytes, Failure> {
        let word = format!("{kind:?}").to_lowercase();
        let exported = self.key_file(owner, kind, passphrase);
        self.log.deed(&owner.profile, "export key", &word, exported).await.map(SecretBytes::new)
    }

    async fn key_file(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        kind: KeyKind,
        passphrase: Option<SecretText>,
    ) -> Result<Vec<u8>, Failure> {
        let (sm4, signing, eoa) = {
            let keyring = owner.keyring();
            (keyring.keys().sm4.clone(), keyring.keys().signing.clone(), keyring.keys().eoa.clone())
        };
        match kind {
            KeyKind::Sm4 => Ok(keyfile::sm4_hex(&sm4).as_bytes().to_vec()),
            KeyKind::Sm2 => Ok(keyfile::sm2_pem(&signing.secret)?.as_bytes().to_vec()),
            KeyKind::Eoa => {
                let passphrase = passphrase
                    .ok_or_else(|| input("a V3 keystore needs a passphrase; pass --keystore-passphrase-file"))?;
                blocking(self, move |_| Ok(keyfile::eoa_keystore(&eoa, passphrase.expose())?.into_bytes())).await
            }
        }
    }
}
