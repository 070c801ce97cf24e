//! The compiled contract built into this program.

use std::sync::LazyLock;

use ethers::abi::{Abi, Function, Token};
use ethers::utils::keccak256;
use serde::Deserialize;

use super::ChainError;
use crate::model::{Hash, bytes::unhex};

const ARTEFACT: &str = include_str!("../../../contracts/AuthROS.json");

/// ABI and code of AuthROS.sol.
#[derive(Debug)]
pub struct Artefact {
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

static READ: LazyLock<Result<Artefact, String>> = LazyLock::new(|| read(ARTEFACT));

fn read(json: &str) -> Result<Artefact, String> {
    let file: File = serde_json::from_str(json).map_err(|error| format!("the contract's artefact: {error}"))?;
    let code = |text: &str| unhex(text).ok_or_else(|| "the contract's artefact is not hex".to_owned());
    Ok(Artefact {
        creation: code(&file.bytecode)?,
        code_hash: Hash(keccak256(code(&file.deployed_bytecode)?)),
        abi: file.abi,
    })
}

/// The artefact.
///
/// # Errors
/// [`ChainError::Internal`] if the file built into the program is broken.
pub fn artefact() -> Result<&'static Artefact, ChainError> {
    READ.as_ref().map_err(|error| ChainError::Internal(error.clone()))
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

    /// Creation code with the constructor's arguments: whether registration is open, and the delay of a succession,
    /// seconds.
    ///
    /// # Errors
    /// [`ChainError::Internal`] if the artefact has no constructor.
    pub fn creation(&self, open: bool, delay: u64) -> Result<Vec<u8>, ChainError> {
        let constructor = self.abi.constructor().ok_or_else(|| ChainError::Internal("no constructor".into()))?;
        let arguments = [Token::Bool(open), Token::Uint(delay.into())];
        let code = constructor.encode_input(self.creation.clone(), &arguments);
        code.map_err(|error| ChainError::Internal(format!("constructor: {error}")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;
    use std::process::Command;

    #[test]
    fn the_artefact_is_for_old_evms_and_small_enough() {
        let file: serde_json::Value = serde_json::from_str(ARTEFACT).expect("JSON");
        assert!(file["compiler"].as_str().expect("compiler").starts_with("0.7.6"));
        assert!(artefact().expect("artefact").creation.len() < 24_576);
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
