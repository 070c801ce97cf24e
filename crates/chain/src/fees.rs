//! Gas prices, and re-signing transactions: the same call at another price or nonce.

use ethers::types::transaction::eip2718::TypedTransaction;
use ethers::types::{H160, TransactionRequest, U256};
use ethers::utils::rlp;
use serde_json::json;

use super::artefact::artefact;
use super::connect::RawBlock;
use super::gas;
use super::sender::{sign_request, wallet};
use super::{BlockRef, Call, Chain, ChainError, Shortfall, SignedTransaction};
use crate::crypto::EoaSecret;
use crate::model::{Address, Wei};

/// The highest tip on top of the base fee, wei.
const LARGEST_TIP: u128 = 1_000_000_000;
/// The gas of a plain transfer of ether (Yellow Paper, appendix G).
const TRANSFER_GAS: u64 = 21_000;

/// The newest block and its gas price.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Market {
    /// The newest block.
    pub head: BlockRef,
    /// Its base fee, wei; `None` if the network has none, or it is zero.
    pub base: Option<u128>,
    /// The node's suggested price, wei.
    pub quoted: u128,
}

impl Market {
    /// The gas price of a legacy transaction, wei: twice the base fee, which may rise until it is mined, and a tip of
    /// at most 1 gwei. Without a base fee, the node's own price, without a margin: nodes quote what was paid last, so a
    /// margin would feed on itself.
    pub fn offer(&self) -> u128 {
        match self.base {
            Some(base) => base.saturating_mul(2) + self.quoted.saturating_sub(base).min(LARGEST_TIP),
            None => self.quoted,
        }
    }
}

/// The gas terms of signed bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Offered {
    /// Wei per gas.
    pub price: u128,
    /// The most gas it may use.
    pub gas: u64,
    /// The ether that it sends, wei.
    pub value: u128,
}

impl Offered {
    /// The most wei that the transaction may cost at `price`, what it sends included.
    pub fn cost_at(&self, price: u128) -> u128 {
        price.saturating_mul(u128::from(self.gas)).saturating_add(self.value)
    }
}

impl Chain {
    /// The newest block and the current gas price.
    ///
    /// # Errors
    /// Errors of the node.
    pub async fn market(&self) -> Result<Market, ChainError> {
        let block: RawBlock = self.rpc("eth_getBlockByNumber", json!(["latest", false])).await?;
        self.note_room(block.room());
        let quoted: U256 = self.rpc("eth_gasPrice", json!([])).await?;
        let base = block.base_fee_per_gas.filter(|base| !base.is_zero());
        let base = base.map(|base| self.small("eth_getBlockByNumber", base)).transpose()?;
        Ok(Market { head: block.reference(), base, quoted: self.small("eth_gasPrice", quoted)? })
    }

    fn small(&self, method: &str, value: U256) -> Result<u128, ChainError> {
        u128::try_from(value).map_err(|_| self.misunderstood(method, "it is too large"))
    }

    /// Wei held by an account, saturating at the largest number.
    ///
    /// # Errors
    /// Errors of the node.
    pub async fn wealth(&self, account: Address) -> Result<u128, ChainError> {
        Ok(u128::try_from(self.balance(account).await?).unwrap_or(u128::MAX))
    }

    /// What the account holds, and what its next call needs at this price; the node's own estimate may be higher.
    ///
    /// # Errors
    /// Errors of the node, [`ChainError::Input`].
    pub async fn shortfall(&self, account: Address, call: &Call, price: u128) -> Result<Shortfall, ChainError> {
        let gas = call.known_cost(&call.encode()?);
        let needed = Wei(price.saturating_mul(u128::from(gas)));
        Ok(Shortfall { account, held: Wei(self.wealth(account).await?), needed })
    }

    /// Like [`Chain::sign`], at a given price in wei per gas.
    ///
    /// # Errors
    /// See [`Chain::sign`].
    pub async fn sign_at(
        &self,
        eoa: &EoaSecret,
        nonce: u64,
        call: &Call,
        price: u128,
    ) -> Result<SignedTransaction, ChainError> {
        let contract = self.contract()?;
        let data = call.encode()?;
        let wallet = wallet(eoa)?;
        let gas = self.gas_for(eoa.address(), contract, call, &data).await?;
        let mut request = TransactionRequest::new().nonce(nonce).gas(gas).gas_price(price).data(data).value(0u64);
        request.to = Some(H160(contract.0).into());
        sign_request(&wallet, request.chain_id(self.chain_id()))
    }

    /// Signs a transfer of `wei` to `to`, without data. Nothing is sent.
    ///
    /// # Errors
    /// [`ChainError::Internal`] if it cannot be signed.
    pub fn sign_transfer(
        &self,
        eoa: &EoaSecret,
        nonce: u64,
        to: Address,
        wei: u128,
        price: u128,
    ) -> Result<SignedTransaction, ChainError> {
        let mut request = TransactionRequest::new().nonce(nonce).gas(TRANSFER_GAS).gas_price(price).value(wei);
        request.to = Some(H160(to.0).into());
        sign_request(&wallet(eoa)?, request.chain_id(self.chain_id()))
    }

