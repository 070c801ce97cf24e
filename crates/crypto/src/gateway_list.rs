//! The notice that a robot's gateways have changed. The notice is signed by d_C, and its content by the owner's account:
//! a thief who has only one of them cannot lead a robot to a gateway of their own.

use zeroize::Zeroizing;

use crate::model::wire::{Reader, WireError, put_text};
use crate::model::{Address, Domain, SignerId};

use super::enrolment::{GatewayAccess, LONGEST_GATEWAY, MOST_GATEWAYS};
use super::{AccountSignature, CryptoError, EoaSecret, TransportKey, TypedStructure, recover_account, sign_hash};

/// The EIP-712 type that the account signs.
const TYPE: &str = "Gateways(address owner,bytes32 device,bytes gateways)";
const WHAT: &str = "list of gateways";

/// A gateway as a notice names it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ListedGateway {
    /// Host:port.
    pub address: String,
    /// SM3 of its identity key.
    pub fingerprint: SignerId,
    /// K_T there; none if the robot has it already.
    pub transport: Option<TransportKey>,
}

/// All gateways of a robot, in order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GatewayList {
    /// At least one, at most [`MOST_GATEWAYS`].
    pub gateways: Vec<ListedGateway>,
    /// The owner's EOA signature over them and the device.
    pub account_signature: AccountSignature,
}

impl GatewayList {
    /// The owner's list for a device, signed by the account.
    ///
    /// # Errors
    /// [`CryptoError::Length`] for too many or none, [`CryptoError::Internal`].
    pub fn sign(
        domain: &Domain,
        account: &EoaSecret,
        device: SignerId,
        gateways: Vec<ListedGateway>,
    ) -> Result<Self, CryptoError> {
        if !(1..=MOST_GATEWAYS).contains(&gateways.len()) {
            return Err(CryptoError::Length { what: WHAT, found: gateways.len(), allowed: "1 to 8 gateways" });
        }
        let hash = signed_hash(domain, &account.address(), &device, &gateways);
        Ok(Self { gateways, account_signature: sign_hash(account, &hash)? })
    }

    /// Whether the owner's account signed this list for this device. The signer of the notice was checked with the
    /// record.
    ///
    /// # Errors
    /// [`CryptoError::NotAccepted`].
    pub fn check(&self, domain: &Domain, owner: &Address, device: &SignerId) -> Result<(), CryptoError> {
        let hash = signed_hash(domain, owner, device, &self.gateways);
        if recover_account(&hash, &self.account_signature).is_ok_and(|account| account == *owner) {
            return Ok(());
        }
        Err(CryptoError::NotAccepted { what: WHAT, field: "account's signature" })
    }

    /// The gateways that a robot has from now on: those of the list whose K_T it knows, in the order of the list.
    pub fn applied(&self, known: &[GatewayAccess]) -> Vec<GatewayAccess> {
        let of = |listed: &ListedGateway| {
            let had = known.iter().find(|gateway| gateway.fingerprint == listed.fingerprint);
            let transport = listed.transport.clone().or_else(|| had.map(|gateway| gateway.transport.clone()))?;
            Some(GatewayAccess { address: listed.address.clone(), fingerprint: listed.fingerprint, transport })
        };
        self.gateways.iter().filter_map(of).collect()
    }

    /// Count (1, 1 to 8), each: length (2) || address || fingerprint (32) || 0, or 1 || K_T (32); then the account's
    /// signature (65).
    pub fn encode(&self) -> Zeroizing<Vec<u8>> {
        let mut out = encoded(&self.gateways);
        out.extend_from_slice(&self.account_signature.0);
        out
    }

    /// From its encoding; only the form is checked.
    ///
    /// # Errors
    /// [`WireError`] if it is malformed, or names a gateway twice.
    pub fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(bytes);
        let count = usize::from(reader.u8("gateway count")?);
        if !(1..=MOST_GATEWAYS).contains(&count) {
            return Err(WireError::Value("gateway count"));
        }
        let mut gateways: Vec<ListedGateway> = Vec::with_capacity(count);
        for _ in 0..count {
            let (address, fingerprint) = (reader.text("gateway")?, SignerId(reader.array("fingerprint")?));
            let twice = gateways.iter().any(|known| known.fingerprint == fingerprint);
            if address.is_empty() || address.len() > LONGEST_GATEWAY || twice {
                return Err(WireError::Value("gateway"));
            }
            let transport = match reader.u8("transport key")? {
                0 => None,
                1 => Some(TransportKey::new(reader.array("transport key")?)),
                _ => return Err(WireError::Value("transport key")),
            };
            gateways.push(ListedGateway { address, fingerprint, transport });
        }
        let account_signature = AccountSignature(reader.array("account's signature")?);
        reader.end()?;
        Ok(Self { gateways, account_signature })
    }
}

