//! The subject of a command: an address, or a name from the address book.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::{Address, clean};

/// Why a text names no party.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PartyError {
    /// It is not an address book name.
    #[error(
        "'{0}' is not a valid name; use 1 to 40 letters, digits, '.', '-' and '_', starting with a letter, or an \
         address"
    )]
    Name(String),
    /// It begins like an address but is not one.
    #[error(transparent)]
    Address(#[from] super::address::AddressError),
}

/// A name in the address book of a home; never on the chain.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ContactName(String);

impl ContactName {
    /// The name.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl FromStr for ContactName {
    type Err = PartyError;

    fn from_str(text: &str) -> Result<Self, PartyError> {
        let inner = |b: u8| b.is_ascii_alphanumeric() || b"._-".contains(&b);
        let begins = text.bytes().next().is_some_and(|first| first.is_ascii_alphabetic());
        let valid = begins && text.len() <= 40 && text.bytes().all(inner);
        if valid { Ok(Self(text.to_owned())) } else { Err(PartyError::Name(clean(text, 40))) }
    }
}

impl fmt::Display for ContactName {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.0)
    }
}

/// An account, by address or by its name in the address book.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Party {
    /// By its address.
    Address(Address),
    /// By its name.
    Contact(ContactName),
}

impl Party {
    /// The name, or the shortened address for narrow columns.
    pub fn short(&self) -> String {
        self.address().map_or_else(|| self.to_string(), |address| address.short())
    }

    /// The address, if it was given as one.
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

macro_rules! as_text {
    ($($type:ty),*) => {$(
        impl Serialize for $type {
            fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.collect_str(self)
            }
        }

        impl<'de> Deserialize<'de> for $type {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                String::deserialize(deserializer)?.parse().map_err(serde::de::Error::custom)
            }
        }
    )*};
}
as_text!(ContactName, Party);

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
