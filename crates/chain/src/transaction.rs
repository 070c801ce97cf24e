//! RLP, and transactions: one legacy (EIP-155) transaction per call, signed, encoded, decoded, sent.

use std::{ops::Deref, sync::PoisonError};

use alloy_primitives::{B256, Bytes, Signature, TxKind, U256, keccak256};
use alloy_rlp::{Decodable, Encodable, Error};
use ethers::types::{H160, H256, U64};
use k256::ecdsa::SigningKey;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::model::{Address, Hash, bytes::hex};
use crate::reader::{RawLog, reason};
use crate::{Call, Chain, ChainError, Receipt, SignedTransaction, crypto::EoaSecret, error::explain, fees};

#[derive(Default)]
pub struct List(Vec<u8>);

impl List {
    pub fn add(mut self, item: &(impl Encodable + ?Sized)) -> Self {
        item.encode(&mut self.0);
        self
    }

    pub fn add_encoded(mut self, item: &[u8]) -> Self {
        self.0.extend_from_slice(item);
        self
    }

    pub fn end(self) -> Vec<u8> {
        let mut out = Vec::with_capacity(self.0.len() + 4);
        alloy_rlp::Header { list: true, payload_length: self.0.len() }.encode(&mut out);
        out.extend_from_slice(&self.0);
        out
    }
}

pub struct Items<'a>(&'a [u8]);

impl<'a> Items<'a> {
    /// The bytes must be exactly one list.
    pub fn of(mut bytes: &'a [u8]) -> alloy_rlp::Result<Self> {
        let items = alloy_rlp::Header::decode_bytes(&mut bytes, true)?;
        if bytes.is_empty() { Ok(Self(items)) } else { Err(Error::UnexpectedLength) }
    }

    pub fn next<T: Decodable>(&mut self) -> alloy_rlp::Result<T> {
        T::decode(&mut self.0)
    }

    pub fn address(&mut self) -> alloy_rlp::Result<Option<Address>> {
        Ok(self.next::<TxKind>()?.into_to().map(|address| Address(address.into_array())))
    }

    pub fn end(self) -> alloy_rlp::Result<()> {
        if self.0.is_empty() { Ok(()) } else { Err(Error::ListLengthMismatch { expected: 0, got: self.0.len() }) }
    }
}

/// The empty string if there is none.
pub fn optional(address: Option<&Address>) -> &[u8] {
    address.map_or(&[], Address::as_bytes)
}

/// Only the lower of a key's two signatures counts (EIP-2).
pub fn signer(signature: &Signature, hash: B256) -> Option<Address> {
    let canonical = signature.normalize_s().is_none();
    let address = signature.recover_address_from_prehash(&hash).ok().filter(|_| canonical);
    address.map(|address| Address(address.into_array()))
}

pub fn created_address(sender: Address, nonce: u64) -> Address {
    Address(alloy_primitives::Address::from(sender.0).create(nonce).into_array())
}

/// Bytes of a raw transaction, as in geth.
pub const LARGEST: usize = 128 * 1024;
/// EIP-155: the recovery value is the parity plus this and twice the chain id.
const REPLAY_PROTECTED: u64 = 35;

#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Unsigned {
    pub nonce: u64,
    pub gas_price: u128,
    pub gas_limit: u64,
    /// `None` creates a contract.
    pub to: Option<Address>,
    pub value: U256,
    pub input: Vec<u8>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Transaction {
    pub hash: Hash,
    pub sender: Address,
    pub unsigned: Unsigned,
    /// Recovery value with the chain id (EIP-155).
    pub v: u64,
    pub r: U256,
    pub s: U256,
    pub raw: Vec<u8>,
}

impl Deref for Transaction {
    type Target = Unsigned;

    fn deref(&self) -> &Unsigned {
        &self.unsigned
    }
}

/// What signing gives.
pub type Signed = Result<SignedTransaction, ChainError>;

impl Unsigned {
    fn encode(&self, v: u128, r: U256, s: U256) -> Vec<u8> {
        let list = List::default().add(&self.nonce).add(&self.gas_price).add(&self.gas_limit);
        let list = list.add(optional(self.to.as_ref())).add(&self.value).add(&self.input[..]);
        list.add(&v).add(&r).add(&s).end()
    }

    fn signing_hash(&self, chain_id: u64) -> B256 {
        keccak256(self.encode(chain_id.into(), U256::ZERO, U256::ZERO))
    }

