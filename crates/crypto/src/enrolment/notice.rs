//! The content of an owner's notice to a device. The first byte is the kind: 0 for keys (whose first field, an epoch,
//! is far below 2^56), 1 for another P_C of the owner, 2 for its gateway's addresses, 3 for a span of the device's ring, 4 for its
//! policy; further kinds take the next numbers.

use zeroize::Zeroizing;

use super::IssuedKeys;
use crate::crypto::{GatewayAddresses, OwnerKeyChange, SignedPolicy};
use crate::model::RingSpan;
use crate::model::wire::WireError;

/// What an owner tells a device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Notice {
    /// The keys to seal with from now on.
    Keys(IssuedKeys),
    /// The key the owner signs with from now on.
    OwnerKey(OwnerKeyChange),
    /// The addresses of its gateway from now on.
    Addresses(GatewayAddresses),
    /// A span of its ring is to be sent like other records.
    Pull(RingSpan),
    /// The policy to work by from now on.
    Policy(SignedPolicy),
    /// A kind that this version does not know, by its number; it is ignored.
    Unknown(u8),
}

impl Notice {
    /// The kind of [`Self::Keys`].
    const KEYS: u8 = 0;
    /// The kind of [`Self::OwnerKey`].
    const OWNER_KEY: u8 = 1;
    /// The kind of [`Self::Addresses`].
    const ADDRESSES: u8 = 2;
    /// The kind of [`Self::Pull`].
    const PULL: u8 = 3;
    /// The kind of [`Self::Policy`].
    const POLICY: u8 = 4;

    /// Its encoding, the body of the record.
    pub fn encode(&self) -> Zeroizing<Vec<u8>> {
        match self {
            Self::Keys(keys) => keys.encode(),
            Self::OwnerKey(change) => Zeroizing::new([&[Self::OWNER_KEY], &change.encode()[..]].concat()),
            Self::Addresses(list) => Zeroizing::new([&[Self::ADDRESSES], &list.encode()[..]].concat()),
            Self::Pull(span) => Zeroizing::new([&[Self::PULL], &span.encode()[..]].concat()),
            Self::Policy(policy) => Zeroizing::new([&[Self::POLICY], &policy.encode()[..]].concat()),
            Self::Unknown(kind) => Zeroizing::new(vec![*kind]),
        }
    }

    /// From the body of a record.
    ///
    /// # Errors
    /// [`WireError`] if it is malformed.
    pub fn parse(body: &[u8]) -> Result<Self, WireError> {
        match body.split_first() {
            Some((&Self::KEYS, _)) | None => IssuedKeys::parse(body).map(Self::Keys),
            Some((&Self::OWNER_KEY, change)) => OwnerKeyChange::parse(change).map(Self::OwnerKey),
            Some((&Self::ADDRESSES, list)) => GatewayAddresses::parse(list).map(Self::Addresses),
            Some((&Self::PULL, span)) => RingSpan::parse(span).map(Self::Pull),
            Some((&Self::POLICY, policy)) => SignedPolicy::parse(policy).map(Self::Policy),
            Some((kind, _)) => Ok(Self::Unknown(*kind)),
        }
    }
}
