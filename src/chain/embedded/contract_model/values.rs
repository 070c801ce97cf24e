//! ABI values as plain ones.

use ethers::abi::Token as AbiToken;
use ethers::types::H160;

use super::Word;
use crate::model::Address;

/// Arguments of a call whose shape the ABI vouches for.
pub(super) struct Values<'a>(pub &'a [AbiToken]);

impl Values<'_> {
    pub fn bytes(&self, at: usize) -> Vec<u8> {
        self.0[at].clone().into_bytes().expect("bytes")
    }

    pub fn word(&self, at: usize) -> Word {
        self.0[at].clone().into_fixed_bytes().expect("a word").try_into().expect("32 bytes")
    }

    pub fn number(&self, at: usize) -> u64 {
        self.0[at].clone().into_uint().expect("a number").as_u64()
    }

    pub fn flag(&self, at: usize) -> bool {
        self.0[at] == AbiToken::Bool(true)
    }

    pub fn address(&self, at: usize) -> Address {
        let H160(bytes) = self.0[at].clone().into_address().expect("an address");
        Address(bytes)
    }

    pub fn addresses(&self, at: usize) -> Vec<Address> {
        let list = self.0[at].clone().into_array().expect("a list");
        list.into_iter().map(|one| Address(one.into_address().expect("an address").0)).collect()
    }

    pub fn list(&self, at: usize) -> Vec<Vec<u8>> {
        let list = self.0[at].clone().into_array().expect("a list");
        list.into_iter().map(|one| one.clone().into_bytes().or(one.into_fixed_bytes()).expect("bytes")).collect()
    }
}
