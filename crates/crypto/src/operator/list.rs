//! The operators of a profile, as a file in its folder: magic (8), version (1), count (2), then each statement: its terms
//! and its signature (64). Each is certified by itself, so the file needs no signature of its own.

use std::path::Path;

use crate::crypto::CryptoError;
use crate::crypto::error::shown;
use crate::crypto::private_file::{read_private, write_private};
use crate::model::wire::{Reader, WireError};
use crate::model::{OperatorName, Signature};

use super::{OperatorStatement, OperatorTerms};

const MAGIC: [u8; 8] = *b"\x89AuthOps";
const VERSION: u8 = 1;
/// The most operators of a profile.
pub const MOST_OPERATORS: usize = 64;
/// The largest file accepted, bytes.
const LARGEST: usize = 16 + MOST_OPERATORS * 256;

/// The statements of a profile's operators, in the order of their making; not checked.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct OperatorList(pub Vec<OperatorStatement>);

impl OperatorList {
    /// What is stated of an operator.
    pub fn of(&self, name: &OperatorName) -> Option<&OperatorStatement> {
        self.0.iter().find(|statement| statement.terms.name == *name)
    }

    /// Reads the file; nobody if there is none.
    ///
    /// # Errors
    /// Errors of reading, and [`CryptoError::NotAKey`] if it is not such a file.
    pub fn read(path: &Path) -> Result<Self, CryptoError> {
        if !path.exists() {
            return Ok(Self::default());
        }
        let bytes = read_private(path, LARGEST)?;
        Self::parse(&bytes).map_err(|why| {
            let found = format!("it is damaged or something else ({why}); remove it and add the operators again");
            CryptoError::NotAKey { path: shown(path), wanted: "a list of operators", found }
        })
    }

    /// Replaces the file in one step.
    ///
    /// # Errors
    /// [`CryptoError::Length`] for too many, [`CryptoError::Write`].
    pub fn write(&self, path: &Path) -> Result<(), CryptoError> {
        if self.0.len() > MOST_OPERATORS {
            let allowed = "at most 64 operators";
            return Err(CryptoError::Length { what: "list of operators", found: self.0.len(), allowed });
        }
        write_private(path, &self.encode())
    }

    pub(super) fn encode(&self) -> Vec<u8> {
        let mut out = MAGIC.to_vec();
        out.push(VERSION);
        out.extend_from_slice(&u16::try_from(self.0.len()).unwrap_or(u16::MAX).to_be_bytes());
        for statement in &self.0 {
            out.extend_from_slice(&statement.terms.encode());
            out.extend_from_slice(&statement.signature.0);
        }
        out
    }

    pub(super) fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(bytes);
        if reader.array("magic")? != MAGIC {
            return Err(WireError::Value("magic"));
        }
        if reader.u8("version")? != VERSION {
            return Err(WireError::Value("version"));
        }
        let count = usize::from(reader.u16("count")?);
        if count > MOST_OPERATORS {
            return Err(WireError::Value("count"));
        }
        let mut list = Self(Vec::with_capacity(count));
        for _ in 0..count {
            let terms = OperatorTerms::parse(&mut reader)?;
            if list.of(&terms.name).is_some() {
                return Err(WireError::Value("operator's name"));
            }
            list.0.push(OperatorStatement { terms, signature: Signature(reader.array("owner's signature")?) });
        }
        reader.end()?;
        Ok(list)
    }
}
