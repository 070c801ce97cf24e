//! An Ethereum externally owned account (EOA), shown in EIP-55 checksum form.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Deserializer, Serialize, Serializer};
use sha3::{Digest as _, Keccak256};

use super::bytes::{hex, unhex};

/// Why a text is not an address.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum AddressError {
    /// Not 20 bytes of hex.
    #[error("an address is 0x and 40 hex characters; copy it from `authros identity show`")]
    Shape,
    /// Mixed case that does not match EIP-55: a mistyped character.
    #[error("the address checksum (EIP-55) does not match, so a character is wrong; copy the address again")]
    Checksum,
}

/// The 20 bytes of an EOA or contract address.
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

    /// From a slice of exactly 20 bytes.
    pub fn from_slice(bytes: &[u8]) -> Option<Self> {
        bytes.try_into().ok().map(Self)
    }

    /// The bytes.
    pub fn as_bytes(&self) -> &[u8] {
        &self.0
    }

    /// `0x1234…`: for files given to others, so that they cannot link the content to an account.
    pub fn redacted(&self) -> String {
        format!("{}…", self.to_string().get(..6).unwrap_or_default())
    }

    /// `0x1234…abcd`, for narrow columns.
    pub fn short(&self) -> String {
        let text = self.to_string();
        format!("{}…{}", &text[..6], &text[38..])
    }
}

/// The text with every address in it [`Address::redacted`]; hashes and keys, which are longer, are left alone.
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
        // Not twice: below, another 0x would be passed over.
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

impl Serialize for Address {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for Address {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(serde::de::Error::custom)
    }
}

#[cfg(test)]
mod tests {
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
