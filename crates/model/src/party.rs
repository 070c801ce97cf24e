//! Who: addresses, identities, parties and their names, profiles and operators.

use std::collections::BTreeSet;
use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use sha3::{Digest as _, Keccak256};

use crate::bytes::{PublicKey, Signature, Token, hex, unhex};
use crate::clean;
use crate::text::{as_text, is_name, names};

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PartyError {
    #[error(
        "'{0}' is not a valid name; use 1 to 40 letters, digits, '.', '-' and '_', starting with a letter, or an \
         address"
    )]
    Name(String),
    #[error(transparent)]
    Address(#[from] AddressError),
}

/// A name in the address book of a home; never on the chain.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ContactName(String);

/// An account, by address or by its name in the address book.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Party {
    Address(Address),
    Contact(ContactName),
}

impl Party {
    /// For narrow columns.
    pub fn short(&self) -> String {
        self.address().map_or_else(|| self.to_string(), |address| address.short())
    }

    pub fn address(&self) -> Option<Address> {
        match self {
            Self::Address(address) => Some(*address),
            Self::Contact(_) => None,
        }
    }
}

impl From<Address> for Party {
    fn from(address: Address) -> Self {
        Self::Address(address)
    }
}

impl FromStr for Party {
    type Err = PartyError;

    fn from_str(text: &str) -> Result<Self, PartyError> {
        let hex = text.len() == 40 && text.bytes().all(|b| b.is_ascii_hexdigit());
        // A mistyped address must not be looked up as a name.
        if hex || text.is_empty() || text.starts_with(|first: char| first.is_ascii_digit()) {
            return Ok(Self::Address(text.parse()?));
        }
        text.parse().map(Self::Contact)
    }
}

impl fmt::Display for Party {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Address(address) => address.fmt(formatter),
            Self::Contact(name) => name.fmt(formatter),
        }
    }
}

names! {
    ContactName: |text| {
        is_name(text, 40, |b| b.is_ascii_alphabetic(), |b| b.is_ascii_alphanumeric() || b"._-".contains(&b))
    }, else PartyError by |text| PartyError::Name(clean(text, 40));
    OperatorName: |text| {
        let begins = |b: u8| b.is_ascii_alphanumeric() || b == b'_';
        is_name(text, LONGEST, begins, |b| begins(b) || b".-+@$\\".contains(&b))
    }, else OperatorNameError by |text| OperatorNameError(clean(text, LONGEST));
    ProfileName: |text| {
        let fits = |b: u8| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'-' || b == b'_';
        is_name(text, 32, |b| b.is_ascii_lowercase(), fits)
    }, else ProfileNameError by |text| ProfileNameError(clean(text, 40));
}
as_text!(ContactName, Party, Address, ProfileName);
crate::layout!(Address(0));
crate::body!(Identity);
crate::layout!(Identity { token: "token", signing: "signing key", envelope: "envelope key", proof: "proof" });

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum AddressError {
    #[error("an address is 0x and 40 hex characters; copy it from `authros identity show`")]
    Shape,
    /// Mixed case that does not match EIP-55: a mistyped character.
    #[error("the address checksum (EIP-55) does not match, so a character is wrong; copy the address again")]
    Checksum,
}

#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Address(pub [u8; 20]);

impl Address {
    /// The address for an uncompressed secp256k1 public key (x || y, 64 bytes).
    pub fn from_public_key(point: &[u8; 64]) -> Self {
        let hash = Keccak256::digest(point);
        let mut bytes = [0; 20];
        bytes.copy_from_slice(&hash[12..]);
        Self(bytes)
    }

    pub fn from_slice(bytes: &[u8]) -> Option<Self> {
        bytes.try_into().ok().map(Self)
    }

    pub fn as_bytes(&self) -> &[u8] {
        &self.0
    }

    /// `0x1234…`: for files given to others, who must not link the content to an account.
    pub fn redacted(&self) -> String {
        format!("{}…", self.to_string().get(..6).unwrap_or_default())
    }

    /// `0x1234…abcd`, for narrow columns.
    pub fn short(&self) -> String {
        let text = self.to_string();
        format!("{}…{}", &text[..6], &text[38..])
    }
}

