//! The compiled contract that this program carries.

use std::sync::LazyLock;

use ethers::abi::{Abi, Function, Token};
use ethers::utils::keccak256;
use serde::Deserialize;

use super::ChainError;
use crate::model::{Hash, bytes::unhex};

const JSON: &str = include_str!("../../contracts/AuthROS.json");

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

static ARTEFACT: LazyLock<Result<Artefact, String>> = LazyLock::new(read);

fn read() -> Result<Artefact, String> {
    let file: File = serde_json::from_str(JSON).map_err(|error| format!("the contract's artefact: {error}"))?;
    let code = |text: &str| unhex(text).ok_or_else(|| "the contract's artefact holds no hex".to_owned());
    Ok(Artefact {
        creation: code(&file.bytecode)?,
        code_hash: Hash(keccak256(code(&file.deployed_bytecode)?)),
        abi: file.abi,
    })
}

/// The artefact.
///
/// # Errors
/// [`ChainError::Internal`] where the file built into the program is broken.
pub fn artefact() -> Result<&'static Artefact, ChainError> {
    ARTEFACT.as_ref().map_err(|error| ChainError::Internal(error.clone()))
}

impl Artefact {
    /// A function of the contract.
    ///
    /// # Errors
    /// [`ChainError::Internal`] where there is none of that name.
    pub fn function(&self, name: &str) -> Result<&Function, ChainError> {
        self.abi.function(name).map_err(|error| ChainError::Internal(format!("{name}: {error}")))
    }

    /// Call data of a function.
    ///
    /// # Errors
    /// [`ChainError::Internal`] where name or arguments do not fit the ABI.
    pub fn encode(&self, name: &str, arguments: &[Token]) -> Result<Vec<u8>, ChainError> {
        let encoded = self.function(name)?.encode_input(arguments);
        encoded.map_err(|error| ChainError::Internal(format!("{name}: {error}")))
    }

    /// The first topic of an event.
    ///
    /// # Errors
    /// [`ChainError::Internal`] where there is none of that name.
    pub fn event_signature(&self, name: &str) -> Result<Hash, ChainError> {
        let event = self.abi.event(name).map_err(|error| ChainError::Internal(format!("{name}: {error}")))?;
        Ok(Hash(event.signature().0))
    }

    /// Creation code with the constructor's argument: whether registration is open.
    ///
    /// # Errors
    /// [`ChainError::Internal`] where the artefact has no constructor.
    pub fn creation(&self, open: bool) -> Result<Vec<u8>, ChainError> {
        let constructor = self.abi.constructor().ok_or_else(|| ChainError::Internal("no constructor".into()))?;
        let code = constructor.encode_input(self.creation.clone(), &[Token::Bool(open)]);
        code.map_err(|error| ChainError::Internal(format!("constructor: {error}")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;
    use std::process::Command;

    #[test]
    fn artefact_is_for_old_evms_and_small_enough() {
        let artefact = artefact().expect("artefact");
        let file: serde_json::Value = serde_json::from_str(JSON).expect("JSON");
        assert!(file["compiler"].as_str().expect("compiler").starts_with("0.7.6"));
        assert!(artefact.creation.len() < 24_576);
    }

    #[test]
    fn artefact_recompiles() {
        let Some(solc) = std::env::var_os("AUTHROS_SOLC") else {
            println!("SKIPPED artefact_recompiles: AUTHROS_SOLC names no folder of the npm module solc 0.7.6");
            return;
        };
        let script = Path::new(file!()).with_file_name("../../contracts/compile.mjs");
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let output = Command::new("node").arg(root.join(script)).arg("--check").arg(solc).output().expect("node runs");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
}
