//! Operators: people who work at a site with keys of their own, under rights that its owner signed.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::clean;

/// Why a text is not the name of an operator, or not a list of rights.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum OperatorError {
    /// Not a name.
    #[error(
        "'{0}' is not a valid operator name; use 1 to 32 characters from a-z, 0-9, - and _, starting with a letter"
    )]
    Name(String),
    /// Not rights.
    #[error("'{0}' is not a right of an operator; give look, capture or grant, separated by commas")]
    Right(String),
}

/// An operator's name at a profile: 1 to 32 of a-z, 0-9, `-` and `_`, starting with a letter.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct OperatorName(String);

impl OperatorName {
    /// The name.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl FromStr for OperatorName {
    type Err = OperatorError;

    fn from_str(text: &str) -> Result<Self, OperatorError> {
        let body = |b: u8| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'-' || b == b'_';
        let begins = text.bytes().next().is_some_and(|first| first.is_ascii_lowercase());
        let valid = begins && text.len() <= 32 && text.bytes().all(body);
        if valid { Ok(Self(text.to_owned())) } else { Err(OperatorError::Name(clean(text, 40))) }
    }
}

impl fmt::Display for OperatorName {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.0)
    }
}

impl Serialize for OperatorName {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for OperatorName {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(serde::de::Error::custom)
    }
}

/// A right that an operator may have.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OperatorRight {
    /// Read what needs no decryption of a message: lists, states, checks, the audit log.
    Look,
    /// Decide what is captured: watches, captures, rules, pins.
    Capture,
    /// Decide who reads: grants, extensions, revocations.
    Grant,
}

impl OperatorRight {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Look, Self::Capture, Self::Grant];

    /// Its word.
    pub fn word(self) -> &'static str {
        match self {
            Self::Look => "look",
            Self::Capture => "capture",
            Self::Grant => "grant",
        }
    }

    fn bit(self) -> u8 {
        match self {
            Self::Look => 1,
            Self::Capture => 2,
            Self::Grant => 4,
        }
    }
}

/// The rights of an operator: at least one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OperatorRights(u8);

impl OperatorRights {
    /// From their encoding, one bit each: look 1, capture 2, grant 4. `None` for no right or an unknown one.
    pub fn from_bits(bits: u8) -> Option<Self> {
        (1..=7).contains(&bits).then_some(Self(bits))
    }

    /// Their encoding.
    pub fn bits(self) -> u8 {
        self.0
    }

    /// Whether one of them is this.
    pub fn has(self, right: OperatorRight) -> bool {
        self.0 & right.bit() != 0
    }
}

impl FromStr for OperatorRights {
    type Err = OperatorError;

    fn from_str(text: &str) -> Result<Self, OperatorError> {
        let wrong = |word: &str| OperatorError::Right(clean(word, 40));
        let mut bits = 0;
        for word in text.split(',').map(str::trim) {
            let right = OperatorRight::ALL.into_iter().find(|right| right.word() == word);
            bits |= right.ok_or_else(|| wrong(word))?.bit();
        }
        Self::from_bits(bits).ok_or_else(|| wrong(text))
    }
}

impl fmt::Display for OperatorRights {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let words: Vec<&str> =
            OperatorRight::ALL.into_iter().filter(|right| self.has(*right)).map(OperatorRight::word).collect();
        formatter.write_str(&words.join(","))
    }
}

impl Serialize for OperatorRights {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for OperatorRights {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(serde::de::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_cannot_hide_a_slash_or_a_space() {
        for good in ["bob", "night-shift_2"] {
            assert_eq!(good.parse::<OperatorName>().expect(good).as_str(), good);
        }
        for bad in ["", "Bob", "1bob", "alice/bob", "b ob", "b\u{1b}[2J", &"a".repeat(33)] {
            let refused = bad.parse::<OperatorName>().expect_err(bad).to_string();
            assert!(!refused.contains('\u{1b}'), "{refused:?}");
        }
    }

    #[test]
    fn rights_are_words_and_bits() {
        let rights: OperatorRights = "grant, look".parse().expect("two rights");
        assert_eq!((rights.to_string(), rights.bits()), ("look,grant".to_owned(), 5));
        assert!(rights.has(OperatorRight::Look) && !rights.has(OperatorRight::Capture));
        assert!("".parse::<OperatorRights>().is_err() && "look,all".parse::<OperatorRights>().is_err());
        assert!(OperatorRights::from_bits(0).is_none() && OperatorRights::from_bits(8).is_none());
        let text = serde_json::to_string(&rights).expect("json");
        assert_eq!(serde_json::from_str::<OperatorRights>(&text).expect("read"), rights);
    }
}
