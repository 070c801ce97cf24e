//! Fixed-size byte strings, each a type of its own, written in lower-case hex.

use std::fmt;
use std::str::FromStr;

use crate::text::as_text;

/// Why a text is not the hex of a fixed-size byte string.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("expected {expected} hex characters, found {found}; write all bytes in hex, with or without 0x")]
pub struct HexError {
    pub expected: usize,
    pub found: usize,
}

/// Lower-case hex of `bytes`.
pub fn hex(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 16] = b"0123456789abcdef";
    let mut text = vec![0; bytes.len() * 2];
    for (pair, byte) in text.as_chunks_mut::<2>().0.iter_mut().zip(bytes) {
        *pair = [DIGITS[usize::from(byte >> 4)], DIGITS[usize::from(byte & 15)]];
    }
    // Its bytes are all digits.
    String::from_utf8(text).unwrap_or_default()
}

/// The bytes of a hex text, with or without `0x`; `None` if it is not hex of whole bytes.
pub fn unhex(text: &str) -> Option<Vec<u8>> {
    let text = text.strip_prefix("0x").unwrap_or(text).as_bytes();
    if !text.len().is_multiple_of(2) {
        return None;
    }
    let nibble = |digit: u8| char::from(digit).to_digit(16).and_then(|nibble| u8::try_from(nibble).ok());
    text.as_chunks::<2>().0.iter().map(|[high, low]| Some(nibble(*high)? << 4 | nibble(*low)?)).collect()
}

macro_rules! fixed_bytes {
    ($($(#[$doc:meta])* $name:ident($size:literal) $prefix:literal;)*) => {$(
        $(#[$doc])*
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub struct $name(pub [u8; $size]);

        impl $name {
            pub const LENGTH: usize = $size;

            pub fn from_slice(bytes: &[u8]) -> Option<Self> {
                bytes.try_into().ok().map(Self)
            }

            pub fn as_bytes(&self) -> &[u8] {
                &self.0
            }

            /// Lower-case hex, no prefix.
            pub fn to_hex(&self) -> String {
                hex(&self.0)
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(formatter, concat!($prefix, "{}"), self.to_hex())
            }
        }

        impl fmt::Debug for $name {
            fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(formatter, concat!(stringify!($name), "({})"), self.to_hex())
            }
        }

        impl FromStr for $name {
            type Err = HexError;

            fn from_str(text: &str) -> Result<Self, HexError> {
                let found = text.strip_prefix("0x").unwrap_or(text).len();
                unhex(text)
                    .and_then(|bytes| Self::from_slice(&bytes))
                    .ok_or(HexError { expected: $size * 2, found })
            }
        }

        as_text!($name);
        crate::layout!($name(0));
    )*};
}

fixed_bytes! {
    /// SM3 of a record's stored bytes, as kept by the chain.
    Digest(32) "";
    /// Public commitment to an epoch's key; selects an epoch, authenticates nobody.
    Token(32) "";
    /// Binds every signed, derived or hashed structure to one chain and contract.
    Domain(32) "";
    /// A 32-byte hash other than a record digest (transaction, block, code, genesis); written with 0x as in Ethereum.
    Hash(32) "0x";
    /// Pseudonym of a topic, computable only by readers.
    TopicId(16) "";
    /// Pseudonym of a type or tag, for queries.
    FilterId(8) "";
    /// Identifies one signing key in the life of one ledger file; see [`super::RecorderPrefix`].
    RecorderId(16) "";
    /// SM3 of a signer's public key.
    SignerId(32) "";
    /// Fresh randomness of one record.
    Salt(24) "";
    /// Commitment of a record to its keys.
    Commit(32) "";
    /// An SM2 public key, affine x || y.
    PublicKey(64) "";
    /// A raw SM2 signature, r || s.
    Signature(64) "";
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hex_round_trips_and_refuses_odd_and_foreign() {
        let id = TopicId([0xa5; 16]);
        assert_eq!(id.to_hex().parse::<TopicId>(), Ok(id));
        assert_eq!(format!("0x{id}").parse::<TopicId>(), Ok(id));
        assert!("a5".parse::<TopicId>().is_err());
        assert_eq!(Hash([1; 32]).to_string(), format!("0x{}", "01".repeat(32)));
        assert_eq!(Hash([1; 32]).to_string().parse::<Hash>(), Ok(Hash([1; 32])));
        assert_eq!(unhex("abc"), None);
        assert_eq!(unhex("zz"), None);
        assert_eq!(unhex("é0"), None);
    }

    #[test]
    fn hex_is_what_the_standard_library_writes_and_reads() {
        let all: Vec<u8> = (0..=255).collect();
        let written: String = all.iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(hex(&all), written);
        for text in [written.clone(), format!("0x{written}"), written.to_uppercase()] {
            assert_eq!(unhex(&text), Some(all.clone()));
        }
        for byte in 0..128u8 {
            let digit = char::from(byte);
            for text in [format!("{digit}0"), format!("7{digit}")] {
                // A sign is none of its digits.
                let expected = u8::from_str_radix(&text, 16).ok().filter(|_| digit != '+');
                assert_eq!(unhex(&text), expected.map(|byte| vec![byte]), "{text:?}");
            }
        }
        assert_eq!((hex(&[]), unhex(""), unhex("0x")), (String::new(), Some(Vec::new()), Some(Vec::new())));
    }
}
