//! A profile's keys: shown, loaded, handed out.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use tokio::task::block_in_place;

use super::Site;
use crate::chain::Call;
use crate::crypto::{Fingerprint, SmKeyPair, keyfile, prove};
use crate::model::RecordState;
use crate::pipeline::{Network, Owner};
use crate::service::command::{KeyKind, SecretBytes, SecretText};
use crate::service::event::Part;
use crate::service::failure::{input, refused};
use crate::service::reply::{EpochView, Failure, KeysView};

/// How long a change of the signing key waits for records that the old one signed.
const DRAIN: Duration = Duration::from_secs(60);

impl Site {
    /// Keys with fingerprints and epochs; no secret.
    pub(super) async fn keys_view(self: &Arc<Self>, owner: &Arc<Owner>) -> Result<KeysView, Failure> {
        let (signing, envelope) = owner.public_keys();
        let mut epochs = Vec::new();
        if let Some(network) = self.network_now() {
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

    /// Replaces one key by that of a file.
    pub(super) async fn load_key(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        kind: KeyKind,
        path: PathBuf,
        passphrase: Option<SecretText>,
    ) -> Result<KeysView, Failure> {
        let registered = match self.network().await {
            Ok(network) => network.directory.identity(owner.address).is_ok().then_some(network),
            Err(_) if self.home.pin().exists() => {
                return Err(self.network().await.err().unwrap_or_else(|| refused("the chain is not up")));
            }
            Err(_) => None,
        };
        self.audit_first(owner, "load key", &format!("{kind:?}").to_lowercase()).await?;
        let owner = match kind {
            KeyKind::Sm4 => self.load_sm4(owner, path, registered.is_some()).await?,
            KeyKind::Sm2 => self.load_sm2(owner, path, registered.as_ref()).await?,
            KeyKind::Eoa => self.load_eoa(owner, path, passphrase, registered.is_some()).await?,
        };
        self.changed(Part::Identity);
        self.keys_view(&owner).await
    }

    async fn load_sm4(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        path: PathBuf,
        registered: bool,
    ) -> Result<Arc<Owner>, Failure> {
        let key = self.blocking(move |_| Ok(keyfile::load_sm4(&path)?)).await?;
        {
            let mut keyring = owner.keyring();
            keyring.keyring.sm4 = key;
            block_in_place(|| keyring.save())?;
        }
        if registered {
            self.rotate(owner, "a new SM4 key was loaded").await?;
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
        let pair = self.blocking(move |_| Ok(SmKeyPair::from_secret(provider, keyfile::load_sm2(&path)?)?)).await?;
        // Until the new key signs: nothing may be signed by the old one once the chain has the new one.
        let _one_at_a_time = owner.changes.lock().await;
        if let Some(network) = network {
            self.drain(owner).await?;
            let epoch = network.directory.epoch(owner.address);
            let token =
                owner.token(network.domain, epoch).ok_or_else(|| refused("the keyring lacks the current epoch"))?;
            let envelope = owner.envelope();
            let identity = prove(provider, &network.domain, &owner.address, &pair, &envelope.public, token)?;
            let call = Call::RotateKeys { identity };
            let (_, receipt) = self.sender.send(&network.chain, &owner.eoa(), call, "rotateKeys").await?;
            self.scanned(receipt.block).await;
        }
        {
            let mut keyring = owner.keyring();
            keyring.keyring.signing = pair;
            block_in_place(|| keyring.save())?;
        }
        if let Some(keys) = owner.sealing() {
            owner.seal_under(keys.domain, keys.epoch)?;
        }
        Ok(Arc::clone(owner))
    }

    /// Waits until no record signed by the present key is still on its way.
    async fn drain(&self, owner: &Owner) -> Result<(), Failure> {
        if !self.recorder.wanted_by(&owner.author).is_empty() {
            return Err(refused("topics are being captured; unwatch them before the signing key is changed"));
        }
        let deadline = tokio::time::Instant::now() + DRAIN;
        loop {
            let counts = block_in_place(|| self.plant.ledger.counts(Some(owner.address)))?;
            if counts.pending_of_any_kind() == 0 {
                return Ok(());
            }
            if tokio::time::Instant::now() > deadline {
                let pending = counts.pending_of_any_kind();
                return Err(refused(format!(
                    "{pending} records signed by the present key are not verified yet; try again when they are"
                )));
            }
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    }

    async fn load_eoa(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        path: PathBuf,
        passphrase: Option<SecretText>,
        registered: bool,
    ) -> Result<Arc<Owner>, Failure> {
        if registered {
            return Err(refused(format!(
                "profile '{}' is registered as {}; an EOA is an identity, so make another profile for another EOA",
                owner.profile, owner.address
            )));
        }
        let rows = block_in_place(|| self.plant.ledger.in_state(Some(owner.address), RecordState::Stored, 1))?;
        if !rows.is_empty() {
            return Err(refused(format!("records of {} wait to be anchored; register first", owner.address)));
        }
        let key =
            self.blocking(move |_| Ok(keyfile::load_eoa(&path, passphrase.as_ref().map(SecretText::expose))?)).await?;
        {
            let mut keyring = owner.keyring();
            keyring.keyring.eoa = key;
            keyring.keyring.networks.clear();
            block_in_place(|| keyring.save())?;
        }
        Ok(self.reopen_owner(owner))
    }

    /// Hands one key out, in the form that other tools read.
    pub(super) async fn export_key(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        kind: KeyKind,
        passphrase: Option<SecretText>,
    ) -> Result<SecretBytes, Failure> {
        self.audit_first(owner, "export key", &format!("{kind:?}").to_lowercase()).await?;
        let (sm4, signing, eoa) = {
            let keyring = owner.keyring();
            (keyring.keyring.sm4.clone(), keyring.keyring.signing.clone(), keyring.keyring.eoa.clone())
        };
        let bytes = match kind {
            KeyKind::Sm4 => keyfile::sm4_hex(&sm4).as_bytes().to_vec(),
            KeyKind::Sm2 => keyfile::sm2_pem(&signing.secret)?.as_bytes().to_vec(),
            KeyKind::Eoa => {
                let passphrase = passphrase
                    .ok_or_else(|| input("a V3 keystore needs a passphrase; give --keystore-passphrase-file"))?;
                self.blocking(move |_| Ok(keyfile::eoa_keystore(&eoa, passphrase.expose())?.into_bytes())).await?
            }
        };
        Ok(SecretBytes::new(bytes))
    }
}