/// With every address [`Address::redacted`]; hashes and keys, which are longer, stay.
pub fn redact_addresses(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(at) = rest.find("0x") {
        let (before, from) = rest.split_at(at);
        let digits = from.bytes().skip(2).take_while(u8::is_ascii_hexdigit).count();
        let whole = from.get(..2 + digits).unwrap_or(from);
        out.push_str(before);
        match (digits, whole.get(..6)) {
            (40, Some(first)) => {
                out.push_str(first);
                out.push('…');
            }
            _ => out.push_str(whole),
        }
        rest = from.get(whole.len()..).unwrap_or_default();
    }
    out.push_str(rest);
    out
}

impl fmt::Display for Address {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let lower = hex(&self.0);
        let hash = Keccak256::digest(lower.as_bytes());
        let mixed: String = lower
            .char_indices()
            .map(|(index, character)| {
                let nibble = hash[index / 2] >> (4 * (1 - index % 2)) & 15;
                if nibble >= 8 { character.to_ascii_uppercase() } else { character }
            })
            .collect();
        write!(formatter, "0x{mixed}")
    }
}

impl fmt::Debug for Address {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "Address({self})")
    }
}

impl FromStr for Address {
    type Err = AddressError;

    fn from_str(text: &str) -> Result<Self, AddressError> {
        // Once only: `unhex` strips another 0x.
        let digits = text.strip_prefix("0x").filter(|digits| !digits.starts_with("0x")).ok_or(AddressError::Shape)?;
        let bytes = unhex(digits).ok_or(AddressError::Shape)?;
        let address = Self::from_slice(&bytes).ok_or(AddressError::Shape)?;
        let mixed = digits.bytes().any(|b| b.is_ascii_uppercase()) && digits.bytes().any(|b| b.is_ascii_lowercase());
        if mixed && address.to_string() != text {
            return Err(AddressError::Checksum);
        }
        Ok(address)
    }
}

/// `token || P_C || P_E || proof`. The contract cannot verify the proof (SM2 by d_C), so every client does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Identity {
    pub token: Token,
    /// P_C, which verifies signatures.
    pub signing: PublicKey,
    /// P_E, to which envelopes are encrypted.
    pub envelope: PublicKey,
    pub proof: Signature,
}

impl Identity {
    pub const LENGTH: usize = 224;
}

// Operators: Unix users who work at another user's site.

const LONGEST: usize = 64;

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "'{0}' is not a usable name; use 1 to 64 letters, digits and . _ - + @ $ \\, starting with a letter, a digit or _"
)]
pub struct OperatorNameError(String);

/// The name of a Unix user or group, as the user database has it.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct OperatorName(String);

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, strum::IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
#[serde(rename_all = "snake_case")]
pub enum OperatorRight {
    /// Read what needs no decryption of a message: lists, states, checks, the audit log.
    Look,
    /// Decide what is captured: watches, captures, rules, pins.
    Capture,
    /// Decide who reads: grants, extensions, revocations.
    Grant,
}

crate::words!(OperatorRight);

#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct OperatorRights(BTreeSet<OperatorRight>);

impl OperatorRights {
    pub fn has(&self, right: OperatorRight) -> bool {
        self.0.contains(&right)
    }

    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    pub fn add(&mut self, others: &Self) {
        self.0.extend(&others.0);
    }
}

impl FromIterator<OperatorRight> for OperatorRights {
    fn from_iter<Rights: IntoIterator<Item = OperatorRight>>(rights: Rights) -> Self {
        Self(rights.into_iter().collect())
    }
}

impl fmt::Display for OperatorRights {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let words: Vec<&str> = self.0.iter().map(|right| right.word()).collect();
        formatter.write_str(&words.join(","))
    }
}

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("'{0}' is not a valid profile name; use 1 to 32 characters from a-z, 0-9, - and _, starting with a letter")]
pub struct ProfileNameError(String);

/// A profile's name on this machine; never on the chain.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ProfileName(String);

