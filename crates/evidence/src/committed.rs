//! Seals of QBFT and IBFT 2.0, as Besu writes them: a header has those of a quorum of its validators in its extra data,
//! each over the header with its round and without the seals. Its hash covers neither round nor seals.

use std::collections::BTreeSet;
use std::fmt;

use authros_crypto::{AccountSignature, keccak256, recover_account};
use authros_model::Address;
use rlp::{Rlp, RlpStream};

use crate::form::{is_canonical, text};
use crate::header::{EXTRA, SEAL, Seals, VANITY};

/// The mix hash of such a header.
pub(crate) const MIX: [u8; 32] = *b"ctical byzantine fault tolerance";
/// Rounds tried if the seals do not fit the header's own, to say what is wrong.
const ROUNDS_TRIED: u32 = 16;

/// How validators agree.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Protocol {
    /// QBFT, of Besu and GoQuorum.
    Qbft,
    /// IBFT 2.0, of Besu.
    Ibft2,
}

impl fmt::Display for Protocol {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Qbft => "QBFT",
            Self::Ibft2 => "IBFT 2.0",
        })
    }
}

/// Why the seals in a header are not those of such a block.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the variants and their messages name the fields")]
pub enum Flaw {
    /// Fewer than two thirds of the validators it names.
    #[error("its header has the seals of {have} of the {named} validators that it names, and {needed} are needed")]
    TooFew { have: usize, named: usize, needed: usize },
    /// One seal is there twice.
    #[error("{0} has sealed its header twice")]
    Twice(Address),
    /// The seals were made in another round.
    #[error("its seals are of round {sealed}, and its header says round {said}")]
    Round { said: u32, sealed: u32 },
    /// A seal fits no validator.
    #[error("a seal in its header is of no validator that it names: it was altered after it was sealed")]
    Altered,
}

/// Two thirds of a number of validators, rounded up: so many have to seal a block.
pub(crate) fn two_thirds(validators: usize) -> usize {
    validators.saturating_mul(2).div_ceil(3)
}

/// The extra data of such a header.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Committed {
    /// The protocol.
    pub protocol: Protocol,
    /// The validators that it names; none if a contract of the network keeps them.
    pub validators: Vec<Address>,
    /// The round in which they agreed.
    pub round: u32,
    seals: Vec<[u8; SEAL]>,
    /// The header, RLP.
    header: Vec<u8>,
}

impl Committed {
    /// From a header's RLP and its extra data: vanity, validators, vote, round, seals. A missing vote is an empty list
    /// under QBFT, and empty under IBFT 2.0; a round is a number under QBFT, and four bytes under IBFT 2.0.
    pub(crate) fn parse(header: &[u8], extra: &[u8]) -> Option<Self> {
        let list = Rlp::new(extra);
        if !is_canonical(extra) || list.item_count().ok()? != 5 || text(&list.at(0).ok()?)?.len() != VANITY {
            return None;
        }
        let (vote, round) = (list.at(2).ok()?, text(&list.at(3).ok()?)?);
        let without = vote.is_list() && vote.item_count().ok()? == 0;
        let (protocol, digits) = match round {
            [0, digits @ ..] if digits.len() == 3 && !without => (Protocol::Ibft2, digits),
            [0, ..] => return None,
            digits if digits.len() <= 3 && vote.is_list() => (Protocol::Qbft, digits),
            _ => return None,
        };
        let round = digits.iter().fold(0, |number, digit| (number << 8) | u32::from(*digit));
        let address = |item: Rlp<'_>| Some(Address(text(&item)?.try_into().ok()?));
        let seal = |item: Rlp<'_>| text(&item)?.try_into().ok();
        let (validators, seals) = (list.at(1).ok()?, list.at(4).ok()?);
        if !validators.is_list() || !seals.is_list() {
            return None;
        }
        Some(Self {
            protocol,
            validators: validators.iter().map(address).collect::<Option<_>>()?,
            round,
            seals: seals.iter().map(seal).collect::<Option<_>>()?,
            header: header.to_vec(),
        })
    }

    /// The block's hash: without seals, and without the round or with 0 as its round.
    pub(crate) fn block_hash(&self) -> Option<[u8; 32]> {
        self.hash(match self.protocol {
            Protocol::Qbft => Some(0),
            Protocol::Ibft2 => None,
        })
    }

    /// The header's hash with another round in its extra data, or none, and without seals.
    fn hash(&self, round: Option<u32>) -> Option<[u8; 32]> {
        let header = Rlp::new(&self.header);
        let extra = text(&header.at(EXTRA).ok()?)?;
        let list = Rlp::new(extra);
        let items = match (self.protocol, round) {
            (_, None) => 3,
            (Protocol::Ibft2, Some(_)) => 4,
            (Protocol::Qbft, Some(_)) => 5,
        };
        let mut unsealed = RlpStream::new_list(items);
        for at in 0..3 {
            unsealed.append_raw(list.at(at).ok()?.as_raw(), 1);
        }
        match (self.protocol, round) {
            (_, None) => {}
            (Protocol::Qbft, Some(round)) => {
                unsealed.append(&round).begin_list(0);
            }
            (Protocol::Ibft2, Some(round)) => {
                unsealed.append(&&round.to_be_bytes()[..]);
            }
        }
        with_extra(&header, &unsealed.out())
    }

