//! A legacy (EIP-155) transaction: decoded from its raw bytes, with its sender recovered.
//!
//! Refusals are worded as in geth, so that one table of messages fits every node.

use ethers::types::U256;
use ethers::utils::keccak256;
use ethers::utils::rlp::{DecoderError, Rlp, RlpStream};
use k256::ecdsa::{RecoveryId, Signature, VerifyingKey};

use crate::model::{Address, Hash};

/// The largest raw transaction accepted, bytes, as in geth.
pub const LARGEST: usize = 128 * 1024;

/// One signed transaction.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Transaction {
    /// Keccak-256 of the raw bytes.
    pub hash: Hash,
    /// Who signed it.
    pub sender: Address,
    /// Its nonce.
    pub nonce: u64,
    /// Wei per gas.
    pub gas_price: u128,
    /// The most gas it may use.
    pub gas_limit: u64,
    /// The account it calls; `None` creates a contract.
    pub to: Option<Address>,
    /// Wei to send.
    pub value: U256,
    /// Call data or creation code.
    pub input: Vec<u8>,
    /// Recovery value with the chain id (EIP-155).
    pub v: u64,
    /// First half of the signature.
    pub r: U256,
    /// Second half of the signature.
    pub s: U256,
    /// Its raw bytes.
    pub raw: Vec<u8>,
}

impl Transaction {
    /// Decodes `raw` and recovers its sender.
    ///
    /// # Errors
    /// What is wrong, in geth's words.
    pub fn decode(raw: &[u8], chain_id: u64) -> Result<Self, String> {
        if raw.len() > LARGEST {
            return Err(format!("oversized data: transaction size {}, limit {LARGEST}", raw.len()));
        }
        if raw.first().is_some_and(|first| *first < 0xc0) {
            return Err("transaction type not supported".into());
        }
        let mut transaction = Self::fields(raw).map_err(|error| format!("rlp: {error}"))?;
        transaction.check_chain(chain_id)?;
        transaction.sender =
            transaction.recover(chain_id).ok_or("invalid sender: invalid transaction v, r, s values")?;
        Ok(transaction)
    }

    fn fields(raw: &[u8]) -> Result<Self, DecoderError> {
        let list = Rlp::new(raw);
        if list.payload_info()?.total() != raw.len() || list.item_count()? != 9 {
            return Err(DecoderError::RlpIncorrectListLen);
        }
        let to: Vec<u8> = list.val_at(3)?;
        let price: U256 = list.val_at(1)?;
        Ok(Self {
            hash: Hash(keccak256(raw)),
            sender: Address([0; 20]),
            nonce: list.val_at(0)?,
            gas_price: u128::try_from(price).map_err(|_| DecoderError::RlpIsTooBig)?,
            gas_limit: list.val_at(2)?,
            to: if to.is_empty() {
                None
            } else {
                Some(Address::from_slice(&to).ok_or(DecoderError::RlpInvalidLength)?)
            },
            value: list.val_at(4)?,
            input: list.val_at(5)?,
            v: list.val_at(6)?,
            r: list.val_at(7)?,
            s: list.val_at(8)?,
            raw: raw.to_vec(),
        })
    }

    fn check_chain(&self, chain_id: u64) -> Result<(), String> {
        if self.v < 35 {
            return Err("only replay-protected (EIP-155) transactions allowed over RPC".into());
        }
        let have = (self.v - 35) / 2;
        if have == chain_id {
            Ok(())
        } else {
            Err(format!("invalid sender: invalid chain id for signer: have {have} want {chain_id}"))
        }
    }

    fn recover(&self, chain_id: u64) -> Option<Address> {
        let parity = u8::try_from((self.v - 35) % 2).ok()?;
        let mut scalars = [0; 64];
        self.r.to_big_endian(&mut scalars[..32]);
        self.s.to_big_endian(&mut scalars[32..]);
        let signature = Signature::from_slice(&scalars).ok()?;
        if signature.normalize_s().is_some() {
            return None;
        }
        recover(&self.signing_hash(chain_id), &signature, RecoveryId::from_byte(parity)?)
    }

    fn signing_hash(&self, chain_id: u64) -> [u8; 32] {
        let mut list = RlpStream::new_list(9);
        list.append(&self.nonce).append(&self.gas_price).append(&self.gas_limit);
        list.append(&self.to.as_ref().map_or(&[][..], Address::as_bytes));
        list.append(&self.value).append(&self.input).append(&chain_id).append(&0u8).append(&0u8);
        keccak256(list.out())
    }

    /// Gas charged before the first instruction (Istanbul, EIP-2028).
    pub fn intrinsic_gas(&self) -> u64 {
        let data: u64 = self.input.iter().map(|byte| if *byte == 0 { 4 } else { 16 }).sum();
        data + if self.to.is_some() { 21_000 } else { 53_000 }
    }

    /// The most that it can cost its sender, wei.
    pub fn cost(&self) -> U256 {
        U256::from(self.gas_price).saturating_mul(self.gas_limit.into()).saturating_add(self.value)
    }
}

/// The address whose key signed `hash`.
pub fn recover(hash: &[u8; 32], signature: &Signature, parity: RecoveryId) -> Option<Address> {
    let key = VerifyingKey::recover_from_prehash(hash, signature, parity).ok()?;
    let point = key.to_encoded_point(false);
    point.as_bytes().get(1..)?.try_into().ok().map(Address::from_public_key)
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
    fn decodes_what_ethers_signs() {
        let (raw, sender) = signed(77);
        let transaction = Transaction::decode(&raw, 77).expect("decodes");
        assert_eq!((transaction.sender, transaction.nonce, transaction.gas_limit), (sender, 3, 50_000));
        assert_eq!(transaction.to, Some(Address([1; 20])));
        assert_eq!(transaction.intrinsic_gas(), 21_000 + 36);
        assert!(Transaction::decode(&raw, 78).expect_err("chain").contains("chain id"));
        assert!(Transaction::decode(&vec![0xf9; LARGEST + 1], 77).expect_err("size").contains("oversized"));
        assert!(Transaction::decode(&[2, 0xc0], 77).expect_err("type").contains("not supported"));
        assert!(Transaction::decode(&[raw, vec![0]].concat(), 77).is_err());
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
