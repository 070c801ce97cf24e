//! Registration: the profile's public identity on the chain, and resuming its epochs.

use super::Profiles;
use std::sync::Arc;

use crate::chain::Call;
use crate::crypto::prove;
use crate::pipeline::{Network, Owner};
use crate::service::event::{NoticeLevel, Part};
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
        self.take_up_epoch(owner, &network).await?;
        self.view(&owner.profile).await
    }

    async fn send_registration(self: &Arc<Self>, owner: &Arc<Owner>, network: &Network) -> Result<(), Failure> {
        let token = owner.prepare_epoch(network.domain, 1)?;
        let (signing, envelope) = (owner.signing(), owner.envelope());
        let identity = prove(self.plant.provider, &network.domain, &owner.address, &signing, &envelope.public, token)?;
        let sent = self.sender.send(&network.chain, &owner.eoa(), Call::Register { identity }, "register").await;
        let outcome = if sent.is_ok() { "done" } else { "failed" };
        self.log.write(&owner.profile, "register", &owner.address.to_string(), outcome).await?;
        let (_, receipt) = sent?;
        self.link.scanned(receipt.block).await;
        self.hub.changed(Part::Identity);
        Ok(())
    }

    /// Resumes at the state of the owner's epochs on the chain: seals under the current one, or finishes one that was
    /// begun and never reached the chain; re-wraps what readers lack.
    pub(in crate::site) async fn resume(self: &Arc<Self>, owner: &Arc<Owner>) -> Result<(), Failure> {
        if self.home.original().is_some() {
            return Ok(());
        }
        let network = self.link.network().await?;
        if network.directory.identity(owner.address).is_err() {
            return Ok(());
        }
        {
            let _one_at_a_time = owner.changes.lock().await;
            self.take_up_epoch(owner, &network).await?;
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

    async fn take_up_epoch(self: &Arc<Self>, owner: &Arc<Owner>, network: &Network) -> Result<(), Failure> {
        let on_chain = network.directory.epoch(owner.address);
        let known = owner.epochs(network.domain);
        if owner.token(network.domain, on_chain)
            != network.directory.account(owner.address).and_then(|account| account.token)
        {
            // The supposed current epoch is not current: nobody knows who reads under it.
            owner.author.rest();
            return Err(crate::service::failure::refused(format!(
                "the keyring of '{}' lacks the key of its current epoch {on_chain}; restore the newest keyring, or \
                 start a new epoch with `authros keys rotate`",
                owner.profile
            )));
        }
        owner.confirm_epoch(network.domain, on_chain)?;
        let newest = known.last().copied().unwrap_or(on_chain).max(on_chain);
        if owner.sealing().is_none_or(|keys| keys.domain != network.domain || keys.epoch < newest) {
            owner.seal_under(network.domain, newest)?;
        }
        self.sharing.foresee_expiry(owner, network, None)?;
        self.hub.changed(Part::Identity);
        Ok(())
    }
}
