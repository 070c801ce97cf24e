//! Registration: the profile's public identity on the chain, and resuming its epochs.

use super::Profiles;
use std::sync::Arc;

use tokio::task::block_in_place;

use crate::chain::Call;
use crate::crypto::prove;
use crate::pipeline::{Network, Owner, recovery};
use crate::service::event::{NoticeLevel, Part};
use crate::service::failure::refused;
use crate::service::reply::{Failure, IdentityView};

impl Profiles {
    /// Registers the owner's identity; nothing is sent if the chain has it already.
    pub(in crate::site) async fn register(self: &Arc<Self>, owner: &Arc<Owner>) -> Result<IdentityView, Failure> {
        let network = self.connection.network_or_deploy(owner).await?;
        let _one_at_a_time = owner.changes.lock().await;
        self.is_current(owner)?;
        if network.directory.identity(owner.address).is_err() {
            self.connection.fund(&network.chain, owner).await?;
            self.send_registration(owner, &network).await?;
        }
        self.take_up(owner, &network).await?;
        if owner.sealing().is_none() {
            let missing = self.sharing.missing_text();
            return Err(refused(missing.unwrap_or_else(|| "no epoch has started; run the command again".to_owned())));
        }
        self.view(&owner.profile).await
    }

    async fn send_registration(self: &Arc<Self>, owner: &Arc<Owner>, network: &Network) -> Result<(), Failure> {
        let token = owner.prepare_epoch(network.domain, 1)?;
        let (signing, envelope) = (owner.signing(), owner.envelope());
        let identity = prove(self.plant.provider, &network.domain, &owner.address, &signing, &envelope.public, token)?;
        let envelope = recovery::own_envelope(&self.plant, network, owner, 1)?;
        let call = Call::Register { identity, envelope };
        let sent = self.sender.send(&network.chain, &owner.eoa(), call, "register").await;
        let outcome = if sent.is_ok() { "done" } else { "failed" };
        self.log.write(&owner.profile, "register", &owner.address.to_string(), outcome).await?;
        let (_, receipt) = sent?;
        self.link.scanned(receipt.block).await;
        self.hub.changed(Part::Identity);
        Ok(())
    }

    /// Resumes at the state of the owner's keys on the chain: fetches those that the keyring lacks, seals under the
    /// current epoch, or finishes one that was begun and never reached the chain; re-wraps what readers lack.
    pub(in crate::site) async fn resume(self: &Arc<Self>, owner: &Arc<Owner>) -> Result<(), Failure> {
        if self.home.original().is_some() {
            return Ok(());
        }
        let network = self.link.network().await?;
        // A locked keyring goes on sealing as it was told.
        if owner.is_locked() || network.directory.identity(owner.address).is_err() {
            return Ok(());
        }
        {
            let _one_at_a_time = owner.changes.lock().await;
            self.take_up(owner, &network).await?;
        }
        let profiles = Arc::clone(self);
        let owner = Arc::clone(owner);
        tokio::spawn(async move {
            let pairs = async {
                let network = profiles.link.network().await?;
                let _one_at_a_time = owner.changes.lock().await;
                profiles.finish_pairs(&owner, &network).await
            };
            if let Err(failure) = pairs.await {
                profiles.hub.notice(NoticeLevel::Error, &format!("the change of an SM2 key: {}", failure.message));
            }
            if let Err(failure) = profiles.sharing.finish_epoch(&owner).await {
                profiles.hub.notice(NoticeLevel::Error, &failure.message);
            }
        });
        Ok(())
    }

    /// Brings the keyring to what the chain has of this owner's pairs and epochs. The caller holds the owner's changes.
    async fn take_up(self: &Arc<Self>, owner: &Arc<Owner>, network: &Network) -> Result<(), Failure> {
        let newer = block_in_place(|| recovery::recover_pairs(&self.plant, network, owner));
        self.sharing.note_pairs(owner, newer.as_ref().err().map(ToString::to_string));
        let newer = newer.unwrap_or(false);
        self.sharing.take_up_epoch(owner, network)?;
        if newer {
            self.finish_pairs(owner, network).await?;
            let text = format!("the chain handed newer SM2 keys over to the keyring of '{}'", owner.profile);
            self.hub.notice(NoticeLevel::Info, &text);
        }
        Ok(())
    }
}
