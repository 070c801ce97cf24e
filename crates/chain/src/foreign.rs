//! Contracts other than AuthROS, deployed and called by their bytes; only to compare costs.

use ethers::abi::{Abi, Token as AbiToken};
use ethers::types::{H160, TransactionRequest};
use serde::Deserialize;

use super::sender::{sign_request, wallet};
use super::{Chain, ChainError, Offered, SignedTransaction};
use crate::crypto::EoaSecret;
use crate::model::{Address, bytes::unhex};

/// Another project's compiled contract, whose functions take only byte strings.
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
    /// [`ChainError::Input`] if it is something else.
    pub fn parse(json: &str) -> Result<Self, ChainError> {
        let wrong = |reason: String| ChainError::Input(format!("this is not a compiled contract: {reason}"));
        let file: File = serde_json::from_str(json).map_err(|error| wrong(error.to_string()))?;
        let creation = unhex(&file.bytecode).ok_or_else(|| wrong("its bytecode is not hex".into()))?;
        Ok(Self { abi: file.abi, creation })
    }

    /// Its creation code, for a constructor without arguments.
    pub fn creation(&self) -> &[u8] {
        &self.creation
    }

    /// Call data of a function.
    ///
    /// # Errors
    /// [`ChainError::Input`] if name or arguments do not match.
    pub fn call(&self, name: &str, arguments: &[&[u8]]) -> Result<Vec<u8>, ChainError> {
        let arguments: Vec<AbiToken> = arguments.iter().map(|bytes| AbiToken::Bytes(bytes.to_vec())).collect();
        let encoded = self.abi.function(name).and_then(|function| function.encode_input(&arguments));
        encoded.map_err(|error| ChainError::Input(format!("{name} cannot be called with these arguments: {error}")))
    }
}

impl Chain {
    /// Signs a call of any contract, or with `to: None` the creation of one, as a legacy transaction with estimated
    /// gas. Nothing is sent.
    ///
    /// # Errors
    /// [`ChainError::Reverted`] if it would fail, or an error of the node.
    pub async fn sign_bytes(
        &self,
        eoa: &EoaSecret,
        nonce: u64,
        to: Option<Address>,
        data: Vec<u8>,
    ) -> Result<SignedTransaction, ChainError> {
        let gas = self.gas_of_bytes(eoa.address(), to, &data).await?;
        let price = self.market().await?.offer();
        self.sign_bytes_at(eoa, nonce, to, data, Offered { price, gas })
    }

    /// Gas for such a call: the node's estimate plus a quarter.
    ///
    /// # Errors
    /// See [`Chain::sign_bytes`].
    pub async fn gas_of_bytes(&self, from: Address, to: Option<Address>, data: &[u8]) -> Result<u64, ChainError> {
        self.estimate(from, to, data).await
    }

    /// Like [`Chain::sign_bytes`], with given price and gas. Nothing is requested or sent.
    ///
    /// # Errors
    /// [`ChainError::Internal`] if it cannot be signed.
    pub fn sign_bytes_at(
        &self,
        eoa: &EoaSecret,
        nonce: u64,
        to: Option<Address>,
        data: Vec<u8>,
        offered: Offered,
    ) -> Result<SignedTransaction, ChainError> {
        let mut request = TransactionRequest::new().nonce(nonce).gas(offered.gas).gas_price(offered.price);
        request = request.data(data).value(0u64).chain_id(self.chain_id());
        request.to = to.map(|to| H160(to.0).into());
        sign_request(&wallet(eoa)?, request)
    }
}

/// The address of the contract that `sender` creates with `nonce`.
pub fn created_address(sender: Address, nonce: u64) -> Address {
    Address(ethers::utils::get_contract_address(H160(sender.0), nonce).0)
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
    fn what_does_not_fit_is_told() {
        for bad in ["", "{}", r#"{"abi":[],"bytecode":"0xz"}"#] {
            assert!(matches!(ForeignContract::parse(bad), Err(ChainError::Input(_))), "{bad}");
        }
        let empty = ForeignContract::parse(r#"{"abi":[],"bytecode":"0x00"}"#).expect("parses");
        assert!(matches!(empty.call("register", &[]), Err(ChainError::Input(_))));
    }
}