impl Default for ProfileName {
    fn default() -> Self {
        Self("default".to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn what_is_shown_is_read_again_and_noise_is_refused_or_shown_as_it_is(text in "\\PC{0,50}", bytes: [u8; 20]) {
            let party = Party::Address(Address(bytes));
            prop_assert_eq!(party.to_string().parse::<Party>(), Ok(party));
            if let Ok(party) = text.parse::<Party>() && party.address().is_none() {
                prop_assert_eq!(party.to_string(), text);
            }
        }
    }

    #[test]
    fn a_mistyped_address_is_no_name() {
        let address = Address([0xab; 20]).to_string();
        assert_eq!(address.parse(), Ok(Party::Address(Address([0xab; 20]))));
        for bad in [&address[..41], &address.to_uppercase(), "0x12", "", "1abc", "a b", "a/b", "-x", "\u{202e}a"] {
            assert!(bad.parse::<Party>().is_err(), "{bad}");
        }
        assert!(matches!("Bob.from-Lab_2".parse(), Ok(Party::Contact(_))));
        assert!("a".repeat(41).parse::<Party>().is_err());
    }
}

#[cfg(test)]
mod address_tests {
    use super::*;

    #[test]
    fn eip55_examples() {
        for text in ["0x5aAeb6053F3E94C9b9A09f33669435E7Ef1BeAed", "0xfB6916095ca1df60bB79Ce92cE3Ea74c37c5d359"] {
            let address: Address = text.parse().expect("valid");
            assert_eq!(address.to_string(), text);
            assert_eq!(text.to_lowercase().parse(), Ok(address));
        }
    }

    #[test]
    fn one_wrong_case_is_a_checksum_error() {
        let text = "0x5aAeb6053F3E94C9b9A09f33669435E7Ef1Beaed";
        assert_eq!(text.parse::<Address>(), Err(AddressError::Checksum));
        assert_eq!("0x12".parse::<Address>(), Err(AddressError::Shape));
        assert_eq!("hello".parse::<Address>(), Err(AddressError::Shape));
        assert_eq!(format!("0x{}", text.to_lowercase()).parse::<Address>(), Err(AddressError::Shape), "0x twice");
    }
}

#[cfg(test)]
mod identity_tests {
    use super::*;

    #[test]
    fn exactly_224_bytes() {
        let bytes: Vec<u8> = (0..224).map(|i| u8::try_from(i).unwrap_or(0)).collect();
        let identity = Identity::parse(&bytes).expect("parses");
        assert_eq!(identity.encode(), bytes);
        assert!(Identity::parse(&bytes[1..]).is_err());
        assert!(Identity::parse(&[bytes.clone(), vec![0]].concat()).is_err());
    }
}

#[cfg(test)]
mod operator_tests {
    use super::*;

    #[test]
    fn a_name_cannot_hide_a_slash_or_a_space() {
        for good in ["bob", "night-shift_2", "Bob", "alice@corp.example", "CORP\\bob", "robot$"] {
            assert_eq!(good.parse::<OperatorName>().expect(good).as_str(), good);
        }
        for bad in ["", "@robotics", "-bob", "alice/bob", "b ob", "b\u{1b}[2J", "b,c", "käthe", &"a".repeat(65)] {
            let refused = bad.parse::<OperatorName>().expect_err(bad).to_string();
            assert!(!refused.contains('\u{1b}'), "{refused:?}");
        }
    }

    #[test]
    fn rights_add_up() {
        let mut rights: OperatorRights = [OperatorRight::Grant, OperatorRight::Look].into_iter().collect();
        assert_eq!(rights.to_string(), "look,grant");
        assert!(rights.has(OperatorRight::Look) && !rights.has(OperatorRight::Capture));
        rights.add(&[OperatorRight::Look, OperatorRight::Capture].into_iter().collect());
        assert_eq!(rights.to_string(), "look,capture,grant");
        assert!(OperatorRights::default().is_empty());
    }
}

#[cfg(test)]
mod profile_tests {
    use super::*;

    #[test]
    fn names() {
        assert!("default".parse::<ProfileName>().is_ok());
        for bad in ["", "A", "../x", "a/b", "1a", "a b", &"a".repeat(33)] {
            assert!(bad.parse::<ProfileName>().is_err(), "{bad}");
        }
    }
}