    /// Signs the call in `raw` again, with another nonce or price, and with gas that is estimated anew: the estimate of
    /// then may be what keeps it out of a block. Nothing is sent.
    ///
    /// # Errors
    /// [`ChainError::Input`] if `raw` is not a legacy transaction, [`ChainError::BlockTooSmall`].
    pub async fn resign(
        &self,
        eoa: &EoaSecret,
        raw: &[u8],
        nonce: u64,
        price: u128,
    ) -> Result<SignedTransaction, ChainError> {
        let request = decode(raw)?;
        let data = request.data.clone().unwrap_or_default();
        let gas = match function_of(&data) {
            Some(function) => {
                // It may fail because an earlier transaction of the lane is in no block yet.
                let estimate = self.estimate(eoa.address(), Some(self.contract()?), &data).await.unwrap_or(0);
                gas::limit(estimate, gas::known_cost(&function, &data), self.room())?
            }
            None => TRANSFER_GAS,
        };
        let request = request.nonce(nonce).gas_price(price).gas(gas).chain_id(self.chain_id());
        sign_request(&wallet(eoa)?, request)
    }
}

/// The name of the contract's function that call data is for.
fn function_of(data: &[u8]) -> Option<String> {
    let selector = data.get(..4)?;
    let abi = &artefact().ok()?.abi;
    abi.functions().find(|function| function.short_signature() == selector).map(|function| function.name.clone())
}

/// The gas terms of signed legacy bytes.
///
/// # Errors
/// [`ChainError::Input`] if they are not a legacy transaction.
pub fn offered(raw: &[u8]) -> Result<Offered, ChainError> {
    let request = decode(raw)?;
    let price = request.gas_price.and_then(|price| u128::try_from(price).ok());
    let gas = request.gas.and_then(|gas| u64::try_from(gas).ok());
    let value = request.value.map_or(0, |value| u128::try_from(value).unwrap_or(u128::MAX));
    price.zip(gas).map(|(price, gas)| Offered { price, gas, value }).ok_or_else(no_transaction)
}

/// Whether two signed legacy transactions make the same call, regardless of nonce and price.
pub fn is_same_call(one: &[u8], other: &[u8]) -> bool {
    let call = |raw| decode(raw).ok().map(|request| (request.to, request.value, request.data));
    call(one).is_some_and(|found| call(other) == Some(found))
}

/// The call data of signed legacy bytes.
///
/// # Errors
/// [`ChainError::Input`] if they are not a legacy transaction.
pub fn call_data(raw: &[u8]) -> Result<Vec<u8>, ChainError> {
    Ok(decode(raw)?.data.map(|data| data.to_vec()).unwrap_or_default())
}

fn decode(raw: &[u8]) -> Result<TransactionRequest, ChainError> {
    let (transaction, _) = TypedTransaction::decode_signed(&rlp::Rlp::new(raw)).map_err(|_| no_transaction())?;
    match transaction {
        TypedTransaction::Legacy(request) => Ok(TransactionRequest { from: None, ..request }),
        _ => Err(no_transaction()),
    }
}

fn no_transaction() -> ChainError {
    ChainError::Input("the stored bytes are not a legacy transaction; check the ledger with `authros audit`".into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Hash;

    fn market(base: Option<u128>, quoted: u128) -> Market {
        Market { head: BlockRef { number: 1, hash: Hash([0; 32]), timestamp: 0 }, base, quoted }
    }

    #[test]
    fn offers() {
        assert_eq!(market(None, 7).offer(), 7);
        assert_eq!(market(Some(100), 130).offer(), 230);
        assert_eq!(market(Some(100), 90).offer(), 200);
        assert_eq!(market(Some(1), 5_000_000_000).offer(), 1_000_000_002, "the tip is bounded");
    }

    #[test]
    fn signed_again_only_price_nonce_and_hash_differ() {
        let eoa = EoaSecret::from_slice(&[7; 32]).expect("key");
        let wallet = wallet(&eoa).expect("wallet");
        let mut request = TransactionRequest::new().nonce(3).gas(50_000).gas_price(9u64).data(vec![1, 2, 3]);
        request = request.value(0u64).chain_id(31_337u64);
        request.to = Some(H160([5; 20]).into());
        let first = sign_request(&wallet, request.clone()).expect("signs");
        let again =
            sign_request(&wallet, decode(&first.raw).expect("decodes").nonce(4).gas_price(11u64).chain_id(31_337u64));
        let again = again.expect("signs");
        assert_ne!(first.hash, again.hash);
        assert_eq!(offered(&again.raw), Ok(Offered { price: 11, gas: 50_000, value: 0 }));
        assert_eq!((again.nonce, again.gas_limit, again.gas_price), (4, 50_000, 11));
        assert!(is_same_call(&first.raw, &again.raw));
        assert_eq!(call_data(&again.raw), Ok(vec![1, 2, 3]));
        let other = sign_request(&wallet, request.data(vec![1, 2])).expect("signs");
        assert!(!is_same_call(&first.raw, &other.raw));
        assert!(!is_same_call(&[1], &[1]) && offered(&[0xc0]).is_err() && call_data(&[]).is_err());
        assert_eq!(offered(&first.raw).map(|offered| offered.cost_at(2)), Ok(100_000));
    }
}