fn encoded(gateways: &[ListedGateway]) -> Zeroizing<Vec<u8>> {
    let room: usize = gateways.iter().map(|gateway| gateway.address.len() + 67).sum();
    // Reserved in one piece, signature and tag included: growing the buffer would leave unwiped copies behind.
    let mut out = Zeroizing::new(Vec::with_capacity(1 + room + 65 + 16));
    out.push(u8::try_from(gateways.len()).unwrap_or(0));
    for gateway in gateways {
        put_text(&mut out, &gateway.address);
        out.extend_from_slice(&gateway.fingerprint.0);
        match &gateway.transport {
            None => out.push(0),
            Some(key) => {
                out.push(1);
                out.extend_from_slice(key.expose());
            }
        }
    }
    out
}

fn signed_hash(domain: &Domain, owner: &Address, device: &SignerId, gateways: &[ListedGateway]) -> [u8; 32] {
    TypedStructure::new(TYPE).address(owner).word(&device.0).bytes(&encoded(gateways)).signing_hash(domain)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn listed(number: u8, key: Option<u8>) -> ListedGateway {
        let transport = key.map(|key| TransportKey::new([key; 32]));
        ListedGateway { address: format!("gate{number}:7420"), fingerprint: SignerId([number; 32]), transport }
    }

    #[test]
    fn only_the_owners_account_names_the_gateways_of_a_robot() {
        let (account, thief) = (EoaSecret::generate().expect("generates"), EoaSecret::generate().expect("generates"));
        let (domain, owner, device) = (Domain([1; 32]), account.address(), SignerId([9; 32]));
        let gateways = vec![listed(1, None), listed(2, Some(5))];
        let list = GatewayList::sign(&domain, &account, device, gateways.clone()).expect("signs");
        assert!(list.check(&domain, &owner, &device).is_ok());
        assert!(list.check(&Domain([2; 32]), &owner, &device).is_err(), "of another network");
        assert!(list.check(&domain, &owner, &SignerId([8; 32])).is_err(), "for another robot");
        let forged = GatewayList::sign(&domain, &thief, device, gateways.clone()).expect("signs");
        assert!(forged.check(&domain, &owner, &device).is_err(), "by another account");
        assert!(GatewayList::sign(&domain, &account, device, Vec::new()).is_err());
        assert!(GatewayList::sign(&domain, &account, device, vec![listed(1, None); 9]).is_err());

        let bytes = list.encode();
        assert_eq!(GatewayList::parse(&bytes), Ok(list));
        for cut in 0..bytes.len() {
            assert!(GatewayList::parse(&bytes[..cut]).is_err(), "{cut}");
        }
        for at in 0..bytes.len() {
            let mut altered = bytes.to_vec();
            altered[at] ^= 1;
            if let Ok(altered) = GatewayList::parse(&altered) {
                assert!(altered.check(&domain, &owner, &device).is_err(), "byte {at}");
            }
        }
        let twice = GatewayList::sign(&domain, &account, device, vec![listed(1, None), listed(1, None)]);
        assert!(GatewayList::parse(&twice.expect("signs").encode()).is_err());
    }

    #[test]
    fn a_robot_keeps_the_keys_it_has_and_takes_those_it_is_given() {
        let account = EoaSecret::generate().expect("generates");
        let known = |number: u8| GatewayAccess {
            address: "elsewhere:1".to_owned(),
            fingerprint: SignerId([number; 32]),
            transport: TransportKey::new([number; 32]),
        };
        let gateways = vec![listed(2, Some(22)), listed(1, None), listed(3, None)];
        let list = GatewayList::sign(&Domain([1; 32]), &account, SignerId([9; 32]), gateways).expect("signs");
        let applied = list.applied(&[known(1), known(4)]);
        let told: Vec<_> =
            applied.iter().map(|gateway| (gateway.address.as_str(), gateway.transport.expose()[0])).collect();
        assert_eq!(told, [("gate2:7420", 22), ("gate1:7420", 1)], "one whose key nobody gave is left out");
    }
}
