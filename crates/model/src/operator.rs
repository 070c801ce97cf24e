//! Operators: Unix users who work at somebody else's site, with the rights that its owner gave them.

use std::collections::BTreeSet;
use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::clean;

/// The longest name, characters.
const LONGEST: usize = 64;

/// A text is not the name of a user or a group.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "'{0}' is not a usable name; use 1 to 64 letters, digits and . _ - + @ $ \\, starting with a letter, a digit or _"
)]
pub struct OperatorNameError(String);

/// The name of a Unix user or group, as the user database has it.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct OperatorName(String);

impl OperatorName {
    /// The name.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl FromStr for OperatorName {
    type Err = OperatorNameError;

    fn from_str(text: &str) -> Result<Self, OperatorNameError> {
        let begins = |b: u8| b.is_ascii_alphanumeric() || b == b'_';
        let body = |b: u8| begins(b) || b".-+@$\\".contains(&b);
        let valid = text.len() <= LONGEST && text.bytes().next().is_some_and(begins) && text.bytes().all(body);
        if valid { Ok(Self(text.to_owned())) } else { Err(OperatorNameError(clean(text, LONGEST))) }
    }
}

impl fmt::Display for OperatorName {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.0)
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
    /// Its word.
    pub fn word(self) -> &'static str {
        match self {
            Self::Look => "look",
            Self::Capture => "capture",
            Self::Grant => "grant",
        }
    }
}

/// The rights of an operator.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct OperatorRights(BTreeSet<OperatorRight>);

impl OperatorRights {
    /// Whether one of them is this.
    pub fn has(&self, right: OperatorRight) -> bool {
        self.0.contains(&right)
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Adds those of another rule.
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

#[cfg(test)]
mod tests {
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
