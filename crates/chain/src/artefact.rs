//! The compiled contracts built into this program: every revision that was ever in use.

use std::fmt;
use std::sync::LazyLock;

use ethers::abi::{Abi, Function, Token};
use ethers::utils::keccak256;
use serde::{Deserialize, Serialize};

use super::ChainError;
use crate::model::{Hash, bytes::unhex};

const FIRST: &str = include_str!("../../../contracts/revision1/AuthROS.json");
const SECOND: &str = include_str!("../../../contracts/AuthROS.json");

/// A revision of the contract, identified by the hash of its code.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(into = "u8", try_from = "u8")]
pub enum Revision {
    /// The first: the administrator appoints successors at once, and a pause has no end.
    First,
    /// The administrator's powers are bounded, grants can be extended.
    Second,
}

impl Revision {
    /// The one deployed by default.
    pub const NEWEST: Self = Self::Second;
}

impl From<Revision> for u8 {
    fn from(revision: Revision) -> Self {
        match revision {
            Revision::First => 1,
            Revision::Second => 2,
        }
    }
}

impl TryFrom<u8> for Revision {
    type Error = String;

    fn try_from(number: u8) -> Result<Self, String> {
        match number {
            1 => Ok(Self::First),
            2 => Ok(Self::Second),
            other => Err(format!("there is no revision {other} of the contract; choose 1 or 2")),
        }
    }
}

impl fmt::Display for Revision {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        u8::from(*self).fmt(formatter)
    }
}

/// ABI and code of one revision of AuthROS.sol.
#[derive(Debug)]
pub struct Artefact {
    /// Which one.
    pub revision: Revision,
    /// Functions and events.
    pub abi: Abi,
    /// Creation code, without the constructor's arguments.
    pub creation: Vec<u8>,
    /// Keccak-256 of the deployed code.
    pub code_hash: Hash,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct File {
    abi: Abi,
    bytecode: String,
    deployed_bytecode: String,
}

/// The newest first.
static ARTEFACTS: LazyLock<Result<[Artefact; 2], String>> =
    LazyLock::new(|| Ok([read(Revision::Second, SECOND)?, read(Revision::First, FIRST)?]));

fn read(revision: Revision, json: &str) -> Result<Artefact, String> {
    let file: File = serde_json::from_str(json).map_err(|error| format!("the contract's artefact: {error}"))?;
    let code = |text: &str| unhex(text).ok_or_else(|| "the contract's artefact is not hex".to_owned());
    Ok(Artefact {
        revision,
        creation: code(&file.bytecode)?,
        code_hash: Hash(keccak256(code(&file.deployed_bytecode)?)),
        abi: file.abi,
    })
}

/// All artefacts, the newest first.
///
/// # Errors
/// [`ChainError::Internal`] if a file built into the program is broken.
pub fn artefacts() -> Result<&'static [Artefact], ChainError> {
    ARTEFACTS.as_ref().map(<[_; 2]>::as_slice).map_err(|error| ChainError::Internal(error.clone()))
}

/// The artefact of a revision.
///
/// # Errors
/// See [`artefacts`].
pub fn artefact(revision: Revision) -> Result<&'static Artefact, ChainError> {
    the(|artefact| artefact.revision == revision, "revision")
}

/// The newest revision that has this function.
///
/// # Errors
/// [`ChainError::Internal`] if none has, or see [`artefacts`].
pub fn offering(function: &str) -> Result<&'static Artefact, ChainError> {
    the(|artefact| artefact.abi.function(function).is_ok(), function)
}

/// The newest revision that has this event.
///
/// # Errors
/// See [`offering`].
pub fn telling(event: &str) -> Result<&'static Artefact, ChainError> {
    the(|artefact| artefact.abi.event(event).is_ok(), event)
}

/// The revision whose code has this hash; `None` for any other contract.
///
/// # Errors
/// See [`artefacts`].
pub fn revision_of(code_hash: Hash) -> Result<Option<Revision>, ChainError> {
    Ok(artefacts()?.iter().find(|artefact| artefact.code_hash == code_hash).map(|artefact| artefact.revision))
}

