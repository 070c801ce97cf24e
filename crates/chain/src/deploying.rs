//! Deploying the contract.

use std::time::Duration;

use ethers::types::TransactionRequest;

use super::artefact::artefact;
use super::gas;
use super::sender::{sign_request, wallet};
use super::{Chain, ChainError, Pin};
use crate::crypto::EoaSecret;
use crate::model::Address;

/// How long a deployment may wait for its block.
const PATIENCE: Duration = Duration::from_secs(60);
const DAY: Duration = Duration::from_secs(86_400);
/// The default delay of a succession.
pub const DEFAULT_DELAY: Duration = Duration::from_secs(7 * DAY.as_secs());
/// The shortest delay of a succession (contract limit).
pub const SHORTEST_DELAY: Duration = DAY;
/// The longest delay of a succession (contract limit).
pub const LONGEST_DELAY: Duration = Duration::from_secs(365 * DAY.as_secs());
/// The longest pause (contract limit).
pub const LONGEST_PAUSE: Duration = Duration::from_secs(3 * DAY.as_secs());

impl Chain {
    /// Deploys the contract with open registration and [`DEFAULT_DELAY`], waits until it is mined, and uses it.
    ///
    /// # Errors
    /// See [`Chain::deploy_with`].
    pub async fn deploy(&self, eoa: &EoaSecret) -> Result<Pin, ChainError> {
        self.deploy_with(eoa, DEFAULT_DELAY).await
    }

    /// Like [`Chain::deploy`], with another delay of successions.
    ///
    /// # Errors
    /// [`ChainError::Reverted`] if the contract refuses the delay, [`ChainError::NotMined`] if no block includes it
    /// within 60 s, or an error of the node.
    pub async fn deploy_with(&self, eoa: &EoaSecret, delay: Duration) -> Result<Pin, ChainError> {
        let artefact = artefact()?;
        let data = artefact.creation(true, delay.as_secs())?;
        let gas = gas::with_margin(self.estimate(eoa.address(), None, &data).await?);
        let nonce = self.nonce(eoa.address(), true).await?;
        let price = self.market().await?.offer();
        let gas = gas.min(self.room().unwrap_or(u64::MAX));
        let creation = TransactionRequest::new().nonce(nonce).gas(gas).gas_price(price).data(data).value(0u64);
        let signed = sign_request(&wallet(eoa)?, creation.chain_id(self.chain_id()))?;
        let hash = self.broadcast(&signed.raw).await?;
        let receipt = self.await_receipt(hash, PATIENCE).await?;
        let Some(contract) = receipt.contract_address.filter(|_| receipt.status.is_none_or(|s| !s.is_zero())) else {
            let reason = "the deployment failed; the network must run the Istanbul fork or newer";
            return Err(ChainError::Rejected { method: "eth_sendRawTransaction".into(), reason: reason.into() });
        };
        let contract = Address(contract.0);
        if self.code_hash(contract).await? != Some(artefact.code_hash) {
            return Err(ChainError::NotTheContract(contract));
        }
        Ok(self.set_pin(self.pin_of(contract, artefact.code_hash, receipt.block_number.as_u64())))
    }
}
