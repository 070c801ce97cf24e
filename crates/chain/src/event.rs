//! Events of the contract, decoded.

use ethers::abi::{RawLog, Token as AbiToken};
use ethers::types::H256;
use serde::{Deserialize, Serialize};

use super::artefact::artefact;
use crate::model::{Address, Digest, GrantTerms, Hash, Identity, Scope, SignerId, Timestamp, Token, TopicId};

/// A change of the contract's state, as reported by its event.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "each variant's line names its fields")]
pub enum Event {
    /// An account registered at epoch 1.
    Registered { owner: Address, identity: Identity, epoch: u64 },
    /// An account replaced its SM2 keys; `keys` is their version, from 1.
    KeysRotated { owner: Address, keys: u64, identity: Identity, envelope: Vec<u8> },
    /// A grant was extended; `None` = no end.
    Extended { owner: Address, grantee: Address, expiry: Option<Timestamp> },
    /// From `from` on `recovery` may stop a succession of the owner's account; `None` = nobody.
    RecoveryNamed { owner: Address, recovery: Option<Address>, from: Timestamp },
    /// A digest, the owner's `number`-th, sealed in `epoch`. The time is what the owner says, `None` if it is not 8
    /// bytes.
    DataUploaded { owner: Address, digest: Digest, token: Token, epoch: u64, number: u64, timestamp: Option<Timestamp> },
    /// A grant began.
    Granted { terms: GrantTerms, envelope: Vec<u8> },
    /// A grantee got the envelope of another epoch.
    Wrapped { owner: Address, grantee: Address, epoch: u64, envelope: Vec<u8> },
    /// A grant ended; `epoch` and `token` are the owner's new ones.
    Revoked { owner: Address, grantee: Address, epoch: u64, token: Token },
    /// An epoch ended without a revoke; `epoch` and `token` are the owner's new ones.
    Rotated { owner: Address, epoch: u64, token: Token },
    /// A root over `count` digests.
    Anchored { account: Address, root: Hash, count: u64, previous: Hash },
    /// A device may sign for the owner.
    Lent { owner: Address, device: SignerId, until: Option<Timestamp> },
    /// A device may no longer sign for the owner.
    Recalled { owner: Address, device: SignerId },
    /// An account may register.
    Admitted { account: Address },
    /// An admission was withdrawn.
    Dismissed { account: Address },
    /// Registration was opened or closed.
    OpenChanged { open: bool },
    /// An account was suspended.
    Suspended { account: Address },
    /// An account's suspension was lifted.
    Restored { account: Address },
    /// All changes are paused until then; a time in the past means that they resumed.
    PausedUntil { until: Timestamp },
    /// A succession is pending until `due`; `recovery` may stop it.
    SuccessionProposed { lost: Address, successor: Address, recovery: Option<Address>, due: Timestamp },
    /// A pending succession was stopped or withdrawn.
    SuccessionCancelled { lost: Address, by: Address },
    /// The delay of successions, seconds.
    DelayFixed { seconds: u64 },
    /// A lost account has a successor.
    Succeeded { lost: Address, successor: Address },
    /// The nominee for administrator.
    AdministratorNominated { nominee: Address },
    /// The administrator changed.
    AdministratorChanged { previous: Address, administrator: Address },
}

impl Event {
    /// The owner or account that the event is about.
    pub fn account(&self) -> Option<Address> {
        match self {
            Self::Registered { owner, .. }
            | Self::KeysRotated { owner, .. }
            | Self::DataUploaded { owner, .. }
            | Self::Granted { terms: GrantTerms { owner, .. }, .. }
            | Self::Wrapped { owner, .. }
            | Self::Revoked { owner, .. }
            | Self::Rotated { owner, .. }
            | Self::Extended { owner, .. }
            | Self::RecoveryNamed { owner, .. }
            | Self::Lent { owner, .. }
            | Self::Recalled { owner, .. } => Some(*owner),
            Self::Anchored { account, .. }
            | Self::Admitted { account }
            | Self::Dismissed { account }
            | Self::Suspended { account }
            | Self::Restored { account } => Some(*account),
            Self::Succeeded { lost, .. }
            | Self::SuccessionProposed { lost, .. }
            | Self::SuccessionCancelled { lost, .. } => Some(*lost),
            Self::OpenChanged { .. }
            | Self::PausedUntil { .. }
            | Self::DelayFixed { .. }
            | Self::AdministratorNominated { .. }
            | Self::AdministratorChanged { .. } => None,
        }
    }