fn the(wanted: impl Fn(&Artefact) -> bool, what: &str) -> Result<&'static Artefact, ChainError> {
    let found = artefacts()?.iter().find(|artefact| wanted(artefact));
    found.ok_or_else(|| ChainError::Internal(format!("{what} is missing from every revision of the contract")))
}

impl Artefact {
    /// A function of the contract.
    ///
    /// # Errors
    /// [`ChainError::Internal`] if there is none of that name.
    pub fn function(&self, name: &str) -> Result<&Function, ChainError> {
        self.abi.function(name).map_err(|error| ChainError::Internal(format!("{name}: {error}")))
    }

    /// Call data of a function.
    ///
    /// # Errors
    /// [`ChainError::Internal`] if name or arguments do not match the ABI.
    pub fn encode(&self, name: &str, arguments: &[Token]) -> Result<Vec<u8>, ChainError> {
        let encoded = self.function(name)?.encode_input(arguments);
        encoded.map_err(|error| ChainError::Internal(format!("{name}: {error}")))
    }

    /// The first topic of an event.
    ///
    /// # Errors
    /// [`ChainError::Internal`] if there is none of that name.
    pub fn event_signature(&self, name: &str) -> Result<Hash, ChainError> {
        let event = self.abi.event(name).map_err(|error| ChainError::Internal(format!("{name}: {error}")))?;
        Ok(Hash(event.signature().0))
    }

    /// Creation code with the constructor's arguments: whether registration is open, and from the second revision on
    /// the delay of a succession, seconds.
    ///
    /// # Errors
    /// [`ChainError::Internal`] if the artefact has no constructor.
    pub fn creation(&self, open: bool, delay: u64) -> Result<Vec<u8>, ChainError> {
        let constructor = self.abi.constructor().ok_or_else(|| ChainError::Internal("no constructor".into()))?;
        let arguments = [Token::Bool(open), Token::Uint(delay.into())];
        let taken = arguments.get(..constructor.inputs.len()).unwrap_or(&arguments);
        let code = constructor.encode_input(self.creation.clone(), taken);
        code.map_err(|error| ChainError::Internal(format!("constructor: {error}")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;
    use std::process::Command;

    #[test]
    fn artefacts_are_for_old_evms_and_small_enough() {
        for (artefact, json) in artefacts().expect("artefacts").iter().zip([SECOND, FIRST]) {
            let file: serde_json::Value = serde_json::from_str(json).expect("JSON");
            assert!(file["compiler"].as_str().expect("compiler").starts_with("0.7.6"));
            assert!(artefact.creation.len() < 24_576);
            assert_eq!(revision_of(artefact.code_hash), Ok(Some(artefact.revision)));
        }
        assert_eq!(revision_of(Hash([1; 32])), Ok(None));
    }

    /// Homes are pinned to it, so it must stay as it was at 7ed4b9f.
    #[test]
    fn the_first_revision_is_what_it_was() {
        let hash = artefact(Revision::First).expect("artefact").code_hash;
        assert_eq!(hash.to_hex(), "c3a4be2839b5e632f8755ae0700ee32f8713c8fb1c3c4d9e4c3c7909d4fb3ee5");
    }

    #[test]
    fn a_revision_is_a_number() {
        for revision in [Revision::First, Revision::Second] {
            assert_eq!(Revision::try_from(u8::from(revision)), Ok(revision));
        }
        assert!(Revision::try_from(3).is_err());
    }

    #[test]
    fn artefact_recompiles() {
        let Some(solc) = std::env::var_os("AUTHROS_SOLC") else {
            println!("SKIPPED artefact_recompiles: AUTHROS_SOLC names no folder of the npm module solc 0.7.6");
            return;
        };
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../contracts/compile.mjs");
        let output = Command::new("node").arg(script).arg("--check").arg(solc).output().expect("node runs");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
}