    /// The hash that its validators signed.
    pub fn signed(&self) -> Option<[u8; 32]> {
        self.hash(Some(self.round))
    }

    /// How many seals it has.
    pub(crate) fn count(&self) -> usize {
        self.seals.len()
    }

    /// The pinned among those who sealed it.
    pub(crate) fn seals(&self, pinned: &[Address]) -> Seals {
        let mut found = Seals { committed: Some(self.protocol), ..Seals::default() };
        match self.sealers(pinned) {
            Ok(sealers) => {
                found.stranger = sealers.iter().find(|sealer| !pinned.contains(sealer)).copied();
                found.pinned = sealers.into_iter().filter(|sealer| pinned.contains(sealer)).collect();
            }
            Err(flaw) => found.flaw = Some(flaw),
        }
        found
    }

    /// Who sealed it.
    fn sealers(&self, pinned: &[Address]) -> Result<BTreeSet<Address>, Flaw> {
        let signed = self.signed().ok_or(Flaw::Altered)?;
        let mut sealers = BTreeSet::new();
        for seal in &self.seals {
            let sealer = recovered(&signed, seal).filter(|sealer| {
                // Nothing tells a stranger from an altered header if it names no validators.
                self.validators.is_empty() || self.validators.contains(sealer)
            });
            let sealer = sealer.ok_or_else(|| self.misfit(seal, &self.validators))?;
            if !sealers.insert(sealer) {
                return Err(Flaw::Twice(sealer));
            }
        }
        let (have, named) = (sealers.len(), self.validators.len());
        let needed = two_thirds(named);
        if have < needed {
            return Err(Flaw::TooFew { have, named, needed });
        }
        match self.seals.first() {
            Some(seal) if self.validators.is_empty() && !sealers.iter().any(|sealer| pinned.contains(sealer)) => {
                match self.misfit(seal, pinned) {
                    flaw @ Flaw::Round { .. } => Err(flaw),
                    Flaw::TooFew { .. } | Flaw::Twice(_) | Flaw::Altered => Ok(sealers),
                }
            }
            _ => Ok(sealers),
        }
    }

    /// Why a seal is by none of these: it was made in another round, or its header was altered.
    fn misfit(&self, seal: &[u8; SEAL], those: &[Address]) -> Flaw {
        let made = |round: &u32| {
            let sealer = self.hash(Some(*round)).and_then(|signed| recovered(&signed, seal));
            sealer.is_some_and(|sealer| those.contains(&sealer))
        };
        let sealed = (0..=ROUNDS_TRIED).filter(|round| *round != self.round).find(made);
        sealed.map_or(Flaw::Altered, |sealed| Flaw::Round { said: self.round, sealed })
    }
}

/// The validators that the extra data of a header names: under QBFT and IBFT 2.0, and under the first IBFT, whose list
/// follows the vanity. None if it is of another consensus, or a contract of the network keeps them.
pub fn validators_in(extra: &[u8]) -> Vec<Address> {
    let address = |item: Rlp<'_>| Some(Address(text(&item)?.try_into().ok()?));
    let named = |list: &[u8], items: usize, at: usize| {
        let list = Rlp::new(list);
        let validators = list.at(at).ok().filter(Rlp::is_list)?;
        let is_such = list.is_list() && list.item_count() == Ok(items);
        if is_such { validators.iter().map(address).collect::<Option<Vec<_>>>() } else { None }
    };
    let whole = is_canonical(extra).then(|| named(extra, 5, 1)).flatten();
    let first = || {
        let rest = extra.get(VANITY..).filter(|rest| is_canonical(rest))?;
        named(rest, 3, 0)
    };
    whole.or_else(first).unwrap_or_default()
}

/// The account whose key made a seal (r, s, parity) over a hash.
pub(crate) fn recovered(signed: &[u8; 32], seal: &[u8; SEAL]) -> Option<Address> {
    let mut seal = *seal;
    let parity = seal.last_mut()?;
    *parity = parity.checked_add(27)?;
    recover_account(signed, &AccountSignature(seal)).ok()
}

/// The hash of a header with other extra data.
pub(crate) fn with_extra(header: &Rlp<'_>, extra: &[u8]) -> Option<[u8; 32]> {
    let fields = header.item_count().ok()?;
    let mut out = RlpStream::new_list(fields);
    for at in 0..fields {
        match at {
            EXTRA => out.append(&extra),
            _ => out.append_raw(header.at(at).ok()?.as_raw(), 1),
        };
    }
    Some(keccak256(&[&out.out()]))
}