    /// From the topics and data of a log of the contract.
    ///
    /// # Errors
    /// What is wrong with the log, or with the artefact.
    pub fn decode(topics: &[Hash], data: &[u8]) -> Result<Self, String> {
        let artefact = artefact().map_err(|error| error.to_string())?;
        let first = topics.first().ok_or("an event without a topic")?;
        let mut events = artefact.abi.events();
        let event = events.find(|event| event.signature().0 == first.0).ok_or("an unknown event")?;
        let topics = topics.iter().map(|topic| H256(topic.0)).collect();
        let log = event.parse_log(RawLog { topics, data: data.to_vec() }).map_err(|error| error.to_string())?;
        let mut fields =
            Fields(log.params.into_iter().map(|parameter| parameter.value).collect::<Vec<_>>().into_iter());
        fields.event(&event.name).ok_or_else(|| format!("a malformed event {}", event.name))
    }
}

/// The parameters of an event, in the contract's order.
struct Fields(std::vec::IntoIter<AbiToken>);

impl Fields {
    fn event(&mut self, name: &str) -> Option<Event> {
        Some(match name {
            "Registered" => {
                let (owner, _) = (self.address()?, self.word()?);
                Event::Registered { owner, identity: self.identity()?, epoch: 1 }
            }
            "KeysRotated" => Event::KeysRotated {
                owner: self.address()?,
                keys: self.number()?,
                identity: self.identity()?,
                envelope: self.bytes()?,
            },
            "DataUploaded" => self.uploaded()?,
            "Granted" => self.granted()?,
            "Wrapped" => Event::Wrapped {
                owner: self.address()?,
                grantee: self.address()?,
                epoch: self.number()?,
                envelope: self.bytes()?,
            },
            "Revoked" => Event::Revoked {
                owner: self.address()?,
                grantee: self.address()?,
                epoch: self.number()?,
                token: Token(self.word()?),
            },
            "Rotated" => Event::Rotated { owner: self.address()?, epoch: self.number()?, token: Token(self.word()?) },
            "Anchored" => Event::Anchored {
                account: self.address()?,
                root: Hash(self.word()?),
                count: self.number()?,
                previous: Hash(self.word()?),
            },
            "Lent" => {
                Event::Lent { owner: self.address()?, device: SignerId(self.word()?), until: end(self.number()?) }
            }
            "Recalled" => Event::Recalled { owner: self.address()?, device: SignerId(self.word()?) },
            "Extended" => {
                Event::Extended { owner: self.address()?, grantee: self.address()?, expiry: end(self.number()?) }
            }
            "RecoveryNamed" => {
                Event::RecoveryNamed { owner: self.address()?, recovery: self.somebody()?, from: self.moment()? }
            }
            other => return self.administration(other),
        })
    }

    fn administration(&mut self, name: &str) -> Option<Event> {
        Some(match name {
            "Admitted" => Event::Admitted { account: self.address()? },
            "Dismissed" => Event::Dismissed { account: self.address()? },
            "OpenChanged" => Event::OpenChanged { open: self.0.next()?.into_bool()? },
            "Suspended" => Event::Suspended { account: self.address()? },
            "Restored" => Event::Restored { account: self.address()? },
            "PausedUntil" => Event::PausedUntil { until: self.moment()? },
            "SuccessionProposed" => Event::SuccessionProposed {
                lost: self.address()?,
                successor: self.address()?,
                recovery: self.somebody()?,
                due: self.moment()?,
            },
            "SuccessionCancelled" => Event::SuccessionCancelled { lost: self.address()?, by: self.address()? },
            "DelayFixed" => Event::DelayFixed { seconds: self.number()? },
            "Succeeded" => Event::Succeeded { lost: self.address()?, successor: self.address()? },
            "AdministratorNominated" => Event::AdministratorNominated { nominee: self.address()? },
            "AdministratorChanged" => {
                Event::AdministratorChanged { previous: self.address()?, administrator: self.address()? }
            }
            _ => return None,
        })
    }