    pub fn sign(self, eoa: &EoaSecret, chain_id: u64) -> Signed {
        let key = SigningKey::from_slice(eoa.expose());
        let signed = key.and_then(|key| key.sign_prehash_recoverable(&self.signing_hash(chain_id)[..]));
        let (signature, parity) = signed.map_err(|error| ChainError::Internal(format!("signing: {error}")))?;
        let signature = Signature::from_signature_and_parity(signature, parity.is_y_odd());
        let v = u128::from(chain_id) * 2 + u128::from(REPLAY_PROTECTED) + u128::from(signature.v());
        let raw = self.encode(v, signature.r(), signature.s());
        let Self { nonce, gas_limit, gas_price, .. } = self;
        Ok(SignedTransaction { hash: Hash(keccak256(&raw).0), nonce, raw, gas_limit, gas_price })
    }

    /// Charged before the first instruction (Istanbul, EIP-2028).
    pub fn intrinsic_gas(&self) -> u64 {
        let data: u64 = self.input.iter().map(|byte| if *byte == 0 { 4 } else { 16 }).sum();
        data + if self.to.is_some() { 21_000 } else { 53_000 }
    }

    /// Wei, at most.
    pub fn cost(&self) -> U256 {
        U256::from(self.gas_price).saturating_mul(U256::from(self.gas_limit)).saturating_add(self.value)
    }
}

impl Transaction {
    /// Recovers the sender. Refusals are worded as in geth, so that one table of messages fits every node.
    pub fn decode(raw: &[u8], chain_id: u64) -> Result<Self, String> {
        if raw.len() > LARGEST {
            return Err(format!("oversized data: transaction size {}, limit {LARGEST}", raw.len()));
        }
        if raw.first().is_some_and(|first| *first < 0xc0) {
            return Err("transaction type not supported".into());
        }
        let transaction = Self::parse(raw).map_err(|error| format!("rlp: {error}"))?;
        let Some(protected) = transaction.v.checked_sub(REPLAY_PROTECTED) else {
            return Err("only replay-protected (EIP-155) transactions allowed over RPC".into());
        };
        let have = protected / 2;
        if have != chain_id {
            return Err(format!("invalid sender: invalid chain id for signer: have {have} want {chain_id}"));
        }
        let signature = Signature::new(transaction.r, transaction.s, protected % 2 == 1);
        let sender = signer(&signature, transaction.signing_hash(chain_id));
        let sender = sender.ok_or("invalid sender: invalid transaction v, r, s values")?;
        Ok(Self { sender, ..transaction })
    }

    /// Leaves out the sender.
    pub fn parse(raw: &[u8]) -> alloy_rlp::Result<Self> {
        let mut items = Items::of(raw)?;
        let (nonce, gas_price, gas_limit) = (items.next()?, items.next()?, items.next()?);
        let (to, value, input) = (items.address()?, items.next()?, items.next::<Bytes>()?.to_vec());
        let unsigned = Unsigned { nonce, gas_price, gas_limit, to, value, input };
        let (v, r, s) = (items.next()?, items.next()?, items.next()?);
        items.end()?;
        let (hash, sender) = (Hash(keccak256(raw).0), Address([0; 20]));
        Ok(Self { hash, sender, unsigned, v, r, s, raw: raw.to_vec() })
    }
}

// Sending, and results.

impl Chain {
    /// Signs a legacy transaction, unsent. Estimates of uploads and anchors are remembered per account until a
    /// transaction fails, so that many can be signed in advance.
    pub async fn sign(&self, eoa: &EoaSecret, nonce: u64, call: &Call) -> Signed {
        let price = self.market().await?.offer();
        self.sign_at(eoa, nonce, call, price).await
    }

    pub(super) async fn gas(&self, from: Address, to: Address, call: &Call, data: &[u8]) -> Result<u64, ChainError> {
        let key = (from, call.name());
        let remembered = self.inner.gas.lock().unwrap_or_else(PoisonError::into_inner).get(&key).copied();
        let estimate = match remembered {
            Some(estimate) => estimate,
            None => self.estimate(from, Some(to), data).await?,
        };
        if matches!(call, Call::DataUpload { .. } | Call::Anchor { .. }) {
            self.inner.gas.lock().unwrap_or_else(PoisonError::into_inner).insert(key, estimate);
        }
        fees::limit(estimate, fees::known_cost(call.name(), data), self.room())
    }

    pub(super) fn room(&self) -> Option<u64> {
        *self.inner.block_room.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) async fn estimate(&self, from: Address, to: Option<Address>, data: &[u8]) -> Result<u64, ChainError> {
        let mut message = json!({ "from": from.to_string(), "data": format!("0x{}", hex(data)) });
        if let Some(to) = to {
            message["to"] = json!(to.to_string());
        }
        match self.rpc::<U64>("eth_estimateGas", json!([message])).await {
            Ok(gas) => Ok(gas.as_u64()),
            Err(error @ ChainError::Rejected { .. }) => {
                // Old nodes only say that it fails: simulating the call gives the reason.
                match to {
                    Some(to) => self.call(from, to, data, "latest").await.and(Err(error)),
                    None => Err(error),
                }
            }
            Err(error) => Err(error),
        }
    }

