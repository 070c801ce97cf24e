//! Where a robot finds its gateway. The notice is signed by d_C, and its content by the owner's account: a thief with
//! only one of them cannot cut a robot off.

use crate::model::wire::{Reader, Wire as _, WireError, put_list, read_list};
use crate::model::{Address, Domain, SignerId};

use super::enrolment::{LONGEST_ADDRESS, MOST_ADDRESSES};
use super::identity::check_account;
use super::{AccountSignature, CryptoError, EoaSecret, Result, TypedStructure, sign_hash};

/// The EIP-712 type that the account signs.
const TYPE: &str = "Addresses(address owner,bytes32 device,bytes32 gateway,bytes addresses)";
const WHAT: &str = "list of a gateway's addresses";

/// All addresses of a robot's gateway.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GatewayAddresses {
    /// SM3 of the gateway's identity key.
    pub gateway: SignerId,
    /// Host:port each, in the order in which they are tried; at least one, at most [`MOST_ADDRESSES`].
    pub addresses: Vec<String>,
    /// The owner's EOA signature over them, the gateway and the device.
    pub account_signature: AccountSignature,
}

impl GatewayAddresses {
    /// The owner's list for a device, signed by the account.
    /// # Errors
    /// [`CryptoError::Length`] for too many or none, [`CryptoError::Internal`].
    pub fn sign(
        domain: &Domain,
        account: &EoaSecret,
        device: SignerId,
        (gateway, addresses): (SignerId, Vec<String>),
    ) -> Result<Self> {
        if !(1..=MOST_ADDRESSES).contains(&addresses.len()) {
            return Err(CryptoError::Length { what: WHAT, found: addresses.len(), allowed: "1 to 8 addresses" });
        }
        let hash = signed_hash(domain, (&account.address(), &device), &gateway, &addresses);
        Ok(Self { gateway, addresses, account_signature: sign_hash(account, &hash)? })
    }

    /// Whether the owner's account signed this list for this device. The record shows who signed the notice.
    /// # Errors
    /// [`CryptoError::NotAccepted`].
    pub fn check(&self, domain: &Domain, owner: &Address, device: &SignerId) -> Result<()> {
        let hash = signed_hash(domain, (owner, device), &self.gateway, &self.addresses);
        check_account(&hash, &self.account_signature, owner, WHAT)
    }

    /// Fingerprint (32), count (1, 1 to 8), each address with its length (2), the account's signature (65).
    pub fn encode(&self) -> Vec<u8> {
        let mut out = self.gateway.0.to_vec();
        put_addresses(&mut out, &self.addresses);
        self.account_signature.put(&mut out);
        out
    }

    /// From its encoding; only the form is checked.
    /// # Errors
    /// [`WireError`] if it is malformed.
    pub fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(bytes);
        let gateway = SignerId(reader.array("fingerprint")?);
        let addresses = read_addresses(&mut reader)?;
        let account_signature = AccountSignature(reader.array("account's signature")?);
        reader.end()?;
        Ok(Self { gateway, addresses, account_signature })
    }
}

pub(super) fn put_addresses(out: &mut Vec<u8>, addresses: &[String]) {
    put_list::<u8>(out, addresses, MOST_ADDRESSES);
}

/// At least one, at most [`MOST_ADDRESSES`], each of at most [`LONGEST_ADDRESS`] bytes.
pub(super) fn read_addresses(reader: &mut Reader<'_>) -> Result<Vec<String>, WireError> {
    let addresses: Vec<String> = read_list::<u8, _>(reader, 1..=MOST_ADDRESSES, ("address count", "address"))?;
    let is_usable = |address: &String| (1..=LONGEST_ADDRESS).contains(&address.len());
    if addresses.iter().all(is_usable) { Ok(addresses) } else { Err(WireError::Value("address")) }
}

fn signed_hash(
    domain: &Domain,
    (owner, device): (&Address, &SignerId),
    gateway: &SignerId,
    addresses: &[String],
) -> [u8; 32] {
    let mut encoded = Vec::new();
    put_addresses(&mut encoded, addresses);
    let structure = TypedStructure::new(TYPE).address(owner).word(&device.0).word(&gateway.0);
    structure.bytes(&encoded).signing_hash(domain)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_owners_account_names_the_addresses_of_a_robots_gateway() {
        let (account, thief) = (EoaSecret::generate().expect("generates"), EoaSecret::generate().expect("generates"));
        let (domain, owner, device) = (Domain([1; 32]), account.address(), SignerId([9; 32]));
        let listed = |count: u8| {
            let addresses = (0..count).map(|number| format!("gate{number}:7420")).collect();
            (SignerId([3; 32]), addresses)
        };
        let list = GatewayAddresses::sign(&domain, &account, device, listed(2)).expect("signs");
        assert!(list.check(&domain, &owner, &device).is_ok());
        assert!(list.check(&Domain([2; 32]), &owner, &device).is_err(), "of another network");
        assert!(list.check(&domain, &owner, &SignerId([8; 32])).is_err(), "for another robot");
        let forged = GatewayAddresses::sign(&domain, &thief, device, listed(2)).expect("signs");
        assert!(forged.check(&domain, &owner, &device).is_err(), "by another account");
        for count in [0, 9] {
            assert!(GatewayAddresses::sign(&domain, &account, device, listed(count)).is_err(), "{count}");
        }

        let bytes = list.encode();
        assert_eq!(GatewayAddresses::parse(&bytes), Ok(list));
        for cut in 0..bytes.len() {
            assert!(GatewayAddresses::parse(&bytes[..cut]).is_err(), "{cut}");
        }
        for at in 0..bytes.len() {
            let mut altered = bytes.clone();
            altered[at] ^= 1;
            if let Ok(altered) = GatewayAddresses::parse(&altered) {
                assert!(altered.check(&domain, &owner, &device).is_err(), "byte {at}");
            }
        }
    }
}