    fn uploaded(&mut self) -> Option<Event> {
        Some(Event::DataUploaded {
            owner: self.address()?,
            digest: Digest(self.word()?),
            token: Token(self.word()?),
            epoch: self.number()?,
            number: self.number()?,
            timestamp: self.bytes()?.try_into().ok().map(|bytes| Timestamp(u64::from_be_bytes(bytes))),
        })
    }

    fn granted(&mut self) -> Option<Event> {
        let (owner, grantee, epoch) = (self.address()?, self.address()?, self.number()?);
        let expiry = end(self.number()?);
        let ids = self.0.next()?.into_array()?.into_iter();
        let topics = ids.map(|id| TopicId::from_slice(&id.into_fixed_bytes()?)).collect::<Option<Vec<_>>>()?;
        let scope = if topics.is_empty() { Scope::All } else { Scope::Topics(topics) };
        Some(Event::Granted { terms: GrantTerms { owner, grantee, epoch, expiry, scope }, envelope: self.bytes()? })
    }

    fn address(&mut self) -> Option<Address> {
        self.0.next()?.into_address().map(|address| Address(address.0))
    }

    /// The zero address means nobody.
    #[allow(clippy::option_option, reason = "no word left is another thing than nobody")]
    fn somebody(&mut self) -> Option<Option<Address>> {
        self.address().map(|address| (address.0 != [0; 20]).then_some(address))
    }

    fn moment(&mut self) -> Option<Timestamp> {
        self.number().map(Timestamp::from_seconds)
    }

    fn number(&mut self) -> Option<u64> {
        self.0.next()?.into_uint()?.try_into().ok()
    }

    fn word(&mut self) -> Option<[u8; 32]> {
        self.0.next()?.into_fixed_bytes()?.try_into().ok()
    }

    fn bytes(&mut self) -> Option<Vec<u8>> {
        self.0.next()?.into_bytes()
    }

    fn identity(&mut self) -> Option<Identity> {
        Identity::parse(&self.bytes()?).ok()
    }
}

/// 0 means no end.
pub(super) fn end(seconds: u64) -> Option<Timestamp> {
    (seconds != 0).then(|| Timestamp::from_seconds(seconds))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn noise_is_an_error_never_a_panic(which in 0usize..60, words in proptest::collection::vec(any::<[u8; 32]>(), 0..4), data: Vec<u8>) {
            let events: Vec<_> = artefact().expect("artefact").abi.events().collect();
            let mut topics = vec![Hash(events[which % events.len()].signature().0)];
            topics.extend(words.into_iter().map(Hash));
            let _ = Event::decode(&topics, &data);
        }
    }

    #[test]
    fn every_event_of_the_contract_has_a_word_here() {
        for event in artefact().expect("artefact").abi.events() {
            let topics: Vec<Hash> = std::iter::once(Hash(event.signature().0))
                .chain(event.inputs.iter().filter(|input| input.indexed).map(|_| Hash([0; 32])))
                .collect();
            let plain: Vec<AbiToken> =
                event.inputs.iter().filter(|input| !input.indexed).map(|input| zero(&input.kind)).collect();
            let decoded = Event::decode(&topics, &ethers::abi::encode(&plain));
            assert!(decoded.is_ok(), "{}: {decoded:?}", event.name);
        }
        assert!(Event::decode(&[], &[]).is_err());
        assert!(Event::decode(&[Hash([1; 32])], &[]).is_err());
    }

    fn zero(kind: &ethers::abi::ParamType) -> AbiToken {
        use ethers::abi::ParamType;
        match kind {
            ParamType::Bool => AbiToken::Bool(false),
            ParamType::Bytes => AbiToken::Bytes(vec![0; Identity::LENGTH]),
            ParamType::Array(_) => AbiToken::Array(Vec::new()),
            ParamType::FixedBytes(size) => AbiToken::FixedBytes(vec![0; *size]),
            _ => AbiToken::Uint(0.into()),
        }
    }
}
