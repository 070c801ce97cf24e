//! Transactions: signing, sending, receipts, deployment. One legacy (EIP-155) transaction per call.

use std::sync::PoisonError;

use ethers::types::transaction::eip2718::TypedTransaction;
use ethers::types::{H160, TransactionRequest, U64, U256};
use ethers::utils::keccak256;
use ethers_signers::LocalWallet;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::crypto::EoaSecret;
use crate::error::explain;
use crate::model::bytes::hex;
use crate::model::{Address, Hash};
use crate::reader::{RawLog, reason};
use crate::{Call, Chain, ChainError, Receipt, SignedTransaction, fees};

impl Chain {
    /// Signs a call as a legacy transaction. Nothing is sent.
    ///
    /// Gas is estimated and held against what the call is known to cost; for uploads and anchors once per account, then
    /// remembered until a transaction fails, so that many can be signed in advance.
    ///
    /// # Errors
    /// [`ChainError::Reverted`] if the contract would refuse the call, [`ChainError::Input`], or an error of the node.
    pub async fn sign(&self, eoa: &EoaSecret, nonce: u64, call: &Call) -> Result<SignedTransaction, ChainError> {
        let price = self.market().await?.offer();
        self.sign_at(eoa, nonce, call, price).await
    }

    pub(super) async fn gas_for(
        &self,
        from: Address,
        to: Address,
        call: &Call,
        data: &[u8],
    ) -> Result<u64, ChainError> {
        let key = (from, call.name());
        let remembered = self.inner.gas.lock().unwrap_or_else(PoisonError::into_inner).get(&key).copied();
        let estimate = match remembered {
            Some(estimate) => estimate,
            None => self.estimate(from, Some(to), data).await?,
        };
        if matches!(call, Call::DataUpload { .. } | Call::Anchor { .. }) {
            self.inner.gas.lock().unwrap_or_else(PoisonError::into_inner).insert(key, estimate);
        }
        fees::limit(estimate, call.known_cost(data), self.room())
    }

    /// Notes how much gas the newest block may hold.
    pub(super) fn note_room(&self, room: Option<u64>) {
        *self.inner.block_room.lock().unwrap_or_else(PoisonError::into_inner) = room;
    }

    /// How much gas a block may hold, as far as the node has said.
    pub(super) fn room(&self) -> Option<u64> {
        *self.inner.block_room.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The node's estimate.
    pub(super) async fn estimate(&self, from: Address, to: Option<Address>, data: &[u8]) -> Result<u64, ChainError> {
        let mut message = json!({ "from": from.to_string(), "data": format!("0x{}", hex(data)) });
        if let Some(to) = to {
            message["to"] = json!(to.to_string());
        }
        match self.rpc::<U64>("eth_estimateGas", json!([message])).await {
            Ok(gas) => Ok(gas.as_u64()),
            Err(error @ ChainError::Rejected { .. }) => {
                // Old nodes say only that it always fails: simulating the call gives the reason.
                match to {
                    Some(to) => self.eth_call(from, to, data, "latest").await.and(Err(error)),
                    None => Err(error),
                }
            }
            Err(error) => Err(error),
        }
    }

    pub(super) fn forget_gas(&self) {
        self.inner.gas.lock().unwrap_or_else(PoisonError::into_inner).clear();
    }

    /// Sends signed bytes.
    ///
    /// # Errors
    /// [`ChainError::AlreadyKnown`], [`ChainError::NonceTooLow`], [`ChainError::Underpriced`],
    /// [`ChainError::InsufficientFunds`], or an error of the node.
    pub async fn broadcast(&self, raw: &[u8]) -> Result<Hash, ChainError> {
        let sent = self.rpc::<String>("eth_sendRawTransaction", json!([format!("0x{}", hex(raw))])).await;
        let wrong = |_| self.misunderstood("eth_sendRawTransaction", "it is not a transaction hash");
        match sent {
            Ok(hash) => hash.parse().map_err(wrong),
            // A node that runs a transaction at once (ganache) reports its failure here; it is mined nevertheless.
            Err(ChainError::Reverted { code }) => match self.receipt(Hash(keccak256(raw))).await? {
                Some(_) => Ok(Hash(keccak256(raw))),
                None => Err(ChainError::Reverted { code }),
            },
            Err(error) => Err(error),
        }
    }

    /// The result of a transaction; `None` until it is mined.
    ///
    /// # Errors
    /// Errors of the node.
    pub async fn receipt(&self, hash: Hash) -> Result<Option<Receipt>, ChainError> {
        let Some((raw, value)) = self.raw_receipt(hash).await? else { return Ok(None) };
        let success = raw.status.is_none_or(|status| !status.is_zero());
        let block = raw.block_number.as_u64();
        let mut why = None;
        if !success {
            self.forget_gas();
            why = reason(self, &value, block).await.map(|code| explain(&code));
        }
        let gas_used = u64::try_from(raw.gas_used).unwrap_or(u64::MAX);
        let contract = self.pin().map(|pin| pin.contract);
        let own = raw.logs.iter().filter(|log| contract.is_some_and(|contract| contract.0 == log.address.0));
        let events = own.map(|log| self.decode(log)).collect::<Result<_, _>>()?;
        Ok(Some(Receipt { block, block_hash: Hash(raw.block_hash.0), success, gas_used, reason: why, events }))
    }

    pub(super) async fn raw_receipt(&self, hash: Hash) -> Result<Option<(RawReceipt, Value)>, ChainError> {
        const METHOD: &str = "eth_getTransactionReceipt";
        let value: Value = self.rpc(METHOD, json!([hash.to_string()])).await?;
        if value.get("blockHash").is_none_or(Value::is_null) {
            return Ok(None);
        }
        let raw = RawReceipt::deserialize(&value).map_err(|error| self.misunderstood(METHOD, &error.to_string()))?;
        Ok(Some((raw, value)))
    }
}

/// Signs a request that has nonce, gas, price and chain id.
pub(super) fn sign_request(wallet: &LocalWallet, request: TransactionRequest) -> Result<SignedTransaction, ChainError> {
    let missing = || ChainError::Internal("signing: a transaction lacks a field".into());
    let number = |value: Option<U256>| value.and_then(|value| u64::try_from(value).ok()).ok_or_else(missing);
    let (nonce, gas_limit) = (number(request.nonce)?, number(request.gas)?);
    let gas_price = request.gas_price.and_then(|price| u128::try_from(price).ok()).ok_or_else(missing)?;
    let transaction = TypedTransaction::Legacy(request);
    let signature = wallet.sign_transaction_sync(&transaction).map_err(|error| unsigned(&error))?;
    let raw = transaction.rlp_signed(&signature).to_vec();
    Ok(SignedTransaction { hash: Hash(keccak256(&raw)), nonce, raw, gas_limit, gas_price })
}

/// The key in ethers' form; it is wiped when dropped.
pub(super) fn wallet(eoa: &EoaSecret) -> Result<LocalWallet, ChainError> {
    LocalWallet::from_bytes(&eoa.expose()[..]).map_err(|error| unsigned(&error))
}

fn unsigned(error: &dyn std::fmt::Display) -> ChainError {
    ChainError::Internal(format!("signing: {error}"))
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct RawReceipt {
    pub block_number: U64,
    block_hash: ethers::types::H256,
    gas_used: U256,
    pub status: Option<U64>,
    pub contract_address: Option<H160>,
    #[serde(default)]
    logs: Vec<RawLog>,
}
