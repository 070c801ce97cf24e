//! What only a lab asks of a chain: the contents of blocks, and calls of other contracts by their bytes.

use ethers::abi::{Abi, Token as AbiToken};
use ethers::types::transaction::eip2718::TypedTransaction;
use ethers::types::{H160, TransactionRequest};
use ethers::utils::{get_contract_address, keccak256};
use ethers_signers::{LocalWallet, Signer as _};
use serde::Deserialize;
use serde_json::{Value, json};

use authros_chain::{Chain, Offered, RelayError, SignedTransaction};
use authros_crypto::EoaSecret;
use authros_model::bytes::{hex, unhex};
use authros_model::{Address, ErrorKind, Hash};
use authros_service::Failure;
use authros_service::reply::internal;

/// What a block holds.
pub struct Block {
    /// Its transactions, in order.
    pub transactions: Vec<Hash>,
    /// The most gas that a block of this network may use.
    pub gas_limit: u64,
}

/// The contents of a block; `None` above the head.
///
/// # Errors
/// Errors of the node.
pub async fn block(chain: &Chain, number: u64) -> Result<Option<Block>, Failure> {
    let block = ask(chain, "eth_getBlockByNumber", json!([format!("{number:#x}"), false])).await?;
    if block.is_null() {
        return Ok(None);
    }
    let listed = block.get("transactions").and_then(Value::as_array);
    let hashes = listed.map(|all| all.iter().map(|hash| hash.as_str()?.parse().ok()).collect::<Option<Vec<_>>>());
    let transactions = hashes.flatten().ok_or_else(|| not_understood("a block's transactions"))?;
    let gas_limit = block.get("gasLimit").and_then(quantity).ok_or_else(|| not_understood("a block's gas limit"))?;
    Ok(Some(Block { transactions, gas_limit }))
}

/// Gas for a call, or with `to: None` for the creation of a contract: the node's estimate plus a quarter.
///
/// # Errors
/// If it would fail, or an error of the node.
pub async fn gas_of(chain: &Chain, from: Address, to: Option<Address>, data: &[u8]) -> Result<u64, Failure> {
    let mut message = json!({ "from": from.to_string(), "data": format!("0x{}", hex(data)) });
    if let Some(to) = to {
        message["to"] = json!(to.to_string());
    }
    let gas = ask(chain, "eth_estimateGas", json!([message])).await?;
    let gas = quantity(&gas).ok_or_else(|| not_understood("a gas estimate"))?;
    Ok(gas.saturating_add(gas / 4))
}

/// Signs a call with estimated gas, as a legacy transaction. Nothing is sent.
///
/// # Errors
/// See [`gas_of`].
pub async fn sign_estimated(
    chain: &Chain,
    eoa: &EoaSecret,
    nonce: u64,
    to: Option<Address>,
    data: Vec<u8>,
) -> Result<SignedTransaction, Failure> {
    let gas = gas_of(chain, eoa.address(), to, &data).await?;
    let price = chain.market().await?.offer();
    sign(chain, eoa, nonce, to, data, Offered { price, gas, value: 0 })
}

/// Signs a call at a given price and gas, as a legacy transaction. Nothing is sent.
///
/// # Errors
/// If it cannot be signed.
pub fn sign(
    chain: &Chain,
    eoa: &EoaSecret,
    nonce: u64,
    to: Option<Address>,
    data: Vec<u8>,
    Offered { price, gas, .. }: Offered,
) -> Result<SignedTransaction, Failure> {
    let wrong = |error: &dyn std::fmt::Display| internal(format!("a transaction cannot be signed: {error}"));
    let mut request = TransactionRequest::new().nonce(nonce).gas(gas).gas_price(price).data(data).value(0u64);
    request.to = to.map(|to| H160(to.0).into());
    let transaction = TypedTransaction::Legacy(request.chain_id(chain.chain_id()));
    let wallet = LocalWallet::from_bytes(&eoa.expose()[..]).map_err(|error| wrong(&error))?;
    let wallet = wallet.with_chain_id(chain.chain_id());
    let signature = wallet.sign_transaction_sync(&transaction).map_err(|error| wrong(&error))?;
    let raw = transaction.rlp_signed(&signature).to_vec();
    Ok(SignedTransaction { hash: Hash(keccak256(&raw)), nonce, raw, gas_limit: gas, gas_price: price })
}

/// The address of the contract that `sender` creates with `nonce`.
pub fn created_address(sender: Address, nonce: u64) -> Address {
    Address(get_contract_address(H160(sender.0), nonce).0)
}

/// A compiled contract whose functions take only byte strings.
#[derive(Debug)]
pub struct ForeignContract {
    abi: Abi,
    creation: Vec<u8>,
}

#[derive(Deserialize)]
struct File {
    abi: Abi,
    bytecode: String,
}

impl ForeignContract {
    /// From a compiler's JSON: `abi` and `bytecode`.
    ///
    /// # Errors
    /// If it is something else.
    pub fn parse(json: &str) -> Result<Self, Failure> {
        let file: File = serde_json::from_str(json).map_err(|_| internal("a compiled contract"))?;
        let creation = unhex(&file.bytecode).ok_or_else(|| internal("a contract's code"))?;
        Ok(Self { abi: file.abi, creation })
    }

    /// Its creation code, for a constructor without arguments.
    pub fn creation(&self) -> &[u8] {
        &self.creation
    }

    /// Call data of a function.
    ///
    /// # Errors
    /// If name or arguments do not match.
    pub fn call(&self, name: &str, arguments: &[&[u8]]) -> Result<Vec<u8>, Failure> {
        let arguments: Vec<AbiToken> = arguments.iter().map(|bytes| AbiToken::Bytes(bytes.to_vec())).collect();
        let encoded = self.abi.function(name).and_then(|function| function.encode_input(&arguments));
        encoded.map_err(|error| internal(format!("{name} cannot be called with these arguments: {error}")))
    }
}

async fn ask(chain: &Chain, method: &str, parameters: Value) -> Result<Value, Failure> {
    chain.relay(method, &parameters).await.map_err(|error| match error {
        RelayError::Answered { message, .. } => Failure::new(ErrorKind::Refused, format!("{method}: {message}")),
        other => Failure::new(ErrorKind::Unreachable, format!("{method}: {other}")),
    })
}

fn quantity(value: &Value) -> Option<u64> {
    u64::from_str_radix(value.as_str()?.strip_prefix("0x")?, 16).ok()
}

fn not_understood(what: &str) -> Failure {
    Failure::new(ErrorKind::Unreachable, format!("the node's answer is not understood: {what}; check --node"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_ethereums() {
        let sender: Address = "0x6ac7ea33f8831ea9dcc53393aaa88b25a785dbf0".parse().expect("address");
        let created = created_address(sender, 0).to_string().to_lowercase();
        assert_eq!(created, "0xcd234a471b72ba2f1ccf0a70fcaba648a5eecd8d");
    }

    #[test]
    fn quantities_are_hexadecimal() {
        assert_eq!((quantity(&json!("0x10")), quantity(&json!("10")), quantity(&json!(16))), (Some(16), None, None));
    }
}
