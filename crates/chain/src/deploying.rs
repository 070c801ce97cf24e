//! Deploying the contract.

use std::time::{Duration, Instant};

use ethers::types::TransactionRequest;

use super::artefact::artefact;
use super::gas;
use super::sender::{RawReceipt, sign_request, wallet};
use super::{Chain, ChainError, Pin, Policy, Priced, STARVING, Shortfall, Wait};
use crate::crypto::EoaSecret;
use crate::model::{Address, Hash, Wei};

/// How long a deployment may wait for its block at one price.
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

/// A contract that was deployed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Deployment {
    /// What identifies it.
    pub pin: Pin,
    /// The price in wei per gas at which it was mined, if blocks had passed it by at lower ones.
    pub raised: Option<u128>,
}

impl Chain {
    /// Deploys the contract with open registration and [`DEFAULT_DELAY`], waits until it is mined, and uses it.
    ///
    /// # Errors
    /// See [`Chain::deploy_with`].
    pub async fn deploy(&self, eoa: &EoaSecret) -> Result<Pin, ChainError> {
        Ok(self.deploy_with(eoa, DEFAULT_DELAY, Policy::default()).await?.pin)
    }

    /// Like [`Chain::deploy`], with another delay of successions and within limits of the price.
    ///
    /// # Errors
    /// [`ChainError::Reverted`] if the contract refuses the delay, [`ChainError::NoEther`], [`ChainError::TooDear`],
    /// [`ChainError::NotMined`] if no block includes it within 60 s at the highest price allowed, or an error of the
    /// node.
    pub async fn deploy_with(
        &self,
        eoa: &EoaSecret,
        delay: Duration,
        policy: Policy,
    ) -> Result<Deployment, ChainError> {
        let artefact = artefact()?;
        let data = artefact.creation(true, delay.as_secs())?;
        let nonce = self.nonce(eoa.address(), true).await?;
        let creation = TransactionRequest::new().nonce(nonce).data(data).value(0u64).chain_id(self.chain_id());
        let (receipt, raised) = self.create(eoa, creation, policy).await?;
        let Some(contract) = receipt.contract_address.filter(|_| receipt.status.is_none_or(|s| !s.is_zero())) else {
            let reason = "the deployment failed; the network must run the Istanbul fork or newer";
            return Err(ChainError::Rejected { method: "eth_sendRawTransaction".into(), reason: reason.into() });
        };
        let contract = Address(contract.0);
        if self.code_hash(contract).await? != Some(artefact.code_hash) {
            return Err(ChainError::NotTheContract(contract));
        }
        let pin = self.set_pin(self.pin_of(contract, artefact.code_hash, receipt.block_number.as_u64()));
        Ok(Deployment { pin, raised })
    }

    /// Sends a creation, at a higher price each time that blocks pass it by, until it is mined.
    async fn create(
        &self,
        eoa: &EoaSecret,
        creation: TransactionRequest,
        policy: Policy,
    ) -> Result<(RawReceipt, Option<u128>), ChainError> {
        let market = self.market().await?;
        let mut price = affordable(policy.fresh(&market))?;
        let data = creation.data.clone().unwrap_or_default();
        let gas = match self.estimate(eoa.address(), None, &data).await {
            Err(ChainError::InsufficientFunds) => {
                // What a creation costs (Yellow Paper, appendix G), its constructor aside.
                let gas = 53_000 + 216 * data.len() as u64;
                return Err(self.poor(eoa, price, gas).await);
            }
            estimate => gas::with_margin(estimate?).min(self.room().unwrap_or(u64::MAX)),
        };
        let creation = creation.gas(gas);
        let (mut sent, mut wait): (Vec<Hash>, _) = (Vec::new(), Wait::from(market.head.number, STARVING));
        loop {
            let signed = sign_request(&wallet(eoa)?, creation.clone().gas_price(price))?;
            match self.broadcast(&signed.raw).await {
                Ok(_) | Err(ChainError::AlreadyKnown) => {}
                Err(ChainError::InsufficientFunds) => return Err(self.poor(eoa, price, gas).await),
                // One of those sent before may be in a block by now.
                Err(ChainError::NonceTooLow | ChainError::Underpriced) if !sent.is_empty() => {}
                Err(error) => return Err(error),
            }
            sent.push(signed.hash);
            let deadline = Instant::now() + PATIENCE;
            price = loop {
                if let Some(receipt) = self.one_of(&sent).await? {
                    return Ok((receipt, wait.is_raised().then_some(price)));
                }
                let market = self.market().await?;
                let head = market.head.number;
                if wait.is_due(head)
                    && policy.raises(&market)
                    && let Priced::At(higher) = policy.replacement(price, &market)
                {
                    wait.raise(head);
                    break higher;
                }
                if Instant::now() > deadline {
                    let blocks = wait.passed_by(head).unwrap_or(0);
                    return Err(ChainError::NotMined { seconds: wait.length().as_secs(), blocks, price: Wei(price) });
                }
                self.next_block(head, Duration::from_secs(1)).await?;
            };
        }
    }

    async fn one_of(&self, sent: &[Hash]) -> Result<Option<RawReceipt>, ChainError> {
        for hash in sent.iter().rev() {
            if let Some((receipt, _)) = self.raw_receipt(*hash).await? {
                return Ok(Some(receipt));
            }
        }
        Ok(None)
    }

    /// What the account lacks.
    async fn poor(&self, eoa: &EoaSecret, price: u128, gas: u64) -> ChainError {
        let needed = Wei(price.saturating_mul(u128::from(gas)));
        match self.wealth(eoa.address()).await {
            Ok(held) => ChainError::NoEther(Shortfall { account: eoa.address(), held: Wei(held), needed }),
            Err(error) => error,
        }
    }
}

fn affordable(price: Priced) -> Result<u128, ChainError> {
    match price {
        Priced::At(price) => Ok(price),
        Priced::Capped { needed, cap } => Err(ChainError::TooDear { needed: Wei(needed), cap: Wei(cap) }),
    }
}
