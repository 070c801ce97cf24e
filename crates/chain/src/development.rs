//! Ether for test accounts, from development nodes, which have plenty; never from other nodes.

use std::time::Duration;

use ethers::types::{H160, U256};
use serde_json::{Value, json};

use super::{Chain, ChainError};
use crate::model::Address;

/// 10 ether, in wei.
const GIFT: u64 = 10_000_000_000_000_000_000;
/// How long the gift may take to arrive.
const ARRIVAL: Duration = Duration::from_secs(15);
/// The chain id of `geth --dev`, which its client version does not reveal.
const GETH_DEV: u64 = 1337;

impl Chain {
    /// On a development node (anvil, ganache, hardhat, EthereumJS, `geth --dev`), gives an account that holds nothing
    /// 10 ether. Returns whether it did; `false` elsewhere, or if it is not possible.
    ///
    /// # Errors
    /// [`ChainError::Unreachable`] and the like; a refusal by the node returns `false`.
    pub async fn fund_from_node(&self, account: Address) -> Result<bool, ChainError> {
        if !self.is_development() || !self.balance(account).await?.is_zero() {
            return Ok(false);
        }
        Ok(self.fund_by_transfer(account).await? || self.fund_by_decree(account).await?)
    }

    fn is_development(&self) -> bool {
        let client = self.inner.client.to_lowercase();
        let named = ["anvil", "ganache", "hardhat", "ethereumjs"].iter().any(|name| client.contains(name));
        named || (client.contains("geth") && self.chain_id() == GETH_DEV)
    }

    async fn fund_by_transfer(&self, account: Address) -> Result<bool, ChainError> {
        let unlocked: Vec<H160> = answered(self.rpc("eth_accounts", json!([])).await)?.unwrap_or_default();
        let value = format!("{GIFT:#x}");
        for giver in unlocked {
            let gift = json!({ "from": giver, "to": account.to_string(), "value": value });
            let head = self.head().await?.number;
            if answered(self.rpc::<Value>("eth_sendTransaction", json!([gift])).await)?.is_some() {
                return self.wait_for_gift(account, head).await;
            }
        }
        Ok(false)
    }

    async fn wait_for_gift(&self, account: Address, mut head: u64) -> Result<bool, ChainError> {
        let deadline = tokio::time::Instant::now() + ARRIVAL;
        while self.balance(account).await?.is_zero() {
            if tokio::time::Instant::now() >= deadline {
                return Ok(false);
            }
            head = self.next_block(head, Duration::from_secs(1)).await?.number;
        }
        Ok(true)
    }

    async fn fund_by_decree(&self, account: Address) -> Result<bool, ChainError> {
        let amount = format!("{:#x}", U256::from(GIFT));
        for method in ["anvil_setBalance", "hardhat_setBalance", "evm_setAccountBalance"] {
            let decreed = self.rpc::<Value>(method, json!([account.to_string(), amount])).await;
            if answered(decreed)?.is_some() && !self.balance(account).await?.is_zero() {
                return Ok(true);
            }
        }
        Ok(false)
    }
}

/// A refusal just means no; a broken connection stays an error.
fn answered<T>(result: Result<T, ChainError>) -> Result<Option<T>, ChainError> {
    match result {
        Ok(value) => Ok(Some(value)),
        Err(error @ (ChainError::Unreachable { .. } | ChainError::Answer { .. })) => Err(error),
        Err(_) => Ok(None),
    }
}
