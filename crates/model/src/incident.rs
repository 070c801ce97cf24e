//! Names of incidents: spans of time and topics that an operator keeps together.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::clean;

/// Why a text is not a valid name of an incident.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("'{0}' is not a valid name; use 1 to 64 letters, digits, '.', '-' and '_', starting with a letter or a digit")]
pub struct IncidentNameError(String);

/// An incident's name, given by its owner: 1 to 64 ASCII letters, digits, `.`, `-` and `_`.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct IncidentName(String);

impl IncidentName {
    /// The longest, bytes.
    pub const LONGEST: usize = 64;

    /// The name.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl FromStr for IncidentName {
    type Err = IncidentNameError;

    fn from_str(text: &str) -> Result<Self, IncidentNameError> {
        let inner = |b: u8| b.is_ascii_alphanumeric() || b"._-".contains(&b);
        let begins = text.bytes().next().is_some_and(|first| first.is_ascii_alphanumeric());
        let valid = begins && text.len() <= Self::LONGEST && text.bytes().all(inner);
        if valid { Ok(Self(text.to_owned())) } else { Err(IncidentNameError(clean(text, Self::LONGEST))) }
    }
}

impl fmt::Display for IncidentName {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.0)
    }
}

impl Serialize for IncidentName {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for IncidentName {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(serde::de::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_short_and_plain_or_it_is_refused_with_its_text_cleaned() {
        let long = "a".repeat(64);
        for good in ["crash", "2026-11-21_bay.3", long.as_str()] {
            let name: IncidentName = good.parse().expect(good);
            assert_eq!((name.as_str(), name.to_string()), (good, good.to_owned()));
        }
        let longer = "a".repeat(65);
        for bad in ["", "-a", ".a", "a b", "a/b", "ä", "a\u{1b}[2J", "a:b", "a\0", longer.as_str()] {
            let refused = bad.parse::<IncidentName>().expect_err(bad).to_string();
            assert!(!refused.contains(['\u{1b}', '\0']), "{refused:?}");
        }
        assert!(serde_json::from_str::<IncidentName>("\"../x\"").is_err());
    }
}