    pub(super) fn forget_gas(&self) {
        self.inner.gas.lock().unwrap_or_else(PoisonError::into_inner).clear();
    }

    pub async fn broadcast(&self, raw: &[u8]) -> Result<Hash, ChainError> {
        let sent = self.rpc::<String>("eth_sendRawTransaction", json!([format!("0x{}", hex(raw))])).await;
        let wrong = |_| self.misunderstood("eth_sendRawTransaction", "it is not a transaction hash");
        match sent {
            Ok(hash) => hash.parse().map_err(wrong),
            // ganache runs it immediately and reports its failure here; it is mined nevertheless.
            Err(ChainError::Reverted { code }) => match self.receipt(Hash(keccak256(raw).0)).await? {
                Some(_) => Ok(Hash(keccak256(raw).0)),
                None => Err(ChainError::Reverted { code }),
            },
            Err(error) => Err(error),
        }
    }

    /// `None` until it is mined.
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

#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct RawReceipt {
    pub block_number: U64,
    block_hash: H256,
    gas_used: ethers::types::U256,
    pub status: Option<U64>,
    pub contract_address: Option<H160>,
    #[serde(default)]
    logs: Vec<RawLog>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use ethers::types::{TransactionRequest, transaction::eip2718::TypedTransaction};
    use ethers_signers::{LocalWallet, Signer};
    use proptest::prelude::*;

    fn signed(chain_id: u64) -> (Vec<u8>, Address) {
        let wallet = LocalWallet::from_bytes(&[7; 32]).expect("key");
        let request = TransactionRequest::new().to(ethers::types::H160([1; 20])).nonce(3).gas(50_000).gas_price(0);
        let request: TypedTransaction = request.data(vec![1, 0, 2]).chain_id(chain_id).into();
        let signature = wallet.sign_transaction_sync(&request).expect("signs");
        (request.rlp_signed(&signature).to_vec(), Address(wallet.address().0))
    }

    #[test]
    fn decodes_what_ethers_signs_and_signs_the_same_bytes() {
        let (raw, sender) = signed(77);
        let transaction = Transaction::decode(&raw, 77).expect("decodes");
        assert_eq!((transaction.sender, transaction.nonce, transaction.gas_limit), (sender, 3, 50_000));
        assert_eq!(transaction.to, Some(Address([1; 20])));
        assert_eq!(transaction.intrinsic_gas(), 21_000 + 36);
        let own = transaction.unsigned.clone().sign(&EoaSecret::from_slice(&[7; 32]).expect("key"), 77).expect("signs");
        assert_eq!((&own.raw, own.hash), (&raw, transaction.hash));
        assert!(Transaction::decode(&raw, 78).expect_err("chain").contains("chain id"));
        assert!(Transaction::decode(&vec![0xf9; LARGEST + 1], 77).expect_err("size").contains("oversized"));
        assert!(Transaction::decode(&[2, 0xc0], 77).expect_err("type").contains("not supported"));
        assert!(Transaction::decode(&[raw, vec![0]].concat(), 77).is_err());
    }

    #[test]
    fn contract_addresses_are_ethereums() {
        let sender: Address = "0x6ac7ea33f8831ea9dcc53393aaa88b25a785dbf0".parse().expect("address");
        let created = created_address(sender, 0).to_string().to_lowercase();
        assert_eq!(created, "0xcd234a471b72ba2f1ccf0a70fcaba648a5eecd8d");
    }

    /// The other half of a signature's two forms would give a transaction a second hash.
    #[test]
    fn the_higher_signature_is_refused() {
        let (raw, _) = signed(77);
        let low = Transaction::decode(&raw, 77).expect("decodes");
        let order: U256 = "0xfffffffffffffffffffffffffffffffebaaedce6af48a03bbfd25e8cd0364141".parse().expect("n");
        let other =
            low.unsigned.encode(u128::from(if low.v % 2 == 1 { low.v + 1 } else { low.v - 1 }), low.r, order - low.s);
        assert!(Transaction::decode(&other, 77).expect_err("high").contains("v, r, s"));
    }

    proptest! {
        #[test]
        fn noise_never_panics(noise in proptest::collection::vec(any::<u8>(), 0..300)) {
            let _ = Transaction::decode(&noise, 77);
        }

        #[test]
        fn a_flipped_bit_never_keeps_sender_and_hash(at in 0usize..112, bit in 0u8..8) {
            let (mut raw, sender) = signed(77);
            let hash = Transaction::decode(&raw, 77).expect("decodes").hash;
            let at = at % raw.len();
            raw[at] ^= 1 << bit;
            if let Ok(changed) = Transaction::decode(&raw, 77) {
                prop_assert!(changed.sender != sender && changed.hash != hash);
            }
        }
    }
}
